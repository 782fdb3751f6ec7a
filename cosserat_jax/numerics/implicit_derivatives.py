"""Derivatives in forward mode alone, handed to JAX as a matrix that transposes.

With u(p) the root of E(u, p) = 0 and O(u, p) what is computed there, the implicit function theorem gives

    dO/dp = O_p + O_u du/dp        du/dp = -E_u^-1 E_p

Forward mode with a tangent for each parameter that moves gives the dense Jacobian. It is handed to JAX as a matrix
times a tangent, so reverse mode costs what forward mode costs, and no loop is ever run backwards: through adaptive
steps, or a loop whose length is data, that would be wrong or impossible. Differentiating again differentiates that
Jacobian in the same way, so any nesting of forward and reverse works.
"""

import functools as ft
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

Scalars = list[Float[Array, ""]]

# (function, root, params, moving) -> function's value and its derivative by params[moving], the root following
Total = Callable[[Callable, Any, Scalars, tuple[int, ...]], tuple]


def in_places(values: list, places: Sequence[int], new: Iterable) -> list:
    """`values` with the `new` ones in these places."""
    given = dict(zip(places, new, strict=True))
    return [given.get(i, value) for i, value in enumerate(values)]


@ft.partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def at_root(function: Callable, total: Total, root: Any, params: Scalars) -> Any:
    """O of `function(root, params) -> (E, O)`, a pytree of floats, where `root` solves E = 0.

    Derivatives with respect to `params` follow the root, by `total`; with respect to the given `root`, the result of an
    initial guess, they are zero. `function` and `total` close over no traced value. Where `root` is NaN, so is O.
    """
    value = function(root, params)[1]
    # `root` depends on every parameter, so this batches all of O where any is batched, as the derivative's rule does;
    # JAX takes for granted that the two agree (https://github.com/jax-ml/jax/issues/16374)
    lost = jnp.isnan(jax.tree.leaves(root)[-1].ravel()[0])
    return jax.tree.map(lambda leaf: jnp.where(lost, jnp.nan, leaf), value)


@ft.partial(at_root.defjvp, symbolic_zeros=True)
def _derivative_at_root(function: Callable, total: Total, primals: tuple, tangents: tuple) -> tuple:
    root, params = primals
    moving = tuple(i for i, tangent in enumerate(tangents[1]) if not isinstance(tangent, SymbolicZero))

    def with_jacobian(root: Any, params: Scalars) -> tuple:
        (error, value), (_, jacobian) = total(function, root, params, moving)
        return error, (value, jacobian)

    value, jacobian = at_root(with_jacobian, total, root, params)
    change = jnp.stack([tangents[1][i] for i in moving])
    return value, jax.tree.map(lambda columns: columns @ change, jacobian)


def by_forward_mode(function: Callable[[Any], Any], params: Any) -> Any:
    """`function(params)`, a pytree of floats of a pytree of floats, with derivatives of any order and nesting.

    `function` closes over no traced value. Where a parameter is NaN, so is all of the result.
    """
    leaves, tree = jax.tree.flatten(params)
    return _of_leaves(lambda leaves: function(jax.tree.unflatten(tree, leaves)), leaves)


@ft.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _of_leaves(function: Callable, leaves: list[Array]) -> Any:
    value = function(leaves)
    # batches all of the value where any parameter is batched, see `at_root`
    undefined = jnp.isnan(ravel_pytree(leaves)[0]).any()
    return jax.tree.map(lambda leaf: jnp.where(undefined, jnp.nan, leaf), value)


@ft.partial(_of_leaves.defjvp, symbolic_zeros=True)
def _derivative(function: Callable, primals: tuple, tangents: tuple) -> tuple:
    (leaves,), (changes,) = primals, tangents
    moving = tuple(i for i, change in enumerate(changes) if not isinstance(change, SymbolicZero))
    value, jacobian = _of_leaves(_with_jacobian(function, moving), leaves)
    change = ravel_pytree([changes[i] for i in moving])[0]
    return value, jax.tree.map(lambda columns: columns @ change, jacobian)


def _with_jacobian(function: Callable, moving: tuple[int, ...]) -> Callable:
    """leaves -> (value, d value / d leaves[moving]), with the numbers of the moving leaves on the last axis."""

    def with_jacobian(leaves: list[Array]) -> tuple:
        at, restored = ravel_pytree([leaves[i] for i in moving])

        def of(vector: Array) -> tuple:
            value = function(in_places(leaves, moving, restored(vector)))
            return value, value

        jacobian, value = jax.jacfwd(of, has_aux=True)(at)
        return value, jacobian

    return with_jacobian
