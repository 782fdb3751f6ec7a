"""Floor 4, study: questions asked of many equilibria at once."""

from .actuate import Actuation, actuate, with_tensions
from .reach import reach
from .reached import Reach, ReachOutcome
from .sweep import Sweep, sweep
from .workspace import Workspace, workspace

__all__ = [
    "Actuation", "Reach", "ReachOutcome", "Sweep", "Workspace", "actuate", "reach", "sweep", "with_tensions",
    "workspace",
]  # fmt: skip
