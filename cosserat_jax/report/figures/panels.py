"""The panels that figures are put together from: arms in one frame, a quantity of the tip, a quantity along the rod."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.text import Text

from ...scene import Scene
from ...solver import Fields, Solution
from .arm import CORNER, draw_arm, draw_clamp, draw_directors, draw_surroundings, extent, length_unit
from .layout import Layout, bracketed, prefixed

# told apart in grey by dash and marker
CASE_STYLES: tuple[dict[str, Any], ...] = (
    {"color": "black", "linestyle": "-", "marker": "o"},
    {"color": "#d55e00", "linestyle": "--", "marker": "s"},
    {"color": "#0072b2", "linestyle": ":", "marker": "^"},
    {"color": "#009e73", "linestyle": "-.", "marker": "D"},
)
_TIGHT, TALL = 4.0, 3.4  # inches: panels below are narrow and draw small heads; no panel of arms is taller
# name: (label, SI unit, the values)
_ALONG: dict[str, tuple[str, str, Callable[[Fields], Any]]] = {
    "tilt": (r"tilt $\alpha - \theta$", "deg", lambda fields: np.rad2deg(np.arctan2(fields.eta, fields.nu))),
    "beta": (r"cross-section scale $\beta$", "1", lambda fields: fields.beta),
    "N": ("normal traction $N$", "Pa", lambda fields: fields.N),
    "H": ("shear traction $H$", "Pa", lambda fields: fields.H),
    "M": ("bending moment $M$", "Pa/m", lambda fields: fields.M),
}
_AT_TIP: dict[str, tuple[str, Callable[[Solution], Any]]] = {
    "height": ("height of the tip [{unit}]", lambda solution: solution.tip.y),
    "tilt": (r"tilt $\alpha - \theta$ at $L$ [deg]", lambda solution: np.rad2deg(solution.tilt)),
    "theta": (r"angle $\theta$ at $L$ [deg]", lambda solution: np.rad2deg(solution.tip.theta)),
}


class Rod(NamedTuple):
    """One rod to draw: its scene, its equilibrium, and the style of its lines."""

    scene: Scene
    fields: Fields
    style: dict[str, Any]


class Frame(NamedTuple):
    """What panels of arms share: inches of width and height, unit of length and factor from metres, limits in it."""

    width: float
    height: float
    unit: str
    factor: float
    x: tuple[float, float]
    y: tuple[float, float]

    @classmethod
    def around(
        cls, rods: Sequence[Rod], width: float, tallest: float = TALL, also: Float[np.ndarray, "points 2"] | None = None
    ) -> "Frame":
        """The frame that holds every one of these arms and leaves the upper left corner free, `width` inches wide.

        `also`: further points [m] that it is to hold.
        """
        factor, unit = length_unit(max((float(rod.scene.arm.length) for rod in rods), default=1.0))
        arms = [extent(rod.scene, rod.fields) * factor for rod in rods] or [np.array([[0.0, 0.0], [1.0, 0.4]])]
        points = np.concatenate([*arms, np.zeros((0, 2)) if also is None else also * factor])
        low, high = points.min(axis=0), points.max(axis=0)
        inch = max((high[0] - low[0]) / width, (high[1] - low[1]) / tallest)
        below = points[points[:, 0] < low[0] + CORNER[0] * inch, 1].max()
        top = max(high[1], below + CORNER[1] * inch)
        margin = 0.08 * inch
        height = min((top - low[1]) / inch, tallest)
        x, y = (low[0] - margin, high[0] + margin), (low[1] - margin, top + margin)
        return cls(width, height, unit, factor, x, y)


def case_style(i: int) -> dict[str, Any]:
    """The style of line `i`; where there are more lines than styles they come again with white markers."""
    again = {"markerfacecolor": "white"} if i // len(CASE_STYLES) % 2 else {}
    return CASE_STYLES[i % len(CASE_STYLES)] | again


def draw_arms(
    axes: Axes, rods: Sequence[Rod], frame: Frame, title: str, *, inside: bool = True, none: str = "no solution"
) -> None:
    """Arms with the directors of their tips on their stage; the words `none` where there are no arms."""
    draw_rods(axes, rods, frame, inside=inside)
    draw_stage(axes, rods, frame, title)
    if not rods:
        say(axes, none)


def draw_stage(axes: Axes, rods: Sequence[Rod], frame: Frame, title: str) -> None:
    """What is around these arms: the clamp, which way current and gravity go, the axes in units of length."""
    for arm in {float(rod.scene.arm.base_angle): rod.scene.arm for rod in rods}.values():
        draw_clamp(axes, arm, frame.factor)
    if rods:
        draw_surroundings(axes, [rod.scene for rod in rods])
    labels = {"xlabel": f"$x$ [{frame.unit}]", "ylabel": f"$y$ [{frame.unit}]", "title": title}
    axes.set(xlim=frame.x, ylim=frame.y, aspect="equal", anchor="W", **labels)


def draw_rods(axes: Axes, rods: Sequence[Rod], frame: Frame, *, inside: bool = True) -> None:
    """Arms with the directors of their tips, and nothing around them."""
    factor, scale = frame.factor, 1.0 if frame.width > _TIGHT else 0.65
    for rod in rods:
        color, linestyle = rod.style["color"], "-" if inside else rod.style["linestyle"]
        draw_arm(axes, rod.scene, rod.fields, factor, color=color, linestyle=linestyle, inside=inside)
    for rod in rods:
        draw_directors(axes, rod.scene.arm, rod.fields, factor, scale=scale)


def draw_tips(axes: Axes, layout: Layout, what: str) -> None:
    """Draws "height", "theta" or "tilt" of the tip over the colour's values, a line for each case."""
    values, label = layout.axis
    factor, unit = length_unit(float(layout.scene.arm.length))
    name, of = _AT_TIP[what]
    for i, (case, style) in enumerate(zip(layout.cases, CASE_STYLES, strict=False)):
        y = np.asarray(of(case.solution)) * (factor if what == "height" else 1.0)
        axes.plot(values, y, label=case.name, markevery=_markers(len(values), i, len(layout.cases)), **style)
    axes.set(xlabel=label, ylabel=name.format(unit=unit))


def draw_along(axes: Axes, rods: Sequence[Rod], what: str) -> None:
    """Draws "tilt", "beta", "N", "H" or "M" along the undeformed arc length, a line for each rod."""
    name, unit, of = _ALONG[what]
    curves = [np.asarray(of(rod.fields)) for rod in rods]
    finite = np.concatenate([curve[np.isfinite(curve)] for curve in curves] or [np.zeros(0)])
    factor, unit = prefixed(unit, np.abs(finite).max(initial=0.0))
    length, length_name = length_unit(max((float(rod.scene.arm.length) for rod in rods), default=1.0))
    for i, (rod, curve) in enumerate(zip(rods, curves, strict=True)):
        markers = _markers(len(curve), i, len(rods))
        axes.plot(np.asarray(rod.fields.s) * length, curve * factor, markevery=markers, **rod.style)
    if finite.size == 0:
        say(axes, "not defined:\ninfinite stiffness" if rods else "no solution")
    axes.set(xlabel=f"$s$ [{length_name}]", ylabel=f"{name} {bracketed(unit)}")


def _markers(points: int, line: int, lines: int) -> tuple[int, int]:
    """First and step of a line's markers, between those of the others: lines that coincide are then seen to be many."""
    step = max(1, points // 8)
    return line * step // lines, step


def say(axes: Axes, words: str) -> Text:
    """Writes in the middle of the axes why there is nothing to see."""
    return axes.text(
        0.5, 0.5, words, transform=axes.transAxes, horizontalalignment="center", verticalalignment="center"
    )
