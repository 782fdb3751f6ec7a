"""What `reach` found as text and JSON for the terminal."""

import json
import math
from typing import Any

import jax
import numpy as np

from ..solver import outcome_codes
from ..study import Reach, ReachOutcome
from .text import number_or_none

_POSE = ("x", "y", "theta")


def reach_json(name: str, found: Reach) -> list[str]:
    """A JSON object on one line for each target of one point; a number that there is none of is null."""
    names = {code: name for name, code in outcome_codes(ReachOutcome).items()}
    lines = []
    for i, target in enumerate(found.target):
        line = {
            "scene": name,
            "target": {"x": float(target[0]), "y": float(target[1])},
            "at": float(found.at[0]),
            "outcome": names[int(np.asarray(found.outcome._value)[i])],
            "reached": bool(found.reached[i]),
            "message": found.message_of(i),
            "distance": number_or_none(found.distance[i]),
            "parameters": _parameters(found, i),
            "tip": {key: number_or_none(getattr(found.solution.tip, key)[i]) for key in _POSE},
            "effort": number_or_none(found.effort[i]),
            "iterations": int(found.iterations[i]),
        }
        lines.append(json.dumps(line, allow_nan=False))
    return lines


def reach_text(name: str, found: Reach) -> str:
    """Every target in a few lines to read."""
    lines = []
    for i, target in enumerate(found.target):
        lines.append(f"{name}: {found.message_of(i)}")
        lines.append(f"  target       x {target[0]:.6g} m, y {target[1]:.6g} m{_place(found)}")
        for path, one in _parameters(found, i).items():
            if one["value"] is not None:
                bounds = f"of {one['lower']:.6g} to {one['upper']:.6g} {one['unit']}"
                lines.append(f"  {path} = {one['value']:.6g} {one['unit']}, {bounds}".replace(" 1,", ","))
        if np.isfinite(found.distance[i]):
            tip = jax.tree.map(lambda leaf, i=i: float(leaf[i]), found.solution.tip)
            lines.append(f"  tip          x {tip.x:.6g} m, y {tip.y:.6g} m")
            lines.append(f"  theta        {tip.theta:.6g} rad, {math.degrees(tip.theta):.6g} deg")
    return "\n".join(lines)


def _place(found: Reach) -> str:
    s = float(found.at[0])
    return "" if s == float(found.scene.arm.length) else f", for the arm at s = {s:.6g} m"


def _parameters(found: Reach, i: int) -> dict[str, dict[str, Any]]:
    return {
        one.path: {
            "value": number_or_none(found.values[one.path][i]),
            "unit": one.unit,
            "lower": one.lower,
            "upper": one.upper,
        }
        for one in found.free
    }
