"""The figures, ready to print: lengths and loads with units, arms at equal aspect."""

from .actuation import actuation_figure, save_animation
from .animation import animation_suffixes
from .calibration import calibration_figure
from .inverse import reach_figure, workspace_figure
from .sweep import (
    arms_over_tension,
    solve_figure,
    sweep_figure,
    tilt_and_stretch_along,
    tip_angles,
    tractions_along,
    velocities_compared,
)

__all__ = [
    "actuation_figure", "animation_suffixes", "arms_over_tension", "calibration_figure", "reach_figure",
    "save_animation", "solve_figure", "sweep_figure", "tilt_and_stretch_along", "tip_angles", "tractions_along",
    "velocities_compared", "workspace_figure",
]  # fmt: skip
