"""Free parameters: what `fit` and `reach` may change, from where, and between which bounds."""

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from ..scene import Quantity, Scene, SceneError, lookup, to_si
from ..scene.quantity import Interval


class Free(NamedTuple):
    """One free parameter: its path, SI unit, the scene's value, and the bounds, infinite where there is none."""

    path: str
    unit: str
    start: float
    lower: float
    upper: float


def free_parameters(
    scene: Scene, free: Iterable[str] | Mapping[str, Any], *, from_scene: bool = True
) -> tuple[Free, ...]:
    """`free`, paths or {path: (lower, upper)}, as `Free`s that start at the scene's values.

    A bound is a number in SI or a string with a unit; None, for one or for both, is what the parameter may be at all.
    Raises `SceneError` for a path that cannot be free, and for bounds that are not allowed or, where the study starts
    `from_scene`, leave out the scene's value.
    """
    bounds = dict(free) if isinstance(free, Mapping) else dict.fromkeys([free] if isinstance(free, str) else free)
    if not bounds:
        raise SceneError("free: nothing is free; allowed: paths of parameters, such as arm.youngs_modulus")
    return tuple(_free(scene, path, given, from_scene) for path, given in bounds.items())


def _free(scene: Scene, path: str, bounds: Any, from_scene: bool) -> Free:
    value, rule = lookup(scene, path)
    if not isinstance(rule, Quantity) or rule.components > 1:
        raise SceneError(f"{path}: cannot be free; allowed: a parameter that is one number")
    if value is None:
        raise SceneError(f"{path}: has no value in this scene to start from; allowed: give it one")
    start, allowed = float(value), rule.allowed
    low, high = (None, None) if bounds is None else _two(path, bounds)
    lower = allowed.lower if low is None else to_si(low, rule.unit, path)
    upper = allowed.upper if high is None else to_si(high, rule.unit, path)
    text = f"{lower:g} to {upper:g} [{rule.unit}]"
    if not lower < upper or np.isnan([lower, upper]).any():
        raise SceneError(f"{path}: bounds {text} are not allowed; allowed: a lower one below an upper one")
    if lower < allowed.lower or upper > allowed.upper:
        raise SceneError(f"{path}: bounds {text} are not allowed; allowed: {allowed} [{rule.unit}]")
    if from_scene and not Interval(lower, upper).holds(start):
        raise SceneError(f"{path}: starts at {start:g}, outside its bounds; allowed: {text}")
    return Free(path, rule.unit, start, lower, upper)


def _two(path: str, bounds: Any) -> tuple[Any, Any]:
    if not isinstance(bounds, tuple | list) or len(bounds) != 2:
        raise SceneError(f"{path}: bounds {bounds!r} are not allowed; allowed: (lower, upper)")
    return bounds[0], bounds[1]
