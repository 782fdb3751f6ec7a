"""Results as text and JSON for the terminal."""

import json
import math
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import numpy as np

from ..physics.tcam import tension_gain
from ..scene import ZERO_CELSIUS, unit_of
from ..solver import Outcome, ResponseOutcome, Solution, outcome_codes

if TYPE_CHECKING:
    from ..study import Actuation, Sweep

_ROWS = 60  # of a table on the screen
_FAILURES = 5  # that a summary spells out
_POSE = ("x", "y", "theta")


def json_line(name: str, solution: Solution) -> str:
    """One solution as a JSON object on one line; a number that a rod without solution does not have is null."""
    tip, strain = solution.tip, solution.tip_strain
    line = {
        "scene": name,
        "outcome": _outcome_names(solution.outcome).item(),
        "converged": bool(solution.converged),
        "message": solution.message,
        "residual": number_or_none(solution.residual),
        "iterations": int(solution.iterations),
        "steps": int(solution.steps),
        "tip": {key: number_or_none(getattr(tip, key)) for key in _POSE},
        "tip_strain": {key: number_or_none(getattr(strain, key)) for key in ("nu", "eta", "mu", "beta")},
        "tilt_deg": number_or_none(np.degrees(solution.tilt)),
        "condition": number_or_none(solution.condition),
        "load_fraction": float(solution.load_fraction),
        "failed_at": number_or_none(solution.failed_at),
        "tensions_N": [number_or_none(tension) for tension in solution.tensions],
    }
    return json.dumps(line, allow_nan=False)


def solution_text(name: str, solution: Solution) -> str:
    """One solution in a few lines to read."""
    lines = [f"{name}: {solution.message}"]
    if bool(solution.converged):
        lines += [*_tip_lines("tip", solution), f"  tilt         {math.degrees(float(solution.tilt)):.6g} deg"]
        if solution.tensions.size:
            lines.append(f"  tensions     {', '.join(_tension_text(tension) for tension in solution.tensions)}")
    lines.append(f"  residual     {float(solution.residual):.2g} after {int(solution.iterations)} iterations")
    return "\n".join(lines)


def sweep_table(swept: "Sweep") -> str:
    """A line for each rod, the swept values, the tip and the outcome; of many rods the first and the last."""
    names = {"tip_x": "tip.x [m]", "tip_y": "tip.y [m]", "tip_theta": "tip.theta [rad]"}
    table = swept.to_xarray()[list(names)].to_dataframe().rename(columns=names)
    table["outcome"] = _outcome_names(swept.solution.outcome).ravel()
    table.index.names = [f"{path} [{unit_of(swept.scene, path)}]" for path in swept.over]
    return table.to_string(max_rows=_ROWS)


def sweep_summary(name: str, swept: "Sweep", seconds: float) -> str:
    """What was swept, the outcomes, and the first of the rods that have no solution."""
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


def actuation_json(name: str, actuation: "Actuation") -> str:
    """A motion as a JSON object on one line; a number that a muscle or the arm does not have is null.

    The temperature at the top is that of the hottest muscle, the force the largest with which one pulls, both between
    the instants too; the contraction is the largest at the instants. `outcome` is the worst of the muscles'.
    """
    converged, end = np.asarray(actuation.solution.converged), actuation.solution.tip
    muscles = {str(i): _muscle_line(actuation, i) for i in actuation.responses}
    hottest = max(muscles.values(), key=lambda muscle: _or_lowest(muscle["peak_temperature_degC"]))
    contractions = np.array([response.contraction for response in actuation.responses.values()])
    line = {
        "scene": name,
        "outcome": muscles[str(_worst(actuation))]["outcome"],
        "converged": bool(converged.all()),
        "message": _motion_sentence(actuation),
        "instants": converged.size,
        "instants_converged": int(converged.sum()),
        "peak_temperature_degC": hottest["peak_temperature_degC"],
        "time_of_peak_s": hottest["time_of_peak_s"],
        "peak_force_N": max((muscle["peak_force_N"] for muscle in muscles.values()), key=_or_lowest),
        "peak_contraction_m": number_or_none(np.fmax.reduce(contractions, axis=None)),
        "tip_at_end": {key: number_or_none(getattr(end, key)[-1]) for key in _POSE},
        "muscles": muscles,
    }
    return json.dumps(line, allow_nan=False)


def actuation_text(name: str, actuation: "Actuation") -> str:
    """A motion in a few lines to read."""
    solution, times = actuation.solution, np.asarray(actuation.times)
    converged = np.asarray(solution.converged)
    lines = [
        f"{name}: {_motion_sentence(actuation)}",
        f"  instants     {converged.size} from {times[0]:.6g} to {times[-1]:.6g} s, {converged.sum()} converged",
    ]
    for i, response in actuation.responses.items():
        if not np.isnan(response.peak.temperature):
            peak = "{peak_temperature_degC:.6g} degC and {peak_force_N:.6g} N at {time_of_peak_s:.6g} s"
            lines.append(f"  {f'muscles.{i}':12} peak {peak.format_map(_muscle_line(actuation, i))}")
    if converged[-1]:
        lines += _tip_lines("tip at end", _one(solution, -1))
    return "\n".join(lines)


def overheated_lines(actuation: "Actuation") -> list[str]:
    """For each muscle that got hotter than its limit, how hot it was, when, and what to do."""
    advice = ResponseOutcome[ResponseOutcome.overheated].partition("; ")[2]
    lines = []
    for i, response in actuation.responses.items():
        if bool(response.outcome == ResponseOutcome.overheated):
            peak, tcam = response.peak, actuation.tcam(i)
            reached = f"{float(peak.temperature):.1f} K = {_celsius(peak.temperature):.1f} degC at {peak.time:.1f} s"
            limit = f"above its limit of {_celsius(tcam.limit_temperature):.6g} degC"
            lines.append(f"muscles.{i}.tcam: {reached}, {limit}; {advice}")
    return lines


def _muscle_line(actuation: "Actuation", i: int) -> dict[str, Any]:
    """The outcome of muscle `i`, its highest temperature, when, and with what force it then pulls."""
    response, tcam = actuation.responses[i], actuation.tcam(i)
    rise = response.peak.temperature - tcam.ambient_temperature
    return {
        "outcome": _outcome_names(response.outcome, ResponseOutcome).item(),
        "peak_temperature_degC": number_or_none(_celsius(response.peak.temperature)),
        "time_of_peak_s": number_or_none(response.peak.time),
        "peak_force_N": number_or_none(tension_gain(tcam) * rise),
    }


def _motion_sentence(actuation: "Actuation") -> str:
    """The outcomes of the worst of the muscles and of the first instant at which the arm has no equilibrium."""
    worst = _worst(actuation)
    outcome, solution = actuation.responses[worst].outcome, actuation.solution
    lost = np.flatnonzero(~np.asarray(solution.converged))
    sentence = ResponseOutcome[outcome]
    if bool(outcome != ResponseOutcome.followed):
        sentence = f"muscles.{worst}.tcam: {sentence}"
    if lost.size == 0 or np.isnan(actuation.responses[worst].peak.temperature):
        return sentence  # an arm whose muscle has no tension says no more than that
    count = f"{lost.size} of {len(actuation.times)} instants have no equilibrium"
    return f"{sentence}; {count}, first at {actuation.times[lost[0]]:.6g} s: {_one(solution, lost[0]).message}"


def _worst(actuation: "Actuation") -> int:
    """The number of the muscle that fared worst: the members of `ResponseOutcome` go from good to bad."""
    return max(actuation.responses, key=lambda i: int(actuation.responses[i].outcome._value))


def _tip_lines(label: str, solution: Solution) -> list[str]:
    x, y, theta = (float(getattr(solution.tip, key)) for key in _POSE)
    return [
        f"  {label:12} x {x:.6g} m, y {y:.6g} m",
        f"  theta        {theta:.6g} rad, {math.degrees(theta):.6g} deg",
    ]


def _tension_text(tension: Any) -> str:
    return f"{float(tension):.6g} N" if tension > 0 else "0 N (slack)"


def _rod_text(swept: "Sweep", place: tuple[int, ...]) -> str:
    """The swept values of the rod at `place` of the grid, and its outcome."""
    values = [
        f"{path} = {values[i]:.6g} {unit_of(swept.scene, path)}".removesuffix(" 1")
        for (path, values), i in zip(swept.over.items(), place, strict=True)
    ]
    return f"{', '.join(values)}: {_one(swept.solution, place).message}"


def _one(solution: Solution, place: Any) -> Solution:
    """One solution of a batch."""
    return jax.tree.map(lambda leaf: np.asarray(leaf[place]), solution)


def _outcome_names(outcome: Any, kind: type[eqx.Enumeration] = Outcome) -> np.ndarray:
    """The name of each outcome of a batch, in the batch's shape."""
    (codes,) = jax.tree.leaves(outcome)
    by_code = {code: name for name, code in outcome_codes(kind).items()}
    return np.vectorize(by_code.__getitem__, otypes=[object])(codes)


def number_or_none(value: Any) -> float | None:
    """JSON has no NaN: a number that there is none of is null."""
    return float(value) if np.isfinite(value) else None


def _or_lowest(value: float | None) -> float:
    return -math.inf if value is None else value


def _celsius(kelvin: Any) -> float:
    return float(kelvin) - ZERO_CELSIUS
