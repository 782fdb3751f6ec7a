"""Floor 1, describe: what a user writes. Scenes, their files with units, and the paths that name their parameters."""

from .files import SceneFile, dumps, load, presets, read, sweep_values
from .parts import Arm, Gravity, Muscle, Scene, SectionStiffness, Tip, Water
from .paths import lookup, parameters, replace, unit_of
from .quantity import Choice, Quantity, SceneError
from .units import range_to_si, to_si

__all__ = [
    "Arm", "Choice", "Gravity", "Muscle", "Quantity", "Scene", "SceneError", "SceneFile", "SectionStiffness", "Tip",
    "Water", "dumps", "load", "lookup", "parameters", "presets", "range_to_si", "read", "replace", "sweep_values",
    "to_si", "unit_of",
]  # fmt: skip
