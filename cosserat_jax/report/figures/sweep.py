"""Figures of sweeps and of single solves, ready to print: lengths and loads with units, arms at equal aspect.

Every function returns a `matplotlib.figure.Figure` that belongs to no window; `figure.savefig(path)` writes it. In a
figure of a sweep one swept path is the colour, the first that is a muscle's tension or else the longest; the values of
the others are cases, each a panel or a line style, a few of them at most. A rod without a solution is left out and
counted in a note.
"""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ...scene import Scene
from ...solver import Solution
from ...study import with_tensions
from .arm import draw_directors
from .layout import Case, Layout
from .panels import CASE_STYLES, TALL, Frame, Rod, case_style, draw_along, draw_arms, draw_tips
from .style import CURVES, HALF, LABELS, LEGEND, WIDE, WIDTH, explain, footer, printed

if TYPE_CHECKING:
    from ...study import Sweep


@printed
def sweep_figure(swept: "Sweep") -> Figure:
    """A sweep on one page: its arms, a panel for each case, all cases at the colour's largest value, and the tips."""
    layout = Layout.of(swept)
    if len(layout.cases) == 1:
        return _single_case(layout)
    arms = [_coloured(layout, case, most=6) for case in layout.cases]
    frame = Frame.around(_flat(arms), HALF)
    count = len(arms) + 2 + len(arms) % 2  # the tip's height, and where a place is left in the last row also its angle
    row = frame.height + LABELS
    heights = [row] * (count // 2 - 1) + [max(row, CURVES + LABELS)]
    figure = Figure(figsize=(WIDTH, sum(heights) + LEGEND + _footer_height(layout)))
    grid = figure.add_gridspec(len(heights), 2, height_ratios=heights)
    panels = [figure.add_subplot(grid[i // 2, i % 2]) for i in range(count)]
    coloured, compared, curves = panels[: len(arms)], panels[len(arms)], panels[len(arms) + 1 :]
    _draw_cases(coloured, layout, arms, frame)
    draw_arms(compared, _at_largest(layout), frame, layout.largest, inside=False)
    for axes, what in zip(curves, ("height", "theta"), strict=False):
        draw_tips(axes, layout, what)
    _colour_bar(figure, layout, coloured)
    explain(figure, _flat(arms))
    footer(figure, list(curves[0].lines), layout.note)
    return figure


def _single_case(layout: Layout) -> Figure:
    """A sweep without other cases: the arms above the curves, or beside them where the arms need the height."""
    arms = _coloured(layout, layout.cases[0])
    frame = Frame.around(arms, WIDE)
    if frame.height < TALL:
        figure = Figure(figsize=(WIDTH, frame.height + CURVES + 2 * LABELS + LEGEND))
        grid = figure.add_gridspec(2, 2, height_ratios=(frame.height + LABELS, CURVES + LABELS))
        places = grid[0, :], grid[1, 0], grid[1, 1]
    else:
        frame = Frame.around(arms, WIDTH / 2)
        figure = Figure(figsize=(WIDTH, max(frame.height, TALL) + LABELS + LEGEND))
        grid = figure.add_gridspec(2, 2, width_ratios=(1.7, 1))
        places = grid[:, 0], grid[0, 1], grid[1, 1]
    panels = [figure.add_subplot(place) for place in places]
    draw_arms(panels[0], arms, frame, layout.cases[0].name)
    draw_tips(panels[1], layout, "height")
    draw_tips(panels[2], layout, "theta")
    _colour_bar(figure, layout, panels[:1])
    explain(figure, arms)
    footer(figure, [], layout.note)
    return figure


@printed
def solve_figure(scenes: Mapping[str, Scene], solutions: Mapping[str, Solution]) -> Figure:
    """Single solves by name: a panel of its arm for each, and all of their N, H, M and beta along s."""
    names = [name for name in scenes if bool(solutions[name].converged)]
    rods = []
    for i, name in enumerate(names):
        drawn = with_tensions(scenes[name], dict(enumerate(solutions[name].tensions)))
        rods.append(Rod(drawn, solutions[name].fields, case_style(i) | {"label": name}))
    columns = 1 if len(rods) == 1 else 2
    frames = [Frame.around([rod], WIDE if columns == 1 else HALF) for rod in rods]
    heights = [max(frame.height for frame in frames[i : i + columns]) + LABELS for i in range(0, len(rods), columns)]
    first = len(heights)
    heights += [CURVES + LABELS] * 2
    figure = Figure(figsize=(WIDTH, sum(heights) + LEGEND * 2))
    grid = figure.add_gridspec(len(heights), 2, height_ratios=heights)
    for i, (rod, frame) in enumerate(zip(rods, frames, strict=True)):
        axes = figure.add_subplot(grid[i // 2, i % 2] if columns == 2 else grid[0, :])
        draw_arms(axes, [rod], frame, rod.style["label"])
        draw_directors(axes, rod.scene.arm, rod.fields, frame.factor, at=0, scale=0.65)
    curves = [figure.add_subplot(grid[first + i // 2, i % 2]) for i in range(4)]
    for axes, what in zip(curves, ("N", "H", "M", "beta"), strict=True):
        draw_along(axes, rods, what)
    failed = [name for name in scenes if name not in names]
    note = f"no solution, left out: {', '.join(failed)} ({len(failed)} of {len(scenes)})" if failed else ""
    explain(figure, rods)
    footer(figure, list(curves[0].lines) if columns == 2 else [], note)
    return figure


@printed
def arms_over_tension(swept: "Sweep") -> Figure:
    """The arms of a sweep over its colour, a panel for each case below the other, directors at every tip."""
    layout = Layout.of(swept)
    arms = [_coloured(layout, case) for case in layout.cases]
    frame = Frame.around(_flat(arms), WIDE)
    figure = Figure(figsize=(WIDTH, len(arms) * (frame.height + LABELS) + LEGEND))
    panels = list(figure.subplots(len(arms), 1, squeeze=False)[:, 0])
    _draw_cases(panels, layout, arms, frame)
    _colour_bar(figure, layout, panels)
    explain(figure, _flat(arms))
    footer(figure, [], layout.note)
    return figure


@printed
def velocities_compared(swept: "Sweep") -> Figure:
    """The cases of a sweep on each other at the largest value of its colour, the heights of their tips named."""
    layout = Layout.of(swept)
    rods = _at_largest(layout)
    frame = Frame.around(rods, WIDTH - 0.7)
    figure = Figure(figsize=(WIDTH, frame.height + LABELS + LEGEND + _footer_height(layout)))
    draw_arms(figure.add_subplot(), rods, frame, layout.largest, inside=False)
    handles = []
    for rod in rods:
        height = f"tip at {float(rod.fields.y[-1]) * frame.factor:.2f} {frame.unit}"
        label = ": ".join(filter(None, (rod.style["label"], height)))
        handles.append(Line2D([], [], color=rod.style["color"], linestyle=rod.style["linestyle"], label=label))
    explain(figure, [])
    footer(figure, handles, layout.note)
    return figure


@printed
def tip_angles(swept: "Sweep") -> Figure:
    """Tilt alpha - theta and angle theta of the tip's section over the colour's values, a line for each case."""
    layout = Layout.of(swept)
    figure = Figure(figsize=(WIDTH, CURVES + 2 * LABELS + _footer_height(layout)))
    panels = list(figure.subplots(1, 2))
    for axes, what in zip(panels, ("tilt", "theta"), strict=True):
        draw_tips(axes, layout, what)
    footer(figure, list(panels[0].lines) if len(layout.cases) > 1 else [], layout.note)
    return figure


@printed
def tilt_and_stretch_along(swept: "Sweep", case: int = 0) -> Figure:
    """Tilt atan2(eta, nu) and cross-section scale beta along the rod for some values of the colour, in one case."""
    return _curves_along(Layout.of(swept), case, ("tilt", "beta"))


@printed
def tractions_along(swept: "Sweep", case: int = 0) -> Figure:
    """The paper's tractions N and H and bending moment M along the rod for some values of the colour, in one case."""
    return _curves_along(Layout.of(swept), case, ("N", "H", "M"))


def _curves_along(layout: Layout, case: int, names: Sequence[str]) -> Figure:
    rods = _coloured(layout, layout.cases[case])
    figure = Figure(figsize=(WIDTH, CURVES + 2 * LABELS))
    panels = list(figure.subplots(1, len(names)))
    for axes, what in zip(panels, names, strict=True):
        draw_along(axes, rods, what)
    panels[0].set_title(layout.cases[case].name)
    _colour_bar(figure, layout, panels)
    footer(figure, [], layout.note)
    return figure


def _coloured(layout: Layout, case: Case, most: int = 9) -> list[Rod]:
    """Some rods of a case, each in the colour of its value."""
    return [Rod(scene, fields, {"color": layout.color(value)}) for scene, fields, value in layout.rods(case, most)]


def _at_largest(layout: Layout) -> list[Rod]:
    """The rod of each case at the colour's largest value, in the style of the case."""
    last = len(layout.values) - 1
    styled = zip(layout.cases, CASE_STYLES, strict=False)
    return [
        Rod(*layout.rod(case, last), style | {"label": case.name}) for case, style in styled if case.converged[last]
    ]


def _draw_cases(panels: Sequence[Axes], layout: Layout, arms: Sequence[Sequence[Rod]], frame: Frame) -> None:
    for axes, rods, case in zip(panels, arms, layout.cases, strict=True):
        draw_arms(axes, rods, frame, case.name)


def _colour_bar(figure: Figure, layout: Layout, coloured: Sequence[Axes]) -> None:
    if len(layout.values) > 1:
        figure.colorbar(layout.bar, ax=list(coloured), label=layout.axis[1], aspect=35, pad=0.02, panchor=False)


def _footer_height(layout: Layout) -> float:
    rows = (len(layout.cases) + 1) // 2 * (1 + layout.cases[0].name.count("\n"))
    return 0.14 * (rows + bool(layout.note)) + 0.1


def _flat(rods: Sequence[Sequence[Rod]]) -> list[Rod]:
    return [rod for some in rods for rod in some]
