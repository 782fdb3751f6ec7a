"""Free parameters: what `fit` and `reach` may change, from where, and between which bounds."""

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..errors import quoted
from ..scene import InputError, Quantity, Scene, lookup, to_si
from ..scene.quantity import Interval, Scalar


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
    Raises `InputError` for a path that cannot be free, and for bounds that are not allowed or, where the study starts
    `from_scene`, leave out the scene's value.
    """
    bounds = dict(free) if isinstance(free, Mapping) else dict.fromkeys([free] if isinstance(free, str) else free)
    if not bounds:
        raise InputError("free must name parameters, such as arm.youngs_modulus, but is empty")
    return tuple(_free(scene, path, given, from_scene) for path, given in bounds.items())


def _free(scene: Scene, path: str, bounds: Any, from_scene: bool) -> Free:
    value, rule = lookup(scene, path)
    if not isinstance(rule, Quantity) or rule.components > 1:
        raise InputError(f"{path} must be a parameter that is one number to be free, but is none")
    if value is None:
        raise InputError(f"{path} must have a value in this scene to start from, but has none")
    start, allowed = float(value), rule.allowed
    low, high = (None, None) if bounds is None else _two(path, bounds)
    lower = allowed.lower if low is None else to_si(low, rule.unit, path)
    upper = allowed.upper if high is None else to_si(high, rule.unit, path)
    text = f"{lower:g} to {upper:g} [{rule.unit}]"
    if not lower < upper or np.isnan([lower, upper]).any():
        raise InputError(f"{path} must have a lower bound below its upper bound, but is {text}")
    if lower < allowed.lower or upper > allowed.upper:
        raise InputError(f"{path} must be {allowed} within its bounds, but they are {text}")
    if from_scene and not Interval(lower, upper).holds(start):
        raise InputError(f"{path} must start within its bounds, {text}, but starts at {start:g}")
    return Free(path, rule.unit, start, lower, upper)


def _two(path: str, bounds: Any) -> tuple[Any, Any]:
    if not isinstance(bounds, tuple | list) or len(bounds) != 2:
        raise InputError(f"{path} must have bounds (lower, upper), but has {quoted(bounds)}")
    return bounds[0], bounds[1]


class Unbounded(NamedTuple):
    """Free parameters as functions of unbounded ones, u, of which a step of 1 is a large one.

    Between two bounds value = lower + (upper - lower) (1 + sin u) / 2, which reaches both (James & Roos, MINUIT, 1975);
    above one, for a positive parameter 0, value = lower + exp(u); below one, value = upper - exp(u); with none,
    value = start + scale u.
    """

    free: tuple[Free, ...]

    def values(self, u: Float[Array, " params"]) -> dict[str, Float[Array, ""]]:
        """The values at u, by path."""
        return {one.path: _value(one, u[i]) for i, one in enumerate(self.free)}

    def array(self, u: Float[Array, " params"]) -> Float[Array, " params"]:
        """The values at u, in the order of `free`."""
        return jnp.stack(list(self.values(u).values()))

    def slopes(self, u: Float[Array, " params"]) -> Float[Array, " params"]:
        """d value / d u of each."""
        return jnp.diagonal(jax.jacfwd(self.array)(u))

    def at(self, values: Float[Array, " params"]) -> Float[Array, " params"]:
        """The u of these values."""
        return jnp.stack([_unbounded(one, values[i]) for i, one in enumerate(self.free)])

    def start(self) -> np.ndarray:
        """The u of the scene's values; one that stands at one of two bounds starts a hundredth of the way inside."""
        values = [np.clip(one.start, *_inside(one)) for one in self.free]
        for one in self.free:
            if np.isinf(one.upper) != np.isinf(one.lower) and one.start in (one.lower, one.upper):
                raise InputError(
                    f"{one.path} must start inside its bounds, but starts at one, {one.start:g}; give another value"
                )
        return np.asarray(self.at(jnp.array(values)))

    def drawn(self, count: int, seed: int) -> np.ndarray:
        """`count` starts by chance: anywhere between two bounds, else within a factor of 3 or three scales."""
        rng = np.random.default_rng(seed)
        start = self.start()
        spread = rng.uniform(-np.log(3), np.log(3), (count, len(self.free)))
        bounded = np.array([np.isfinite(one.lower) and np.isfinite(one.upper) for one in self.free])
        anywhere = np.arcsin(rng.uniform(-0.98, 0.98, spread.shape))
        return np.where(bounded, anywhere, start + spread)


def _value(one: Free, u: Scalar) -> Any:
    if np.isfinite(one.lower) and np.isfinite(one.upper):
        return one.lower + (one.upper - one.lower) * (1 + jnp.sin(u)) / 2
    if np.isfinite(one.lower):
        return one.lower + jnp.exp(u)
    if np.isfinite(one.upper):
        return one.upper - jnp.exp(u)
    return one.start + _scale(one) * u


def _unbounded(one: Free, value: Scalar) -> Any:
    if np.isfinite(one.lower) and np.isfinite(one.upper):
        return jnp.arcsin(2 * (value - one.lower) / (one.upper - one.lower) - 1)
    if np.isfinite(one.lower):
        return jnp.log(value - one.lower)
    if np.isfinite(one.upper):
        return jnp.log(one.upper - value)
    return (value - one.start) / _scale(one)


def _scale(one: Free) -> float:
    return abs(one.start) if one.start else 1.0


def _inside(one: Free) -> tuple[float, float]:
    margin = 0.01 * (one.upper - one.lower)
    return (one.lower + margin, one.upper - margin) if np.isfinite(margin) else (-np.inf, np.inf)
