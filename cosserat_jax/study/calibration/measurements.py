"""Measurements: tables whose columns are a scene's inputs and what was measured, with units, read from many forms.

A column's head is a path and a unit, "water.velocity [m/s]". What is measured is named

- `tip.x`, `tip.y`, `tip.theta`: pose of the tip [m, m, rad]
- `x@S`, `y@S`, `theta@S`: pose of a marker at the arc length S, as in "y@200 mm [cm]"
- `muscles.0.tcam.temperature` [K], `.tension`, `.force` [N], `.contraction` [m]: of a TCAM, over `time` [s]

and a measurement's own standard error is a column `sigma(tip.y) [cm]`. Any other head is the path of a parameter that
was set for that row; with `time`, `muscles.0.tcam.voltage` [V] is the voltage at that instant. A record with a voltage
starts at its first row, whatever its clock shows then, and the muscle at its ambient temperature. A cell of a
measurement may be empty: it was not taken.
"""

import dataclasses
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...errors import InputError, nearest, quoted
from ...scene import Quantity, Scene, lookup, replace, to_si
from ...scene.units import scale_to_si
from .csv_table import read_csv

_POSE_UNITS = {"x": "m", "y": "m", "theta": "rad"}
_TCAM_UNITS = {"temperature": "K", "tension": "N", "force": "N", "contraction": "m"}


class Observable(NamedTuple):
    """What is measured: its name and unit, and `marker` [m], or the number of the `muscle`, or neither, at the tip."""

    name: str
    unit: str
    field: str
    marker: float | None = None
    muscle: int | None = None


@dataclasses.dataclass(frozen=True)
class Measurements:
    """A table in SI. `values` and `sigma` (None: not known) have an axis over the rows, then one over `observables`;
    a value that was not taken is NaN. `inputs` and `voltages`, by path, and `times` [s], have one over the rows."""

    observables: tuple[Observable, ...]
    values: np.ndarray
    sigma: np.ndarray | None
    inputs: dict[str, np.ndarray]
    times: np.ndarray | None = None
    voltages: dict[int, np.ndarray] = dataclasses.field(default_factory=dict)
    name: str = "data"

    @property
    def start(self) -> float:
        """The time [s] at which the muscles start: of a record with a voltage, its first row, else 0."""
        return float(self.times[0]) if self.times is not None and self.voltages else 0.0

    @property
    def markers(self) -> tuple[float, ...]:
        """The arc lengths [m] of the markers, ascending."""
        return markers_of(self.observables)


def markers_of(observables: tuple[Observable, ...]) -> tuple[float, ...]:
    """The arc lengths [m] of the markers, ascending."""
    return tuple(sorted({one.marker for one in observables if one.marker is not None}))


def read_measurements(scene: Scene, data: Any, sigma: Mapping[str, Any] | float | str | None = None) -> Measurements:
    """`data` as `Measurements` of `scene`.

    - `data`: the path of a CSV file, {head: values}, a pandas DataFrame, or an xarray Dataset whose variables and
      coordinates are named by paths and have `units`; or `Measurements`, which are given back.
    - `sigma`: standard errors that have no column: {name: value}, or one for all, in SI or with a unit.

    Raises `InputError` for a table that cannot be read, or that does not fit the scene: where, what, what is allowed.
    """
    if isinstance(data, Measurements):
        return data
    name, columns = _columns(data)
    try:
        return _measurements(scene, name, columns, sigma)
    except InputError as error:
        raise InputError(f"{name}: {error}") from None


def _columns(data: Any) -> tuple[str, dict[str, Any]]:
    """The name of a table, and its columns by their heads."""
    if isinstance(data, str | os.PathLike):
        return os.fspath(data), read_csv(Path(data))
    if hasattr(data, "data_vars"):  # an xarray Dataset, which is a mapping too
        units = {name: data[name].attrs.get("units") for name in data.variables}
        numbered = [dim for dim in data.dims if dim not in data.coords]  # by nothing but their order
        table = data.to_dataframe().reset_index().drop(columns=numbered)
        heads = [f"{name} [{units[name]}]" if units.get(name) else str(name) for name in table.columns]
        return "data", {head: table[name].to_numpy() for head, name in zip(heads, table.columns, strict=True)}
    if hasattr(data, "to_dict") and hasattr(data, "columns"):  # a pandas DataFrame
        return "data", {str(name): data[name].to_numpy() for name in data.columns}
    if isinstance(data, Mapping):
        return "data", dict(data)
    raise InputError(
        f"data must be a CSV file, a mapping of columns, a DataFrame or a Dataset, but is a {type(data).__name__}"
    )


def _measurements(scene: Scene, name: str, columns: dict[str, Any], sigma: Any) -> Measurements:
    arrays = {head: _array(head, values) for head, values in columns.items()}
    if len({len(values) for values in arrays.values()}) > 1:
        lengths = ", ".join(f"{head}: {len(values)}" for head, values in arrays.items())
        raise InputError(f"columns must have one value a row, but have different lengths ({lengths})")
    observables, taken, errors = [], [], {}
    inputs: dict[str, np.ndarray] = {}
    voltages: dict[int, np.ndarray] = {}
    times = None
    for head, values in arrays.items():
        path, unit = _split(head)
        inner = re.fullmatch(r"sigma\((.*)\)", path)
        observable = _observable(scene, inner[1].strip() if inner else path)
        if observable is not None:
            si = _to_si(values, unit, observable.unit, head, only_scale=inner is not None)
            if inner:
                errors[observable.name] = si
            else:
                observables.append(observable)
                taken.append(si)
        elif path == "time":
            times = _to_si(values, unit, "s", head)
        elif matched := re.fullmatch(r"muscles\.(\d+)\.tcam\.voltage", path):
            voltages[int(matched[1][:9])] = _to_si(values, unit, "V", head)
        else:
            inputs[path] = _to_si(values, unit, _unit_of_input(scene, path), head)
    if not observables:
        raise InputError("something must be measured, but nothing is; give a column such as tip.y [cm]")
    if np.isnan(taken).all():
        raise InputError(f"{observables[0].name} must have a value in some row, but all its cells are blank")
    _check_inputs(scene, inputs, times, voltages, observables)
    return Measurements(
        observables=tuple(observables),
        values=np.stack(taken, axis=1),
        sigma=_sigma(tuple(observables), errors, sigma, len(taken[0])),
        inputs=inputs,
        times=times,
        voltages=voltages,
        name=name,
    )


def _array(head: str, values: Any) -> np.ndarray:
    try:
        array = np.asarray(values, dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{head} must be a column of numbers, but is {quoted(values)}") from None
    if array.ndim != 1 or array.size == 0:
        raise InputError(f"{head} must have one axis, not empty, but has the shape {array.shape}")
    if np.isinf(array).any():
        row = np.flatnonzero(np.isinf(array))[0]
        raise InputError(f"{head} must be finite, or nan where nothing was measured, but is {array[row]} in row {row}")
    return array


def _split(head: str) -> tuple[str, str]:
    """Path and unit of "path [unit]"."""
    path, bracket, unit = head.strip().partition("[")
    if not path or (bracket and not unit.endswith("]")):
        raise InputError(f"the head {quoted(head)} must be a path and a unit, such as tip.y [cm]")
    return path.strip(), unit.removesuffix("]").strip()


def _to_si(values: np.ndarray, unit: str, si: str, head: str, only_scale: bool = False) -> np.ndarray:
    if not unit:
        return values
    scale, offset = scale_to_si(unit, si, head)
    return values * scale + (0.0 if only_scale else offset)


def _observable(scene: Scene, path: str) -> Observable | None:
    """What a head without its unit says was measured; None for the path of a parameter."""
    if path.startswith("tip.") and path[4:] in _POSE_UNITS:
        return Observable(path, _POSE_UNITS[path[4:]], path[4:])
    if "@" in path:
        field, _, place = (part.strip() for part in path.partition("@"))
        if field not in _POSE_UNITS:
            raise InputError(f"{path}: {field!r} is not measured at a marker; {nearest(field, list(_POSE_UNITS))}")
        marker, length = to_si(place, "m", path), float(scene.arm.length)
        if not 0 <= marker <= length:
            raise InputError(f"{path} must be on the arm, 0 to {length:g} m, but is at {marker:g} m")
        return Observable(path, _POSE_UNITS[field], field, marker=marker)
    matched = re.fullmatch(r"muscles\.(\d+)\.tcam\.(\w+)", path)
    if matched and matched[2] in _TCAM_UNITS:
        muscle = int(matched[1][:9])
        if muscle >= len(scene.muscles) or scene.muscles[muscle].tcam is None:
            raise InputError(f"{path}: this scene has no muscles.{muscle}.tcam")
        return Observable(path, _TCAM_UNITS[matched[2]], matched[2], muscle=muscle)
    return None


def _unit_of_input(scene: Scene, path: str) -> str:
    known = ["tip.x", "tip.y", "tip.theta", "time"]
    try:
        _, rule = lookup(scene, path)
    except InputError as error:
        raise InputError(f"{error}; what is measured is {', '.join(known)}, y@200 mm, or a TCAM's") from None
    if not isinstance(rule, Quantity) or rule.components > 1:
        raise InputError(f"{path} must be a parameter that is one number to be a column, but is none")
    return rule.unit


def _check_inputs(
    scene: Scene, inputs: dict, times: np.ndarray | None, voltages: dict, observables: list[Observable]
) -> None:
    driven = [i for i, muscle in enumerate(scene.muscles) if muscle.tcam is not None]
    if times is None:
        if driven or voltages or any(o.muscle is not None for o in observables):
            raise InputError("time [s] must be a column where a TCAM drives a muscle, but is missing")
    else:
        if not driven:
            raise InputError("time must be a column only where a TCAM drives a muscle, but this scene has none")
        if not np.isfinite(times).all() or (np.diff(times) < 0).any():
            raise InputError("time must be finite numbers [s] that ascend, but is not in order")
        tcams = {i: muscle.tcam for i, muscle in enumerate(scene.muscles) if i not in voltages}
        own = [i for i, tcam in tcams.items() if tcam is not None and tcam.voltage is not None]
        if times[0] != 0 and voltages and own:
            raise InputError(
                f"time must start at 0 s, when the voltage of muscles.{own[0]} in the scene starts, but starts at "
                f"{times[0]:g} s; give that voltage as a column too"
            )
        if times[0] < 0 and not voltages:
            raise InputError(
                f"time must start at 0 s, when the scene's voltage starts, or later, but starts at {times[0]:g} s"
            )
        if slow := [path for path in inputs if ".tcam." in path]:
            raise InputError(f"{slow[0]} must not change with time, but is a column; set it in the scene")
    for i, values in voltages.items():
        if i not in driven:
            raise InputError(f"muscles.{i}.tcam.voltage: this scene has no muscles.{i}.tcam")
        if not np.isfinite(values).all() or times is None or len(times) < 2 or (np.diff(times) <= 0).any():
            raise InputError(
                f"muscles.{i}.tcam.voltage must be finite numbers [V] at two or more instants that differ, but is not"
            )
    for path, values in inputs.items():
        if np.isnan(values).any():
            raise InputError(
                f"{path} must be given in every row, but is blank in row {np.flatnonzero(np.isnan(values))[0]}"
            )
    replace(scene, inputs)  # every row is checked before the first is solved


def _sigma(observables: tuple[Observable, ...], columns: dict, given: Any, rows: int) -> np.ndarray | None:
    """Standard errors, rows by observables, in SI; None where there are none."""
    by_name = dict(given) if isinstance(given, Mapping) else {o.name: given for o in observables if given is not None}
    names = [o.name for o in observables]
    for name in (*by_name, *columns):
        if name not in names:
            raise InputError(f"sigma({name}): not measured here; {nearest(name, names)}")
    missing = [name for name in names if name not in by_name and name not in columns]
    if len(missing) == len(names):
        units = {o.unit: o.name for o in observables}
        if len(units) > 1:
            raise InputError(
                f"sigma must be given where measurements have different units, as {' and '.join(units.values())} have, "
                "but is missing"
            )
        return None
    if missing:
        raise InputError(f"sigma({missing[0]}) must be given, as that of the others is, but is missing")
    errors = []
    for o in observables:
        error = columns[o.name] if o.name in columns else _error(by_name[o.name], o)
        try:
            errors.append(np.broadcast_to(np.asarray(error, float), rows))
        except (TypeError, ValueError, OverflowError):
            raise InputError(
                f"sigma({o.name}) must be one number or {rows}, one a row, but is {quoted(error)}"
            ) from None
        if not (good := np.isfinite(errors[-1]) & (errors[-1] > 0)).all():
            raise InputError(f"sigma({o.name}) must be positive, but is {errors[-1][~good][0]:g} {o.unit}")
    return np.stack(errors, axis=1)


def _error(value: Any, o: Observable) -> Any:
    """A standard error in SI; of a temperature a difference, so that 1 degC is 1 K."""
    if not isinstance(value, str):
        return value
    where = f"sigma({o.name})"
    if o.unit == "K":
        value = value.replace("degC", "delta_degC") if "delta" not in value else value
    return to_si(value, o.unit, where)
