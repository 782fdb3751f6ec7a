"""What a solution becomes in a dataset: one variable for each of its numbers, with unit and long name."""

import datetime
import json
from importlib.metadata import version
from typing import Any

import equinox as eqx
import jax
import numpy as np
import xarray

from ..scene import InputError, Scene, dumps
from .outcome import Outcome, ResponseOutcome, outcome_codes

Dims = tuple[str, ...]
Variable = tuple[Dims, np.ndarray, dict[str, Any]]

# name: (unit, long name)
_TIP = {
    "x": ("m", "tip position along e1"),
    "y": ("m", "tip height over the base"),
    "theta": ("rad", "angle of the tip's cross-section"),
}
_TIP_STRAIN = {
    "nu": ("1", "stretch at the tip"),
    "eta": ("1", "shear at the tip"),
    "mu": ("1/m", "curvature at the tip"),
    "beta": ("1", "scale of the tip's cross-section"),
}
_FIELDS = {
    "x": ("m", "centerline position along e1"),
    "y": ("m", "centerline height over the base"),
    "theta": ("rad", "angle of the cross-section"),
    "nu": ("1", "stretch"),
    "eta": ("1", "shear"),
    "mu": ("1/m", "curvature"),
    "beta": ("1", "scale of the cross-section"),
    "N": ("Pa", "normal traction"),
    "H": ("Pa", "shear traction"),
    "M": ("Pa/m", "bending moment per second moment of area"),
    "force_x": ("N", "internal force along e1, muscles included"),
    "force_y": ("N", "internal force along e2, muscles included"),
    "moment": ("N*m", "internal moment, muscles included"),
}
_STATS = {
    "residual": ("1", "error of the clamp at the base, in radians and lengths of the arm"),
    "condition": ("1", "condition number of the equation that clamps the base"),
    "iterations": ("1", "integrations with their Jacobian"),
    "steps": ("1", "steps of the last integration"),
    "load_fraction": ("1", "part of the load up to which the equilibrium was followed"),
    "failed_at": ("m", "arc length at which the volume constraint folded or the integration stopped"),
}

# of a muscle; name: (unit, long name)
_OVER_TIME = {
    "voltage": ("V", "voltage on the muscle"),
    "temperature": ("K", "temperature of the muscle"),
    "contraction": ("m", "contraction of the muscle on its own, under its hanging mass"),
    "contraction_rate": ("m/s", "rate of the contraction"),
    "force": ("N", "what heat adds to the pull of the muscle held at its ambient length"),
    "tension": ("N", "tension with which the muscle pulls the arm"),
}

MUSCLE = "number of the muscle in the scene"


def solution_variables(dims: Dims, solution: Any) -> dict[str, Variable]:
    """Every number of `solution`, whose leading axes are `dims`; the fields have an axis `s` after them.

    The tip's are `tip_x` and so on, the fields `x y theta nu eta mu beta N H M force_x force_y moment`; then `tilt`,
    `outcome` with its flag meanings, `converged`, `residual`, `condition`, `iterations`, `steps`,
    `load_fraction`, `failed_at`.
    """
    data: dict[str, Variable] = {}
    for name, (unit, meaning) in _TIP.items():
        data[f"tip_{name}"] = variable(dims, getattr(solution.tip, name), unit, meaning)
    for name, (unit, meaning) in _TIP_STRAIN.items():
        data[f"tip_{name}"] = variable(dims, getattr(solution.tip_strain, name), unit, meaning)
    data["tilt"] = variable(dims, solution.tilt, "rad", "tilt of the tip's cross-section, alpha - theta")
    for name, (unit, meaning) in _STATS.items():
        data[name] = variable(dims, getattr(solution, name), unit, meaning)
    converged = np.asarray(solution.converged, np.int8)
    data["converged"] = variable(dims, converged, "1", "1 where the equilibrium was found")
    data["outcome"] = outcome_variable(dims, solution.outcome, Outcome, "outcome of the solve")
    for name, (unit, meaning) in _FIELDS.items():
        data[name] = variable((*dims, "s"), getattr(solution.fields, name), unit, meaning)
    return data


def response_variables(dims: Dims, response: Any, prefix: str = "") -> dict[str, Variable]:
    """Every number of `response`, whose leading axes are `dims`; those over time have an axis `time` after them.

    Over time: `voltage temperature contraction contraction_rate force tension`; then `peak_temperature`,
    `time_of_peak`, and with this prefix `outcome` with its flag meanings, and `steps`.
    """
    data = {
        name: variable((*dims, "time"), getattr(response, name), unit, meaning)
        for name, (unit, meaning) in _OVER_TIME.items()
    }
    meaning = "highest temperature of the muscle, between the times too"
    data["peak_temperature"] = variable(dims, response.peak.temperature, "K", meaning)
    data["time_of_peak"] = variable(dims, response.peak.time, "s", "time of the highest temperature")
    data[f"{prefix}outcome"] = outcome_variable(dims, response.outcome, ResponseOutcome, "outcome of the response")
    data[f"{prefix}steps"] = variable(dims, response.steps, "1", "steps of the integration in time")
    return data


def solution_dataset(solution: Any) -> xarray.Dataset:
    """The dataset of a solution alone, which knows no scene: over the axes of its batch, and the fields along `s`, the
    arc length, or s / L where the arms are not all of one length."""
    dims = _batch_dims(np.shape(solution.residual))
    ends = np.asarray(solution.fields.s)[..., -1]
    lengths = ends[np.isfinite(ends)]
    places = places_of(solution)
    if lengths.size and np.ptp(lengths) <= 1e-12 * lengths.max():
        along = variable(("s",), places * lengths.max(), "m", "undeformed arc length from the base")
    else:
        along = variable(("s",), places, "1", "undeformed arc length over the arm's")
    coords, data = {"s": along}, solution_variables(dims, solution)
    count = np.shape(solution.tensions)[-1]
    if count:
        coords["muscle"] = variable(("muscle",), range(count), "1", MUSCLE)
        data["tension"] = variable((*dims, "muscle"), solution.tensions, "N", "tension of the muscle")
    return xarray.Dataset(data, coords, provenance("equilibrium of a soft rod"))


def response_dataset(response: Any) -> xarray.Dataset:
    """The dataset of a response alone: over the axes of its batch and `time`, which in a batch is a variable if it is
    not the same for all."""
    dims, times = _batch_dims(np.shape(response.steps)), np.asarray(response.times)
    rows = times.reshape(-1, times.shape[-1])
    same = bool((rows == rows[0]).all())
    over = variable(("time",), rows[0], "s", "time since the voltage begins")
    data = response_variables(dims, response)
    if not same:
        data["times"] = variable((*dims, "time"), times, "s", "time since the voltage begins")
    return xarray.Dataset(data, {"time": over} if same else {}, provenance("response of a TCAM"))


def _batch_dims(shape: tuple[int, ...]) -> Dims:
    return ("batch",) if len(shape) == 1 else tuple(f"batch_{i}" for i in range(len(shape)))


def variable(dims: Dims, values: Any, unit: str, meaning: str) -> Variable:
    """A variable, or a coordinate, with its unit and long name."""
    return dims, np.asarray(values), {"units": unit, "long_name": meaning}


def outcome_variable(dims: Dims, outcome: Any, kind: type[eqx.Enumeration], meaning: str) -> Variable:
    """The codes of `outcome`, an array of members of `kind`, with the name of each code in the attributes."""
    (codes,) = jax.tree.leaves(outcome)
    known = outcome_codes(kind)
    flags = {"flag_values": np.array(list(known.values()), np.int8), "flag_meanings": " ".join(known)}
    where, values, attributes = variable(dims, np.asarray(codes, np.int8), "1", meaning)
    return where, values, attributes | flags


def arc_length(scene: Scene, places: np.ndarray) -> Variable:
    """The coordinate `s` [m] at these places s / L of an arm of this length."""
    return variable(("s",), places * float(scene.arm.length), "m", "undeformed arc length from the base")


def places_of(solution: Any) -> np.ndarray:
    """The places s / L at which the fields are held, equally spaced or as a rod that has an equilibrium tells."""
    s = np.asarray(solution.fields.s)
    rods = s.reshape(-1, s.shape[-1])
    held, equal = rods[np.isfinite(rods[:, -1])], np.linspace(0.0, 1.0, s.shape[-1])
    if len(held) == 0 or np.allclose(held[0], equal * held[0, -1], rtol=0.0, atol=1e-12 * held[0, -1]):
        return equal
    return held[0] / held[0, -1]


def provenance(title: str, scene: Scene | None = None) -> dict[str, str]:
    """The attributes of a dataset: what it is, of which scene where that is known, and by what it was made."""
    packages = ("cosserat_jax", "jax", "diffrax", "numpy", "xarray")
    return {
        "title": title,
        **({} if scene is None else {"scene": _scene_text(scene)}),
        "versions": json.dumps({name: version(name) for name in packages}),
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "source": "Golestaneh, Cichella & Lamuta: quasi-static continuum model of an octopus-like arm driven by TCAMs",
    }


def _scene_text(scene: Scene) -> str:
    try:
        return dumps(scene)
    except InputError as error:
        return f"not written: {error}"
