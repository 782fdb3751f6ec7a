"""Floor 1, describe: what a user writes. Scenes, their files with units, and the paths that name their parameters."""

from ..errors import InputError
from .files import SceneFile, dumps, load_scene, presets, read, sweep_values
from .parts import Arm, Gravity, Muscle, Scene, SectionStiffness, Tip, Water
from .paths import lookup, parameters, replace, unit_of
from .quantity import Choice, Quantity
from .tcam import TCAM, ZERO_CELSIUS, LinearConductance
from .units import bounds_to_si, range_to_si, to_si
from .validate import validate_tcam
from .voltage import AbstractVoltage, Pulses, Sampled, Sinusoid, Step, VoltageFunction

__all__ = [
    "TCAM",
    "ZERO_CELSIUS",
    "AbstractVoltage",
    "Arm",
    "Choice",
    "Gravity",
    "InputError",
    "LinearConductance",
    "Muscle",
    "Pulses",
    "Quantity",
    "Sampled",
    "Scene",
    "SceneFile",
    "SectionStiffness",
    "Sinusoid",
    "Step",
    "Tip",
    "VoltageFunction",
    "Water",
    "bounds_to_si",
    "dumps",
    "load_scene",
    "lookup",
    "parameters",
    "presets",
    "range_to_si",
    "read",
    "replace",
    "sweep_values",
    "to_si",
    "unit_of",
    "validate_tcam",
]  # fmt: skip
