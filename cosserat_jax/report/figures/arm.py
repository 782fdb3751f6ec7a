"""Draws one arm as it is: both its surfaces, its centerline, its muscles, the clamp, and the directors of its sections.

surfaces    r +- beta R b               muscle    r + y beta b,   y(s) = side (a + (b - a) s / L_i),   s <= L_i
director    a = (cos theta, sin theta)  tangent   t = r_s = nu a + eta b
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.lines import Line2D
from matplotlib.patches import FancyArrowPatch, Polygon
from matplotlib.transforms import Affine2D, ScaledTranslation

from ...physics.tendon import Tendon
from ...scene import Arm, Muscle, Scene
from ...solver import Fields

INK, PALE = "0.1", "0.4"
CORNER = (1.5, 0.55)  # inches that the arrows of current and gravity take, with their words
_DIRECTOR_LENGTH, _TANGENT_LENGTH = 0.08, 0.12  # of the arm
_LOOKS: dict[str, dict[str, Any]] = {
    "centerline": {"color": INK, "linewidth": 0.5, "linestyle": (0, (7, 2, 1.5, 2))},
    "muscle": {"color": INK, "linewidth": 1.0},
    "slack muscle": {"color": INK, "linewidth": 1.0, "linestyle": (0, (1, 1.2))},
    "director": {"arrowstyle": "-|>,head_width=1.5,head_length=3.5", "color": "black", "linewidth": 0.9},
    "tangent": {
        "arrowstyle": "simple,head_width=7,head_length=7,tail_width=2.6",
        "facecolor": "white",
        "edgecolor": PALE,
        "linewidth": 0.7,
    },
}


def length_unit(length: float) -> tuple[float, str]:
    """The factor from metres and the name of the unit in which an arm of this length [m] is drawn."""
    if length < 0.05:
        return 1e3, "mm"
    return (1e2, "cm") if length < 2 else (1.0, "m")


def surfaces(arm: Arm, fields: Fields) -> tuple[Float[np.ndarray, "points 2"], Float[np.ndarray, "points 2"]]:
    """The arm's two surfaces [m], r + beta R b and r - beta R b, in the deformed state."""
    x, y, theta, beta = (np.asarray(part) for part in (fields.x, fields.y, fields.theta, fields.beta))
    part = np.asarray(fields.s) / float(arm.length)
    half_width = beta * (float(arm.base_radius) * (1 - part) + float(arm.tip_radius) * part)
    return _beside(x, y, theta, half_width), _beside(x, y, theta, -half_width)


def muscle_line(muscle: Muscle, arm: Arm, fields: Fields) -> Float[np.ndarray, "points 2"]:
    """The muscle [m] from the base to its end L_i, which need not be a point at which the fields are held."""
    end = float(arm.length if muscle.end is None else muscle.end)
    held = np.asarray(fields.s)
    s = np.append(held[held < end], end)
    x, y, theta, beta = (np.interp(s, held, part) for part in (fields.x, fields.y, fields.theta, fields.beta))
    offset = np.asarray(Tendon.of(muscle, arm).offset_at(s))
    return _beside(x, y, theta, beta * offset)


def director_and_tangent(fields: Fields, at: int = -1) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """The unit director a and the tangent t = nu a + eta b of the section at point `at`: -1 the tip, 0 the base."""
    theta, nu, eta = (float(part[at]) for part in (fields.theta, fields.nu, fields.eta))
    a, b = np.array([np.cos(theta), np.sin(theta)]), np.array([-np.sin(theta), np.cos(theta)])
    return a, nu * a + eta * b


def extent(scene: Scene, fields: Fields) -> Float[np.ndarray, "points 2"]:
    """Points [m] that enclose all that is drawn of an arm: its surfaces, the arrows at its tip, and its clamp."""
    _, t = director_and_tangent(fields)
    tip = np.array([[fields.x[-1], fields.y[-1]]], float)
    arrow = tip + _TANGENT_LENGTH * float(scene.arm.length) * t / np.linalg.norm(t)
    return np.concatenate([*surfaces(scene.arm, fields), arrow, _wall(scene.arm)])


def draw_arm(
    axes: Axes, scene: Scene, fields: Fields, factor: float, *, color: Any, linestyle: Any = "-", inside: bool = True
) -> None:
    """Draws the arm of `scene` in its equilibrium `fields`, lengths times `factor`, above what is drawn already.

    Every muscle of `scene` has its tension, whatever it was found from; see `study.with_tensions`.
    `color` and `linestyle` are those of the outline. `inside` draws centerline and muscles too, on a ground that covers
    the arms below; without it the arm is glass. A dot ends each muscle; a slack one is dotted.
    """
    upper, lower = surfaces(scene.arm, fields)
    outline = np.concatenate([upper, lower[::-1]]) * factor
    above: dict[str, Any] = {"zorder": 2 + 1e-3 * len(axes.patches)}
    # mixed with white, not transparent: where many arms lie on each other, transparent ones add up to mud
    ground = (*(0.65 + 0.35 * np.array(to_rgb(color))), 0.9) if inside else (*to_rgb(color), 0.08)
    look = {"facecolor": ground, "edgecolor": color, "linewidth": 0.9, "linestyle": linestyle}
    axes.add_patch(Polygon(outline, gid="outline", **look, **above))
    if not inside:
        return
    x, y = np.asarray(fields.x) * factor, np.asarray(fields.y) * factor
    axes.plot(x, y, gid="centerline", **_LOOKS["centerline"], **above)
    for muscle in scene.muscles:
        line = muscle_line(muscle, scene.arm, fields) * factor
        axes.plot(*line.T, gid="muscle", **_LOOKS[_state(muscle)], **above)
        axes.plot(*line[-1], gid="muscle end", color=INK, marker="o", markersize=2.2, **above)


def draw_clamp(axes: Axes, arm: Arm, factor: float) -> None:
    """Draws the wall in which the base is clamped, square to the direction `base_angle`."""
    wall = _wall(arm) * factor
    axes.add_patch(Polygon(wall, gid="clamp", facecolor="none", edgecolor=PALE, hatch="/////", linewidth=0))
    axes.plot(*wall[:2].T, gid="clamp", color=INK, linewidth=1.5, solid_capstyle="butt")


def draw_directors(axes: Axes, arm: Arm, fields: Fields, factor: float, *, at: int = -1, scale: float = 1.0) -> None:
    """Draws, as arrows from the centerline at point `at`, the tangent t and over it the shorter, thin director a.

    `scale` is that of their heads; a small panel wants small ones.
    """
    start = np.array([fields.x[at], fields.y[at]], float) * factor
    length = float(arm.length) * factor
    a, t = director_and_tangent(fields, at)
    arrows = {"tangent": _TANGENT_LENGTH * length * t / np.linalg.norm(t), "director": _DIRECTOR_LENGTH * length * a}
    for name, arrow in arrows.items():
        ends = {"posA": start, "posB": start + arrow, "shrinkA": 0, "shrinkB": 0}
        above: dict[str, Any] = {"zorder": 3 + 1e-3 * len(axes.patches), "mutation_scale": scale}
        axes.add_patch(FancyArrowPatch(gid=name, **ends, **_LOOKS[name], **above))


def draw_surroundings(axes: Axes, scenes: Sequence[Scene]) -> None:
    """Draws which way the current goes and gravity pulls, in the upper left `CORNER` of the axes, which must be free.

    Where the current differs between the scenes its arrow shows the sign alone, e1 where there are both.
    """
    # points from the corner, so that arrows keep their size whatever the scale of the axes
    place: Any = axes.transAxes
    corner = Affine2D().scale(1 / 72) + axes.figure.dpi_scale_trans + ScaledTranslation(0, 1, place)
    words: dict[str, Any] = {"transform": corner, "verticalalignment": "center_baseline", "fontsize": 7}
    speeds = {float(scene.water.velocity) for scene in scenes if scene.water is not None}
    pulls = {float(scene.gravity.acceleration) for scene in scenes if scene.gravity is not None}
    if speeds - {0.0}:
        ends = [(5.0, -8.0), (27.0, -8.0)]
        _arrow(axes, corner, ends if max(speeds) > 0 else ends[::-1], "current")
        axes.text(31, -8, _current(speeds), **words)
    else:
        axes.text(5, -8, "still water" if speeds else "in air", **words)
    if pulls - {0.0}:
        ends = [(10.0, -15.0), (10.0, -33.0)]
        _arrow(axes, corner, ends if max(pulls) > 0 else ends[::-1], "gravity")
        axes.text(15, -24, "gravity", **words)


def _current(speeds: set[float]) -> str:
    if len(speeds) == 1:
        return f"current {abs(min(speeds)):.4g} m/s"
    return "current" if min(speeds) * max(speeds) >= 0 else "positive current"


def _arrow(axes: Axes, transform: Any, ends: Sequence[tuple[float, float]], name: str) -> None:
    look: dict[str, Any] = {"arrowstyle": "-|>,head_width=2.2,head_length=4.5", "color": INK, "linewidth": 1.2}
    look |= {"mutation_scale": 1, "shrinkA": 0, "shrinkB": 0, "transform": transform}
    axes.add_patch(FancyArrowPatch(*ends, gid=name, **look))


def legend_handles(scenes: Sequence[Scene]) -> list[Line2D]:
    """What the arrows at a tip mean, and the lines inside the arms of these scenes, for a legend."""
    states = {_state(muscle) for scene in scenes for muscle in scene.muscles}
    shown = [name for name in ("muscle", "slack muscle") if name in states]
    lines = [Line2D([], [], label=name, **_LOOKS[name]) for name in (["centerline", *shown] if scenes else [])]
    head: dict[str, Any] = {"marker": ">", "markevery": [1], "markersize": 5}
    a = Line2D([0, 1], [0, 0], label="director a(L)", color="black", linewidth=0.9, markerfacecolor="black", **head)
    t = Line2D([0, 1], [0, 0], label="tangent t(L)", color=PALE, linewidth=2, markerfacecolor="white", **head)
    return [*lines, a, t]


def _state(muscle: Muscle) -> str:
    assert muscle.tension is not None, "a scene is drawn with the tensions of its solution"
    return "muscle" if float(muscle.tension) > 0 else "slack muscle"


def _wall(arm: Arm) -> Float[np.ndarray, "4 2"]:
    """The corners [m] of the wall at the base, those of its face first."""
    depth = 0.02 * float(arm.length)
    half = max(1.6 * float(arm.base_radius), 2 * depth)
    along = np.array([np.cos(arm.base_angle), np.sin(arm.base_angle)])
    face = half * np.array([[-along[1], along[0]], [along[1], -along[0]]])
    return np.concatenate([face, face[::-1] - depth * along])


def _beside(x: np.ndarray, y: np.ndarray, theta: np.ndarray, distance: np.ndarray) -> Float[np.ndarray, "points 2"]:
    """r + distance b."""
    return np.stack([x - distance * np.sin(theta), y + distance * np.cos(theta)], axis=-1)
