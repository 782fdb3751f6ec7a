"""Integrates the rod with diffrax from the tip, where its loads are known, to the base.

Each segment between tendon ends is integrated on its own, so that no step straddles the end of a tendon; all segments
share one compiled integration. Its steps are equal in tau from 0 to 1, with

    s = start + (end - start) tau / (q + (1 - q) tau)        q = (R(end) / R(start))^0.35

so that they are short where the arm is thin: ds/dtau grows with R^0.7.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from ..numerics.runge_kutta import AROUND, Nodes, Tableau, dense_output
from ..numerics.runge_kutta import integrate as integrate_equal_steps
from ..physics.rod import Rod, RodState, derivative, restarted
from ..physics.segments import segments_of

_GRADING = 0.35


class Segment(NamedTuple):
    """From s = `start` down to `end` [m]; which tendons are active; q, see above."""

    start: Array
    end: Array
    active: tuple[Bool[Array, "..."], ...]
    grading: Array

    def place(self, tau: Any) -> tuple[Array, Array]:
        """s and ds/dtau at tau."""
        spread = self.grading + (1 - self.grading) * tau
        s = self.start + (self.end - self.start) * (tau / spread)
        return s, (self.end - self.start) * (self.grading / (spread * spread))

    def tau(self, s: Any) -> Array:
        """tau at s, 0 or 1 beyond the ends."""
        length = jnp.where(self.start > self.end, self.start - self.end, 1.0)  # one between equal ends has none
        part = jnp.clip((self.start - s) / length, 0.0, 1.0)
        return part * self.grading / (1 - part * (1 - self.grading))


class Trajectory(NamedTuple):
    """The integration of the whole rod: what each segment holds for dense output, segments first, and the base."""

    nodes: Nodes
    base: RodState


def segments(rod: Rod, cuts: Float[Array, " cuts"] | None = None) -> Segment:
    """All segments of the rod, from the tip to the base, on the first axis."""
    places, active = segments_of(rod.tendons, rod.length, cuts)
    start, end = places[:-1], places[1:]
    return Segment(start, end, active, graded(rod, start, end))


def graded(rod: Rod, start: Array, end: Array) -> Array:
    """q of segments with these ends; no derivative goes through it."""
    return lax.stop_gradient(jnp.abs(rod.radius_at(end) / rod.radius_at(start))) ** _GRADING


def slope_of(rod: Rod, segment: Segment, known: Any = None) -> Any:
    """d(state)/dtau as a function of tau and the state. For `known` see `physics.volume.strained`."""

    def slope(tau: Any, state: RodState) -> RodState:
        s, rate = segment.place(tau)
        d_ds, *_ = derivative(rod, s, state, segment.active, known)
        return jax.tree.map(lambda u, d: jnp.broadcast_to(d * rate, u.shape), state, d_ds)

    return slope


def integrate(
    rod: Rod, state: RodState, segment: Segment, tableau: Tableau, count: Int[Array, ""], room: Any, most: int
) -> Nodes:
    """Integrates one segment in `count` steps, at most `most`, from the state where it starts; see `restarted`, and for
    `room` `numerics.runge_kutta.integrate`."""
    return integrate_equal_steps(slope_of(rod, segment), tableau, state, count, room, most)


def shoot(rod: Rod, at_tip: RodState, tableau: Tableau, count: Int[Array, ""], before: Trajectory) -> Trajectory:
    """Integrates from the tip to the base, and writes over the trajectory `before`, which has room for the nodes."""
    spans = segments(rod)
    room = before.nodes.states, before.nodes.slopes
    most = jax.tree.leaves(room)[0].shape[1] - 1

    def onward(state: RodState, given: tuple[Segment, Any]) -> tuple[RodState, Nodes]:
        segment, room = given
        state = restarted(rod, segment.start, state, segment.active)
        nodes = integrate(rod, state, segment, tableau, count, room, most)
        return nodes.end, nodes

    if len(spans.start) == 1:
        base, nodes = onward(at_tip, jax.tree.map(lambda leaf: leaf[0], (spans, room)))
        return Trajectory(jax.tree.map(lambda leaf: leaf[None], nodes), base)
    base, nodes = lax.scan(onward, at_tip, (spans, room))
    return Trajectory(nodes, base)


def states_at(
    rod: Rod, trajectory: Trajectory, s: Float[Array, "points ..."], around: int = AROUND
) -> tuple[RodState, Segment]:
    """The states at arc lengths `s` [m] from the base to the tip, and the segment in which each lies, the lower at its
    end. For `around` see `dense_output`."""
    spans = segments(rod)
    nodes = trajectory.nodes
    places = spans.end[:-1]
    if s.ndim < places.ndim:
        s = s[:, None]
    which = (s[None] <= places[:, None]).sum(0)

    def taken(values: Array) -> Array:
        if len(values) == 1:
            return values[0]
        if values.ndim == which.ndim == 2:
            return jnp.take_along_axis(values, which, axis=0)
        if values.ndim == 1:
            return values[which]
        return jnp.take_along_axis(values, which[..., None] if which.ndim == 1 else which, axis=0)

    here = jax.tree.map(taken, spans)
    return dense_output(nodes, here.tau(s), which, around), here
