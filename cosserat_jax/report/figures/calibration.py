"""The figure of a calibration: data against model, residuals, correlation of the parameters, loss."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ...scene import unit_of
from ...study import Calibration, Measurements
from .style import CURVES, LABELS, LEGEND, WIDTH, printed

_MOST_OBSERVABLES = 6
_LINE_FROM = 30  # rows over time from which the model is a line


@printed
def calibration_figure(found: Calibration) -> Figure:
    """Data against model and their residual for each observable, the correlation of the parameters, and the loss."""
    names = list(found.rms)[:_MOST_OBSERVABLES]
    figure = Figure(figsize=(WIDTH, (len(names) + 1) * (CURVES + LABELS) + LEGEND))
    grid = figure.add_gridspec(len(names) + 1, 2)
    for i, name in enumerate(names):
        _draw_observable(figure.add_subplot(grid[i, 0]), figure.add_subplot(grid[i, 1]), found, name)
    _draw_correlation(figure.add_subplot(grid[-1, 0]), found)
    _draw_loss(figure.add_subplot(grid[-1, 1]), found)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=2)
    return figure


def _draw_observable(axes: Axes, below: Axes, found: Calibration, name: str) -> None:
    """Measured and predicted over what was changed, and beside them the residual."""
    unit = found.units[name]
    for table, said in zip(found.measured, found.predicted, strict=True):
        places = [i for i, observable in enumerate(table.observables) if observable.name == name]
        for i in places:
            across, label = _across(found, table)
            measured, predicted = table.values[:, i], said[:, i]
            error = None if table.sigma is None else table.sigma[:, i]
            axes.errorbar(
                across, measured, error, fmt="o", color="0.5", markersize=2.5, linewidth=0.8, label="measured"
            )
            style = "-" if table.times is not None and len(across) >= _LINE_FROM else "x"
            axes.plot(across, predicted, style, color="tab:red", zorder=3, label="fitted scene")
            below.errorbar(across, predicted - measured, error, fmt="o", color="0.3", markersize=2.5, linewidth=0.8)
            axes.set(xlabel=label, ylabel=f"{name} [{unit}]")
            below.set(xlabel=label, ylabel=f"residual [{unit}]")
    below.axhline(0.0, color="0.7", linewidth=0.8)
    below.ticklabel_format(axis="y", scilimits=(-2, 3))


def _across(found: Calibration, table: Measurements) -> tuple[np.ndarray, str]:
    """What to draw a table over: time, the input that takes the most values, or the number of the row."""
    if table.times is not None:
        return table.times, "time [s]"
    counts = {path: len(np.unique(values)) for path, values in table.inputs.items()}
    if counts and max(counts.values()) > 1:
        path = max(counts, key=lambda path: counts[path])
        return table.inputs[path], f"{path} [{unit_of(found.scene, path)}]"
    return np.arange(1, len(table.values) + 1), "row"


def _draw_correlation(axes: Axes, found: Calibration) -> None:
    axes.imshow(found.correlation, cmap="RdBu_r", vmin=-1, vmax=1)
    names = [path.rpartition(".")[2].replace("_", " ") for path in found.paths]
    axes.set_xticks(range(len(names)), names, rotation=30, ha="right", rotation_mode="anchor")
    axes.set_yticks(range(len(names)), names)
    axes.set_title("correlation of the errors")
    for (i, j), entry in np.ndenumerate(found.correlation):
        dark = abs(entry) > 0.6
        axes.text(j, i, f"{entry:.3f}", ha="center", va="center", fontsize=6, color="w" if dark else "k")


def _draw_loss(axes: Axes, found: Calibration) -> None:
    for history in np.atleast_2d(found.searches.history):
        axes.semilogy(np.arange(1, len(history) + 1), history, color="0.75", linewidth=0.8)
    axes.semilogy(np.arange(1, len(found.history) + 1), found.history, "o-", color="tab:blue", markersize=2.5)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set(xlabel="step", ylabel="loss", xlim=(0.5, max(2.5, len(found.history) + 0.5)))
