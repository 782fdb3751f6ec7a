"""Floor 4, study: questions asked of many equilibria at once."""

from .actuate import Actuation, actuate, with_tensions
from .calibration.fit import fit
from .calibration.measurements import Measurements, read_measurements
from .calibration.result import Calibration
from .calibration.sampling import bootstrap, log_density
from .inverse.reach import reach
from .inverse.result import Reach, ReachOutcome
from .inverse.workspace import Workspace, workspace
from .sweep import Sweep, sweep

__all__ = [
    "Actuation", "Calibration", "Measurements", "Reach", "ReachOutcome", "Sweep", "Workspace", "actuate",
    "bootstrap", "fit", "log_density", "reach", "read_measurements", "sweep", "with_tensions", "workspace",
]  # fmt: skip
