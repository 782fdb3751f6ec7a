"""What `reach` gives back."""

import dataclasses
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from ...scene import Scene
from ...solver import Solution
from ...solver.display import centerlines, counted, described, holds_numbers, notebook, shape_text, values_text
from ..free_parameters import Free
from .controls import steady_with
from .workspace import Workspace

_PER_TARGET = (
    "target", "values", "unknowns", "points", "solution", "outcome", "distance", "effort", "iterations", "starts",
)  # fmt: skip


class ReachOutcome(eqx.Enumeration):
    """What came of a target; `ReachOutcome[member]` is the sentence."""

    reached = "reached"
    out_of_reach = (
        "out of reach: these values bring the arm as close as any within the bounds; widen the bounds, let more be "
        "free, or move the target"
    )
    equilibrium_lost = (
        "not reached: closer to the target the arm has no equilibrium; these values are the closest found; let more be "
        "free, or move the target"
    )
    iterations_exhausted = (
        "not reached: the search did not settle, and these values are the closest found; narrow the bounds"
    )
    no_equilibrium = (
        "nowhere was an equilibrium found within the bounds to start from; lower them, or lower the load on the arm"
    )


@dataclasses.dataclass(frozen=True)
class Reach:
    """The values of free parameters that bring the arm to targets, each target with its own outcome.

    Arrays have one leading axis over the targets if there were several, and none for one target.

    - `free`: the parameters with the bounds that were kept, default limits of tensions and voltages among them.
    - `at`: arc lengths s [m] of the points that were to come to the `target` [m]; `points` [m]: where they came.
    - `values`: {path: value} [SI]. `unknowns`: the same by what a scene without TCAMs is given, {path: value}: a
      tension for each voltage.
    - `solution`: the equilibria with these values; NaN where the outcome is `no_equilibrium`, as `values` are.
    - `outcome`: a `ReachOutcome`. `distance` [m]: from the target, of several points the root mean square. `effort`:
      sum (value / limit)^2, with a tension in the place of each voltage.
    - `iterations`: steps tried by the search that found it, and `starts`, how many searches there were.
    - `workspace`: the points over the grid that the searches started from.
    """

    scene: Scene
    free: tuple[Free, ...]
    at: Float[np.ndarray, " at"]
    target: Float[np.ndarray, "..."]
    values: dict[str, Float[np.ndarray, "..."]]
    unknowns: dict[str, Float[np.ndarray, "..."]]
    points: Float[np.ndarray, "..."]
    solution: Solution
    outcome: ReachOutcome
    distance: Float[np.ndarray, "..."]
    effort: Float[np.ndarray, "..."]
    iterations: Int[np.ndarray, "..."]
    starts: Int[np.ndarray, "..."]
    workspace: Workspace

    def _text(self) -> str:
        shape = np.shape(self.distance)
        if shape:
            lines = [f"Reach of {shape_text(shape)} targets: {counted(self.outcome, ReachOutcome)}"]
        else:
            lines = [f"Reach: {self.message}"]
        x, y = (values_text(np.asarray(self.target)[..., i], "m") for i in range(2))
        lines.append(f"  target at s={values_text(self.at, 'm')}: x={x}, y={y}")
        lines += [f"  {one.path}: {values_text(self.values[one.path], one.unit)}" for one in self.free]
        lines.append(f"  distance: {values_text(self.distance, 'm')}")
        return "\n".join([*lines, f"  tip: {self.solution.tip}"])

    __repr__ = described(_text, ("at", "target", "values", "solution", "outcome", "distance"))

    def _repr_html_(self) -> str:
        if not holds_numbers((self.solution, self.target)):
            return notebook(repr(self))
        return notebook(repr(self), centerlines(self.solution.fields.x, self.solution.fields.y, self.target))

    @property
    def first(self) -> "Reach":
        """That of the first target alone, without the axis over the targets."""
        return self._changed(lambda leaf: np.asarray(leaf[0]), _PER_TARGET[1:])

    @property
    def as_batch(self) -> "Reach":
        """That of one target with an axis over the targets."""
        return self._changed(lambda leaf: np.asarray(leaf)[None], _PER_TARGET)

    def _changed(self, change: Callable[[Any], np.ndarray], names: tuple[str, ...]) -> "Reach":
        return dataclasses.replace(self, **{name: jax.tree.map(change, getattr(self, name)) for name in names})

    @property
    def reached(self) -> Bool[np.ndarray, "..."]:
        """Whether the target was reached, to 1e-9 of the arm's length."""
        return np.asarray(self.outcome == ReachOutcome.reached)

    @property
    def message(self) -> str:
        """What came of one target, in a sentence."""
        return self.message_of(())

    def message_of(self, index: int | tuple[()]) -> str:
        """What came of the target `index`, in a sentence."""
        sentence = ReachOutcome[jax.tree.map(lambda codes: np.asarray(codes[index]), self.outcome)]
        distance = float(self.distance[index])
        if bool(self.reached[index]) or not np.isfinite(distance):
            return sentence
        return f"{sentence} (nearest {distance:.4g} m away)"

    def scene_at(self, index: int | tuple[()] = ()) -> Scene:
        """The scene with the values for one target in it, and with its tension in place of each TCAM: `solve` takes it.

        `index` is that of the target, where there are several.
        """
        return steady_with(self.scene, {path: float(value[index]) for path, value in self.unknowns.items()})
