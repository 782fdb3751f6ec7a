"""cosserat_jax: differentiable statics of soft rods that bend under muscles and water."""

import importlib.metadata

import jax

jax.config.update("jax_enable_x64", True)  # single precision would give wrong numbers, not rough ones

from .physics.loads import AbstractLoad, DeformedSection  # noqa: E402
from .physics.section_laws import AbstractSectionLaw, ReferenceSection, StrainEnergy  # noqa: E402
from .physics.tcam import TCAMState, gain_from_formulas, gain_from_measurement  # noqa: E402
from .scene import (  # noqa: E402
    TCAM,
    Arm,
    Gravity,
    LinearConductance,
    Muscle,
    Pulses,
    Sampled,
    Scene,
    SceneError,
    SectionStiffness,
    Sinusoid,
    Step,
    Tip,
    VoltageFunction,
    Water,
    dumps,
    load,
    parameters,
    presets,
    replace,
)
from .solver import (  # noqa: E402
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
from .study import (  # noqa: E402
    Actuation,
    Calibration,
    Measurements,
    Reach,
    ReachOutcome,
    Sweep,
    Workspace,
    actuate,
    fit,
    reach,
    read_measurements,
    sweep,
    workspace,
)

__version__ = importlib.metadata.version("cosserat_jax")

__all__ = [
    "TCAM", "AbstractLoad", "AbstractSectionLaw", "Actuation", "Arm", "Automatic", "Calibration", "DeformedSection",
    "Gravity", "LinearConductance", "Measurements", "MultipleShooting", "Muscle", "Outcome", "Pulses", "Reach",
    "ReachOutcome", "ReferenceSection", "Response", "ResponseOutcome", "Sampled", "Scene", "SceneError",
    "SectionStiffness", "SingleShooting", "Sinusoid", "Solution", "SolveError", "Step", "StrainEnergy", "Sweep",
    "TCAMState", "TimeStepping", "Tip", "VoltageFunction", "Water", "Workspace", "actuate", "dumps", "fit",
    "gain_from_formulas", "gain_from_measurement", "load", "parameters", "presets", "reach", "read_measurements",
    "replace", "solve", "sweep", "tcam_response", "workspace",
]  # fmt: skip
