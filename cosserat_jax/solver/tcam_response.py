"""`tcam_response`: the muscle's temperature, contraction and force over time, integrated with diffrax.

The time is cut at every instant asked for and at every jump of the voltage, and each interval is mapped to [0, 1] and
integrated on its own, all of them by one compiled integration. So no step straddles a jump, and derivatives with
respect to the instants, those of the jumps too, are exact. Where a jump falls on an instant asked for, the value there
is that before the jump, and so is its derivative.

A voltage that is a Python function has no jumps to cut at. It is sampled on each interval: where the samples jump,
steps are at most two of their spacings, and a feature that only one or two of them see is not resolved.
"""

from typing import TYPE_CHECKING, Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.flatten_util import ravel_pytree
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int

from ..numerics.implicit_derivatives import by_forward_mode
from ..numerics.newton import batched_with
from ..numerics.runge_kutta import FirstStep
from ..physics.tcam import (
    TCAMState,
    coil_cosine,
    coiled_length,
    driving_force,
    heating_rate,
    resting_state,
    spring_coefficient,
    state_rate,
    tension_gain,
)
from ..scene import TCAM, AbstractVoltage, InputError, Sinusoid, VoltageFunction, validate_tcam
from ..scene.quantity import as_floats, concrete
from .display import counted, described, shape_text, values_text
from .method import TimeStepping, error_norm
from .outcome import ResponseOutcome

if TYPE_CHECKING:
    import xarray

_SAMPLES = 128  # of a voltage function on each interval
_ROUGH = 0.125  # change of v^2 between two samples, of its range on the interval, from which it counts as a jump
_FLAT = 1e-9  # range of v^2 on an interval, of its largest there, that is rounding
_PRINTED = {"voltage": "V", "temperature": "K", "force": "N", "tension": "N"}  # by a response
_SAME_INSTANT = 1e-12  # of the last time: instants that differ by rounding


class Peak(NamedTuple):
    """The highest temperature [K] and the time [s] at which it is reached."""

    temperature: Float[Array, "..."]
    time: Float[Array, "..."]


class Response(eqx.Module):
    """What a TCAM does over time; every array has a last axis over the `times` asked for, except those marked *.

    - `voltage` [V], `temperature` [K], `contraction` d = L_o - length [m] and its `contraction_rate` [m/s].
    - `force` [N]: what heat adds to the pull of a muscle held at its ambient length, `driving_force`.
    - `tension` C_T T [N]: with which it pulls an arm (paper, Eq. CableTensionTCAMs).
    - `peak`*: the highest temperature from 0 to the last of the times, between them too, and when.
    - `outcome`*: a `ResponseOutcome`. Numbers that there are none of are NaN; those of an overheated muscle stand.
    - `steps`*: of the integrator.
    """

    times: Float[Array, "... times"]
    voltage: Float[Array, "... times"]
    temperature: Float[Array, "... times"]
    contraction: Float[Array, "... times"]
    contraction_rate: Float[Array, "... times"]
    force: Float[Array, "... times"]
    tension: Float[Array, "... times"]
    peak: Peak
    outcome: ResponseOutcome
    steps: Int[Array, "..."]

    @described
    def __repr__(self) -> str:
        shape = np.shape(self.steps)
        if shape:
            lines = [f"Response of {shape_text(shape)} muscles: {counted(self.outcome, ResponseOutcome)}"]
        else:
            lines = [f"Response: {ResponseOutcome[jax.tree.map(np.asarray, self.outcome)]}"]
        lines.append(f"  times: {np.shape(self.times)[-1]}, {values_text(self.times, 's')}")
        lines += [f"  {name}: {values_text(getattr(self, name), unit)}" for name, unit in _PRINTED.items()]
        peak = f"{values_text(self.peak.temperature, 'K')} at {values_text(self.peak.time, 's')}"
        return "\n".join([*lines, f"  peak: {peak}"])

    def to_xarray(self) -> "xarray.Dataset":
        """A dataset over `time` with units and long names; the axes of a batch are `batch`, or `batch_0` and so on."""
        from .variables import response_dataset

        return response_dataset(self)


def tcam_response(
    tcam: TCAM, times: ArrayLike, method: TimeStepping | None = None, initial: TCAMState | None = None
) -> Response:
    """The response of `tcam` to its voltage from t = 0 on, at `times` [s], of shape (times,), in ascending order.

    It starts from `initial`, by default at ambient temperature and at rest. `method` is by default
    `TimeStepping.suited_to(tcam)`. Works under `jit`, `vmap`, `grad` and `jacfwd`, with respect to every float of
    `tcam`, the times and the initial state. Does not raise for what comes of it: see `Response.outcome`. Raises
    `InputError` for a constant or times that are not allowed.
    """
    validate_tcam(tcam)
    _check_times(times)
    method = TimeStepping.suited_to(tcam) if method is None else method
    start = resting_state(tcam) if initial is None else initial
    return _response(as_floats(tcam), jnp.asarray(times, float), as_floats(start), method)


def _check_times(times: ArrayLike) -> None:
    """Raises `InputError` unless `times` are instants from 0 on in ascending order; traced ones pass."""
    seconds = concrete(times)
    if np.ndim(times) != 1 or np.size(times) == 0:
        raise InputError(f"times: an array of shape {np.shape(times)}; allowed: one axis, not empty")
    if seconds is not None and not (np.isfinite(seconds).all() and (np.diff(seconds, prepend=0.0) >= 0).all()):
        raise InputError("times: not in order; allowed: finite numbers [s], from 0 on, ascending")


@eqx.filter_jit
def _response(tcam: TCAM, times: Float[Array, " times"], start: TCAMState, method: TimeStepping) -> Response:
    floats, rest = eqx.partition((tcam, times, start), eqx.is_inexact_array)

    def of(floats: Any) -> _Found:
        tcam, times, start = eqx.combine(floats, rest)
        return _found(tcam, times, start, method)

    found = by_forward_mode(of, floats)
    outcome = _outcome(found)
    known = (outcome == ResponseOutcome.followed) | (outcome == ResponseOutcome.overheated)
    asked, peak = jax.tree.map(lambda leaf: jnp.where(known, leaf, jnp.nan), (found.asked, found.peak))
    return Response(
        times=times,
        voltage=_voltage(tcam)(times),
        temperature=tcam.ambient_temperature + asked.rise,
        contraction=asked.contraction,
        contraction_rate=asked.rate,
        force=jnp.asarray(driving_force(tcam, asked.rise)),
        tension=tension_gain(tcam) * asked.rise,
        peak=peak,
        outcome=outcome,
        steps=found.steps.astype(int),
    )


class _Found(NamedTuple):
    """What an integration brings, all of it floats: the states asked for, the peak, and figures for the outcome."""

    asked: TCAMState
    peak: Peak
    steps: Float[Array, ""]
    finished: Float[Array, ""]
    has_coil: Float[Array, ""]
    is_resolved: Float[Array, ""]
    heat_above_limit: Float[Array, ""]


def _found(tcam: TCAM, times: Float[Array, " times"], start: TCAMState, method: TimeStepping) -> _Found:
    breaks = _voltage(tcam).breaks
    watched = jnp.linspace(0.0, times[-1], method.watch + 1)[1:]
    others = jnp.concatenate([times, watched])
    within = jnp.where(breaks < 0, 0.0, jnp.where(breaks > times[-1], times[-1], breaks))
    # a break comes after the instants that it falls on, and breaks that coincide keep their order
    order = jnp.argsort(jnp.concatenate([others, lax.cummax(within)]))
    edges = jnp.concatenate([jnp.zeros(1), jnp.concatenate([others, within])[order]])
    is_break = order >= others.size
    pieces = jnp.cumsum(is_break) - is_break  # the breaks that lie before each interval
    states, steps, finished, resolved = _integrate(tcam, edges, pieces, method, start)
    at = jnp.argsort(order)[: times.size]  # where each of the times went
    rises = jnp.concatenate([jnp.atleast_1d(start.rise), states.rise])
    peak = _peak(tcam, edges, pieces, rises, is_break | ~_on_breaks(edges[1:], within))
    cosines = jnp.asarray(coil_cosine(tcam, rises if tcam.dynamics == "full" else 0.0))
    return _Found(
        asked=jax.tree.map(lambda state: state[at], states),
        peak=peak,
        steps=steps.astype(float),
        finished=(finished & jnp.isfinite(rises).all()).astype(float),
        has_coil=_is_coil(cosines).all().astype(float),
        is_resolved=resolved.astype(float),
        heat_above_limit=peak.temperature - tcam.limit_temperature,
    )


def _integrate(
    tcam: TCAM, edges: Float[Array, " edges"], pieces: Int[Array, " intervals"], method: TimeStepping, start: TCAMState
) -> tuple[TCAMState, Int[Array, ""], Bool[Array, ""], Bool[Array, ""]]:
    """The states at the later edge of every interval, the steps taken, whether all came through, and whether the steps
    were short enough for the voltage."""
    units, state_of = ravel_pytree(_scales(tcam))
    drive = _voltage(tcam)

    def interval(carry: tuple[TCAMState, Array], span: tuple[Array, Array, Array]) -> tuple[tuple, tuple]:
        (state, came_through), (begin, end, piece) = carry, span
        length = end - begin

        def slope(tau: Any, scaled: Any, _: Any) -> Float[Array, " state"]:
            voltage = drive.on_piece(piece, begin + length * tau)
            rate = state_rate(tcam, voltage, state_of(scaled * units))
            return jnp.where(came_through, ravel_pytree(rate)[0] * (length / units), 0.0)

        held = lax.stop_gradient(length)
        longest, resolved = _longest_step(drive, lax.stop_gradient(begin), held)
        # what failed once is not tried in every later interval
        dtmax = jnp.where(came_through & (held > 0), longest / jnp.where(held > 0, held, 1.0), 1.0)
        dt0 = batched_with(state, jnp.minimum(dtmax, 1.0))
        steps = diffrax.PIDController(rtol=method.rtol, atol=method.atol, dtmax=dtmax, norm=error_norm)
        here = jax.tree.map(lambda leaf: jnp.where(came_through, leaf, 0.0), state)
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(slope),
            method.solver,
            t0=0.0,
            t1=1.0,
            dt0=None,
            y0=ravel_pytree(here)[0] / units,
            stepsize_controller=FirstStep(steps, dt0),
            adjoint=diffrax.ForwardMode(),  # reverse mode goes through `by_forward_mode`
            max_steps=method.max_steps,
            throw=False,
        )
        ys: Any = solution.ys
        there = state_of(ys[-1] * units)
        taken = jnp.where(came_through, solution.stats["num_steps"], 0)
        through = came_through & (solution.result == diffrax.RESULTS.successful)
        return (there, through), (there, taken, resolved)

    is_coil = _is_coil(coil_cosine(tcam, start.rise if tcam.dynamics == "full" else 0.0))
    begin = batched_with(tcam, (start, is_coil))  # what is none is not integrated
    (_, came_through), (states, steps, resolved) = lax.scan(interval, begin, (edges[:-1], edges[1:], pieces))
    return states, steps.sum(), came_through, resolved.all()


def _is_coil(cosine: Any) -> Array:
    return jnp.asarray((cosine > 0) & (cosine <= 1))


def _longest_step(drive: AbstractVoltage, begin: Array, length: Array) -> tuple[Any, Any]:
    """The longest step [s] on an interval, and whether it resolves all that the voltage is seen to do there.

    The samples of a voltage function are spread evenly and shifted from interval to interval (an additive recurrence,
    Roberts 2018), so that pulses in step with the intervals do not slip between them.
    """
    limit = lax.stop_gradient(drive.step_limit)
    if not isinstance(drive, VoltageFunction):
        return limit, jnp.asarray(True)
    spacing = length / _SAMPLES
    shifts = jnp.mod(begin / jnp.where(length > 0, length, 1.0) * 0.6180339887 + jnp.arange(_SAMPLES) * 0.7548776662, 1)
    squares = lax.stop_gradient(drive(begin + spacing * (jnp.arange(_SAMPLES) + shifts))) ** 2
    change = jnp.diff(squares)
    extent = squares.max() - squares.min()
    jumps = (jnp.abs(change) > _ROUGH * extent) & (extent > _FLAT * squares.max())
    returns = [jumps[:-n] & jumps[n:] & (change[:-n] * change[n:] < 0) for n in (1, 2)]
    is_narrow = (returns[0].any() | returns[1].any()) & (limit > spacing)
    return jnp.minimum(limit, jnp.where(jumps.any(), 2 * spacing, jnp.inf)), ~is_narrow


def _on_breaks(instants: Float[Array, " n"], breaks: Float[Array, " breaks"]) -> Bool[Array, " n"]:
    """Which of the instants fall on one of the breaks, but for rounding."""
    if breaks.size == 0:
        return jnp.zeros(instants.shape, bool)
    after = jnp.clip(jnp.searchsorted(breaks, instants), 0, breaks.size - 1)
    distance = jnp.abs(instants[None] - breaks[jnp.stack([after, jnp.maximum(after - 1, 0)])]).min(0)
    return distance <= _SAME_INSTANT * instants[-1]


def _voltage(tcam: TCAM) -> AbstractVoltage:
    """What drives the muscle; none of it where nothing does."""
    return Sinusoid(amplitude=0.0, frequency=0.0) if tcam.voltage is None else tcam.voltage


def _scales(tcam: TCAM) -> TCAMState:
    """Units in which the state is integrated: one degree, the muscle's length, that length in a swing's time."""
    length = coiled_length(tcam, 0.0)
    frequency = jnp.sqrt(spring_coefficient(tcam, 0.0) / tcam.mass)
    usable = (length > 0) & jnp.isfinite(frequency)
    return lax.stop_gradient(
        TCAMState(jnp.ones(()), jnp.where(usable, length, 1.0), jnp.where(usable, length * frequency, 1.0))
    )


def _outcome(found: _Found) -> ResponseOutcome:
    too_hot = found.heat_above_limit > 0
    outcome = ResponseOutcome.where(too_hot, ResponseOutcome.overheated, ResponseOutcome.followed)
    outcome = ResponseOutcome.where(found.is_resolved == 1, outcome, ResponseOutcome.voltage_not_resolved)
    outcome = ResponseOutcome.where(found.finished == 1, outcome, ResponseOutcome.integration_failed)
    return ResponseOutcome.where(found.has_coil == 0, ResponseOutcome.no_coil, outcome)


def _peak(tcam: TCAM, edges: Array, pieces: Array, rises: Float[Array, " edges"], counts: Array) -> Peak:
    """The highest of the rises and of the cubics through them and their rates, of the intervals that count: of those
    that end at one instant, the one that ends with the break, with which the peak moves."""
    begin, end, low, high = edges[:-1], edges[1:], rises[:-1], rises[1:]
    length = end - begin
    drive = _voltage(tcam)
    first = length * heating_rate(tcam, drive.on_piece(pieces, begin), low)
    last = length * heating_rate(tcam, drive.on_piece(pieces, end), high)
    # T(tau) = low + first tau + square tau^2 + cube tau^3
    cube, square = first + last - 2 * (high - low), 3 * (high - low) - 2 * first - last
    has_top = (first > 0) & (last < 0)
    root = jnp.sqrt(jnp.where(has_top, square**2 - 3 * cube * first, 1.0))
    tau = jnp.where(has_top, first / jnp.where(has_top, root - square, 1.0), 1.0)
    tops = low + tau * (first + tau * (square + tau * cube))
    best = jnp.argmax(jnp.where(counts | has_top, tops, -jnp.inf))
    hottest, when = tops[best], begin[best] + tau[best] * length[best]
    at_start = rises[0] >= hottest
    return Peak(tcam.ambient_temperature + jnp.where(at_start, rises[0], hottest), jnp.where(at_start, edges[0], when))
