"""Where an arm can be brought, and how it gets to targets, on one page."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import jax
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ...scene import Scene
from .arm import INK, PALE, draw_clamp, draw_surroundings, length_unit
from .layout import COLOURS, spread
from .panels import Frame, Rod, draw_rods, draw_stage, say
from .style import CURVES, LABELS, LEGEND, WIDE, WIDTH, explain, footer, printed

if TYPE_CHECKING:
    from ...study import Reach, Workspace

_ARMS = 6  # drawn at most on one page
_MISSED = "#d55e00"
_REACHED: dict[str, Any] = {"marker": "o", "markersize": 6, "markerfacecolor": "none", "markeredgecolor": INK}
_OUT: dict[str, Any] = {"marker": "X", "markersize": 6, "markerfacecolor": _MISSED, "markeredgecolor": "white"}
_CLOUD = "0.72"


@printed
def reach_figure(found: "Reach") -> Figure:
    """The workspace, the arms that come to the targets, or closest to them, and the values that it takes.

    A target that was reached is a ring, one that was not a cross, joined to the nearest point of the arm. Of many
    targets all are marked and some of the arms drawn, the values of these arms as bars below.
    """
    found = _batched(found)
    there = np.isfinite(found.distance)
    chosen = spread(np.flatnonzero(there), _ARMS)
    rods = [_rod(found, i, _colour(k, len(chosen))) for k, i in enumerate(chosen.tolist())]
    space = found.workspace
    marked = np.concatenate([space.points[space.converged].reshape(-1, 2), found.target.reshape(-1, 2)])
    frame = Frame.around(rods, WIDE, WIDE, marked)
    figure = Figure(figsize=(WIDTH, frame.height + CURVES + 2 * LABELS + 2 * LEGEND))
    grid = figure.add_gridspec(2, 1, height_ratios=(frame.height + LABELS, CURVES + LABELS))
    arms, values = figure.add_subplot(grid[0, 0]), figure.add_subplot(grid[1, 0])
    _draw_cloud(arms, space, frame.factor)
    draw_rods(arms, rods, frame)
    draw_stage(arms, rods, frame, "")
    if not rods:
        say(arms, "no equilibrium")
    for i in range(len(found.target)):
        _draw_target(arms, found, i, frame.factor)
    _draw_values(values, found, chosen.tolist())
    explain(figure, rods)
    missing = f"{np.sum(~there)} of {there.size} targets have no arm" if not there.all() else ""
    drawn = f"{len(chosen)} of {there.sum()} arms are drawn" if len(chosen) < there.sum() else ""
    footer(figure, _handles(found), "; ".join(filter(None, (missing, drawn))))
    return figure


@printed
def workspace_figure(spaces: "dict[str, Workspace]") -> Figure:
    """Where the points of arms can be brought, a panel for each workspace, by name, all to one scale."""
    points = {name: space.points[space.converged].reshape(-1, 2) for name, space in spaces.items()}
    arms = [space.scene.arm for space in spaces.values()]
    factor, unit = length_unit(max(float(arm.length) for arm in arms))
    every = np.concatenate([np.zeros((1, 2)), *points.values()]) * factor
    low, high = every.min(axis=0), every.max(axis=0)
    margin = 0.08 * (high - low).max()
    width = (WIDTH - 0.6) / len(spaces) - 0.5
    height = min(width * (high[1] - low[1] + 2 * margin) / (high[0] - low[0] + 2 * margin), WIDE)
    figure = Figure(figsize=(WIDTH, height + 2 * LABELS))
    panels: Sequence[Axes] = figure.subplots(1, len(spaces), squeeze=False, sharey=True)[0]
    for axes, (name, space) in zip(panels, spaces.items(), strict=True):
        _draw_cloud(axes, space, factor, INK)
        draw_clamp(axes, space.scene.arm, factor)
        axes.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin))
        axes.set(aspect="equal", title=name, xlabel=f"$x$ [{unit}]")
    panels[0].set_ylabel(f"$y$ [{unit}]")
    draw_surroundings(panels[0], [spaces[name].scene for name in list(spaces)[:1]])
    return figure


def _batched(found: "Reach") -> "Reach":
    return found if np.ndim(found.distance) else found.as_batch


def _colour(k: int, count: int) -> Any:
    return COLOURS(0.35 if count == 1 else k / (count - 1))


def _rod(found: "Reach", i: int, color: Any) -> Rod:
    scene: Scene = found.scene_at(i)
    return Rod(scene, jax.tree.map(lambda leaf: leaf[i], found.solution.fields), {"color": color})


def _draw_cloud(axes: Axes, space: "Workspace", factor: float, color: str = _CLOUD) -> None:
    """The points over the grid: of two parameters the mesh that the grid becomes, else dots."""
    for j in range(space.at.size):
        points = space.points[:, j] * factor
        if space.shape is not None and len(space.shape) == 2:
            mesh = points.reshape(*space.shape, 2)
            lines = [*mesh, *np.swapaxes(mesh, 0, 1)]
            axes.add_collection(LineCollection(lines, colors=color, linewidths=0.4, zorder=0.5, gid="workspace"))
        else:
            look: dict[str, Any] = {"color": color, "linestyle": "", "marker": ".", "markersize": 2.5, "zorder": 0.5}
            axes.plot(*points.T, gid="workspace", **look)


def _draw_target(axes: Axes, found: "Reach", i: int, factor: float) -> None:
    target = found.target[i].reshape(-1, 2) * factor
    points = found.points[i].reshape(-1, 2) * factor
    reached = bool(found.reached[i])
    if not reached and np.isfinite(points).all():
        for ends in zip(target, points, strict=True):
            axes.plot(*np.array(ends).T, color=_MISSED, linewidth=0.9, linestyle=(0, (2, 1.5)), zorder=6, gid="missed")
        axes.plot(*points.T, color=_MISSED, linestyle="", marker=".", markersize=4, zorder=6)
    look = _REACHED if reached else _OUT
    axes.plot(*target.T, linestyle="", zorder=7, gid="target", **look)


def _draw_values(axes: Axes, found: "Reach", chosen: Sequence[int]) -> None:
    """The values of the drawn arms as parts of their bounds, a group of bars for each parameter."""
    width = 0.8 / max(len(chosen), 1)
    for k, i in enumerate(chosen):
        shares = [_share(one, float(found.values[one.path][i])) for one in found.free]
        places = np.arange(len(shares)) + (k - (len(chosen) - 1) / 2) * width
        look: dict[str, Any] = {"color": _colour(k, len(chosen)), "edgecolor": "white", "linewidth": 0.5}
        axes.bar(places, shares, width, gid="value", **look)
    labels = [f"{one.path}\n{one.lower:.4g} to {one.upper:.4g} {one.unit}".removesuffix(" 1") for one in found.free]
    axes.set_xticks(range(len(labels)), labels)
    axes.axhline(100, color=PALE, linewidth=0.6, linestyle=(0, (5, 2)))
    axes.set(ylim=(0, 105), xlim=(-0.6, len(labels) - 0.4), ylabel="of its range [%]")


def _share(one: Any, value: float) -> float:
    return 100 * (value - one.lower) / (one.upper - one.lower)


def _handles(found: "Reach") -> list[Line2D]:
    missed: dict[str, Any] = _OUT | {"color": _MISSED, "linewidth": 0.9, "linestyle": (0, (2, 1.5))}
    mesh = found.workspace.shape is not None and len(found.workspace.shape) == 2
    cloud: dict[str, Any] = {"linewidth": 0.8} if mesh else {"linestyle": "", "marker": ".", "markersize": 4}
    handles = []
    if found.reached.any():
        handles.append(Line2D([], [], linestyle="", label="target, reached", **_REACHED))
    if not found.reached.all():
        handles.append(Line2D([], [], label="target, not reached, and the nearest point", **missed))
    handles.append(Line2D([], [], color=_CLOUD, label="workspace, a grid of the bounds", **cloud))
    return handles
