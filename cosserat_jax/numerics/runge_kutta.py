"""Explicit Runge-Kutta methods for diffrax whose stages run in one loop, equal steps in a number that is data, and the
dense output of the two.

diffrax's own solvers carry the stages as it carries the state, through every operation of its loop. Here the stages of
a step are one array [stages, ...] for each array of the state, combined by a dot product: half of the run time, and a
program as small as one evaluation of the equations.
"""

import functools as ft
from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

State = Any  # a pytree of arrays


class Tableau(NamedTuple):
    """The coefficients of an explicit method: row i of `weights` combines the stages for stage i, the last row for the
    end of the step; `places` of the stages in the step."""

    weights: tuple[tuple[float, ...], ...]
    places: tuple[float, ...]
    order: int

    @classmethod
    def of(cls, solver: diffrax.AbstractERK) -> "Tableau":
        """That of a diffrax solver, without last stages that the end of the step has no use for, as those of "first
        same as last"."""
        tableau: Any = solver.tableau
        count = int(np.flatnonzero(tableau.b_sol)[-1]) + 1
        rows = [*[(), *tableau.a_lower][:count], tableau.b_sol[:count]]
        padded = tuple(tuple(float(a) for a in row) + (0.0,) * (count - len(row)) for row in rows)
        order: Any = solver.order(None)  # pyright: ignore[reportArgumentType]
        return cls(padded, (0.0, *(float(c) for c in tableau.c))[:count], order)


class LoopedRungeKutta(diffrax.AbstractSolver):
    """An explicit Runge-Kutta method with its stages in one loop. Its own state, which is given to diffrax, is the
    number of the step, and arrays [rows, ...] that it fills with the states and slopes at which steps start."""

    tableau: Tableau = eqx.field(static=True)
    term_structure = diffrax.ODETerm
    interpolation_cls = diffrax.LocalLinearInterpolation  # not used: see `dense_output`

    def order(self, terms: Any) -> int:
        return self.tableau.order

    def init(self, terms: Any, t0: Any, t1: Any, y0: State, args: Any) -> tuple:
        raise TypeError("LoopedRungeKutta needs its solver_state given: see `integrate`")

    def func(self, terms: Any, t0: Any, y0: State, args: Any) -> State:
        return terms.vf(t0, y0, args)

    def step(
        self, terms: Any, t0: Any, t1: Any, y0: State, args: Any, solver_state: tuple, made_jump: Any
    ) -> tuple[State, None, dict, tuple, Any]:
        number, *kept = solver_state
        stages = stages_of_step(lambda t, y: terms.vf(t, y, args), self.tableau, t0, t1 - t0, y0)
        y1 = combine(jnp.asarray(self.tableau.weights[-1]) * (t1 - t0), y0, stages)
        new = [y0, jax.tree.map(lambda k: k[0], stages)]
        kept = jax.tree.map(lambda all, one: lax.dynamic_update_index_in_dim(all, one, number, 0), kept, new)
        return y1, None, {"y0": y0, "y1": y1}, (number + 1, *kept), diffrax.RESULTS.successful


def combine(weights: Float[Array, " stages"], y: State, stages: State) -> State:
    """y + sum of weights times stages."""
    return jax.tree.map(lambda u, k: u + jnp.tensordot(weights, k, 1), y, stages)


def stages_of_step(slope: Any, tableau: Tableau, t: Any, h: Any, y: State) -> State:
    """The slopes at the stages of a step of length h from (t, y), [stages, ...] each."""
    weights, places = jnp.asarray(tableau.weights), jnp.asarray(tableau.places)

    def stage(i: Any, stages: State) -> State:
        new = slope(t + places[i] * h, combine(weights[i] * h, y, stages))
        return jax.tree.map(lambda k, f: k.at[i].set(f), stages, new)

    empty = jax.tree.map(lambda u: jnp.zeros((len(tableau.places), *u.shape)), y)
    return lax.fori_loop(0, len(tableau.places), stage, empty)


class EqualSteps(diffrax.AbstractStepSizeController):
    """`count` equal steps from 0 to 1, a number that JAX may trace."""

    count: Int[Array, ""]

    def wrap(self, direction: Any) -> "EqualSteps":
        return self

    def init(
        self, terms: Any, t0: Any, t1: Any, y0: Any, dt0: Any, args: Any, func: Any, error_order: Any
    ) -> tuple[Any, Any]:
        return 1.0 / self.count, jnp.asarray(1)

    def adapt_step_size(
        self, t0: Any, t1: Any, y0: Any, y1_candidate: Any, args: Any, y_error: Any, error_order: Any,
        controller_state: Any,
    ) -> tuple:  # fmt: skip
        done = controller_state + 1
        return True, t1, done / self.count, False, done, diffrax.RESULTS.successful


class FirstStep(diffrax.AbstractAdaptiveStepSizeController):
    """The steps of `controller` after a first one of length `dt0`, which JAX may trace: given to diffrax itself, a
    traced one is checked by a callback to the host."""

    controller: diffrax.PIDController
    dt0: Any
    rtol: Any
    atol: Any
    norm: Any

    def __init__(self, controller: diffrax.PIDController, dt0: Any) -> None:
        self.controller, self.dt0 = controller, dt0
        self.rtol, self.atol, self.norm = controller.rtol, controller.atol, controller.norm

    def wrap(self, direction: Any) -> "FirstStep":
        return FirstStep(self.controller.wrap(direction), self.dt0)

    def init(
        self, terms: Any, t0: Any, t1: Any, y0: Any, dt0: None, args: Any, func: Any, error_order: Any
    ) -> tuple[Any, Any]:
        return self.controller.init(terms, t0, t1, y0, self.dt0, args, func, error_order)

    def adapt_step_size(
        self, t0: Any, t1: Any, y0: Any, y1_candidate: Any, args: Any, y_error: Any, error_order: Any,
        controller_state: Any,
    ) -> tuple:  # fmt: skip
        return self.controller.adapt_step_size(
            t0, t1, y0, y1_candidate, args, y_error, error_order, controller_state
        )  # fmt: skip


class Nodes(NamedTuple):
    """The state and its slope by tau at the equal nodes tau = i / steps at which steps start, and the state at the end,
    tau = 1. Room is left for more nodes than there are, and holds anything."""

    states: State
    slopes: State
    end: State
    steps: Int[Array, ""]


AROUND = 7  # nodes that the dense output takes, where there are as many


def dense_output(
    nodes: Nodes, tau: Float[Array, "points ..."], which: Int[Array, "points ..."] | int = 0, around: int = AROUND
) -> State:
    """The states at tau in [0, 1] of the integrations numbered `which`, the first axis of `nodes`.

    By Hermite's interpolation in the nodes around, seven, for thirteenth order, or as many as there is room for, the
    slope at the last left out. `tau` and `which` may have the batch as last axis or be shared by it.
    """
    count = jnp.max(nodes.steps)
    rows = jax.tree.leaves(nodes.states)[0].shape[1]
    around = min(around, rows)
    tree = jax.tree.structure(nodes.end)

    def stacked(leaves: Any, used: Int[Array, ""]) -> Array:
        """[integrations and nodes, arrays of the state, ...], zero in the room that is left."""
        values = jnp.stack(jax.tree.leaves(leaves), axis=2)
        row = jnp.arange(rows).reshape(-1, *(1,) * (values.ndim - 2))
        values = jnp.where(row < used, values, 0.0)
        return values.reshape(-1, *values.shape[2:])

    ended = jax.tree.map(lambda leaf, last: leaf.at[:, count].set(last), nodes.states, nodes.end)
    middle = (around - 1) / 2
    states, slopes = stacked(ended, count + 1), stacked(nodes.slopes, count) * (middle / count)

    first = jnp.clip(jnp.floor(tau * count).astype(jnp.int32) - (around - 1) // 2, 0, count - around + 1)
    local = (tau * count - first) / middle - 1  # from -1 to 1 over the nodes
    start = (first + rows * which).astype(jnp.int32)

    def weights_at(local: Array) -> tuple[Array, Array]:
        """Of the states and of the slopes, from row `start` on."""
        basis = jnp.asarray(_hermite(around))
        weights = jnp.tensordot(basis, jnp.stack([local**i for i in range(basis.shape[1])]), 1)
        return weights[:around], weights[around:]

    if start.ndim < states.ndim - 1:  # places that the batch shares: a matrix, for reading rows by their number is slow
        values, rates = weights_at(local)
        matrix = jnp.concatenate([_matrix(values, start, len(states)), _matrix(rates, start, len(states))], axis=1)
        total = jnp.tensordot(matrix, jnp.concatenate([states, slopes]), 1)
    else:

        def at(place: tuple[Array, Array]) -> Array:
            start, local = place
            parts = [
                (among, i, weight)
                for among, weights in zip((states, slopes), weights_at(local), strict=True)
                for i, weight in enumerate(weights)
            ]
            taken = [jnp.take_along_axis(v, (start + i)[:, None], axis=0) * weight[:, None] for v, i, weight in parts]
            return ft.reduce(jnp.add, taken)

        # place after place, or XLA repeats all of it in every use of the result
        total = lax.map(at, (start[:, None], local[:, None]))[:, 0]
    return jax.tree.unflatten(tree, [total[:, i] for i in range(total.shape[1])])


def _matrix(
    weights: Float[Array, "nodes points"], start: Int[Array, " points"], rows: int
) -> Float[Array, "points rows"]:
    """The matrix that combines rows, for each point those from `start` on."""
    columns = start[:, None] + jnp.arange(len(weights))
    return jnp.zeros((len(start), rows)).at[jnp.arange(len(start))[:, None], columns].set(weights.T)


@ft.lru_cache
def _hermite(nodes: int) -> Float[np.ndarray, "conditions conditions"]:
    """Row i: the coefficients by powers of x of the polynomial that goes with condition i, which are the values at
    equal nodes from -1 to 1 and the slopes at all of them but the last."""
    x, powers = np.linspace(-1, 1, nodes), np.arange(2 * nodes - 1)
    values = x[:, None] ** powers
    slopes = powers * x[:-1, None] ** np.maximum(powers - 1, 0)
    return np.linalg.inv(np.concatenate([values, slopes])).T


def integrate(
    slope: Any, tableau: Tableau, y0: State, count: Int[Array, ""], room: tuple[State, State], most: int
) -> Nodes:
    """Integrates dy/dtau = slope(tau, y) from tau = 0 to 1 in `count` equal steps, at most `most`.

    `room`: the states and slopes of nodes, [most + 1, ...], into which the new ones are written: in a loop around the
    integration the arrays of the pass before are used again, instead of being made and filled each time.
    """
    leaves, tree = jax.tree.flatten(y0)

    @jax.jit  # for diffrax traces it several times
    def slope_of_leaves(tau: Any, leaves: tuple[Array, ...], _: None) -> tuple[Array, ...]:
        return tuple(jax.tree.leaves(slope(tau, jax.tree.unflatten(tree, leaves))))

    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(slope_of_leaves),
        LoopedRungeKutta(tableau),
        t0=0.0,
        t1=1.0,
        dt0=None,
        y0=tuple(leaves),
        saveat=diffrax.SaveAt(t1=True, solver_state=True),
        stepsize_controller=EqualSteps(count),
        adjoint=diffrax.ForwardMode(),
        solver_state=(jnp.asarray(0), *(tuple(jax.tree.leaves(part)) for part in room)),
        made_jump=False,
        max_steps=most + 1,
        throw=False,
    )
    state: Any = solution.solver_state
    ys: Any = solution.ys
    parts = (*state[1:], tuple(u[-1] for u in ys))
    states, slopes, end = (jax.tree.unflatten(tree, part) for part in parts)
    return Nodes(states, slopes, end, count)
