"""How results print themselves: a few lines with numbers and units, and in a notebook a small drawing in SVG.

No matplotlib, which takes long to import. What JAX traces, or what holds no numbers, is left to equinox to print.
"""

import functools
import html
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jax.core import Tracer

from .outcome import Outcome, outcome_codes

_WIDTH, _HEIGHT, _MARGIN = 360, 240, 8  # pixels
_PANEL = 150  # of a plot of data against model
_LINES = 100  # that a drawing holds
_PANELS = 6


def described(describe: Callable[[Any], str], parts: tuple[str, ...] = ()) -> Any:
    """The `__repr__` that prints a result by `describe` where it, or these parts, hold numbers; else equinox's."""

    @functools.wraps(describe)
    def representation(self: Any) -> str:
        if holds_numbers([getattr(self, name) for name in parts] or self):
            return describe(self)
        # equinox prints by its own means only what has no __repr__ of its own
        fields = {name: getattr(self, name, None) for name in type(self).__dataclass_fields__}
        plain = jax.tree.map(lambda leaf: leaf._value if _is_member(leaf) else leaf, fields, is_leaf=_is_member)
        return f"{type(self).__name__}{eqx.tree_pformat(plain)}"

    return representation


def holds_numbers(tree: Any) -> bool:
    """Whether every leaf is a number or an array that can be looked at."""
    leaves, _ = jax.tree.flatten(tree, is_leaf=lambda leaf: leaf is None)
    return all(_is_number(leaf) for leaf in leaves)


def _is_member(leaf: Any) -> bool:
    """Whether it is a member of an enumeration, which equinox prints only where its code is known."""
    return isinstance(leaf, type(Outcome.converged))


def _is_number(leaf: Any) -> bool:
    if isinstance(leaf, Tracer | bool):
        return False
    if isinstance(leaf, jax.Array):
        return not leaf.is_deleted() and np.issubdtype(leaf.dtype, np.number)
    return isinstance(leaf, int | float) or (
        isinstance(leaf, np.ndarray | np.generic) and np.issubdtype(leaf.dtype, np.number)
    )


def values_text(values: Any, unit: str = "") -> str:
    """Numbers with their unit: up to three of them, of more the range of those that are finite."""
    array = np.asarray(values)
    if array.size <= 3:
        text = ", ".join(f"{number:.6g}" for number in array.ravel().tolist())
    else:
        finite = array[np.isfinite(array)]
        text = f"{finite.min():.6g} to {finite.max():.6g}" if finite.size else "nan"
    return f"{text} {unit}".removesuffix(" 1").rstrip()


def fields_text(part: Any, units: Mapping[str, str]) -> str:
    """The fields of a part as "x=0.35 m, y=0.117 m"."""
    return ", ".join(f"{name}={values_text(getattr(part, name), unit)}" for name, unit in units.items())


def shape_text(shape: tuple[int, ...]) -> str:
    """ "41 x 2"."""
    return " x ".join(str(size) for size in shape)


def counted(outcome: Any, kind: type[eqx.Enumeration]) -> str:
    """How many of a batch came to each outcome, the most frequent one first: "80 converged, 2 limit_point"."""
    names = {code: name for name, code in outcome_codes(kind).items()}
    codes, counts = np.unique(np.asarray(outcome._value), return_counts=True)
    order = np.argsort(-counts, kind="stable")
    return ", ".join(f"{counts[i]} {names.get(int(codes[i]), codes[i])}" for i in order)


def notebook(text: str, *drawings: str) -> str:
    """HTML with the text and the drawings below it."""
    return f"<pre>{html.escape(text)}</pre>" + "".join(drawings)


def centerlines(x: Any, y: Any, targets: Any = ()) -> str:
    """The centerlines of arms, arrays of shape (..., points) [m], at equal aspect, and targets (..., 2) as crosses; an
    empty text where there is none."""
    points = np.stack([np.asarray(x, float), np.asarray(y, float)], axis=-1)
    lines = points.reshape(-1, *points.shape[-2:])
    lines = lines[np.isfinite(lines).all(axis=(1, 2))]
    if len(lines) == 0:
        return ""
    marks = np.asarray(targets, float).reshape(-1, 2)
    marks = marks[np.isfinite(marks).all(axis=1)][:_LINES]
    shown = lines[np.unique(np.linspace(0, len(lines) - 1, min(len(lines), _LINES)).astype(int))]
    everything = np.concatenate([shown.reshape(-1, 2), marks])
    low, high = everything.min(axis=0), everything.max(axis=0)
    span = max(float((high - low).max()), 1e-12)
    scale = min(_WIDTH / max(high[0] - low[0], 1e-3 * span), _HEIGHT / max(high[1] - low[1], 1e-3 * span))
    low, high = (np.where(abs(end) < 1e-9 * span, 0.0, end) for end in (low, high))
    size = (high - low) * scale
    place = functools.partial(_pixels, low=low, high=high, scale=np.array([scale, scale]))
    opacity = 1.0 if len(shown) == 1 else 0.5
    parts = [_line(place(line), opacity) for line in shown] + [_cross(*place(mark)) for mark in marks]
    caption = f"x {low[0]:.3g} to {high[0]:.3g} m, y {low[1]:.3g} to {high[1]:.3g} m"
    return _svg(max(size[0], _WIDTH), size[1], parts, caption)


def data_against_model(panels: Iterable[tuple[str, Any, Any]]) -> str:
    """For each observable, (name and unit, measured, predicted), a square with the two against each other and the line
    on which they agree."""
    drawn = []
    for name, measured, predicted in list(panels)[:_PANELS]:
        points = np.stack([np.ravel(measured), np.ravel(predicted)], axis=-1).astype(float)
        points = points[np.isfinite(points).all(axis=1)]
        if len(points) == 0:
            continue
        low, high = points.min(), points.max()
        room = 0.05 * (high - low) or 0.5 * abs(high) or 1.0
        low, high = np.full(2, low - room), np.full(2, high + room)
        place = functools.partial(_pixels, low=low, high=high, scale=_PANEL / (high - low))
        dots = [f'<circle cx="{x:.1f}" cy="{y:.1f}" r="2.5" fill="currentColor"/>' for x, y in place(points).tolist()]
        drawn.append(_svg(_PANEL, _PANEL, [_line(place(np.stack([low, high])), 0.4), *dots], name))
    return "".join(drawn)


def _pixels(points: np.ndarray, low: np.ndarray, high: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """From the upper left corner down."""
    return np.stack([points[..., 0] - low[0], high[1] - points[..., 1]], axis=-1) * scale + _MARGIN


def _line(pixels: np.ndarray, opacity: float) -> str:
    path = " ".join(f"{x:.1f},{y:.1f}" for x, y in pixels.tolist())
    return f'<polyline points="{path}" fill="none" stroke="currentColor" stroke-width="1.5" opacity="{opacity:g}"/>'


def _cross(x: float, y: float) -> str:
    strokes = f"M{x - 4:.1f} {y - 4:.1f}l8 8m0 -8l-8 8"
    return f'<path d="{strokes}" fill="none" stroke="#d55e00" stroke-width="1.5"/>'


def _svg(width: float, height: float, parts: list[str], caption: str) -> str:
    text = f'<text x="{_MARGIN}" y="{height + 2 * _MARGIN + 10:.0f}" font-size="11" fill="currentColor">'
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" role="img" width="{width + 2 * _MARGIN:.0f}" '
        f'height="{height + 2 * _MARGIN + 16:.0f}">{"".join(parts)}{text}{html.escape(caption)}</text></svg>'
    )
