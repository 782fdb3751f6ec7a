"""`tcam_response`: the muscle's temperature, contraction and force over time, integrated with diffrax.

The time is cut at every instant asked for and at every jump of the voltage, and each interval is mapped to [0, 1] and
integrated on its own, all of them by one compiled integration. So no step straddles a jump, and derivatives with
respect to the instants, those of the jumps too, are exact.
"""

from typing import Any, NamedTuple

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
from ..scene import TCAM, AbstractVoltage, SceneError, Sinusoid, validate_tcam
from ..scene.quantity import as_floats, concrete
from .method import TimeStepping, error_norm
from .outcome import ResponseOutcome


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


def tcam_response(
    tcam: TCAM, times: ArrayLike, method: TimeStepping | None = None, initial: TCAMState | None = None
) -> Response:
    """The response of `tcam` to its voltage from t = 0 on, at `times` [s], of shape (times,), in ascending order.

    It starts from `initial`, by default at ambient temperature and at rest. `method` is by default
    `TimeStepping.suited_to(tcam)`. Works under `jit`, `vmap`, `grad` and `jacfwd`, with respect to every float of
    `tcam`, the times and the initial state. Does not raise for what comes of it: see `Response.outcome`. Raises
    `SceneError` for a constant or times that are not allowed.
    """
    validate_tcam(tcam)
    _check_times(times)
    method = TimeStepping.suited_to(tcam) if method is None else method
    start = resting_state(tcam) if initial is None else initial
    return _response(as_floats(tcam), jnp.asarray(times, float), as_floats(start), method)


def _check_times(times: ArrayLike) -> None:
    """Raises `SceneError` unless `times` are instants from 0 on in ascending order; traced ones pass."""
    seconds = concrete(times)
    if np.ndim(times) != 1 or np.size(times) == 0:
        raise SceneError(f"times: an array of shape {np.shape(times)}; allowed: one axis, not empty")
    if seconds is not None and not (np.isfinite(seconds).all() and (np.diff(seconds, prepend=0.0) >= 0).all()):
        raise SceneError("times: not in order; allowed: finite numbers [s], from 0 on, ascending")


@eqx.filter_jit
def _response(tcam: TCAM, times: Float[Array, " times"], start: TCAMState, method: TimeStepping) -> Response:
    floats, rest = eqx.partition((tcam, times, start), eqx.is_inexact_array)

    def of(floats: Any) -> _Found:
        tcam, times, start = eqx.combine(floats, rest)
        return _found(tcam, times, start, method)

    found = by_forward_mode(of, floats)
    outcome = _outcome(found)
    known = ~((outcome == ResponseOutcome.integration_failed) | (outcome == ResponseOutcome.no_coil))
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
    heat_above_limit: Float[Array, ""]


def _found(tcam: TCAM, times: Float[Array, " times"], start: TCAMState, method: TimeStepping) -> _Found:
    breaks = _voltage(tcam).breaks
    watched = jnp.linspace(0.0, times[-1], method.watch + 1)[1:]
    instants = jnp.concatenate([times, watched, jnp.clip(breaks, 0.0, times[-1])])
    order = jnp.argsort(instants)
    edges = jnp.concatenate([jnp.zeros(1), instants[order]])
    pieces = jnp.searchsorted(breaks, (edges[1:] + edges[:-1]) / 2, side="right")
    states, steps, finished = _integrate(tcam, edges, pieces, method, start)
    at = jnp.argsort(order)[: times.size]  # where each of the times went
    rises = jnp.concatenate([jnp.atleast_1d(start.rise), states.rise])
    peak = _peak(tcam, edges, pieces, rises)
    cosines = jnp.asarray(coil_cosine(tcam, rises if tcam.dynamics == "full" else 0.0))
    return _Found(
        asked=jax.tree.map(lambda state: state[at], states),
        peak=peak,
        steps=steps.astype(float),
        finished=(finished & jnp.isfinite(rises).all()).astype(float),
        has_coil=((cosines > 0) & (cosines <= 1)).all().astype(float),
        heat_above_limit=peak.temperature - tcam.limit_temperature,
    )


def _integrate(
    tcam: TCAM, edges: Float[Array, " edges"], pieces: Int[Array, " intervals"], method: TimeStepping, start: TCAMState
) -> tuple[TCAMState, Int[Array, ""], Bool[Array, ""]]:
    """The states at the later edge of every interval, the steps taken, and whether all came through."""
    units, state_of = ravel_pytree(_scales(tcam))
    drive = _voltage(tcam)
    longest = lax.stop_gradient(drive.step_limit)

    def interval(carry: tuple[TCAMState, Array], span: tuple[Array, Array, Array]) -> tuple[tuple, tuple]:
        (state, came_through), (begin, end, piece) = carry, span
        length = end - begin

        def slope(tau: Any, scaled: Any, _: Any) -> Float[Array, " state"]:
            voltage = drive.on_piece(piece, begin + length * tau)
            rate = state_rate(tcam, voltage, state_of(scaled * units))
            return ravel_pytree(rate)[0] * (length / units)

        held = lax.stop_gradient(length)
        dtmax = jnp.where(held > 0, longest / jnp.where(held > 0, held, 1.0), 1.0)
        dt0 = batched_with(state, jnp.minimum(dtmax, 1.0))
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(slope),
            method.solver,
            t0=jnp.where(came_through, 0.0, 1.0),  # what failed once is not tried in every later interval
            t1=1.0,
            dt0=dt0,
            y0=ravel_pytree(state)[0] / units,
            stepsize_controller=diffrax.PIDController(rtol=method.rtol, atol=method.atol, dtmax=dtmax, norm=error_norm),
            adjoint=diffrax.ForwardMode(),  # reverse mode goes through `by_forward_mode`
            max_steps=method.max_steps,
            throw=False,
        )
        ys: Any = solution.ys
        there = state_of(ys[-1] * units)
        came_through &= solution.result == diffrax.RESULTS.successful
        return (there, came_through), (there, solution.stats["num_steps"])

    begin = batched_with(tcam, (start, True))
    (_, came_through), (states, steps) = lax.scan(interval, begin, (edges[:-1], edges[1:], pieces))
    return states, steps.sum(), came_through


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
    outcome = ResponseOutcome.where(found.finished == 1, outcome, ResponseOutcome.integration_failed)
    return ResponseOutcome.where(found.has_coil == 0, ResponseOutcome.no_coil, outcome)


def _peak(tcam: TCAM, edges: Array, pieces: Array, rises: Float[Array, " edges"]) -> Peak:
    """The highest of the rises and of the cubics through them and their rates, interval by interval."""
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
    best = jnp.argmax(tops)
    hottest, when = tops[best], begin[best] + tau[best] * length[best]
    at_start = rises[0] >= hottest
    return Peak(tcam.ambient_temperature + jnp.where(at_start, rises[0], hottest), jnp.where(at_start, edges[0], when))
