"""cosserat_jax: differentiable statics of soft rods that bend under muscles and water."""

import importlib.metadata

import jax

jax.config.update("jax_enable_x64", True)  # single precision would give wrong numbers, not rough ones

from .scene import (  # noqa: E402
    Arm,
    Gravity,
    Muscle,
    Scene,
    SceneError,
    SectionStiffness,
    Tip,
    Water,
    dumps,
    load,
    parameters,
    presets,
    replace,
)
from .solver import Outcome, Shooting, Solution, SolveError, solve  # noqa: E402
from .study import Sweep, sweep  # noqa: E402

__version__ = importlib.metadata.version("cosserat_jax")

__all__ = [
    "Arm", "Gravity", "Muscle", "Outcome", "Scene", "SceneError", "SectionStiffness", "Shooting", "Solution",
    "SolveError", "Sweep", "Tip", "Water", "dumps", "load", "parameters", "presets", "replace", "solve", "sweep",
]  # fmt: skip
