"""Results as xarray datasets, with units and long names, ready for netCDF."""

from typing import TYPE_CHECKING, Any

import jax
import numpy as np
import xarray

from ..scene import unit_of
from ..solver import ResponseOutcome
from .variables import Variable, arc_length, outcome_variable, places_of, provenance, solution_variables, variable

if TYPE_CHECKING:
    from ..study import Actuation, Sweep

# of a muscle; name: (unit, long name)
_OVER_TIME = {
    "voltage": ("V", "voltage on the muscle"),
    "temperature": ("K", "temperature of the muscle"),
    "contraction": ("m", "contraction of the muscle on its own, under its hanging mass"),
    "contraction_rate": ("m/s", "rate of the contraction"),
    "force": ("N", "what heat adds to the pull of the muscle held at its ambient length"),
    "tension": ("N", "tension with which the muscle pulls the arm"),
}

_MUSCLE = "number of the muscle in the scene"


def sweep_dataset(swept: "Sweep") -> xarray.Dataset:
    """The dataset of a sweep: swept paths as dimensions, fields also along `s`; see `solution_variables`.

    `s` is the arc length; where that differs between rods it is s / L. Over the grid and `muscle`, the number of a
    muscle in the scene: `tension`.
    """
    dims = tuple(swept.over)
    coords = {path: _swept_coordinate(swept, path) for path in dims} | {"s": _swept_arc_length(swept)}
    data = solution_variables(dims, swept.solution)
    if swept.scene.muscles:
        coords["muscle"] = variable(("muscle",), range(len(swept.scene.muscles)), "1", _MUSCLE)
        meaning = "tension of the muscle, given or found from its contraction"
        data["tension"] = variable((*dims, "muscle"), swept.solution.tensions, "N", meaning)
    attributes = provenance("equilibria of a soft rod", swept.scene) | {"method": repr(swept.method)}
    return xarray.Dataset(data, coords, attributes)


def actuation_dataset(actuation: "Actuation") -> xarray.Dataset:
    """The dataset of an arm driven by TCAMs: over `time` the arm, over `muscle` and `time` what drives it.

    Over `time`, the fields also along `s`: see `solution_variables`. `muscle` is the number of a driven muscle in the
    scene. Over both: `voltage temperature contraction contraction_rate force tension`. Over `muscle`:
    `peak_temperature`, `time_of_peak`, `limit_temperature`, `muscle_outcome` with its flag meanings, `muscle_steps`.
    """
    solution = actuation.solution
    numbers = np.array(list(actuation.responses))
    coords = {
        "time": variable(("time",), actuation.times, "s", "time since the voltage begins"),
        "muscle": variable(("muscle",), numbers, "1", _MUSCLE),
        "s": arc_length(actuation.scene, places_of(solution)),
    }
    data = _muscle_variables(actuation) | solution_variables(("time",), solution)
    return xarray.Dataset(data, coords, provenance("motion of a soft rod driven by TCAMs", actuation.scene))


def _muscle_variables(actuation: "Actuation") -> dict[str, Variable]:
    responses: Any = jax.tree.map(lambda *leaves: np.stack(leaves), *actuation.responses.values())
    limits = [float(actuation.tcam(i).limit_temperature) for i in actuation.responses]
    data = {
        name: variable(("muscle", "time"), getattr(responses, name), unit, meaning)
        for name, (unit, meaning) in _OVER_TIME.items()
    }
    dims, peak = ("muscle",), responses.peak
    meaning = "highest temperature of the muscle, between the times too"
    data["peak_temperature"] = variable(dims, peak.temperature, "K", meaning)
    data["time_of_peak"] = variable(dims, peak.time, "s", "time of the highest temperature")
    data["limit_temperature"] = variable(dims, limits, "K", "temperature beyond which the muscle may fail")
    data["muscle_outcome"] = outcome_variable(dims, responses.outcome, ResponseOutcome, "what came of the muscle")
    data["muscle_steps"] = variable(dims, responses.steps, "1", "steps of the integration in time")
    return data


def _swept_coordinate(swept: "Sweep", path: str) -> Variable:
    *owner, name = path.split(".")
    meaning = f"{name.replace('_', ' ')} of {' '.join(owner)}" if owner else name
    return variable((path,), swept.over[path], unit_of(swept.scene, path), meaning)


def _swept_arc_length(swept: "Sweep") -> Variable:
    places = places_of(swept.solution)
    if "arm.length" in swept.over:
        return variable(("s",), places, "1", "undeformed arc length over the arm's")
    return arc_length(swept.scene, places)
