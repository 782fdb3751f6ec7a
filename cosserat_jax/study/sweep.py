"""`sweep`: many load cases at once, a product grid of parameters solved in one compiled batch."""

import dataclasses
import json
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import diffrax
import jax
import numpy as np
from jax.typing import ArrayLike

from ..scene import InputError, Scene, dumps, replace, sweep_values, unit_of
from ..scene.parts import Notes
from ..solver import Automatic, Method, Outcome, Solution
from ..solver.display import centerlines, counted, described, holds_numbers, notebook, shape_text, values_text
from ..solver.solve import places_of
from .batch import solve_rods
from .checkpoint import Checkpoint

if TYPE_CHECKING:
    import xarray


@dataclasses.dataclass(frozen=True)
class Sweep:
    """The equilibria over a grid: `over` holds the values of each swept path, in the order of the grid's axes.

    Every array of `solution` is a NumPy array with the grid's axes in front; each rod has its own outcome, and one that
    has no solution is NaN and leaves no trace in its neighbours.
    """

    scene: Scene
    over: dict[str, np.ndarray]
    method: Method
    solution: Solution

    def _text(self) -> str:
        lines = [
            f"Sweep of {shape_text(np.shape(self.solution.residual))} rods: {counted(self.solution.outcome, Outcome)}"
        ]
        for path, values in self.over.items():
            lines.append(f"  {path}: {len(values)} values, {values_text(values, unit_of(self.scene, path))}")
        return "\n".join([*lines, f"  tip: {self.solution.tip}"])

    __repr__ = described(_text, ("over", "solution"))

    def _repr_html_(self) -> str:
        if not holds_numbers(self.solution):
            return notebook(repr(self))
        return notebook(repr(self), centerlines(self.solution.fields.x, self.solution.fields.y))

    def to_xarray(self) -> "xarray.Dataset":
        """A dataset with one dimension per swept path, named by it, and units and long names on every variable."""
        from .datasets import sweep_dataset

        return sweep_dataset(self.scene, self.over, self.method, self.solution)


def sweep(
    scene: Scene,
    over: Mapping[str, ArrayLike | Sequence[str]],
    method: Method | None = None,
    *,
    points: int | tuple[float, ...] = 101,
    batch: int = 256,
    progress: bool = False,
    checkpoint: str | os.PathLike[str] | None = None,
) -> Sweep:
    """Solves `scene` for every combination of the values in `over`, the first path outermost: {path: values in SI,
    "START:STOP:STEP UNIT", "V1, V2 UNIT" or a list of quantities with units}.

    Rods are solved `batch` at a time by one compiled program, and those that the first of the methods does not solve
    again by the next; `method` and `points` are those of `solve`. `progress` shows a bar on a terminal. With
    `checkpoint`, a folder, every batch is kept as it ends, and the same sweep started again takes up where it was
    stopped, to the same bits; the folder is yours to remove once the result is safe. Raises `InputError` for a path or
    a value that is not allowed. A rod that has no solution does not raise: see `Sweep.solution.outcome`.
    """
    grid = {path: sweep_values(scene, path, values) for path, values in over.items()}
    if not grid:
        raise InputError("over must name a parameter to sweep, {path: values}, but is empty")
    if batch < 1:
        raise InputError(f"batch must be at least 1, but is {batch}")
    method, places = Automatic() if method is None else method, places_of(points)
    mesh = np.meshgrid(*grid.values(), indexing="ij")
    rods = {path: axis.ravel() for path, axis in zip(grid, mesh, strict=True)}

    shape = mesh[0].shape
    count = math.prod(shape)
    size = min(batch, count)
    store = None if checkpoint is None else Checkpoint(Path(checkpoint), _identity(scene, grid, method, points, size))
    try:
        solved = solve_rods(replace(scene, rods), method, places, size, store, partial(_shown, progress))
    finally:
        if store is not None:
            store.close()
    solution = jax.tree.map(lambda leaf: leaf.reshape(shape + leaf.shape[1:]), solved)
    return Sweep(scene, grid, method, solution)


def _shown(progress: bool, batches: Iterable) -> Iterable:
    if not progress:
        return batches
    from tqdm import tqdm

    return tqdm(batches, unit="batch", disable=None)  # None: no bar where the output is no terminal


def _identity(scene: Scene, grid: dict[str, np.ndarray], method: Method, points: Any, size: int) -> dict[str, str]:
    """What a kept batch must have been solved for: the same scene, grid, method and batch, by the same versions."""
    return {
        "scene": dumps(dataclasses.replace(scene, notes=Notes())),
        "grid": json.dumps({path: values.tolist() for path, values in grid.items()}),
        "method": repr(method),
        "points": repr(points),
        "batch size": str(size),
        **{f"version of {one.__name__}": version(one.__name__) for one in (jax, diffrax, np)},
        "version of cosserat_jax": version("cosserat_jax"),
    }
