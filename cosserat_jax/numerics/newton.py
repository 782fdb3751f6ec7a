"""Roots of a few elementwise equations, found by Newton's method and differentiated by the implicit function theorem.

Elementwise: the unknowns are a tuple of arrays of one shape, and every entry has its own equations. Derivatives cost
one directional derivative an unknown, whatever the shape.
"""

import functools as ft
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array

from .linear_systems import solve

Unknowns = tuple[Array, ...]


def jacobian(function: Callable[[Unknowns], Unknowns], x: Unknowns) -> tuple[Unknowns, Array]:
    """`function(x)` and its Jacobian [n, n, ...]."""
    value, along = jax.linearize(function, x)
    zero = jnp.zeros_like(x[0])
    columns = [along(tuple(jnp.ones_like(zero) if i == j else zero for i in range(len(x)))) for j in range(len(x))]
    return value, jnp.stack([jnp.stack(jnp.broadcast_arrays(*row)) for row in zip(*columns, strict=True)])


def newton(
    residual: Callable[[Unknowns], Unknowns], start: Unknowns, *, max_step: float = jnp.inf, most: int = 30
) -> Unknowns:
    """The root near `start` by Newton's iteration with steps of at most `max_step`, without derivatives.

    Stops after the first step below 1e-9 of 1 + |x| in all entries, whose own error is the square of that.
    """
    shape = jnp.broadcast_shapes(*(u.shape for u in residual(start)), *(u.shape for u in start))
    start = tuple(jnp.broadcast_to(u, shape) for u in start)

    def improve(carry: tuple) -> tuple:
        x, _, count = carry
        defect, matrix = jacobian(residual, x)
        step = jnp.clip(-solve(matrix, jnp.stack(jnp.broadcast_arrays(*defect))), -max_step, max_step)
        return tuple(u + du for u, du in zip(x, step, strict=True)), _size(x, step), count + 1

    def unfinished(carry: tuple) -> Array:
        _, size, count = carry
        return (size > 1e-9) & (count < most)

    return lax.while_loop(unfinished, improve, (start, jnp.asarray(jnp.inf), jnp.asarray(0)))[0]


def root(residual: Callable[[Unknowns, Any], Unknowns], start: Unknowns, params: Any, **options: Any) -> Unknowns:
    """The root of residual(x, params) = 0 near `start`, with derivatives of any order by the floats of `params`.

        d x = -(d residual / d x)^-1 (d residual / d params) d params

    The options are those of `newton`. `residual` closes over no traced value.
    """
    start, held = lax.stop_gradient((start, params))
    return differentiable_root(residual, newton(lambda x: residual(x, held), start, **options), params)


@ft.partial(jax.custom_jvp, nondiff_argnums=(0,))
def differentiable_root(residual: Callable[[Unknowns, Any], Unknowns], x: Unknowns, params: Any) -> Unknowns:
    """`x`, already found, with the derivatives of `root`; that by the given `x`, the result of a guess, is zero."""
    return x


@differentiable_root.defjvp
def _implicit_function_theorem(residual: Callable, primals: tuple, tangents: tuple) -> tuple:
    found, params = primals
    x = differentiable_root(residual, found, params)  # not `found`: derivatives of this rule pass through here
    _, change = jax.jvp(lambda params: residual(x, params), (params,), (tangents[1],))
    _, matrix = jacobian(lambda x: residual(x, params), x)
    step = solve(matrix, jnp.stack(jnp.broadcast_arrays(*change)))
    return x, tuple(jnp.broadcast_to(-du, u.shape) for u, du in zip(x, step, strict=True))


def _size(x: Unknowns, step: Array) -> Array:
    """The largest step; NaN counts as none, for its entry is lost and must not hold up the others."""
    sizes = [jnp.abs(du) / (1 + jnp.abs(u)) for u, du in zip(x, step, strict=True)]
    return jnp.max(jnp.nan_to_num(jnp.stack(jnp.broadcast_arrays(*sizes))))


def batched_with(like: Any, tree: Any) -> Any:
    """`tree`, the carry with which a loop begins, as it is, but batched wherever a float of `like` is.

    Under `vmap` JAX finds which parts of a carry are batched by tracing the loop's body again until no more turn up,
    and all of that anew for every loop around it. A carry that is batched as a whole from the beginning is settled at
    once: a batched loop is traced in half the time.
    """
    floats = jax.tree.leaves(eqx.filter(like, eqx.is_inexact_array))
    never = ft.reduce(jnp.logical_or, [jnp.any(leaf < leaf) for leaf in floats])

    def tied(leaf: Any) -> Array:
        leaf = jnp.asarray(leaf)
        return leaf | never if leaf.dtype == bool else leaf + never.astype(leaf.dtype)

    return jax.tree.map(tied, tree)
