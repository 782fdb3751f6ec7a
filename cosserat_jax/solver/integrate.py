"""Integrates the rod with diffrax from the tip, where its loads are known, to the base."""

from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
from jax import lax
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, Int

from ..physics.implicit import batched_with
from ..physics.lengths import units_of
from ..physics.muscles import active_stretches
from ..physics.rod import Rod, RodState, derivative, tip_state
from ..physics.section import stiffness_at
from .method import Shooting


class Progress(NamedTuple):
    """How an integration went: its steps, and whether it came through.

    Where it did not, `stopped_at` is the arc length [m] that it reached, and `folded` whether the volume constraint,
    which has no solution from there on, is why.
    """

    steps: Int[Array, "..."]
    finished: Bool[Array, "..."]
    folded: Bool[Array, "..."]
    stopped_at: Float[Array, "..."]

    def over_all(self) -> "Progress":
        """That of several stretches, from the tip to the base, taken together."""
        stopped_at = self.stopped_at[jnp.argmax(~self.finished)]  # of the first that did not come through
        return Progress(self.steps.sum(), self.finished.all(), self.folded.any(), stopped_at)


class Stretch(NamedTuple):
    """The integration of a part of the rod in which no muscle ends: the states at its end and at asked points."""

    end: RodState
    saved: RodState | None
    progress: Progress


class Shot(NamedTuple):
    """The integration of the whole rod: the states at the base and at asked points."""

    base: RodState
    saved: RodState | None
    progress: Progress


def shoot(
    rod: Rod,
    tip_pose: Float[Array, " pose"],
    method: Shooting,
    points: Float[Array, " points"] | None = None,
) -> Shot:
    """Integrates from the tip at `tip_pose`, (theta,) or (theta, x / L, y / L), to the base.

    Each stretch between muscle ends is integrated on its own, so that no step straddles the end of a muscle; all
    stretches share one compiled integration. `points` are arc lengths in ascending order at which the state is kept.
    """
    ends, active = active_stretches(rod.muscles, rod.arm)

    def onward(state: RodState, span: tuple[Array, Array, Array]) -> tuple[RodState, Stretch]:
        start, end, active = span
        stretch = integrate(rod, state, start, end, active, method, points)
        return stretch.end, stretch

    at_tip = batched_with(tip_pose, state_at_tip(rod, tip_pose))
    spans = ends[:-1], ends[1:], active
    if len(active) == 1:  # without a loop, which JAX would differentiate and batch by tracing it again
        base, stretch = onward(at_tip, jax.tree.map(lambda leaf: leaf[0], spans))
        stretches = jax.tree.map(lambda leaf: leaf[None], stretch)
    else:
        base, stretches = lax.scan(onward, at_tip, spans)
    saved = None if points is None else gather(stretches.saved, ends, points)
    return Shot(base, saved, stretches.progress.over_all())


def integrate(
    rod: Rod,
    state: RodState,
    start: Float[Array, ""],
    end: Float[Array, ""],
    active: Bool[Array, " muscles"],
    method: Shooting,
    points: Float[Array, " points"] | None = None,
) -> Stretch:
    """Integrates from `state` at s = `start` down to s = `end`, mapped to tau in [0, 1], with these muscles active.

    diffrax carries the state as one vector: its bookkeeping, once for each array, is half of what there is to compile.
    """
    units, state_of = ravel_pytree(_scales(rod, start))
    pace = (end - start) / units

    def slope(tau: Any, scaled: Any, _: Any) -> Float[Array, " state"]:
        s = start + (end - start) * tau
        d_ds, *_ = derivative(rod, s, state_of(scaled * units), active)
        return ravel_pytree(d_ds)[0] * pace

    saveat = diffrax.SaveAt(t1=True)
    if points is not None:
        length = jnp.where(start > end, start - end, 1.0)  # a stretch between equal ends has none
        asked = jnp.clip((start - points[::-1]) / length, 0.0, 1.0)
        saveat = diffrax.SaveAt(subs=[diffrax.SubSaveAt(t1=True), diffrax.SubSaveAt(ts=asked)])
    t0, dt0 = batched_with(state.theta, (0.0, method.first_step))
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(slope),
        method.solver,
        t0=t0,
        t1=1.0,
        dt0=dt0,
        y0=ravel_pytree(state)[0] / units,
        saveat=saveat,
        stepsize_controller=method.controller,
        adjoint=diffrax.ForwardMode(),  # reverse mode goes through `at_root`, by forward mode
        max_steps=method.max_steps if method.steps is None else method.steps,
        throw=False,
    )
    ys: Any = solution.ys
    ts: Any = solution.ts
    at_end, at_points = (ys, None) if points is None else ys
    reached = ts[-1] if points is None else ts[0][-1]
    saved = None if at_points is None else jax.vmap(lambda y: state_of(y * units))(at_points)
    progress = Progress(
        steps=solution.stats["num_steps"],
        finished=solution.result == diffrax.RESULTS.successful,
        folded=(solution.result == diffrax.RESULTS.dt_min_reached) & (not rod.is_rigid),
        stopped_at=start + (end - start) * reached,
    )
    return Stretch(state_of(at_end[-1] * units), saved, progress)


def state_at_tip(rod: Rod, tip_pose: Float[Array, " pose"]) -> RodState:
    """The state at s = L for a pose of the tip; where no load asks for its place, that is the origin."""
    x, y = tip_pose[1:] * rod.arm.length if rod.depends_on_position else jnp.zeros(2)
    return tip_state(rod, x, y, tip_pose[0])


def _scales(rod: Rod, s: Float[Array, ""]) -> RodState:
    """Units in which the state is integrated, so that one tolerance suits a whale's arm and a needle."""
    length = rod.arm.length
    bending = stiffness_at(rod.arm, s).bending
    force = bending / length**2
    levers = tuple(units_of(rod.muscles[i], rod.arm).lever for i in rod.length_controlled) or None
    one = jnp.ones(())
    return lax.stop_gradient(RodState(length, length, one, one, one, force, force, bending / length, levers))


def gather(at_points: Any, ends: Float[Array, " stretches+1"], points: Float[Array, " points"]) -> RodState:
    """Of the states saved in every stretch, those of the stretch in which each point lies, the lower at its end."""
    stretch = jnp.sum(points[:, None] <= ends[None, 1:-1], axis=1)
    return jax.tree.map(lambda y: y[:, ::-1][stretch, jnp.arange(len(points))], at_points)
