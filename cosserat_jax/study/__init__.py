"""Floor 4, study: questions asked of many equilibria at once."""

from .actuate import Actuation, actuate, with_tensions
from .calibration import Calibration
from .fit import fit
from .measurements import Measurements, read_measurements
from .sweep import Sweep, sweep

__all__ = [
    "Actuation", "Calibration", "Measurements", "Sweep", "actuate", "fit", "read_measurements", "sweep",
    "with_tensions",
]  # fmt: skip
