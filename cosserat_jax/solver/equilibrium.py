"""Derivatives of what is computed at a root, through the equation that the root solves.

With u(p) the root of E(u, p) = 0 and O(u, p) what is computed there, the implicit function theorem gives

    dO/dp = O_p + O_u du/dp        du/dp = -E_u^-1 E_p

Forward mode with a tangent for each unknown and each parameter that moves gives all four blocks, and so the dense
Jacobian. It is handed to JAX as a matrix times a tangent, which transposes: reverse mode costs what forward mode
costs, and no loop is ever run backwards. A rod has few parameters, and their tangents share one vectorised integration.
Differentiating again differentiates that Jacobian in the same way, so any nesting of forward and reverse works.
"""

import functools as ft
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float

from ..physics.implicit import in_places, solve_columns

Scalars = list[Float[Array, ""]]


# (function, root, params, moving) -> function's value and its derivative by params[moving], the root following
Total = Callable[[Callable, Any, Scalars, tuple[int, ...]], tuple]


@ft.partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def at_root(function: Callable, total: Total, root: Any, params: Scalars) -> Any:
    """O of `function(root, params) -> (E, O)`, a pytree of floats, where `root` solves E = 0.

    Derivatives with respect to `params` follow the root, by `total`; with respect to the given `root`, the fruit of a
    guess, they are zero. `function` and `total` close over no traced value. Where `root` is NaN, so is all of O.
    """
    value = function(root, params)[1]
    # `root` depends on every parameter, so this batches all of O where any is batched, as the derivative's rule does;
    # JAX takes for granted that the two agree (https://github.com/jax-ml/jax/issues/16374)
    lost = jnp.isnan(jax.tree.leaves(root)[-1].ravel()[0])
    return jax.tree.map(lambda leaf: jnp.where(lost, jnp.nan, leaf), value)


@ft.partial(at_root.defjvp, symbolic_zeros=True)
def _derivative(function: Callable, total: Total, primals: tuple, tangents: tuple) -> tuple:
    root, params = primals
    moving = tuple(i for i, tangent in enumerate(tangents[1]) if not isinstance(tangent, SymbolicZero))

    def with_jacobian(root: Any, params: Scalars) -> tuple:
        (error, value), (_, jacobian) = total(function, root, params, moving)
        return error, (value, jacobian)

    value, jacobian = at_root(with_jacobian, total, root, params)
    change = jnp.stack([tangents[1][i] for i in moving])
    return value, jax.tree.map(lambda columns: columns @ change, jacobian)


def total_rates(function: Callable, root: Float[Array, " unknowns"], params: Scalars, moving: tuple[int, ...]) -> tuple:
    """Of a vector of unknowns, in one pass: (E, O) and their derivatives, the moving parameters on the last axis."""

    def of(both: Array) -> tuple[tuple, tuple]:
        result = function(both[: root.size], in_places(params, moving, both[root.size :]))
        return result, result

    at = jnp.concatenate([root, jnp.stack([params[i] for i in moving])])
    rates, result = jax.jacfwd(of, has_aux=True)(at)
    root_rates = -solve_columns(rates[0][:, : root.size], rates[0][:, root.size :])
    return result, jax.tree.map(lambda rate: rate[..., root.size :] + rate[..., : root.size] @ root_rates, rates)
