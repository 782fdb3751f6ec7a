"""The figures, ready to print: lengths and loads with units, arms at equal aspect."""

from .actuation import actuation_figure, animation_suffixes, save_animation
from .calibration import calibration_figure
from .inverse import reach_figure, workspace_figure
from .sweep import solve_figure, sweep_figure

__all__ = [
    "actuation_figure", "animation_suffixes", "calibration_figure", "reach_figure", "save_animation", "solve_figure",
    "sweep_figure", "workspace_figure",
]  # fmt: skip
