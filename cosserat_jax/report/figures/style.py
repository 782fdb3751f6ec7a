"""The page that all figures share: its size and style, and what stands above and below the panels."""

import functools as ft
from collections.abc import Callable, Sequence
from typing import Any

import matplotlib
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from .arm import legend_handles
from .panels import Rod

WIDTH = 7.2  # inches, two columns of a journal
WIDE, HALF = WIDTH - 1.4, WIDTH / 2 - 0.9  # of it, a panel across the page and one of two, without their labels
LABELS, LEGEND, CURVES = 0.65, 0.3, 1.6  # inches: title and labels of a panel, the legend, a panel of curves
STYLE: Any = {
    "figure.constrained_layout.use": True,
    "figure.dpi": 200,
    "font.size": 8,
    "axes.titlesize": 8,
    "axes.titlelocation": "left",
    "axes.labelsize": 8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "legend.fontsize": 7,
    "legend.frameon": False,
    "lines.linewidth": 1.2,
    "lines.markersize": 3.5,
    "hatch.linewidth": 0.5,
}


def printed(draw: Callable[..., Figure]) -> Callable[..., Figure]:
    """The figure that `draw` makes, in the style of all figures."""

    @ft.wraps(draw)
    def styled(*args: Any, **kwargs: Any) -> Figure:
        with matplotlib.rc_context(STYLE):
            figure = draw(*args, **kwargs)
            figure.draw_without_rendering()  # ticks take their style when they are first drawn: here, not at savefig
        return figure

    return styled


def explain(figure: Figure, rods: Sequence[Rod]) -> None:
    """Above the panels, what the lines and arrows of the arms mean."""
    figure.legend(handles=legend_handles([rod.scene for rod in rods]), loc="outside upper center", ncols=5)


def footer(figure: Figure, handles: Sequence[Line2D], note: str) -> None:
    """Below the panels, the note and which line is which case."""
    if handles:
        title = {"title": note, "title_fontsize": 7} if note else {}
        figure.legend(handles=handles, loc="outside lower center", ncols=2, handlelength=3, **title)
    elif note:
        figure.supxlabel(note, fontsize=7)
