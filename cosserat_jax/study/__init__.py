"""Floor 4, study: questions asked of many equilibria at once."""

from .actuate import Actuation, actuate, with_tensions
from .sweep import Sweep, sweep

__all__ = ["Actuation", "Sweep", "actuate", "sweep", "with_tensions"]
