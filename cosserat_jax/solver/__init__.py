"""Floor 3, solve: integrate the rod with diffrax, shoot, continue in the load; integrate a muscle in time."""

from .method import Shooting, TimeStepping
from .outcome import Outcome, ResponseOutcome, outcome_codes
from .response import Peak, Response, check_times, tcam_response
from .solution import Fields, Pose, SectionStrains, Solution
from .solve import SolveError, solve

__all__ = [
    "Fields", "Outcome", "Peak", "Pose", "Response", "ResponseOutcome", "SectionStrains", "Shooting", "Solution",
    "SolveError", "TimeStepping", "check_times", "outcome_codes", "solve", "tcam_response",
]  # fmt: skip
