"""The command line: `cosserat-jax scenes`, `solve` and `sweep`.

Exit status: 0; 1 if a rod has no solution; 2 for bad input, with one line on stderr; 130 if stopped from the keyboard.
"""

import math
import os
import shutil
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np

from . import __version__
from .report.text import json_line, solution_text, sweep_summary, sweep_table
from .report.writing import OutputError, batches_place, figure_place, output_place, save_figure, written_whole
from .scene import Scene, SceneError, SceneFile, presets, read, replace, sweep_values
from .scene.paths import nearest
from .solver import solve
from .study import Sweep, sweep

_MOST_RODS = 1_000_000  # some 10 GB of fields


class _Stopped(click.ClickException):
    """Ctrl-C."""

    exit_code = 130


class _Commands(click.Group):
    """click's group, with Ctrl-C as one line and a hint for a command that does not exist."""

    def resolve_command(self, ctx: click.Context, args: list[str]) -> tuple:
        if args[0] not in self.commands and not args[0].startswith("-"):
            ctx.fail(f"no such command {args[0]!r}; {nearest(args[0], list(self.commands))}")
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            raise _Stopped("stopped") from None


def main(argv: Sequence[str] | None = None) -> int:
    """Runs one command, `argv` or the shell's words after `cosserat-jax`, and returns its exit status."""
    try:
        return _commands.main(argv, prog_name="cosserat-jax", standalone_mode=False) or 0
    except _Stopped as stop:
        if sys.stderr.isatty():
            click.echo(err=True)  # ends the line of the progress bar or of ^C
        _failed(stop.message)
        if argv is None:
            os._exit(stop.exit_code)  # JAX, stopped while it compiles, can crash in its own clean-up at exit
        return stop.exit_code
    except click.UsageError as error:
        command = error.ctx.command_path if error.ctx else "cosserat-jax"
        return _failed(f"error: {error.format_message()} (see '{command} --help')")
    except (SceneError, OutputError, click.ClickException) as error:
        return _failed(f"error: {error}")
    except OSError as error:
        return _failed(f"error: {error.filename or 'a file'}: {error.strerror or error}")


def _failed(message: str) -> int:
    click.echo("cosserat-jax: " + " ".join(message.splitlines()), err=True)
    return 2


_settings = click.option(
    "--set", "settings", multiple=True, metavar="PATH=VALUE", help="Change a parameter of the scene; may be repeated."
)
_plot = click.option("--plot", metavar="FILE", help="Draw a figure; its name says the format (.png, .pdf, .svg ...).")
_names = {"help_option_names": ["-h", "--help"]}


@click.group(cls=_Commands, context_settings=_names, no_args_is_help=False)
@click.version_option(__version__, prog_name="cosserat-jax")
def _commands() -> None:
    """Statics of soft rods that bend under muscles and water.

    SCENE is a TOML file or the name of a preset. A parameter is named by its path, such as water.velocity or
    muscles.0.tension, and a value is a number with a unit, or in SI without one.

    \b
    Examples:
      cosserat-jax scenes
      cosserat-jax solve octopus --set "muscles.0.tension=15 N"
      cosserat-jax sweep octopus --out octopus.nc --plot octopus.png
    """


@_commands.command("scenes")
def _scenes() -> None:
    """List the scenes that ship with the package.

    \b
    Example:
      cosserat-jax scenes
    """
    width = max(len(name) for name in presets())
    for name in presets():
        click.echo(f"{name:{width}}  {read(name).title}")


@_commands.command("solve")
@click.argument("scenes", metavar="SCENE...", nargs=-1, required=True)
@_settings
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object a line, in the order of the scenes.")
@_plot
def _solve(scenes: tuple[str, ...], settings: tuple[str, ...], as_json: bool, plot: str | None) -> int:
    """Find the equilibrium of one or more scenes.

    The exit status is 1 if one of them has no solution.

    \b
    Examples:
      cosserat-jax solve octopus
      cosserat-jax solve octopus --set "muscles.0.tension=20 N" --set "water.velocity=0.4 m/s" --json
      cosserat-jax solve octopus octopus-printed my-arm.toml --plot arms.png
    """
    files = [_changed(read(name), _pairs("--set", settings)) for name in scenes]
    figure = None if plot is None else figure_place("--plot", plot)
    solutions = []
    for file in files:
        solutions.append(solve(file.scene, throw=False))
        click.echo(json_line(file.name, solutions[-1]) if as_json else solution_text(file.name, solutions[-1]))
    if figure is not None:
        from .report.figures import solve_figure

        drawn = dict(zip(scenes, solutions, strict=True))
        save_figure(solve_figure({file.name: file.scene for file in files}, drawn), figure)
    return 0 if all(bool(solution.converged) for solution in solutions) else 1


@_commands.command("sweep")
@click.argument("name", metavar="SCENE")
@click.option(
    "--over", multiple=True, metavar="PATH=RANGE",
    help='Sweep this parameter over "START:STOP:STEP UNIT" or "V1, V2 UNIT"; may be repeated, the first outermost. '
    "Default: the scene's own [sweep].",
)  # fmt: skip
@_settings
@click.option("--out", metavar="FILE.nc", help="Write netCDF: tip, outcome and fields of every rod.")
@_plot
@click.option("--batch", metavar="N", type=click.IntRange(min=1), default=1024, help="Rods at a time; default: 1024.")
@click.option("--resume", is_flag=True, help="Take up where the same command was stopped, to the same bits.")
def _sweep(
    name: str,
    over: tuple[str, ...],
    settings: tuple[str, ...],
    out: str | None,
    plot: str | None,
    batch: int,
    resume: bool,
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
    changes = _pairs("--set", settings)
    file = _changed(read(name), changes)
    grid = _grid(file, _pairs("--over", over), changes)
    data, figure = _sweep_outputs(out, plot)
    kept = None if data is None else batches_place(data)
    if resume and kept is None:
        raise OutputError("--resume: nothing to take up without --out FILE.nc; allowed: --out FILE.nc --resume")

    start = time.perf_counter()
    swept = _run(file.scene, grid, batch, kept, resume)
    if data is not None:
        with written_whole(data) as beside:
            swept.to_xarray().to_netcdf(beside, engine="h5netcdf")
    if figure is not None:
        from .report.figures import sweep_figure

        save_figure(sweep_figure(swept), figure)
    if kept is not None:
        shutil.rmtree(kept, ignore_errors=True)
    if data is None and figure is None:
        click.echo(sweep_table(swept))
    click.echo(sweep_summary(file.name, swept, time.perf_counter() - start))
    for place in (data, figure):
        if place is not None:
            click.echo(f"  written      {place}")
    return 0 if bool(np.all(swept.solution.converged)) else 1


def _run(scene: Scene, grid: dict[str, np.ndarray], batch: int, kept: Path | None, resume: bool) -> Sweep:
    """The sweep, with its batches in the folder `kept` where there is more than one to keep."""
    if kept is not None and kept.exists() and not resume:
        shutil.rmtree(kept)
    rods = math.prod(len(values) for values in grid.values())
    checkpoint = kept if kept is not None and (rods > batch or kept.exists()) else None
    try:
        return sweep(scene, grid, batch=batch, progress=True, checkpoint=checkpoint)
    except KeyboardInterrupt:
        if checkpoint is None:
            raise _Stopped("stopped; nothing was written") from None
        kept_there = f"the batches done are in {checkpoint}"
        raise _Stopped(f"stopped; {kept_there}, and the same command with --resume continues") from None


def _pairs(option: str, texts: tuple[str, ...]) -> dict[str, str]:
    pairs: dict[str, str] = {}
    for text in texts:
        path, equals, value = text.partition("=")
        if not equals:
            raise SceneError(f"{option} {text!r} is not allowed; allowed: {option} PATH=VALUE")
        if path.strip() in pairs:
            raise SceneError(f"{option} {text!r}: {path.strip()} is given twice; allowed: once")
        pairs[path.strip()] = value.strip()
    return pairs


def _changed(file: SceneFile, changes: dict[str, str]) -> SceneFile:
    try:
        return file._replace(scene=replace(file.scene, changes))
    except SceneError as error:
        raise SceneError(f"{file.name}: --set: {error}") from None


def _grid(file: SceneFile, over: dict[str, str], changes: dict[str, str]) -> dict[str, np.ndarray]:
    """The values to sweep over, with every rod of the grid checked."""
    origin = f"{file.name}: {'--over' if over else '[sweep]'}"
    try:
        grid = {path: sweep_values(file.scene, path, text) for path, text in over.items()} if over else file.sweep
        if not grid:
            raise SceneError("nothing to sweep over; allowed: --over PATH=RANGE, or a table [sweep] in the scene")
        if both := [path for path in grid if path in changes]:
            raise SceneError(f"{both[0]}: swept, and set to {changes[both[0]]!r} by --set; allowed: one of the two")
        if (rods := math.prod(len(values) for values in grid.values())) > _MOST_RODS:
            raise SceneError(f"{' x '.join(grid)}: {rods} rods; allowed: at most {_MOST_RODS}")
        mesh = np.meshgrid(*grid.values(), indexing="ij")
        replace(file.scene, {path: axis.ravel() for path, axis in zip(grid, mesh, strict=True)})
    except SceneError as error:
        raise SceneError(f"{origin}: {error}") from None
    return grid


def _sweep_outputs(out: str | None, plot: str | None) -> tuple[Path | None, Path | None]:
    if out is not None and plot is not None and Path(out).resolve() == Path(plot).resolve():
        raise OutputError(f"--out and --plot are both {out!r}; allowed: two files")
    data = None if out is None else output_place("--out", out, [".nc"])
    return data, None if plot is None else figure_place("--plot", plot)
