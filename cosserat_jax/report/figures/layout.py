"""How a sweep is laid out in a figure: which swept path is the colour, which cases are drawn, what each is called."""

import dataclasses
import math
import re
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize

from ...scene import Scene, replace, unit_of
from ...solver import Fields, Solution
from ...study import with_tensions

if TYPE_CHECKING:
    from ...study import Sweep

CASES = 4  # drawn at most
# lightness rises from one end to the other, so the order reads in grey too; the yellow end is too pale for white paper
COLOURS = ListedColormap(colormaps["viridis"](np.linspace(0.0, 0.88, 256)))
_PREFIXES = {-6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}
_IS_PULL = re.compile(r"muscles\.\d+\.(tension|displacement)")
_ALREADY_PREFIXED = re.compile(r"1|rad\b|deg|kg|m\^")  # these take no further prefix


class Case(NamedTuple):
    """One value of every swept path but the colour's: its name, the values, the solutions along the colour's axis."""

    name: str
    at: dict[str, float]
    solution: Solution

    @property
    def converged(self) -> Bool[np.ndarray, " colours"]:
        """Which of its rods have a solution."""
        return np.asarray(self.solution.converged)


@dataclasses.dataclass(frozen=True)
class Layout:
    """A sweep as a figure shows it: the path `colour`, its `values` in rising order, and the drawn `cases`."""

    scene: Scene
    colour: str
    values: Float[np.ndarray, " colours"]
    cases: tuple[Case, ...]
    note: str

    @classmethod
    def of(cls, swept: "Sweep") -> "Layout":
        """The colour is the first swept tension or displacement of a muscle, else the path with the most values."""
        over = swept.over
        pulls = [path for path, v in over.items() if _IS_PULL.fullmatch(path) and v.size > 1]
        colour = pulls[0] if pulls else max(over, key=lambda path: over[path].size)
        order = np.argsort(over[colour], kind="stable")
        others = [path for path in over if path != colour]
        every = list(np.ndindex(*(over[path].size for path in others)))
        chosen = [every[i] for i in spread(np.arange(len(every)), CASES)]
        cases = tuple(_case(swept, colour, order, dict(zip(others, at, strict=True))) for at in chosen)
        drawn = f"{len(chosen)} of {len(every)} cases of {' and '.join(others)} are drawn"
        notes = [drawn] if len(chosen) < len(every) else []
        notes += left_out(np.asarray(swept.solution.converged))
        return cls(swept.scene, colour, over[colour][order], cases, "; ".join(notes))

    def rods(self, case: Case, most: int) -> list[tuple[Scene, Fields, float]]:
        """Rods of a case, spread over the colour, `most` of those with a solution: scene, fields, colour's value."""
        chosen = spread(np.flatnonzero(case.converged), most)
        return [(*self.rod(case, int(i)), float(self.values[i])) for i in chosen]

    def rod(self, case: Case, i: int) -> tuple[Scene, Fields]:
        """The scene, with the tensions found, and the fields of a case's rod at the colour's value `i`."""
        scene = replace(self.scene, {**case.at, self.colour: self.values[i]})
        scene = with_tensions(scene, dict(enumerate(case.solution.tensions[i])))
        return scene, jax.tree.map(lambda leaf: leaf[i], case.solution.fields)

    @property
    def axis(self) -> tuple[Float[np.ndarray, " colours"], str]:
        """The colour's values and the label of their axis, path and unit."""
        factor, unit = prefixed(unit_of(self.scene, self.colour), np.abs(self.values).max())
        return factor * self.values, f"{self.colour} {bracketed(unit)}"

    @property
    def largest(self) -> str:
        """The largest of the colour's values, with path and unit."""
        return assigned(self.scene, self.colour, float(self.values[-1]))

    @property
    def bar(self) -> ScalarMappable:
        """What a colour bar of the colour's values is made from."""
        values, _ = self.axis
        return ScalarMappable(Normalize(values[0], values[-1]), COLOURS)

    def color(self, value: float) -> Any:
        """The colour of a value in SI."""
        return COLOURS(Normalize(self.values[0], self.values[-1])(value))


def spread(items: Int[np.ndarray, " n"], most: int) -> Int[np.ndarray, " m"]:
    """`most` of the items, the first, the last, and evenly between; all where there are no more."""
    if len(items) <= most:
        return items
    return items[np.linspace(0, len(items) - 1, most).round().astype(int)]


def prefixed(unit: str, largest: float) -> tuple[float, str]:
    """The factor from SI and the unit with the prefix in which `largest` is between 1 and 1000."""
    if _ALREADY_PREFIXED.match(unit) or not 0 < largest < math.inf or 0.1 <= largest < 1000:
        return 1.0, unit
    power = min(max(3 * math.floor(math.log10(largest) / 3), -6), 9)
    return 10.0**-power, _PREFIXES[power] + unit


def assigned(scene: Scene, path: str, value: float) -> str:
    """ "water.velocity = 0.2 m/s"."""
    factor, unit = prefixed(unit_of(scene, path), abs(value))
    return f"{path} = {factor * value:.4g} {'' if unit == '1' else unit}".strip()


def bracketed(unit: str) -> str:
    """The unit as an axis label shows it."""
    return "[-]" if unit == "1" else f"[{unit.replace('*', ' ')}]"


def left_out(converged: Bool[np.ndarray, "..."]) -> list[str]:
    """The note that counts the rods without a solution; none where there are none."""
    failed = int(np.sum(~converged))
    return [f"{failed} of {converged.size} rods have no solution and are left out"] if failed else []


def _case(swept: "Sweep", colour: str, order: Int[np.ndarray, " colours"], at: dict[str, int]) -> Case:
    index = tuple(order if path == colour else at[path] for path in swept.over)
    values = {path: float(swept.over[path][i]) for path, i in at.items()}
    name = ",\n".join(assigned(swept.scene, path, value) for path, value in values.items())
    return Case(name, values, jax.tree.map(lambda leaf: leaf[index], swept.solution))
