"""Floor 3, solve: integrate the rod with diffrax, shoot, continue in the load; integrate a muscle in time."""

from .method import Automatic, Method, MultipleShooting, SingleShooting, TimeStepping
from .outcome import Outcome, ResponseOutcome, outcome_codes
from .solution import Fields, Pose, SectionStrains, Solution
from .solve import SolveError, check_steady, solve
from .tcam_response import Peak, Response, tcam_response

__all__ = [
    "Automatic", "Fields", "Method", "MultipleShooting", "Outcome", "Peak", "Pose", "Response", "ResponseOutcome",
    "SectionStrains", "SingleShooting", "Solution", "SolveError", "TimeStepping", "check_steady", "outcome_codes",
    "solve", "tcam_response",
]  # fmt: skip
