"""cosserat_jax: differentiable statics of soft rods that bend under muscles and water."""

import importlib
import os
import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .physics.loads import AbstractLoad, DeformedSection
    from .physics.section_laws import AbstractSectionLaw, ReferenceSection, StrainEnergy
    from .physics.tcam import TCAMState, gain_from_formulas, gain_from_measurement
    from .scene import (
        TCAM,
        Arm,
        Gravity,
        InputError,
        LinearConductance,
        Muscle,
        Pulses,
        Sampled,
        Scene,
        SectionStiffness,
        Sinusoid,
        Step,
        Tip,
        VoltageFunction,
        Water,
        dumps,
        load_scene,
        parameters,
        presets,
        replace,
    )
    from .solver import (
        Automatic,
        MultipleShooting,
        Outcome,
        Response,
        ResponseOutcome,
        SingleShooting,
        Solution,
        SolveError,
        TimeStepping,
        solve,
        tcam_response,
    )
    from .study import (
        Actuation,
        Calibration,
        Measurements,
        Reach,
        ReachOutcome,
        Sweep,
        Workspace,
        actuate,
        bootstrap,
        fit,
        log_density,
        reach,
        read_measurements,
        sweep,
        workspace,
    )

    __version__: str

__all__ = [
    "TCAM",
    "AbstractLoad",
    "AbstractSectionLaw",
    "Actuation",
    "Arm",
    "Automatic",
    "Calibration",
    "DeformedSection",
    "Gravity",
    "InputError",
    "LinearConductance",
    "Measurements",
    "MultipleShooting",
    "Muscle",
    "Outcome",
    "Pulses",
    "Reach",
    "ReachOutcome",
    "ReferenceSection",
    "Response",
    "ResponseOutcome",
    "Sampled",
    "Scene",
    "SectionStiffness",
    "SingleShooting",
    "Sinusoid",
    "Solution",
    "SolveError",
    "Step",
    "StrainEnergy",
    "Sweep",
    "TCAMState",
    "TimeStepping",
    "Tip",
    "VoltageFunction",
    "Water",
    "Workspace",
    "actuate",
    "bootstrap",
    "dumps",
    "fit",
    "gain_from_formulas",
    "gain_from_measurement",
    "load_scene",
    "log_density",
    "parameters",
    "presets",
    "reach",
    "read_measurements",
    "replace",
    "solve",
    "sweep",
    "tcam_response",
    "workspace",
]  # fmt: skip

# single precision would give wrong numbers, not rough ones
if "jax" in sys.modules:
    sys.modules["jax"].config.update("jax_enable_x64", True)
else:
    os.environ["JAX_ENABLE_X64"] = "1"  # JAX reads it when it is imported

if not TYPE_CHECKING:  # a type checker would take every name for one that exists
    _FLOORS = (
        "scene",
        "physics.loads",
        "physics.section_laws",
        "physics.tcam",
        "solver",
        "study",
    )  # each imports those before it

    def __getattr__(name: str) -> Any:
        """Imports a public name when it is first used: the command line answers `--help` without waiting for JAX."""
        if name == "__version__":
            from importlib.metadata import version

            return version("cosserat_jax")
        for floor in _FLOORS if name in __all__ else ():
            module = importlib.import_module(f".{floor}", __name__)
            if hasattr(module, name):
                return globals().setdefault(name, getattr(module, name))
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

    def __dir__() -> list[str]:
        return [*globals(), *__all__, "__version__"]
