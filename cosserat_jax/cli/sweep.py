"""`cosserat-jax sweep`."""

import math
import time
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ..errors import InputError
from ..report.output_files import batches_place, save_figure, written_whole
from .common import (
    Command,
    Stopped,
    about,
    data_and_figure,
    pairs,
    plot_option,
    read_changed,
    said_at_once,
    say_written,
    settings_option,
)

if TYPE_CHECKING:
    import numpy as np

    from ..scene import Scene, SceneFile
    from ..study import Sweep

_MOST_RODS = 1_000_000  # some 10 GB of fields


@click.command("sweep", cls=Command)
@click.argument("name", metavar="SCENE")
@click.option(
    "--over", multiple=True, metavar="PATH=RANGE",
    help='Sweep this parameter over "START:STOP:STEP UNIT" or "V1, V2 UNIT"; may be repeated, the first outermost. '
    "Default: the scene's own [sweep].",
)  # fmt: skip
@settings_option
@click.option("--out", metavar="FILE.nc", help="Write netCDF: tip, outcome and fields of every rod.")
@plot_option
@click.option("--batch", metavar="N", type=click.IntRange(min=1), default=256, help="Rods at a time; default: 256.")
@click.option("--resume", is_flag=True, help="Take up where the same command was stopped, to the same bits.")
@click.option("--restart", is_flag=True, help="Start over, and remove what a stopped run of the command kept.")
def sweep_command(
    name: str,
    over: tuple[str, ...],
    settings: tuple[str, ...],
    out: str | None,
    plot: str | None,
    batch: int,
    resume: bool,
    restart: bool,
) -> int:
    """Find the equilibria over every combination of the swept values.

    The exit status is 1 if a rod has no solution; files are written all the same. While a sweep with --out runs, the
    batches done are kept in FILE.nc.partial. A sweep of another scene, range or --batch cannot be resumed from them.

    \b
    Examples:
      cosserat-jax sweep octopus --plot octopus.png
      cosserat-jax sweep octopus --over "muscles.0.tension=0:20:0.5 N" --over "water.velocity=0.2, 0.4 m/s" --out a.nc
      cosserat-jax sweep octopus --over "water.velocity=0:1:0.001 m/s" --batch 100 --out b.nc --resume
    """
    from ..report.text import sweep_summary, sweep_table
    from ..solver import check_steady
    from ..study.checkpoint import holds_batches, remove

    changes = pairs("--set", settings)
    file = read_changed(name, changes)
    with about(file.name):
        check_steady(file.scene)
    grid = _grid(file, pairs("--over", over), changes)
    data, figure = data_and_figure(out, plot)
    kept = None if data is None else batches_place(data)
    if resume and kept is None:
        raise InputError("--resume must come with --out FILE.nc, beside which a stopped sweep is, but comes without")
    if kept is not None and restart and kept.exists():
        remove(kept)
    if kept is not None and not resume and holds_batches(kept):
        raise InputError(
            f"{kept} holds the batches of a stopped sweep; give --resume to go on, or --restart to start over"
        )

    start = time.perf_counter()
    with said_at_once():
        swept = _run(file.scene, grid, batch, kept)
    if data is not None:
        with written_whole(data) as beside:
            swept.to_xarray().to_netcdf(beside, engine="h5netcdf")
    if figure is not None:
        from ..report.figures import sweep_figure

        save_figure(sweep_figure(swept), figure)
    if kept is not None and kept.exists():
        remove(kept)
    if data is None and figure is None:
        click.echo(sweep_table(swept))
    click.echo(sweep_summary(file.name, swept, time.perf_counter() - start))
    say_written(data, figure)
    return 0 if bool(swept.solution.converged.all()) else 1


def _run(scene: "Scene", grid: "dict[str, np.ndarray]", batch: int, kept: Path | None) -> "Sweep":
    """The sweep, with its batches in the folder `kept` where there is more than one to keep."""
    from ..study import sweep

    rods = math.prod(len(values) for values in grid.values())
    checkpoint = kept if kept is not None and (rods > batch or kept.exists()) else None
    try:
        return sweep(scene, grid, batch=batch, progress=True, checkpoint=checkpoint)
    except KeyboardInterrupt:
        if checkpoint is None:
            raise Stopped("stopped; nothing was written") from None
        kept_there = f"the batches done are in {checkpoint}"
        raise Stopped(f"stopped; {kept_there}, and the same command with --resume continues") from None


def _grid(file: "SceneFile", over: dict[str, str], changes: dict[str, str]) -> "dict[str, np.ndarray]":
    """The values to sweep over, with every rod of the grid checked."""
    import numpy as np

    from ..scene import replace, sweep_values

    with about(f"{file.name}: {'--over' if over else '[sweep]'}"):
        grid = {path: sweep_values(file.scene, path, text) for path, text in over.items()} if over else file.sweep
        if not grid:
            raise InputError("must name what to sweep, but does not; give --over PATH=RANGE, or [sweep] in the scene")
        if both := [path for path in grid if path in changes]:
            raise InputError(f"{both[0]} must be swept or set, but is swept and set to {changes[both[0]]!r} by --set")
        if (rods := math.prod(len(values) for values in grid.values())) > _MOST_RODS:
            raise InputError(f"{' x '.join(grid)} must make at most {_MOST_RODS} rods, but makes {rods} rods")
        mesh = np.meshgrid(*grid.values(), indexing="ij")
        replace(file.scene, {path: axis.ravel() for path, axis in zip(grid, mesh, strict=True)})
    return grid
