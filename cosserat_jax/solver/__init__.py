"""Floor 3, solve: integrate the rod with diffrax, shoot, continue in the load; integrate a muscle in time."""

from .method import Shooting, TimeStepping
from .outcome import Outcome, ResponseOutcome, outcome_codes
from .response import Peak, Response, tcam_response
from .solution import Fields, Pose, SectionStrains, Solution
from .solve import SolveError, check_steady, needs_multiple_shooting, solve

__all__ = [
    "Fields", "Outcome", "Peak", "Pose", "Response", "ResponseOutcome", "SectionStrains", "Shooting", "Solution",
    "SolveError", "TimeStepping", "check_steady", "needs_multiple_shooting", "outcome_codes", "solve", "tcam_response",
]  # fmt: skip
