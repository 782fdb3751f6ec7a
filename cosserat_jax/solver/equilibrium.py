"""Derivatives of what is computed at a root, through the equation that the root solves.

With u(p) the root of E(u, p) = 0 and O(u, p) what is computed there, the implicit function theorem gives

    dO/dp = O_p + O_u du/dp        du/dp = -E_u^-1 E_p

One forward-mode pass with a tangent for each unknown and each parameter that moves gives all four blocks, and so the
dense Jacobian. It is handed to JAX as a matrix times a tangent, which transposes: reverse mode costs what forward mode
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

from ..physics.implicit import solve_linear

Scalars = list[Float[Array, ""]]


@ft.partial(jax.custom_jvp, nondiff_argnums=(0,))
def at_root(function: Callable, root: Float[Array, " unknowns"], params: Scalars) -> Any:
    """O of `function(root, params) -> (E, O)`, a pytree of floats, where `root` solves E = 0.

    Derivatives with respect to `params` follow the root; with respect to the given `root`, the fruit of a guess, they
    are zero. `function` closes over no traced value. Where `root` is NaN, so is all of O.
    """
    value = function(root, params)[1]
    # `root` depends on every parameter, so this batches all of O where any is batched, as the derivative's rule does;
    # JAX takes for granted that the two agree (https://github.com/jax-ml/jax/issues/16374)
    return jax.tree.map(lambda leaf: jnp.where(jnp.isnan(root[0]), jnp.nan, leaf), value)


@ft.partial(at_root.defjvp, symbolic_zeros=True)
def _derivative(function: Callable, primals: tuple, tangents: tuple) -> tuple:
    root, params = primals
    moving = tuple(i for i, tangent in enumerate(tangents[1]) if not isinstance(tangent, SymbolicZero))
    value, jacobian = at_root(_with_jacobian(function, moving), root, params)
    change = jnp.stack([tangents[1][i] for i in moving])
    return value, jax.tree.map(lambda columns: columns @ change, jacobian)


def _with_jacobian(function: Callable, moving: tuple[int, ...]) -> Callable:
    """The function (root, params) -> (E, (O, dO/d params[moving])), with the moving parameters on the last axis."""

    def with_jacobian(root: Array, params: Scalars) -> tuple[Array, tuple]:
        def of(both: Array) -> tuple[tuple, tuple]:
            moved = dict(zip(moving, both[root.size :], strict=True))
            result = function(both[: root.size], [moved.get(i, param) for i, param in enumerate(params)])
            return result, result

        at = jnp.concatenate([root, jnp.stack([params[i] for i in moving])])
        (error_rates, rates), (error, value) = jax.jacfwd(of, has_aux=True)(at)
        root_rates = -jax.vmap(lambda column: solve_linear(error_rates[:, : root.size], column)[0], 1, 1)(
            error_rates[:, root.size :]
        )
        total = jax.tree.map(lambda rate: rate[..., root.size :] + rate[..., : root.size] @ root_rates, rates)
        return error, (value, total)

    return with_jacobian
