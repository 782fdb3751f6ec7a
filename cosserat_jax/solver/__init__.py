"""Floor 3, solve: integrate the rod with diffrax, shoot, continue in the load."""

from .method import Shooting
from .outcome import Outcome, outcome_codes
from .solution import Fields, Pose, SectionStrains, Solution
from .solve import SolveError, solve

__all__ = [
    "Fields",
    "Outcome",
    "Pose",
    "SectionStrains",
    "Shooting",
    "Solution",
    "SolveError",
    "outcome_codes",
    "solve",
]
