"""Roots that are differentiated through the equation they solve, not through the iteration that found them."""

import functools as ft
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float


@ft.partial(jax.custom_jvp, nondiff_argnums=(0,))
def differentiable_root(residual: Callable, root: Float[Array, "..."], params: Any) -> Float[Array, "..."]:
    """`root`, already found, of residual(root, params) = 0, with the derivatives of the implicit function theorem.

        d root = -(d residual / d root)^-1 (d residual / d params) d params

    `root` is a scalar or a vector. Forward and reverse mode, any order and nesting, as far as
    `residual` itself has them; the derivative with respect to the given `root`, the result of a guess, is zero.
    `residual` closes over no traced value.
    """
    return root


@ft.partial(differentiable_root.defjvp, symbolic_zeros=True)
def _implicit_function_theorem(residual: Callable, primals: tuple, tangents: tuple) -> tuple:
    found, params = primals
    leaves, tree = jax.tree.flatten(params)
    dleaves = jax.tree.leaves(tangents[1], is_leaf=lambda x: isinstance(x, SymbolicZero))
    moving = [i for i, tangent in enumerate(dleaves) if not isinstance(tangent, SymbolicZero)]
    root = differentiable_root(residual, found, params)  # not `found`: derivatives of this rule pass through here
    if not moving:
        return root, jnp.zeros_like(root)

    def of_moving(values: list) -> Array:
        return residual(root, jax.tree.unflatten(tree, in_places(leaves, moving, values)))

    _, change = jax.jvp(of_moving, ([leaves[i] for i in moving],), ([dleaves[i] for i in moving],))
    _, jacobian = value_and_jacobian(lambda x: residual(x, params), root)
    return root, -solve_linear(jacobian, change)[0]


def in_places(values: list, places: Sequence[int], new: Iterable) -> list:
    """`values` with the `new` ones in these places."""
    given = dict(zip(places, new, strict=True))
    return [given.get(i, value) for i, value in enumerate(values)]


def batched_with(like: Any, tree: Any) -> Any:
    """`tree`, the carry with which a loop begins, as it is, but batched wherever a float of `like` is.

    Under `vmap` JAX finds which parts of a carry are batched by tracing the loop's body again until no more turn up,
    and all of that anew for every loop around it. A carry that is batched as a whole from the beginning is settled at
    once: a batched solve is traced in half the time.
    """
    floats = jax.tree.leaves(eqx.filter(like, eqx.is_inexact_array))
    never = ft.reduce(jnp.logical_or, [jnp.any(leaf < leaf) for leaf in floats])

    def tied(leaf: Any) -> Array:
        leaf = jnp.asarray(leaf)
        return leaf | never if leaf.dtype == bool else leaf + never.astype(leaf.dtype)

    return jax.tree.map(tied, tree)


def newton(residual: Callable, start: Array, params: Any, max_step: float = jnp.inf) -> Array:
    """Newton's iteration for a scalar or three unknowns, with steps of at most `max_step` in each.

    Stops after the first step below 1e-9, whose own error is the square of that, or after 30. Not differentiable:
    hand its result to `differentiable_root`.
    """

    def improve(carry: tuple) -> tuple:
        root, _, count = carry
        defect, jacobian = value_and_jacobian(lambda x: residual(x, params), root)
        step = solve_linear(jacobian, -defect)[0]
        step = jnp.clip(step, -max_step, max_step)
        return root + step, jnp.max(jnp.abs(step) / (1 + jnp.abs(root))), count + 1

    def unfinished(carry: tuple) -> Array:
        _, size, count = carry
        return (size > 1e-9) & (count < 30)

    return lax.while_loop(unfinished, improve, batched_with(start, (start, jnp.inf, 0)))[0]


def value_and_jacobian(function: Callable, x: Array, has_aux: bool = False) -> tuple:
    """`function(x)`, or (value, aux), and its Jacobian by forward mode; one unknown costs no batching."""

    def along(direction: Array) -> tuple:
        if has_aux:
            value, slope, aux = jax.jvp(function, (x,), (direction,), has_aux=True)
            return (value, aux), slope
        return jax.jvp(function, (x,), (direction,))

    if x.size == 1:
        return along(jnp.ones_like(x))
    return jax.vmap(along, out_axes=(None, -1))(jnp.eye(x.size))


def solve_linear(matrix: Float[Array, "..."], rhs: Float[Array, "..."]) -> tuple[Float[Array, "*n"], Float[Array, ""]]:
    """Solution and determinant; of one or three unknowns in closed form: no library call in a hot loop."""
    if rhs.size == 1:
        return rhs / matrix.reshape(rhs.shape), matrix.reshape(())
    if rhs.size != 3:
        return jnp.linalg.solve(matrix, rhs), jnp.linalg.det(matrix)
    a, b, c = matrix.T
    bc = jnp.cross(b, c)
    determinant = a @ bc
    return jnp.stack([rhs @ bc, rhs @ jnp.cross(c, a), rhs @ jnp.cross(a, b)]) / determinant, determinant


def solve_columns(matrix: Float[Array, "n n"], rhs: Float[Array, "n columns"]) -> Float[Array, "n columns"]:
    """`solve_linear` of every column."""
    return jax.vmap(lambda column: solve_linear(matrix, column)[0], 1, 1)(rhs)


def condition_number(matrix: Float[Array, "n n"]) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """max(1, |A|) max(1, |A^-1|) of a matrix between like quantities, and |A^-1|.

    One unknown has a condition number of 1 whatever the matrix; held against the unit matrix it tells both an
    amplification and a singularity. The norms are Frobenius's.
    """
    inverse = solve_columns(matrix, jnp.eye(len(matrix)))
    norm, of_inverse = (jnp.sqrt(jnp.sum(m**2)) for m in (matrix, inverse))
    return jnp.maximum(norm, 1.0) * jnp.maximum(of_inverse, 1.0), of_inverse
