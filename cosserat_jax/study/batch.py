"""Many rods in compiled batches, those that one method does not solve again by the next."""

from collections.abc import Callable, Iterable

import jax
import numpy as np
from jaxtyping import Float, Int

from ..scene import Scene
from ..scene.quantity import is_traced
from ..solver import Method, Solution
from ..solver.method import MultipleShooting, SingleShooting, methods_of
from ..solver.solve import LOG, empty_solution, is_lost, solve_batch
from .checkpoint import Checkpoint

_STRUCTURE = jax.tree.structure(empty_solution())
_TRIED_AGAIN = 32  # rods at a time by single shooting on finer grids


def solve_rods(
    scene: Scene,
    method: Method | None,
    places: Float[np.ndarray, " points"],
    size: int,
    store: Checkpoint | None = None,
    shown: Callable[[Iterable], Iterable] = iter,
) -> Solution:
    """The solutions, rods first, of a scene of which some floats are arrays [rods]; those of the others all share.

    Rods are solved `size` at a time. Those that one of the methods does not solve are solved again by the next: by
    single shooting in small batches, by multiple shooting one by one, so that no rod waits for another's load steps.
    Batches in `store` are taken from there; `shown` wraps the batches of the first method, for a progress bar. While
    JAX is tracing nothing can be looked at, and all rods are solved at once by the one method for that.
    """
    methods = methods_of(method, traced=is_traced(scene))
    if is_traced(scene):
        return solve_batch(scene, methods[0], places)
    leaves, tree = jax.tree.flatten(scene)
    leaves = [np.asarray(leaf, float) for leaf in leaves]
    count = max(leaf.size for leaf in leaves)
    solved, done = None, 0
    rows = np.arange(count)
    for i, each in enumerate(methods):
        together = 1 if isinstance(each, MultipleShooting) else min(size if i == 0 else _TRIED_AGAIN, size, count)
        batches = _batches(rows, together)
        if i > 0:
            LOG.info("trying %s for %d of %d rods ...", each, rows.size, count)
        parts = []
        for batch in shown(batches) if i == 0 else batches:
            taken = [leaf[batch] if leaf.ndim else leaf for leaf in leaves]
            parts.append(_solved(jax.tree.unflatten(tree, taken), each, places, store, done))
            done += 1
        new = [np.concatenate(some)[: rows.size] for some in zip(*parts, strict=True)]
        if solved is None:
            solved = new
        else:
            for whole, part in zip(solved, new, strict=True):
                whole[rows] = part
        rows = np.flatnonzero(is_lost(jax.tree.unflatten(_STRUCTURE, solved), each))
        if rows.size == 0:
            break
    assert solved is not None, "there is at least one method"
    return jax.tree.unflatten(_STRUCTURE, solved)


def _batches(rows: Int[np.ndarray, " rows"], size: int) -> list[Int[np.ndarray, " size"]]:
    """The rows, `size` at a time. A short last batch is filled with its last row, so that one program serves all."""
    return [rows[np.minimum(np.arange(i, i + size), rows.size - 1)] for i in range(0, rows.size, size)]


def _solved(
    scene: Scene, method: SingleShooting | MultipleShooting, places: np.ndarray, store: Checkpoint | None, index: int
) -> list[np.ndarray]:
    """The leaves of one batch's solutions, taken from the checkpoint where it has them."""
    rows = max(np.shape(leaf)[0] for leaf in jax.tree.leaves(scene) if np.ndim(leaf))
    leaves = None if store is None else store.load(index, rows)
    if leaves is None:
        leaves = [np.asarray(leaf) for leaf in jax.tree.leaves(solve_batch(scene, method, places))]
        if store is not None:
            store.save(index, leaves)
    return leaves
