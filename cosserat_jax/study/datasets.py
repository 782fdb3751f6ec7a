"""Results as xarray datasets, with units and long names, ready for netCDF."""

from collections.abc import Mapping
from typing import Any

import jax
import numpy as np
import xarray

from ..scene import Scene, unit_of
from ..solver import Method, Response, Solution
from ..solver.variables import (
    MUSCLE,
    Variable,
    arc_length,
    places_of,
    provenance,
    response_variables,
    solution_variables,
    variable,
)


def sweep_dataset(scene: Scene, over: dict[str, np.ndarray], method: Method, solution: Solution) -> xarray.Dataset:
    """The dataset of a sweep: swept paths as dimensions, fields also along `s`; see `solution_variables`.

    `s` is the arc length; where that differs between rods it is s / L. Over the grid and `muscle`, the number of a
    muscle in the scene: `tension`.
    """
    dims = tuple(over)
    coords = {path: _swept_coordinate(scene, path, values) for path, values in over.items()}
    coords["s"] = _swept_arc_length(scene, over, solution)
    data = solution_variables(dims, solution)
    if scene.muscles:
        coords["muscle"] = variable(("muscle",), range(len(scene.muscles)), "1", MUSCLE)
        meaning = "tension of the muscle, given or found from its displacement"
        data["tension"] = variable((*dims, "muscle"), solution.tensions, "N", meaning)
    attributes = provenance("equilibria of a soft rod", scene) | {"method": repr(method)}
    return xarray.Dataset(data, coords, attributes)


def actuation_dataset(
    scene: Scene, times: Any, responses: Mapping[int, Response], solution: Solution
) -> xarray.Dataset:
    """The dataset of an arm driven by TCAMs: over `time` the arm, over `muscle` and `time` what drives it.

    Over `time`, the fields also along `s`: see `solution_variables`. `muscle` is the number of a driven muscle in the
    scene. Over both: `voltage temperature contraction contraction_rate force tension`. Over `muscle`:
    `peak_temperature`, `time_of_peak`, `limit_temperature`, `muscle_outcome` with its flag meanings, `muscle_steps`.
    """
    coords = {
        "time": variable(("time",), times, "s", "time since the voltage begins"),
        "muscle": variable(("muscle",), list(responses), "1", MUSCLE),
        "s": arc_length(scene, places_of(solution)),
    }
    data = _muscle_variables(scene, responses) | solution_variables(("time",), solution)
    return xarray.Dataset(data, coords, provenance("motion of a soft rod driven by TCAMs", scene))


def _muscle_variables(scene: Scene, by_muscle: Mapping[int, Response]) -> dict[str, Variable]:
    responses: Any = jax.tree.map(lambda *leaves: np.stack(leaves), *by_muscle.values())
    tcams = [tcam for i in by_muscle if (tcam := scene.muscles[i].tcam) is not None]
    limits = [float(tcam.limit_temperature) for tcam in tcams]
    data = response_variables(("muscle",), responses, "muscle_")
    meaning = "temperature beyond which the muscle may fail"
    data["limit_temperature"] = variable(("muscle",), limits, "K", meaning)
    return data


def _swept_coordinate(scene: Scene, path: str, values: np.ndarray) -> Variable:
    *owner, name = path.split(".")
    meaning = f"{name.replace('_', ' ')} of {' '.join(owner)}" if owner else name
    return variable((path,), values, unit_of(scene, path), meaning)


def _swept_arc_length(scene: Scene, over: dict[str, np.ndarray], solution: Solution) -> Variable:
    places = places_of(solution)
    if "arm.length" in over:
        return variable(("s",), places, "1", "undeformed arc length over the arm's")
    return arc_length(scene, places)
