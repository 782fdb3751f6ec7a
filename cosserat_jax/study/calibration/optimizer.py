"""The engine of a fit: optimistix's Levenberg-Marquardt, or an optax optimiser, on a sum of squares of misfits.

All of it runs in one compiled program, for many starts and many sets of data at once, and keeps its history.
"""

import abc
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jax import lax
from jaxtyping import Array, Float, Int

from ...numerics.implicit_derivatives import by_forward_mode
from ...numerics.newton import batched_with

_STALLED = 5  # trials in a row that were refused
_SETTLED = 1e-9  # part of the loss that an accepted step has to gain
_NOTHING = 1e-18  # loss that counts as none


class AbstractProblem(eqx.Module):
    """Misfits in units of their standard error, as a function of unbounded parameters."""

    @abc.abstractmethod
    def misfits(
        self, u: Float[Array, " params"], values: Float[Array, " values"]
    ) -> tuple[Float[Array, " values"], Float[Array, " values"]]:
        """At the parameters u, against these measured values: never NaN; and the values that the model predicts."""

    @abc.abstractmethod
    def loss(self, misfits: Float[Array, " values"]) -> Float[Array, ""]:
        """What is minimised."""


class Minimum(NamedTuple):
    """Where a search ended: parameters, loss, misfits with their Jacobian, the predicted values (NaN where there are
    none), and the loss after every step, then NaN."""

    u: Float[Array, "*batch params"]
    loss: Float[Array, "*batch"]
    misfits: Float[Array, "*batch values"]
    predicted: Float[Array, "*batch values"]
    jacobian: Float[Array, "*batch values params"]
    steps: Int[Array, "*batch"]
    history: Float[Array, "*batch steps"]


@eqx.filter_jit
def minimise(
    problem: AbstractProblem,
    values: Float[Array, "searches values"],
    starts: Float[Array, "searches params"],
    solver: Any,
    max_steps: int,
) -> Minimum:
    """The minima that `solver` finds from every start, each with measured values of its own, in one batch.

    `solver` is an `optimistix.LevenbergMarquardt` or another solver for least squares, of whose misfits the loss is
    half the sum of squares; or an `optimistix.OptaxMinimiser`.
    """

    def one(values: Array, start: Array) -> Minimum:
        def misfits(u: Array, _: Any) -> tuple[Array, Array]:
            return with_dense_jacobian(problem, lambda problem, *at: problem.misfits(*at), u, values)

        def loss(u: Array, _: Any) -> tuple[Array, Array]:
            return loss_at(problem, u, values), jnp.zeros(())

        if isinstance(solver, optx.AbstractLeastSquaresSolver):
            u, state, steps, history = _search(misfits, solver, start, max_steps)
            found, jacobian = (state.f_info.residual, state.aux), state.f_info.jac.as_matrix()
        else:
            u, state, steps, history = _search(loss, solver, start, max_steps)
            jacobian, found = jax.jacfwd(lambda u: (misfits(u, None)[0], misfits(u, None)), has_aux=True)(u)
        at_end, predicted = found
        return Minimum(u, problem.loss(at_end), at_end, predicted, jacobian, steps, history)

    return jax.vmap(one)(values, starts)


def loss_at(problem: AbstractProblem, u: Float[Array, " params"], values: Float[Array, " values"]) -> Float[Array, ""]:
    """The loss as a function of u. A row without an equilibrium has no derivative, which forward mode leaves out, and
    which reverse mode would multiply by zero to NaN."""
    return with_dense_jacobian(problem, lambda problem, *at: problem.loss(problem.misfits(*at)[0]), u, values)


def with_dense_jacobian(problem: AbstractProblem, function: Callable, *at: Array) -> Any:
    """`function(problem, *at)`, whose derivative is a matrix that is made once: a solver that applies it many times
    would have the model compiled many times."""
    floats, rest = eqx.partition(problem, eqx.is_inexact_array)
    return by_forward_mode(lambda given: function(eqx.combine(given[0], rest), *given[1:]), (floats, *at))


def _search(fn: Callable, solver: Any, start: Array, max_steps: int) -> tuple[Array, Any, Array, Array]:
    """The best parameters, the solver's state, the steps taken, and the loss after each of them."""
    no_tags: frozenset[object] = frozenset()
    state = solver.init(fn, start, None, {}, *jax.eval_shape(fn, start, None), no_tags)
    moving, fixed = eqx.partition(state, eqx.is_array)

    def step(carry: tuple) -> tuple:
        u, moving, count, history = carry
        u, state, _ = solver.step(fn, u, None, {}, eqx.combine(moving, fixed), no_tags)
        loss = state.f if hasattr(state, "f") else jnp.sum(state.f_info.residual**2) / 2
        return u, eqx.filter(state, eqx.is_array), count + 1, history.at[count].set(loss)

    def unfinished(carry: tuple) -> Array:
        u, moving, count, history = carry
        state = eqx.combine(moving, fixed)
        done, _ = solver.terminate(fn, u, None, {}, state, no_tags)
        return (count < max_steps) & ~done & ~_settled(state, count, history)

    begin = batched_with(start, (start, moving, jnp.array(0), jnp.full(max_steps, jnp.nan)))
    u, moving, count, history = lax.while_loop(unfinished, step, begin)
    return u, eqx.combine(moving, fixed), count, history


def _settled(state: Any, count: Array, history: Array) -> Array:
    """Whether a search for least squares has nothing left to gain but rounding; an optax optimiser says so itself."""
    if not hasattr(state, "num_steps_since_acceptance"):
        return jnp.array(False)
    before, now = history[count - 2], history[count - 1]
    gained = (before - now) / now
    settled = (count > 1) & (gained > 0) & (gained < _SETTLED)
    return settled | (now < _NOTHING) | (state.num_steps_since_acceptance >= _STALLED)
