"""What a parameter is: its unit, the values it may take, the choices it may be.

Every field of a scene module is declared with `quantity`, `vector`, `series`, `choice`, `count` or `function`. The
declaration is the only place that knows the unit and the range: the TOML reader, the validation, the datasets and the
error messages read it there. A field that holds one of several kinds of part is declared with `part`.
"""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from ..errors import InputError, quoted

Scalar = Float[Array, ""] | float


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
            return f"between {self.lower:g} and {self.upper:g}"
        if np.isfinite(self.lower):
            return "positive" if self.open_lower else f"at least {self.lower:g}"
        return "a finite number"


ANY = Interval()
POSITIVE = Interval(lower=0.0, open_lower=True)
POSITIVE_OR_INFINITE = Interval(lower=0.0, open_lower=True, infinite=True)
NOT_NEGATIVE = Interval(lower=0.0)


class Quantity(NamedTuple):
    """Declaration of a float parameter: SI unit as pint and netCDF write it, allowed values, number of components, and
    what to do instead of giving it a value that is not allowed."""

    unit: str
    allowed: Interval
    components: int = 1
    advice: str = ""

    def refused(self, where: str, given: Any) -> InputError:
        """The error for a value that is not allowed, with what was `given`: a text as it was typed, or a number."""
        unit = "" if self.unit == "1" else f" {self.unit}"
        said = quoted(given) if isinstance(given, str) else f"{float(given):g}{unit}"
        return InputError(
            f"{where} must be {self.allowed}, but is {said}" + (f"; {self.advice}" if self.advice else "")
        )


class Series(NamedTuple):
    """Declaration of a list of floats of any length: SI unit, allowed values of each."""

    unit: str
    allowed: Interval

    def refused(self, where: str, given: Any) -> InputError:
        """The error for a value that is not allowed."""
        return Quantity(self.unit, self.allowed).refused(where, given)


class Count(NamedTuple):
    """Declaration of a static whole number from 1 to `highest`. It decides which program is compiled."""

    highest: int = 100_000

    def refused(self, where: str, given: Any) -> InputError:
        """The error for what is no such number."""
        return InputError(f"{where} must be a whole number from 1 to {self.highest}, but is {quoted(given)}")


class Function(NamedTuple):
    """Declaration of a function, which Python can give and text cannot."""


class Choice(NamedTuple):
    """Declaration of a static parameter: the values it may take. It decides which program is compiled."""

    values: tuple[Any, ...]

    def __str__(self) -> str:
        return " or ".join(repr(value) for value in self.values)

    def refused(self, where: str, given: Any) -> InputError:
        """The error for a value that is none of these."""
        return InputError(f"{where} must be {self}, but is {quoted(given)}")


def quantity(unit: str, allowed: Interval = ANY, advice: str = "", **kwargs: Any) -> Any:
    """A scalar float field in SI `unit`, a leaf of the scene's pytree."""
    return eqx.field(metadata={"declares": Quantity(unit, allowed, advice=advice)}, **kwargs)


def vector(unit: str, components: int, **kwargs: Any) -> Any:
    """A field of several floats in SI `unit`, each a leaf of the scene's pytree."""
    return eqx.field(metadata={"declares": Quantity(unit, ANY, components)}, **kwargs)


def series(unit: str, **kwargs: Any) -> Any:
    """A field that holds an array of floats in SI `unit`, of shape (n,), one leaf of the scene's pytree."""
    return eqx.field(metadata={"declares": Series(unit, ANY)}, converter=_as_array, **kwargs)


def _as_array(values: Any) -> Any:
    return values if isinstance(values, jax.core.Tracer | jax.Array) else np.asarray(values, dtype=float)


def count(**kwargs: Any) -> Any:
    """A static field that is a whole number."""
    return eqx.field(static=True, metadata={"declares": Count()}, **kwargs)


def function(**kwargs: Any) -> Any:
    """A field that holds a function: an equinox module, whose numbers are leaves, or a plain one."""
    return eqx.field(metadata={"declares": Function()}, converter=as_pytree, **kwargs)


def as_pytree(called: Any) -> Any:
    """A function of a number as one that JAX takes for a pytree: a module keeps its leaves, a plain function is static.

    What a plain function closes over while JAX traces becomes a leaf, so that derivatives by it pass.
    """
    if called is None or isinstance(called, eqx.Module) or not callable(called):
        return called
    cells = [cell.cell_contents for cell in getattr(called, "__closure__", None) or ()]
    if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(cells)):
        return eqx.filter_closure_convert(called, jnp.zeros(()))
    return jax.tree_util.Partial(called)


def part(kinds: dict[str, type], **kwargs: Any) -> Any:
    """A field that holds a part of one of several kinds, named in text by the key `kind`; the first if it is absent."""
    return eqx.field(metadata={"kinds": kinds}, **kwargs)


def choice(*values: Any, **kwargs: Any) -> Any:
    """A static field that is one of `values`."""
    return eqx.field(static=True, metadata={"declares": Choice(values)}, **kwargs)


Declaration = Quantity | Series | Choice | Count | Function


def declaration(field: dataclasses.Field) -> Declaration | None:
    """What a field was declared as; None for a field that holds a part or a list of parts."""
    return field.metadata.get("declares")


def as_floats(tree: Any) -> Any:
    """`tree` with every number in it a double-precision array, which JAX traces: another value is no recompile."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, float) if eqx.is_array_like(leaf) else leaf, tree)


def is_traced(tree: Any) -> bool:
    """Whether JAX hides a value of `tree`, as under `jit` and `vmap`, but not under a plain `grad` or `jacfwd`."""
    tracers = [leaf for leaf in jax.tree.leaves(tree) if isinstance(leaf, jax.core.Tracer)]
    return any(isinstance(leaf, jax.core.Tracer) for leaf in lax.stop_gradient(tracers))


def concrete(value: Any) -> np.ndarray | None:
    """`value` as a NumPy array, or None where JAX is tracing and no value can be looked at."""
    return None if isinstance(value, jax.core.Tracer) else np.asarray(value, dtype=float)
