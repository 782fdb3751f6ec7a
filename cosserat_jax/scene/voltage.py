"""The voltage that drives a muscle, over time.

A voltage is smooth on each of the pieces between its `breaks`, and says on each what it is there. So an integration
can be cut at every jump: no step straddles one, no short pulse is stepped over, and derivatives with respect to the
instants of the jumps are exact.
"""

import abc
import math
from collections.abc import Callable
from typing import Any

import diffrax
import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from .quantity import NOT_NEGATIVE, POSITIVE, POSITIVE_OR_INFINITE, Scalar, count, function, quantity, series

Times = Float[Array, "*times"] | float


class AbstractVoltage(eqx.Module):
    """A voltage v(t) [V] over t [s], called with a time or with an array of times."""

    @property
    @abc.abstractmethod
    def breaks(self) -> Float[Array, " breaks"]:
        """The instants [s], in ascending order, at which the voltage or its slope jumps."""

    @property
    @abc.abstractmethod
    def step_limit(self) -> Scalar:
        """The longest time [s] that an integrator may step over without missing what the voltage does."""

    @abc.abstractmethod
    def on_piece(self, piece: Int[Array, "*times"], t: Times) -> Float[Array, "*times"]:
        """v(t) [V] of the smooth piece after `piece` of the breaks, at its two ends too."""

    def __call__(self, t: Times) -> Float[Array, "*times"]:
        return self.on_piece(jnp.searchsorted(self.breaks, t, side="right"), t)


class Sinusoid(AbstractVoltage):
    """v(t) = offset + amplitude sin(frequency t + phase).

    `amplitude`, `offset` [V], `frequency` [rad/s] (in text also "0.5 Hz", which is pi rad/s), `phase` [rad].
    """

    amplitude: Scalar = quantity("V")
    frequency: Scalar = quantity("rad/s", NOT_NEGATIVE)
    phase: Scalar = quantity("rad", default=0.0)
    offset: Scalar = quantity("V", default=0.0)

    @property
    def breaks(self) -> Float[Array, " breaks"]:
        return jnp.zeros(0)

    @property
    def step_limit(self) -> Scalar:
        return 0.25 * math.pi / jnp.maximum(self.frequency, 1e-300)  # a quarter of v^2's period: error estimates see it

    def on_piece(self, piece: Int[Array, "*times"], t: Times) -> Float[Array, "*times"]:
        return self.offset + self.amplitude * jnp.sin(self.frequency * t + self.phase)


class Step(AbstractVoltage):
    """v(t) = 0 before `start` [s] and `amplitude` [V] from then on."""

    amplitude: Scalar = quantity("V")
    start: Scalar = quantity("s", NOT_NEGATIVE, default=0.0)

    @property
    def breaks(self) -> Float[Array, " breaks"]:
        return jnp.stack([jnp.asarray(self.start, float)])

    @property
    def step_limit(self) -> Scalar:
        return math.inf

    def on_piece(self, piece: Int[Array, "*times"], t: Times) -> Float[Array, "*times"]:
        return jnp.where(piece == 1, self.amplitude, 0.0) + jnp.zeros_like(t)


class Pulses(AbstractVoltage):
    """`number` pulses of `amplitude` [V], each `width` [s] long, one every `period` [s] from `start` [s] on."""

    amplitude: Scalar = quantity("V")
    width: Scalar = quantity("s", POSITIVE)
    period: Scalar = quantity("s", POSITIVE)
    number: int = count()
    start: Scalar = quantity("s", NOT_NEGATIVE, default=0.0)

    @property
    def breaks(self) -> Float[Array, " breaks"]:
        on = self.start + self.period * jnp.arange(self.number)
        return jnp.stack([on, on + self.width], axis=1).ravel()

    @property
    def step_limit(self) -> Scalar:
        return math.inf

    def on_piece(self, piece: Int[Array, "*times"], t: Times) -> Float[Array, "*times"]:
        return jnp.where(piece % 2 == 1, self.amplitude, 0.0) + jnp.zeros_like(t)


class Sampled(AbstractVoltage):
    """`values` [V] measured at `times` [s], straight lines between them, the first and the last held outside."""

    times: Float[Array, " samples"] = series("s")
    values: Float[Array, " samples"] = series("V")

    @property
    def breaks(self) -> Float[Array, " breaks"]:
        return jnp.asarray(self.times)

    @property
    def step_limit(self) -> Scalar:
        return math.inf

    def on_piece(self, piece: Int[Array, "*times"], t: Times) -> Float[Array, "*times"]:
        times, values = jnp.asarray(self.times), jnp.asarray(self.values)
        i = jnp.clip(piece - 1, 0, times.size - 2)
        fraction = (jnp.clip(t, times[0], times[-1]) - times[i]) / (times[i + 1] - times[i])
        return values[i] + fraction * (values[i + 1] - values[i])


class VoltageFunction(AbstractVoltage):
    """v(t) = `function(t)`, any function of a time that JAX can trace.

    Give `longest_step` [s] where the function has features so short that adaptive steps might pass over them. Jumps
    are met by refusing steps, which is slower than `Pulses` and `Sampled`.
    """

    function: Callable[[Times], Float[Array, "*times"]] = function()
    longest_step: Scalar = quantity("s", POSITIVE_OR_INFINITE, default=math.inf)

    @property
    def breaks(self) -> Float[Array, " breaks"]:
        return jnp.zeros(0)

    @property
    def step_limit(self) -> Scalar:
        return self.longest_step

    def on_piece(self, piece: Int[Array, "*times"], t: Times) -> Float[Array, "*times"]:
        return jnp.vectorize(self.function)(t)


class _Evaluated(eqx.Module):
    """A diffrax path as a function."""

    path: diffrax.AbstractPath

    def __call__(self, t: Scalar) -> Any:
        return self.path.evaluate(t)


def as_voltage(given: Any) -> Any:
    """A voltage as it is, a diffrax interpolation or another function as a `VoltageFunction`."""
    if isinstance(given, diffrax.AbstractPath):
        return VoltageFunction(_Evaluated(given))
    if isinstance(given, AbstractVoltage) or not callable(given):
        return given
    function: Any = given
    return VoltageFunction(function)


KINDS: dict[str, type] = {"sinusoid": Sinusoid, "step": Step, "pulses": Pulses, "sampled": Sampled}
