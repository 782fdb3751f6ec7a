"""Many rods in one compiled batch, those that one method does not solve again by the next."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..scene import Scene
from ..scene.quantity import is_traced
from ..solver import Method, Solution
from ..solver.method import MultipleShooting, methods_of
from ..solver.solve import is_lost, solve_batch


def solve_rods(scene: Scene, method: Method | None, places: Float[np.ndarray, " points"], size: int) -> Solution:
    """The solutions, rods first, of a scene of which some floats are arrays [rods], those that all rods share are not.

    Rods that one of the methods does not solve are solved again by the next: by single shooting in batches of `size`,
    by multiple shooting one by one, so that no rod waits for another's load steps. While JAX is tracing nothing can be
    looked at, and all are left as the first method leaves them.
    """
    methods = methods_of(method, traced=is_traced(scene))
    solution = solve_batch(scene, methods[0], places)
    if is_traced(scene):
        return solution
    leaves, tree = jax.tree.flatten(scene)
    for harder in methods[1:]:
        rows = np.flatnonzero(is_lost(solution))
        if rows.size == 0:
            break
        together = 1 if isinstance(harder, MultipleShooting) else min(size, len(np.asarray(solution.residual)))
        parts = []
        for start in range(0, rows.size, together):
            # a short batch is filled up with its last rod, so that one compiled program serves all
            chosen = rows[np.minimum(np.arange(start, start + together), rows.size - 1)]
            taken = [jnp.asarray(leaf)[chosen] if np.ndim(leaf) else leaf for leaf in leaves]
            parts.append(solve_batch(jax.tree.unflatten(tree, taken), harder, places))
        again = jax.tree.map(lambda *some: np.concatenate([np.asarray(one) for one in some])[: rows.size], *parts)
        solution = jax.tree.map(lambda all, new, at=rows: _set(all, at, new), solution, again)
    return solution


def _set(all: Any, rows: np.ndarray, new: np.ndarray) -> Array | np.ndarray:
    if isinstance(all, np.ndarray):
        all = all.copy()
        all[rows] = new
        return all
    return jnp.asarray(all).at[rows].set(new)
