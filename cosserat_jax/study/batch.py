"""Many rods in one compiled batch, those that single shooting does not solve again by multiple shooting."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..scene.quantity import concrete, is_traced
from ..solver import Shooting, Solution, needs_multiple_shooting


def solve_rods(solve_batch: Callable[[Any, Shooting], Solution], rods: Any, method: Shooting) -> Solution:
    """`solve_batch(rods, method)`, `rods` a pytree whose leaves have a leading axis, one entry a rod.

    Rods that need multiple shooting are solved again one by one, so that no rod waits for another's load steps: on a
    CPU the intervals of one fill its lanes. While JAX is tracing nothing can be looked at, and all are left as they
    are.
    """
    solution = solve_batch(rods, method if is_traced(rods) else method.single)
    lost = concrete(needs_multiple_shooting(solution, method))
    rows = np.zeros(0, int) if lost is None else np.flatnonzero(lost)
    if rows.size == 0:
        return solution
    again = [
        solve_batch(jax.tree.map(lambda leaf, at=[row]: leaf[jnp.asarray(at)], rods), method.multiple) for row in rows
    ]
    return jax.tree.map(lambda all, *new: jnp.asarray(all).at[rows].set(jnp.concatenate(new)), solution, *again)
