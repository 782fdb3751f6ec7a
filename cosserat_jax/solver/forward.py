"""Derivatives of an adaptive integration by forward mode alone, handed to JAX as a matrix that transposes.

Reverse mode through adaptive steps runs the loop again, block by block, from states kept on the way. Where tolerances
are tight, the error estimate is little more than round-off, the steps of the second run are not those of the first,
and the derivative is off by far more than the tolerance. A scene has few parameters, so one forward pass with a
tangent for each that moves costs less and gives reverse mode the same numbers as forward mode.
"""

import functools as ft
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero
from jax.flatten_util import ravel_pytree
from jaxtyping import Array

from ..physics.implicit import in_places


def by_forward_mode(function: Callable[[Any], Any], params: Any) -> Any:
    """`function(params)`, a pytree of floats of a pytree of floats, with derivatives of any order and nesting.

    `function` closes over no traced value. Where a parameter is NaN, so is all of the result.
    """
    leaves, tree = jax.tree.flatten(params)
    return _of_leaves(lambda leaves: function(jax.tree.unflatten(tree, leaves)), leaves)


@ft.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _of_leaves(function: Callable, leaves: list[Array]) -> Any:
    value = function(leaves)
    # this batches all of the value where any parameter is batched, as the rule below does; JAX takes for granted that
    # the two agree (https://github.com/jax-ml/jax/issues/16374)
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
