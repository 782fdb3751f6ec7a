"""Results as text and JSON for the terminal."""

import json
import math
from typing import Any

import jax
import numpy as np

from ..scene import unit_of
from ..solver import Outcome, Solution, outcome_codes
from ..study import Sweep

_ROWS = 60  # of a table on the screen
_FAILURES = 5  # that a summary spells out


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
    table.index.names = [f"{path} [{unit_of(swept.scene, path)}]" for path in swept.over]
    return table.to_string(max_rows=_ROWS)


def sweep_summary(name: str, swept: Sweep, seconds: float) -> str:
    """What was swept, what came of it, and the first of the rods that have no solution."""
    converged, heights = np.asarray(swept.solution.converged), np.asarray(swept.solution.tip.y)
    lines = [f"{name}: {converged.sum()} of {converged.size} rods converged"]
    for path, values in swept.over.items():
        span = f"{values.min():.6g} to {values.max():.6g} {unit_of(swept.scene, path)}".removesuffix(" 1")
        lines.append(f"  {path}: {len(values)} values, {span}")
    if converged.any():
        lines.append(f"  tip height   {heights[converged].min():.6g} to {heights[converged].max():.6g} m")
    lines.append(f"  time         {seconds:.1f} s")
    outcomes, counts = np.unique(_outcome_names(swept.solution.outcome)[~converged], return_counts=True)
    lines += [f"  {count} rods: {outcome}" for outcome, count in zip(outcomes, counts, strict=True)]
    failed = [tuple(place) for place in np.argwhere(~converged).tolist()]
    lines += [f"  {_rod_text(swept, place)}" for place in failed[:_FAILURES]]
    if len(failed) > _FAILURES:
        lines.append(f"  ... and {len(failed) - _FAILURES} more without a solution")
    return "\n".join(lines)


def _rod_text(swept: Sweep, place: tuple[int, ...]) -> str:
    """The swept values of the rod at `place` of the grid, and what came of it."""
    values = [
        f"{path} = {values[i]:.6g} {unit_of(swept.scene, path)}".removesuffix(" 1")
        for (path, values), i in zip(swept.over.items(), place, strict=True)
    ]
    return f"{', '.join(values)}: {_sentence(jax.tree.map(lambda leaf: np.asarray(leaf[place]), swept.solution))}"


def _outcome_names(outcome: Any) -> np.ndarray:
    """The name of each outcome of a batch, in the batch's shape."""
    (codes,) = jax.tree.leaves(outcome)
    by_code = {code: name for name, code in outcome_codes().items()}
    return np.vectorize(by_code.__getitem__, otypes=[object])(codes)


def _sentence(solution: Solution) -> str:
    if bool(solution.converged):
        return Outcome[solution.outcome]
    return f"{Outcome[solution.outcome]} (reached {float(solution.load_fraction):.3g} of the load)"


def _number(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None
