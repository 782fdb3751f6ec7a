"""The results of an integration, linearized: the numbers of the tip, and the fields in groups of points.

Fields at all points at once are hundreds of arrays [points, batch], more than a processor's cache holds, so the points
are taken in groups, one after another, by a program as large as that of one group.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from ..numerics.runge_kutta import Nodes
from ..physics.rod import Rod, RodState, derivative, known_slope_at, restarted
from ..physics.segments import active_at
from .integrate import Trajectory, states_at
from .outputs import FIELDS, active_at_tip, arc_lengths, field_values, stacked, tip_values
from .unknowns import Unknowns

_GROUP = 16  # points


class At(NamedTuple):
    """Where to linearize: the rod, the unknowns, the nodes of the integration and its end; or a change or a cotangent
    of each, vectors first."""

    rod: Rod
    u: Array
    nodes: Any
    base: RodState


def tip_forward(at: At, changes: At) -> Float[Array, "vectors rows batch"]:
    """The changes of `tip_values`."""
    _, linear = jax.linearize(_tip(at), at.rod, at.u, at.base)
    return jax.vmap(linear)(changes.rod, changes.u, changes.base)


def tip_backward(at: At, cotangents: Float[Array, "vectors rows batch"]) -> At:
    """The cotangents of where it was linearized from those of `tip_values`; the nodes are not asked for."""
    _, back = jax.vjp(_tip(at), at.rod, at.u, at.base)
    rod, u, base = jax.vmap(back)(cotangents)
    return At(rod, u, None, base)


def _tip(at: At) -> Callable:
    active = active_at_tip(at.rod)
    state = restarted(at.rod, at.rod.length, Unknowns.of(at.rod).tip(at.rod, at.u), active)
    beta_s = derivative(at.rod, at.rod.length, state, active)[1].beta_s
    known = known_slope_at(at.rod, at.rod.length, state, active, beta_s)

    def values(rod: Rod, u: Array, base: RodState) -> Array:
        return tip_values(rod, Unknowns.of(rod), u, base, known)

    return values


def fields_forward(
    at: At, places: Float[Array, " points"], changes: At
) -> Float[Array, "vectors fields_and_points batch"]:
    """The changes of the fields at the places s / L."""
    padded, groups = _padded(places)
    states, linear = jax.linearize(_states(at, padded), at.rod, at.nodes._replace(steps=None))
    d_states = jax.vmap(linear)(changes.rod, changes.nodes)
    d_states = jax.tree.map(lambda leaf: jnp.moveaxis(_grouped(leaf, groups, 1), 1, 0), d_states)

    def one(group: tuple) -> Array:
        places, state, d_state = group
        _, linear = jax.linearize(_values(at, places, state), at.rod, state, at.base)
        return jax.vmap(linear)(changes.rod, d_state, changes.base)

    found = lax.map(one, (_grouped(padded, groups), _grouped(states, groups), d_states))
    found = jnp.moveaxis(found, 0, 2)  # vectors, fields, groups, points, batch
    found = found.reshape(*found.shape[:2], -1, found.shape[-1])[:, :, : len(places)]
    return found.reshape(len(found), -1, found.shape[-1])


def fields_backward(
    at: At, places: Float[Array, " points"], cotangents: Float[Array, "vectors fields_and_points batch"]
) -> At:
    """The cotangents of where it was linearized from those of the fields at the places s / L."""
    padded, groups = _padded(places)
    vectors, _, batch = cotangents.shape
    bars = cotangents.reshape(vectors, len(FIELDS), len(places), batch)
    bars = jnp.pad(bars, ((0, 0), (0, 0), (0, len(padded) - len(places)), (0, 0)))
    bars = jnp.moveaxis(_grouped(bars, groups, 2), 2, 0)
    states, back = jax.vjp(_states(at, padded), at.rod, at.nodes._replace(steps=None))

    def one(total: tuple[Rod, RodState], group: tuple) -> tuple[tuple[Rod, RodState], RodState]:
        places, state, bar = group
        _, back = jax.vjp(_values(at, places, state), at.rod, state, at.base)
        rod_bar, state_bar, base_bar = jax.vmap(back)(bar)
        return jax.tree.map(jnp.add, total, (rod_bar, base_bar)), state_bar

    empty = jax.tree.map(lambda leaf: jnp.zeros((vectors, *leaf.shape)), (at.rod, at.base))
    given = (_grouped(padded, groups), _grouped(states, groups), bars)
    (rod_bar, base_bar), states_bar = lax.scan(one, empty, given)
    states_bar = jax.tree.map(
        lambda leaf: jnp.moveaxis(leaf, 0, 1).reshape(vectors, -1, leaf.shape[-1]), states_bar
    )  # fmt: skip
    more, nodes_bar = jax.vmap(back)(states_bar)
    return At(jax.tree.map(jnp.add, rod_bar, more), jnp.zeros((vectors, *at.u.shape)), nodes_bar, base_bar)


def _states(at: At, places: Array) -> Callable:
    """The states at the places as a function of the rod and the nodes."""

    def states(rod: Rod, kept: Nodes) -> RodState:
        trajectory = Trajectory(kept._replace(steps=at.nodes.steps), at.base)
        return states_at(rod, trajectory, arc_lengths(places, rod.length, at.u.shape[-1]))[0]

    return states


def _values(at: At, places: Array, state: RodState) -> Callable:
    """The fields [fields, points, batch] as a function of the rod, the states and the base."""
    batch = at.u.shape[-1]

    def section_at(rod: Rod, state: RodState, known: Any) -> tuple[Array, Any]:
        s = arc_lengths(places, rod.length, batch)
        return s, derivative(rod, s, state, active_at(rod.tendons, s), known)[1]

    s, section = section_at(at.rod, state, None)
    known = known_slope_at(at.rod, s, state, active_at(at.rod.tendons, s), section.beta_s)

    def values(rod: Rod, state: RodState, base: RodState) -> Array:
        s, section = section_at(rod, state, known)
        return stacked(field_values(rod, base, s, state, section), (len(places), batch))

    return values


def _padded(places: Array) -> tuple[Array, int]:
    """The places, the last as often as makes equal groups, and how many groups."""
    groups = math.ceil(len(places) / _GROUP)
    missing = math.ceil(len(places) / groups) * groups - len(places)
    return jnp.pad(places, (0, missing), mode="edge"), groups


def _grouped(tree: Any, groups: int, axis: int = 0) -> Any:
    """With the points, on this axis, as [groups, points]."""

    def grouped(leaf: Array) -> Array:
        return leaf.reshape(*leaf.shape[:axis], groups, -1, *leaf.shape[axis + 1 :])

    return jax.tree.map(grouped, tree)
