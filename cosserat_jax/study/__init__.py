"""Floor 4, study: questions asked of many equilibria at once."""

from .actuate import Actuation, actuate, with_tensions
from .calibration import Calibration
from .fit import fit
from .measurements import Measurements, read_measurements
from .reach import reach
from .reached import Reach, ReachOutcome
from .sweep import Sweep, sweep
from .workspace import Workspace, workspace

__all__ = [
    "Actuation", "Calibration", "Measurements", "Reach", "ReachOutcome", "Sweep", "Workspace", "actuate", "fit",
    "reach", "read_measurements", "sweep", "with_tensions", "workspace",
]  # fmt: skip
