"""An arm that TCAMs drive, over time: one page to print, and the same page with the arm moving."""

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import matplotlib
import numpy as np
from jaxtyping import Bool
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ...solver import ResponseOutcome
from ...study import with_tensions
from ..output_files import written_whole
from .animation import PIXELS, Picture, Playback, animation_suffixes, write_movie
from .layout import COLOURS, spread
from .panels import Frame, Rod, case_style, draw_arms, draw_rods, draw_stage, say
from .style import CURVES, LABELS, LEGEND, STYLE, WIDE, WIDTH, explain, footer, printed
from .time_series import draw_over_time, limit_words, muscle_name, peak_words, time_unit

if TYPE_CHECKING:
    from ...study import Actuation

__all__ = ["actuation_figure", "animation_suffixes", "rod_at", "save_animation"]

_ARMS = 6  # drawn at most on one page
_TALLEST = 4.6  # inches, of arms above the curves; taller ones stand beside them


@printed
def actuation_figure(actuation: "Actuation") -> Figure:
    """Voltage, temperature and tension of every driven muscle over time, and the arm at some of the instants.

    The arms are coloured by time, and dots in their colours lie on the curves of tension. Instants without equilibrium
    are left out and counted in a note; what went wrong with a muscle is noted too.
    """
    instants = spread(np.flatnonzero(_converged(actuation)), _ARMS)
    clock, seconds = time_unit(actuation)
    times = np.asarray(actuation.times) * clock
    bar = ScalarMappable(Normalize(times[0], times[-1]), COLOURS)
    rods = [rod_at(actuation, i, bar.to_rgba(times[i])) for i in instants]
    figure, frame, (arms, *panels) = _page(actuation, rods, WIDE)
    draw_arms(arms, rods, frame, "", none="no equilibrium")
    if times[-1] > times[0]:
        beside = arms.inset_axes((1.02, 0.0, 0.12 / frame.width, 1.0), gid="bar")
        figure.colorbar(bar, cax=beside, label=f"time [{seconds}]")
    dots = {"s": 14, "c": [rod.style["color"] for rod in rods], "edgecolors": "black", "linewidths": 0.5, "zorder": 3}
    for line in _curves(panels[-1:]):
        panels[-1].scatter(times[instants], _height(line, times[instants]), gid="instant", **dots)
    _hold_ticks(figure, arms)
    return figure


def save_animation(actuation: "Actuation", place: Path) -> None:
    """Writes to `place`, a .gif or .mp4, whole or not at all, the arm moving and the time on the curves moving with it.

    In real time where the motion lasts 2 s to 15 s, else slowed down or sped up to that, which the title says. An
    instant without equilibrium says so in place of the arm. Raises `InputError` if the file cannot be written.
    """
    playback = Playback.of(np.asarray(actuation.times))
    with written_whole(place) as beside, matplotlib.rc_context(STYLE):
        pictures = _pictures(actuation, playback)
        write_movie(next(pictures), pictures, playback.interval, place.suffix.lower(), beside)


def rod_at(actuation: "Actuation", instant: int, color: Any) -> Rod:
    """The arm at one of the instants, each muscle with the tension that it has then."""
    fields, found = jax.tree.map(lambda leaf: leaf[instant], (actuation.solution.fields, actuation.solution.tensions))
    tensions = dict(enumerate(found)) | {i: driven.tension[instant] for i, driven in actuation.responses.items()}
    tensions = {i: np.nan_to_num(tension) for i, tension in tensions.items()}
    return Rod(with_tensions(actuation.scene, tensions), fields, {"color": color})


def _page(actuation: "Actuation", rods: Sequence[Rod], width: float) -> tuple[Figure, Frame, list[Axes]]:
    """The page with its curves, and the empty axes for these arms, which come first.

    The arms stand above the curves, `width` inches wide, or beside them where they need the height.
    """
    frame = Frame.around(rods, width, 10 * width)
    notes, handles = _notes(actuation), _handles(actuation)
    below = 0.14 * (len(notes) + (len(handles) + 1) // 2) + 0.1
    if frame.height < _TALLEST:
        figure = Figure(figsize=(WIDTH, frame.height + CURVES + 2 * LABELS + LEGEND + below))
        grid = figure.add_gridspec(2, 3, height_ratios=(frame.height + LABELS, CURVES + LABELS))
        places = grid[0, :], *(grid[1, i] for i in range(3))
    else:
        frame = Frame.around(rods, WIDTH / 2, _TALLEST)
        figure = Figure(figsize=(WIDTH, _TALLEST + LABELS + LEGEND + below))
        arms_width = min(_TALLEST * np.ptp(frame.x) / np.ptp(frame.y), WIDTH / 2) + 2 * LABELS
        grid = figure.add_gridspec(3, 2, width_ratios=(arms_width, WIDTH - arms_width))
        places = grid[:, 0], *(grid[i, 1] for i in range(3))
    arms, *panels = [figure.add_subplot(place) for place in places]
    for axes, what in zip(panels, ("voltage", "temperature", "tension"), strict=True):
        draw_over_time(axes, actuation, what)
    explain(figure, rods)
    footer(figure, handles, "\n".join(notes))
    return figure, frame, [arms, *panels]


def _hold_ticks(figure: Figure, axes: Axes) -> None:
    """Keeps the ticks of axes at equal aspect: the layout would count them at a height that it then takes away."""
    figure.draw_without_rendering()
    low, high = axes.get_ylim()
    axes.set_yticks([tick for tick in axes.get_yticks() if low <= tick <= high])


def _pictures(actuation: "Actuation", playback: Playback) -> Iterator[Picture]:
    """First a picture that has all the colours, then every frame. `STYLE` must be set while they are drawn.

    What does not move is drawn once.
    """
    solution, responses = jax.tree.map(np.asarray, (actuation.solution, actuation.responses))  # quick to index
    actuation = dataclasses.replace(actuation, solution=solution, responses=responses)
    instants, converged = playback.instants.tolist(), _converged(actuation)
    rods = {i: rod_at(actuation, i, COLOURS(0.55)) for i in set(instants) if converged[i]}
    figure, frame, (arms, *panels) = _page(actuation, list(rods.values()), WIDTH - LABELS)
    draw_stage(arms, list(rods.values())[:1], frame, " ")
    figure.set_dpi(PIXELS)
    canvas = FigureCanvasAgg(figure)
    _hold_ticks(figure, arms)
    canvas.draw()
    background = canvas.copy_from_bbox(figure.bbox)

    clock, seconds = time_unit(actuation)
    for axes in panels:
        axes.autoscale(False)
    still = set(arms.get_children())
    for i in [next(iter(rods), 0), *instants]:
        now = float(actuation.times[i]) * clock
        title = arms.set_title(", ".join(filter(None, (f"t = {now:.2f} {seconds}", playback.words))))
        if i in rods:
            draw_rods(arms, [rods[i]], frame)
        else:
            say(arms, "no equilibrium")
        moving = [artist for artist in arms.get_children() if artist not in still]
        marks = [mark for axes in panels for mark in _time_marks(axes, now)]
        canvas.restore_region(background)
        for artist in [title, *sorted(moving, key=lambda artist: artist.zorder), *marks]:
            arms.draw_artist(artist)
        for artist in [*moving, *marks]:
            artist.remove()
        yield np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _time_marks(axes: Axes, now: float) -> list[Line2D]:
    """A line at this time, and a dot on every curve there."""
    look: dict[str, Any] = {"marker": "o", "markersize": 4.5, "markeredgecolor": "white", "clip_on": False}
    dots = [axes.plot(now, _height(curve, now), color=curve.get_color(), **look)[0] for curve in _curves([axes])]
    return [axes.axvline(now, color="0.6", linewidth=0.8), *dots]


def _curves(panels: Sequence[Axes]) -> list[Line2D]:
    return [line for axes in panels for line in axes.lines if line.get_gid() in ("voltage", "temperature", "tension")]


def _height(curve: Line2D, at: Any) -> Any:
    """The curve at these times."""
    times, values = np.asarray(curve.get_xydata()).T
    return np.interp(at, times, values)


def _converged(actuation: "Actuation") -> Bool[np.ndarray, " times"]:
    return np.asarray(actuation.solution.converged)


def _handles(actuation: "Actuation") -> list[Line2D]:
    """Which line is which muscle, with its peak; none for one muscle alone, whose peak is told beside it."""
    if len(actuation.responses) == 1:
        return []
    words = {
        i: f"{muscle_name(i)}: {peak_words(actuation, i)}, {limit_words(actuation, i)}" for i in actuation.responses
    }
    return [Line2D([], [], label=label, **case_style(line)) for line, label in enumerate(words.values())]


def _notes(actuation: "Actuation") -> list[str]:
    failed = int(np.sum(~_converged(actuation)))
    notes = [f"{failed} of {len(actuation.times)} instants have no equilibrium: no arm is drawn"] if failed else []
    for i, response in actuation.responses.items():
        if response.outcome != ResponseOutcome.followed:
            what, _, _ = ResponseOutcome[response.outcome].partition("; ")
            notes.append(f"{muscle_name(i)}: {what}")
    return notes
