"""Results written down: as text and JSON for the terminal, and as files that are moved into their place in whole."""

import contextlib
import json
import math
import os
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from ..scene import Quantity, Scene, lookup
from ..solver import Outcome, Solution
from ..study import Sweep

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_ROWS = 60  # of a table on the screen
_FAILURES = 5  # that a summary spells out


class OutputError(ValueError):
    """An output cannot be written: one line that names the option, the file and what is allowed."""


def output_place(option: str, file: str, suffixes: Collection[str]) -> Path:
    """The place that `file` names, links followed. Raises `OutputError` where it is plain that it cannot be written."""
    where, place = f"{option} {file!r}", Path(os.path.realpath(file))
    if Path(file).suffix.lower() not in suffixes:
        raise OutputError(f"{where}: not a name for this output; allowed: a name that ends in {', '.join(suffixes)}")
    if not place.parent.is_dir():
        raise OutputError(f"{where}: cannot be written: there is no folder {str(place.parent)!r}")
    if place.is_dir():
        raise OutputError(f"{where}: cannot be written: it is a folder; allowed: a file")
    if not os.access(place.parent, os.W_OK | os.X_OK):
        raise OutputError(f"{where}: cannot be written: no permission to write in {str(place.parent)!r}")
    try:
        os.lstat(_beside(place))  # finds a name that is too long for the file system
    except FileNotFoundError:
        pass
    except OSError as error:
        raise OutputError(f"{where}: cannot be written: {error.strerror}") from None
    return place


def figure_place(option: str, file: str) -> Path:
    """As `output_place`, for a figure in any format that matplotlib writes."""
    from matplotlib.backend_bases import FigureCanvasBase

    # matplotlib asks a TeX installation for the size of every word in a pgf figure
    kinds = sorted(kind for kind in FigureCanvasBase.get_supported_filetypes() if kind != "pgf")
    return output_place(option, file, [f".{kind}" for kind in kinds])


def batches_place(data: Path) -> Path:
    """The folder beside the output `data` that keeps the batches of a sweep while it runs.

    Raises `OutputError` if something there is not such a folder: it is the user's and must not be emptied.
    """
    folder = data.with_name(f"{data.name}.partial")
    if not folder.exists() or (folder / "identity").is_file() or (folder.is_dir() and not any(folder.iterdir())):
        return folder
    raise OutputError(f"{folder}: in the way, and not the batches of an unfinished sweep; move it elsewhere")


def save_figure(figure: "Figure", place: Path) -> None:
    """Writes `figure` to `place`, whole or not at all."""
    with written_whole(place) as beside:
        figure.savefig(beside, format=place.suffix[1:].lower())


@contextlib.contextmanager
def written_whole(place: Path) -> Iterator[Path]:
    """Gives the path to write to, and moves what is written there to `place` at the end.

    A run that is stopped, or a write that fails, leaves `place` as it was. Raises `OutputError` if the write fails.
    """
    beside = _beside(place)
    try:
        yield beside
        os.replace(beside, place)
    except OSError as error:
        raise OutputError(f"{place}: cannot be written: {error.strerror or error}") from None
    finally:
        beside.unlink(missing_ok=True)


def _beside(place: Path) -> Path:
    """One fixed name for each place: the next run overwrites what a killed one left."""
    return place.with_name(f".{place.name}.unfinished")


def json_line(name: str, solution: Solution) -> str:
    """One solution as a JSON object on one line; a number that a rod without solution does not have is null."""
    tip, strain = solution.tip, solution.tip_strain
    line = {
        "scene": name,
        "outcome": _outcome_names(solution.outcome).item(),
        "converged": bool(solution.converged),
        "message": _sentence(solution),
        "residual": _number(solution.residual),
        "iterations": int(solution.iterations),
        "steps": int(solution.steps),
        "tip": {key: _number(getattr(tip, key)) for key in ("x", "y", "theta")},
        "tip_strain": {key: _number(getattr(strain, key)) for key in ("nu", "eta", "mu", "beta")},
        "tilt_deg": _number(np.degrees(solution.tilt)),
    }
    return json.dumps(line, allow_nan=False)


def solution_text(name: str, solution: Solution) -> str:
    """One solution in a few lines to read."""
    lines = [f"{name}: {_sentence(solution)}"]
    if bool(solution.converged):
        x, y, theta = (float(value) for value in (solution.tip.x, solution.tip.y, solution.tip.theta))
        lines += [
            f"  tip          x {x:.6g} m, y {y:.6g} m",
            f"  theta        {theta:.6g} rad, {math.degrees(theta):.6g} deg",
            f"  tilt         {math.degrees(float(solution.tilt)):.6g} deg",
        ]
    lines.append(f"  residual     {float(solution.residual):.2g} after {int(solution.iterations)} iterations")
    return "\n".join(lines)


def sweep_table(swept: Sweep) -> str:
    """A line for each rod, the swept values, the tip and the outcome; of many rods the first and the last."""
    names = {"tip_x": "tip.x [m]", "tip_y": "tip.y [m]", "tip_theta": "tip.theta [rad]"}
    table = swept.to_xarray()[list(names)].to_dataframe().rename(columns=names)
    table["outcome"] = _outcome_names(swept.solution.outcome).ravel()
    table.index.names = [f"{path} [{_unit(swept.scene, path) or 1}]" for path in swept.over]
    return table.to_string(max_rows=_ROWS)


def sweep_summary(name: str, swept: Sweep, seconds: float) -> str:
    """What was swept, what came of it, and the first of the rods that have no solution."""
    converged, heights = np.asarray(swept.solution.converged), np.asarray(swept.solution.tip.y)
    lines = [f"{name}: {converged.sum()} of {converged.size} rods converged"]
    for path, values in swept.over.items():
        span = f"{values.min():.6g} to {values.max():.6g} {_unit(swept.scene, path)}".rstrip()
        lines.append(f"  {path}: {len(values)} values, {span}")
    if converged.any():
        lines.append(f"  tip height   {heights[converged].min():.6g} to {heights[converged].max():.6g} m")
    lines.append(f"  time         {seconds:.1f} s")
    outcomes, counts = np.unique(_outcome_names(swept.solution.outcome)[~converged], return_counts=True)
    lines += [f"  {count} rods: {outcome}" for outcome, count in zip(outcomes, counts, strict=True)]
    failed = [tuple(place) for place in np.argwhere(~converged)]
    lines += [f"  {_rod_text(swept, place)}" for place in failed[:_FAILURES]]
    if len(failed) > _FAILURES:
        lines.append(f"  ... and {len(failed) - _FAILURES} more without a solution")
    return "\n".join(lines)


def _rod_text(swept: Sweep, place: tuple[int, ...]) -> str:
    """The swept values of the rod at `place` of the grid, and what came of it."""
    values = [
        f"{path} = {values[i]:.6g} {_unit(swept.scene, path)}".rstrip()
        for (path, values), i in zip(swept.over.items(), place, strict=True)
    ]
    return f"{', '.join(values)}: {_sentence(jax.tree.map(lambda leaf: np.asarray(leaf[place]), swept.solution))}"


def _outcome_names(outcome: Any) -> np.ndarray:
    """The name of each outcome of a batch, in the batch's shape."""
    (codes,) = jax.tree.leaves(outcome)
    names = np.empty(np.shape(codes), dtype=object)
    for name, member in Outcome._name_to_item.items():  # equinox has no public list of an enumeration's members
        names[np.asarray(outcome == member)] = name
    return names


def _sentence(solution: Solution) -> str:
    if bool(solution.converged):
        return Outcome[solution.outcome]
    return f"{Outcome[solution.outcome]} (reached {float(solution.load_fraction):.3g} of the load)"


def _number(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None


def _unit(scene: Scene, path: str) -> str:
    _, rule = lookup(scene, path)
    return rule.unit if isinstance(rule, Quantity) and rule.unit != "1" else ""
