"""Results as xarray datasets, with units and long names, ready for netCDF."""

import datetime
import json
from typing import TYPE_CHECKING, Any

import jax
import numpy as np
import xarray

from ..scene import dumps, unit_of
from ..solver import outcome_codes

if TYPE_CHECKING:
    from ..study import Sweep

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
    "beta": ("1", "in-plane stretch of the tip's cross-section"),
}
_FIELDS = {
    "x": ("m", "centerline position along e1"),
    "y": ("m", "centerline height over the base"),
    "theta": ("rad", "angle of the cross-section"),
    "nu": ("1", "stretch"),
    "eta": ("1", "shear"),
    "mu": ("1/m", "curvature"),
    "beta": ("1", "in-plane stretch of the cross-section"),
    "N": ("Pa", "normal traction"),
    "H": ("Pa", "shear traction"),
    "M": ("Pa/m", "bending moment per second moment of area"),
    "force_x": ("N", "total force of section and muscles along e1"),
    "force_y": ("N", "total force of section and muscles along e2"),
    "moment": ("N*m", "total moment of section and muscles"),
}
_STATS = {
    "residual": ("1", "error of the clamp at the base, in radians and lengths of the arm"),
    "iterations": ("1", "integrations with their Jacobian"),
    "steps": ("1", "steps of the last integration"),
    "load_fraction": ("1", "part of the load up to which the equilibrium was followed"),
}


def sweep_dataset(swept: "Sweep") -> xarray.Dataset:
    """The dataset of a sweep: swept paths as dimensions, fields also along `s`.

    Variables: the fields `x y theta nu eta mu beta N H M force_x force_y moment`, the same at the tip as `tip_x` and so
    on, `tilt`, `outcome` with its flag meanings, `converged`, `residual`, `iterations`, `steps`, `load_fraction`.
    `s` is the arc length; where that differs between rods it is s / L.
    """
    dims, solution = tuple(swept.over), swept.solution
    data: dict[str, Any] = {}
    for name, (unit, meaning) in _TIP.items():
        data[f"tip_{name}"] = _variable(dims, getattr(solution.tip, name), unit, meaning)
    for name, (unit, meaning) in _TIP_STRAIN.items():
        data[f"tip_{name}"] = _variable(dims, getattr(solution.tip_strain, name), unit, meaning)
    data["tilt"] = _variable(dims, np.asarray(solution.tilt), "rad", "tilt of the tip's cross-section, alpha - theta")
    for name, (unit, meaning) in _STATS.items():
        data[name] = _variable(dims, getattr(solution, name), unit, meaning)
    data["converged"] = _variable(
        dims, np.asarray(solution.converged, np.int8), "1", "1 where the equilibrium was found"
    )
    data["outcome"] = _outcome_variable(dims, solution.outcome)
    for name, (unit, meaning) in _FIELDS.items():
        data[name] = _variable((*dims, "s"), getattr(solution.fields, name), unit, meaning)
    coords = {path: _coordinate(swept, path) for path in dims} | {"s": _arc_length(swept)}
    return xarray.Dataset(data, coords, _attributes(swept))


def _variable(dims: tuple[str, ...], values: Any, unit: str, meaning: str) -> tuple:
    return dims, np.asarray(values), {"units": unit, "long_name": meaning}


def _outcome_variable(dims: tuple[str, ...], outcome: Any) -> tuple:
    (codes,) = jax.tree.leaves(outcome)
    known = outcome_codes()
    attributes = {
        "units": "1",
        "long_name": "what came of the rod",
        "flag_values": np.array(list(known.values()), np.int8),
        "flag_meanings": " ".join(known),
    }
    return dims, np.asarray(codes, np.int8), attributes


def _coordinate(swept: "Sweep", path: str) -> tuple:
    *owner, name = path.split(".")
    meaning = f"{name.replace('_', ' ')} of {' '.join(owner)}" if owner else name
    return (path,), swept.over[path], {"units": unit_of(swept.scene, path), "long_name": meaning}


def _arc_length(swept: "Sweep") -> tuple:
    s = np.asarray(swept.solution.fields.s)
    if "arm.length" in swept.over:
        return (
            ("s",),
            np.linspace(0, 1, s.shape[-1]),
            {"units": "1", "long_name": "undeformed arc length over the arm's"},
        )
    length = float(swept.scene.arm.length)
    return (
        ("s",),
        np.linspace(0, length, s.shape[-1]),
        {"units": "m", "long_name": "undeformed arc length from the base"},
    )


def _attributes(swept: "Sweep") -> dict[str, str]:
    import diffrax

    from .. import __version__

    versions = {"cosserat_jax": __version__, "jax": jax.__version__, "diffrax": diffrax.__version__}
    return {
        "title": "equilibria of a soft rod",
        "scene": dumps(swept.scene),
        "method": repr(swept.method),
        "versions": json.dumps(versions | {"numpy": np.__version__, "xarray": xarray.__version__}),
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "source": "Golestaneh, Cichella & Lamuta: quasi-static continuum model of an octopus-like arm driven by TCAMs",
    }
