"""What the data alone tell against a fit, before anything is compiled."""

import numpy as np

from ...scene import InputError, Scene
from ..free_parameters import Free
from .measurements import Measurements, Observable

_IMPOSSIBLE, _DOUBTFUL = 2.0, 1.05  # lengths of the arm from the base: of most places measured, and of any
_MOST_TURNS = 2  # of a section's angle
_APART = 5.0  # standard errors by which a record may start off the ambient temperature


def doubts(scene: Scene, measured: tuple[Measurements, ...], free: tuple[Free, ...]) -> tuple[str, ...]:
    """A sentence for each of the columns that the scene can hardly explain.

    Raises `InputError` for places most of which no arm of this length reaches: a unit that was left out.
    """
    lines = []
    for table in measured:
        moving = {one.path for one in free} | set(table.inputs)
        for i, observable in enumerate(table.observables):
            errors = None if table.sigma is None else table.sigma[:, i]
            if observable.unit == "m" and observable.muscle is None and "arm.length" not in moving:
                lines += _beyond_reach(scene, table, observable, table.values[:, i])
            if observable.unit == "rad":
                lines += _many_turns(table, observable, table.values[:, i])
            if observable.field == "temperature":
                lines += _warm_start(scene, table, observable, table.values[:, i], errors, moving)
    return tuple(lines)


def _beyond_reach(scene: Scene, table: Measurements, observable: Observable, values: np.ndarray) -> list[str]:
    place = float(scene.arm.length) if observable.marker is None else observable.marker
    parts = np.abs(values) / max(place, 1e-300)
    if np.isnan(parts).all() or not (far := np.nan_to_num(parts) > _DOUBTFUL).any():
        return []
    row = int(np.flatnonzero(far)[0])
    said = f"{abs(values[row]):.4g} m from the base in row {row} of {table.name}, at s = {place:.4g} m"
    if np.nanmedian(parts) > _IMPOSSIBLE:
        raise InputError(
            f"{observable.name} must be within reach, but is {said}; a head without a unit, such as [cm], is in SI"
        )
    return [f"{observable.name} is {said}; only a stretched arm reaches that, or is it an outlier?"]


def _many_turns(table: Measurements, observable: Observable, values: np.ndarray) -> list[str]:
    if np.isnan(values).all() or np.nanmax(np.abs(values)) < _MOST_TURNS * 2 * np.pi:
        return []
    row = int(np.nanargmax(np.abs(values)))
    return [
        f"{observable.name} is {values[row]:.4g} rad in row {row} of {table.name}, more than {_MOST_TURNS} turns; "
        "a head without a unit, such as [deg], is in rad"
    ]


def _warm_start(
    scene: Scene,
    table: Measurements,
    observable: Observable,
    values: np.ndarray,
    errors: np.ndarray | None,
    moving: set,
) -> list[str]:
    assert observable.muscle is not None, "a temperature is that of a muscle"
    tcam, path = scene.muscles[observable.muscle].tcam, f"muscles.{observable.muscle}.tcam.ambient_temperature"
    if tcam is None or table.times is None or path in moving:
        return []
    if table.times[0] != table.start or np.isnan(values[0]):
        return []
    ambient, span = float(tcam.ambient_temperature), float(np.nanmax(values) - np.nanmin(values))
    error = span / 20 if errors is None else errors[0]
    if abs(values[0] - ambient) <= _APART * error:
        return []
    return [
        f"{observable.name} starts at {values[0]:.4g} K in {table.name}, where the muscle starts at {path}, "
        f"{ambient:.4g} K; set that, or give the record from the cold start on"
    ]
