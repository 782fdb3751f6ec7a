"""Floor 4, study: questions asked of many equilibria at once."""

from .sweep import Sweep, sweep

__all__ = ["Sweep", "sweep"]
