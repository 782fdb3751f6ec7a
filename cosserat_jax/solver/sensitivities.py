"""Derivatives of an equilibrium by the floats of its scene: forward by linearized integration, backward by its adjoint.

With u(p) the root of E(u, p) = 0 and O(u, p) what is computed there, the implicit function theorem gives

    dO = O_p dp + O_u du        du = -E_u^-1 E_p dp

The steps of the integration are those of the equilibrium, so they are differentiated as they are. Forward, the stages
of each step are linearized once for the directions of all unknowns and all dp. Backward (the discrete adjoint), the
cotangents of E and of O go through the steps together, by the state alone; then those of O are joined with what
du asks of E, and the parameters are reached once, whatever their number.
"""

import dataclasses
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.core import ShapedArray
from jaxtyping import Array, Float

from ..numerics import batching, linear_systems
from ..numerics.runge_kutta import Nodes, combine, stages_of_step
from ..physics.rod import Rod, RodState, known_slope_at, restarted
from .integrate import Segment, segments, slope_of
from .linear_results import At, fields_backward, fields_forward, tip_backward, tip_forward
from .outputs import FIELDS, TIP, Structure
from .unknowns import Unknowns


class _Problem(NamedTuple):
    """An equilibrium as functions of the floats of its scene, [batch] each: the rod, and of the rod, the unknowns and
    an integration the error of the base and the results, [rows, batch]."""

    structure: Structure
    part: str
    places: Array
    steps: Array

    def rod(self, leaves: list[Array], u: Array) -> Rod:
        """The rod at full load with the tensions among the unknowns."""
        rod = Rod.of(self.structure.scene(leaves)).at_load(jnp.ones(()))
        rod = jax.tree.map(lambda leaf: jnp.broadcast_to(jnp.asarray(leaf, float), u.shape[1:]), rod)
        return Unknowns.of(rod).applied(rod, u)

    def at_tip(self, rod: Rod, u: Array) -> RodState:
        """The state at the tip, before `restarted`."""
        return Unknowns.of(rod).tip(rod, u)

    def error(self, rod: Rod, u: Array, base: RodState) -> Array:
        """E."""
        return Unknowns.of(rod).error(rod, base)


@dataclasses.dataclass(frozen=True)
class Tangent(batching.LinearFunction):
    """From the places of the fields, the root (see `Report`), the floats of a scene and changes of them, to the changes
    of the results: part "tip" those of `tip_values`, part "fields" the fields at all places."""

    structure: Structure
    part: str
    is_transposed: bool = False
    chunk: int = 128

    @property
    def ranks(self) -> tuple[int, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        return (1, 1, *self.structure.ranks, 2)

    def results(self, *shapes: tuple[int, ...]) -> list[ShapedArray]:
        places, root, *leaves, vectors = shapes
        size = sum(math.prod(leaf) for leaf in leaves)
        if not self.is_transposed:
            muscles = len(self.structure.scene([0.0] * len(leaves)).muscles)
            size = len(TIP) + muscles + root[0] - 1 if self.part == "tip" else len(FIELDS) * places[0]
        return [ShapedArray((vectors[0], size), jnp.dtype(float))]

    def transposed(self) -> "Tangent":
        return dataclasses.replace(self, is_transposed=not self.is_transposed)

    def compute(self, *arguments: Array) -> list[Array]:
        places, root, *leaves, vectors = arguments
        batch = next(a.shape[-1] for a, r in zip(arguments, self.ranks, strict=True) if a.ndim > r)

        def spread(a: Array, rank: int) -> Array:
            return jnp.broadcast_to(a if a.ndim > rank else a[..., None], (*a.shape[:rank], batch))

        leaves = [spread(leaf, rank) for leaf, rank in zip(leaves, self.structure.ranks, strict=True)]
        root, vectors = spread(root, 1), spread(vectors, 2)
        u, count = root[:-1], jnp.nanmax(jnp.where(jnp.isnan(root[-1]), 4.0, root[-1])).astype(int)
        problem = _Problem(self.structure, self.part, places, count)
        if self.is_transposed:
            return [_pulled_back(problem, leaves, u, vectors)]
        sizes = [math.prod(leaf.shape[:-1]) for leaf in leaves]
        parts = jnp.split(vectors, [sum(sizes[: i + 1]) for i in range(len(sizes) - 1)], axis=1)
        changes = [part.reshape(-1, *leaf.shape) for part, leaf in zip(parts, leaves, strict=True)]
        return [_pushed_forward(problem, leaves, u, changes)]


def _pushed_forward(problem: _Problem, leaves: list, u: Array, changes: list) -> Float[Array, "vectors rows batch"]:
    """The changes of O along changes of the floats, the unknowns following."""
    n, k = len(u), len(changes[0])
    unit = jnp.broadcast_to(jnp.eye(n)[..., None], (n, n, u.shape[-1]))
    du = jnp.concatenate([unit, jnp.zeros((k, *u.shape))])
    dp = [jnp.concatenate([jnp.zeros((n, *change.shape[1:])), change]) for change in changes]

    def along(function: Callable, *at: Any) -> tuple[Any, Callable]:
        value, linear = jax.linearize(function, *at)
        return value, jax.vmap(linear)

    rod, rod_linear = along(problem.rod, leaves, u)
    d_rod = rod_linear(dp, du)
    state, tip_linear = along(problem.at_tip, rod, u)
    d_state = tip_linear(d_rod, du)
    spans, spans_linear = along(_floats_of_segments, rod)
    d_spans = jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 1, 0), spans_linear(d_rod))  # segments first
    active = segments(rod).active

    def onward(carry: tuple, given: tuple) -> tuple[tuple, tuple]:
        (state, d_state), (span, d_span, active) = carry, given

        def restart(rod: Rod, span: tuple, state: RodState) -> RodState:
            return restarted(rod, span[0], state, active)

        state, linear = along(restart, rod, span, state)
        nodes, d_nodes = _steps_forward(
            problem, (rod, d_rod), (span, d_span), active, (state, linear(d_rod, d_span, d_state))
        )
        return (nodes.end, d_nodes.end), (nodes, d_nodes)

    (base, d_base), (nodes, d_nodes) = lax.scan(onward, (state, d_state), (spans, d_spans, active))
    d_nodes = jax.tree.map(lambda leaf: jnp.moveaxis(leaf, -2, 0), d_nodes._replace(steps=None))

    _, error_linear = along(problem.error, rod, u, base)
    d_error = error_linear(d_rod, du, d_base)
    at, moved = At(rod, u, nodes, base), At(d_rod, du, d_nodes, d_base)
    is_tip = problem.part == "tip"
    d_results = tip_forward(at, moved) if is_tip else fields_forward(at, problem.places, moved)
    by_unknowns = jnp.moveaxis(d_error[:n], 0, 1)
    follow = -linear_systems.solve_columns(by_unknowns, jnp.moveaxis(d_error[n:], 0, 1))  # [unknowns, vectors, batch]
    return d_results[n:] + jnp.einsum("nkb,nrb->krb", follow, d_results[:n])


def _steps_forward(problem: _Problem, rods: tuple, spans: tuple, active: Any, states: tuple) -> tuple[Nodes, Nodes]:
    """The nodes of one segment and their changes, [rows, vectors, batch]."""
    (rod, d_rod), (span, d_span), (state, d_state) = rods, spans, states
    tableau, most, h = problem.structure.tableau, problem.structure.most, 1.0 / problem.steps
    weights, places = jnp.asarray(tableau.weights), jnp.asarray(tableau.places)
    stages = len(places)

    def room(rows: int, like: Any) -> Any:
        return jax.tree.map(lambda leaf: jnp.zeros((rows, *leaf.shape)), like)

    def stage(i: Array, carry: tuple, tau: Array, state: RodState, d_state: RodState) -> tuple:
        slopes, d_slopes = carry
        y, dy = combine(weights[i] * h, state, slopes), combine(weights[i] * h, d_state, d_slopes)

        at = tau + places[i] * h
        f = slope_of(rod, _segment(span, active))(at, y)
        _, linear = jax.linearize(_slope_to_linearize(rod, span, active, at, y, f.beta), rod, span, y)
        df = jax.vmap(linear)(d_rod, d_span, dy)
        return jax.tree.map(lambda k, new: k.at[i].set(new), (slopes, d_slopes), (f, df))

    def step(m: Array, carry: tuple) -> tuple:
        state, d_state, nodes, d_nodes = carry
        empty = room(stages, state), room(stages, d_state)
        slopes, d_slopes = lax.fori_loop(0, stages, lambda i, c: stage(i, c, m * h, state, d_state), empty)
        kept = state, jax.tree.map(lambda k: k[0], slopes)
        d_kept = d_state, jax.tree.map(lambda k: k[0], d_slopes)
        nodes, d_nodes = jax.tree.map(lambda all, one: all.at[m].set(one), (nodes, d_nodes), (kept, d_kept))
        last = weights[stages] * h
        return combine(last, state, slopes), combine(last, d_state, d_slopes), nodes, d_nodes

    nodes, d_nodes = (room(most + 1, state),) * 2, (room(most + 1, d_state),) * 2
    state, d_state, nodes, d_nodes = lax.fori_loop(0, problem.steps, step, (state, d_state, nodes, d_nodes))
    count = jnp.asarray(problem.steps)
    (starts, slopes), (d_starts, d_slopes) = nodes, d_nodes
    return Nodes(starts, slopes, state, count), Nodes(d_starts, d_slopes, d_state, count)


def _pulled_back(problem: _Problem, leaves: list, u: Array, cotangents: Array) -> Float[Array, "vectors size batch"]:
    """The cotangents of the floats from those of O, the unknowns following."""
    n = len(u)
    rod, rod_back = jax.vjp(problem.rod, leaves, u)
    state, tip_back = jax.vjp(problem.at_tip, rod, u)
    spans, spans_back = jax.vjp(_floats_of_segments, rod)
    active = segments(rod).active

    def onward(state: RodState, given: tuple) -> tuple[RodState, tuple]:
        span, active = given
        start = restarted(rod, span[0], state, active)
        nodes, stages = _steps_recorded(problem, rod, span, active, start)
        return nodes.end, (state, nodes, stages)

    base, (before, nodes, stages) = lax.scan(onward, state, (spans, active))
    # those of E, one for each unknown, and behind them those of O go through the integration together
    _, error_back = jax.vjp(problem.error, rod, u, base)
    unit = jnp.broadcast_to(jnp.eye(n)[..., None], (n, n, u.shape[-1]))
    of_error = jax.vmap(error_back)(unit)  # rod, u, base; [n, ...]
    at = At(rod, u, nodes, base)
    is_tip = problem.part == "tip"
    of_results = tip_backward(at, cotangents) if is_tip else fields_backward(at, problem.places, cotangents)
    both = jax.tree.map(lambda a, b: jnp.concatenate([a, b]), of_error, (of_results.rod, of_results.u, of_results.base))
    rod_bar, u_bar, base_bar = both
    nodes_bar = None  # the tip's numbers do not ask for nodes
    if of_results.nodes is not None:
        padded = jax.tree.map(lambda leaf: jnp.pad(leaf, ((n, 0), *((0, 0),) * (leaf.ndim - 1))), of_results.nodes)
        nodes_bar = jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 1, 0), padded)  # segments first

    def backward(carry: tuple[RodState, Rod], given: tuple) -> tuple[tuple[RodState, Rod], Any]:
        (state_bar, total), (span, active, before, stages, nodes_bar) = carry, given
        if nodes_bar is not None:
            state_bar = jax.tree.map(jnp.add, state_bar, nodes_bar.end)
        *bars, start_bar = _steps_backward(problem, rod, span, active, stages, nodes_bar, state_bar)
        _, back = jax.vjp(lambda rod, span, before: restarted(rod, span[0], before, active), rod, span, before)
        *more, before_bar = jax.vmap(back)(start_bar)
        rod_bar, span_bar = jax.tree.map(jnp.add, bars, more)
        return (before_bar, jax.tree.map(jnp.add, total, rod_bar)), span_bar

    given = (spans, active, before, stages, nodes_bar)
    (state_bar, rod_bar), spans_bar = lax.scan(backward, (base_bar, rod_bar), given, reverse=True)
    spans_bar = jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 1, 0), spans_bar)
    at_tip_bar, u_more = jax.vmap(tip_back)(state_bar)
    of_spans = jax.vmap(lambda bar: spans_back(bar)[0])(spans_bar)
    rod_bar = jax.tree.map(lambda *parts: sum(parts), rod_bar, at_tip_bar, of_spans)
    leaves_bar, u_last = jax.vmap(rod_back)(rod_bar)
    by_u = u_bar + u_more + u_last
    by_floats = jnp.concatenate([leaf.reshape(len(by_u), -1, u.shape[-1]) for leaf in leaves_bar], axis=1)

    # u follows: w = -E_u^-T O_u^T for each vector
    w = -linear_systems.solve_columns(jnp.swapaxes(by_u[:n], 0, 1), jnp.moveaxis(by_u[n:], 0, 1))
    return by_floats[n:] + jnp.einsum("nkb,npb->kpb", w, by_floats[:n])


def _segment(span: tuple, active: Any) -> Segment:
    start, end, grading = span
    return Segment(start, end, active, grading)


def _slope_to_linearize(rod: Rod, span: tuple, active: Any, tau: Any, y: RodState, beta_slope: Any) -> Callable:
    """The slope of the state at a stage as a function of rod, segment and state, to be linearized at the given ones,
    where beta has the slope `beta_slope`, None in a rigid section."""
    known = None
    if beta_slope is not None:
        s, rate = _segment(span, active).place(tau)
        has_length = rate != 0  # not where two tendons end at one place
        beta_s = jnp.where(has_length, beta_slope / jnp.where(has_length, rate, 1.0), 0.0)
        known = known_slope_at(rod, s, y, active, beta_s)

    def slope(rod: Rod, span: tuple, y: RodState) -> RodState:
        return slope_of(rod, _segment(span, active), known)(tau, y)

    return slope


def _steps_recorded(
    problem: _Problem, rod: Rod, span: tuple, active: Any, state: RodState
) -> tuple[Nodes, tuple[RodState, Any]]:
    """The nodes of one segment, and the states at all stages with the slopes of beta there, [rows, stages, batch]."""
    tableau, most, h = problem.structure.tableau, problem.structure.most, 1.0 / problem.steps
    weights = jnp.asarray(tableau.weights)
    count = len(tableau.places)
    slope = slope_of(rod, _segment(span, active))

    def step(m: Array, carry: tuple) -> tuple:
        state, stages, slopes = carry
        k = stages_of_step(slope, tableau, m * h, h, state)
        y = jax.tree.map(lambda u, k: u + jnp.tensordot(weights[:count] * h, k, 1), state, k)
        stages, slopes = jax.tree.map(
            lambda all, one: all.at[m].set(one), (stages, slopes), ((y, k.beta), _first(k))
        )  # fmt: skip
        return combine(weights[count] * h, state, k), stages, slopes

    stages = jax.tree.map(lambda leaf: jnp.zeros((most, count, *leaf.shape)), (state, state.beta))
    slopes = jax.tree.map(lambda leaf: jnp.zeros((most + 1, *leaf.shape)), state)
    end, stages, slopes = lax.fori_loop(0, problem.steps, step, (state, stages, slopes))
    starts = jax.tree.map(lambda leaf: jnp.pad(leaf[:, 0], ((0, 1), *((0, 0),) * (leaf.ndim - 2))), stages[0])
    return Nodes(starts, slopes, end, jnp.asarray(problem.steps)), stages


def _first(stages: RodState) -> RodState:
    return jax.tree.map(lambda k: k[0], stages)


def _steps_backward(
    problem: _Problem,
    rod: Rod,
    span: tuple,
    active: Any,
    stages: tuple[RodState, Any],
    nodes_bar: Nodes | None,
    state_bar: RodState,
) -> tuple[Rod, tuple, RodState]:
    """The cotangents of the rod, of the floats of the segment, and of the state where it starts, [vectors, batch]."""
    tableau, h = problem.structure.tableau, 1.0 / problem.steps
    weights, places = jnp.asarray(tableau.weights), jnp.asarray(tableau.places)
    count, vectors = len(places), len(state_bar.x)
    tree = None

    def linear_at(tau: Array, stage: tuple[RodState, Any]) -> Any:
        nonlocal tree
        y, beta_slope = stage
        slope = _slope_to_linearize(rod, span, active, tau, y, beta_slope)
        leaves, tree = jax.tree.flatten(jax.vjp(slope, rod, span, y)[1])
        return leaves

    def step(m: Array, carry: tuple) -> tuple:
        parameters_bar, state_bar = carry
        i = problem.steps - 1 - m
        # what is linear comes apart from what is not, or XLA would compute the latter again for each cotangent
        residuals = jax.vmap(linear_at)((i + places) * h, jax.tree.map(lambda leaf: leaf[i], stages))
        slope_bar = None if nodes_bar is None else jax.tree.map(lambda leaf: leaf[:, i], nodes_bar.slopes)

        def stage(j: Array, carry: tuple) -> tuple:
            parameters_bar, ys_bar = carry
            r = count - 1 - j
            k_bar = jax.tree.map(
                lambda end, later: h * (weights[count, r] * end + jnp.tensordot(weights[:count, r], later, 1)),
                state_bar, ys_bar,
            )  # fmt: skip
            if slope_bar is not None:
                k_bar = jax.tree.map(lambda bar, first: bar + jnp.where(r == 0, first, 0.0), k_bar, slope_bar)
            back = jax.tree.unflatten(tree, [leaf[r] for leaf in residuals])
            *more, y_bar = jax.vmap(back)(k_bar)
            parameters_bar = jax.tree.map(jnp.add, parameters_bar, tuple(more))
            return parameters_bar, jax.tree.map(lambda all, one: all.at[r].set(one), ys_bar, y_bar)

        empty = jax.tree.map(lambda leaf: jnp.zeros((count, *leaf.shape)), state_bar)
        parameters_bar, ys_bar = lax.fori_loop(0, count, stage, (parameters_bar, empty))
        state_bar = jax.tree.map(lambda end, ys: end + ys.sum(0), state_bar, ys_bar)
        if nodes_bar is not None:
            state_bar = jax.tree.map(lambda bar, leaf: bar + leaf[:, i], state_bar, nodes_bar.states)
        return parameters_bar, state_bar

    zero = jax.tree.map(lambda leaf: jnp.zeros((vectors, *leaf.shape)), (rod, span))
    (rod_bar, span_bar), state_bar = lax.fori_loop(0, problem.steps, step, (zero, state_bar))
    return rod_bar, span_bar, state_bar


def _floats_of_segments(rod: Rod) -> tuple[Array, Array, Array]:
    """Start, end and grading of all segments, [segments, batch]."""
    spans = segments(rod)
    return spans.start, spans.end, spans.grading
