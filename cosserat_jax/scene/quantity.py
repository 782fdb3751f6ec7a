"""What a parameter is: its unit, the values it may take, the choices it may be.

Every field of a scene module is declared with `quantity`, `vector` or `choice`. The declaration is the only place
that knows the unit and the range: the TOML reader, the validation, the datasets and the error messages read it there.
"""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax.core
import numpy as np
from jaxtyping import Array, Float

Scalar = Float[Array, ""] | float


class SceneError(ValueError):
    """Something a user wrote cannot be a scene: one line that names the place, the value and what is allowed."""


class Interval(NamedTuple):
    """The values a quantity may take; an infinite bound is one that only a quantity marked `infinite` reaches."""

    lower: float = -np.inf
    upper: float = np.inf
    open_lower: bool = False
    infinite: bool = False

    def holds(self, value: Any) -> Any:
        """Elementwise, whether `value`, a NumPy or a traced array, is allowed; NaN never is."""
        above = value > self.lower if self.open_lower else value >= self.lower
        return above & (value <= self.upper) & ((abs(value) < np.inf) | self.infinite)

    def __str__(self) -> str:
        if np.isfinite(self.upper):
            return f"{'more than ' if self.open_lower else ''}{self.lower:g} to {self.upper:g}"
        if np.isfinite(self.lower):
            return f"{'more than' if self.open_lower else 'at least'} {self.lower:g}"
        return "any finite number"


ANY = Interval()
POSITIVE = Interval(lower=0.0, open_lower=True)
POSITIVE_OR_INFINITE = Interval(lower=0.0, open_lower=True, infinite=True)
NOT_NEGATIVE = Interval(lower=0.0)


class Quantity(NamedTuple):
    """Declaration of a float parameter: SI unit as pint and netCDF write it, allowed values, number of components."""

    unit: str
    allowed: Interval
    components: int = 1


class Choice(NamedTuple):
    """Declaration of a static parameter: the values it may take. It decides which program is compiled."""

    values: tuple[Any, ...]

    def __str__(self) -> str:
        return " or ".join(repr(value) for value in self.values)


def quantity(unit: str, allowed: Interval = ANY, **kwargs: Any) -> Any:
    """A scalar float field in SI `unit`, a leaf of the scene's pytree."""
    return eqx.field(metadata={"declares": Quantity(unit, allowed)}, **kwargs)


def vector(unit: str, components: int, **kwargs: Any) -> Any:
    """A field of several floats in SI `unit`, each a leaf of the scene's pytree."""
    return eqx.field(metadata={"declares": Quantity(unit, ANY, components)}, **kwargs)


def choice(*values: Any, **kwargs: Any) -> Any:
    """A static field that is one of `values`."""
    return eqx.field(static=True, metadata={"declares": Choice(values)}, **kwargs)


def declaration(field: dataclasses.Field) -> Quantity | Choice | None:
    """What a field was declared as; None for a field that holds a part or a list of parts."""
    return field.metadata.get("declares")


def concrete(value: Any) -> np.ndarray | None:
    """`value` as a NumPy array, or None where JAX is tracing and no value can be looked at."""
    return None if isinstance(value, jax.core.Tracer) else np.asarray(value, dtype=float)
