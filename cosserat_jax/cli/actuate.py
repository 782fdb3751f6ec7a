"""`cosserat-jax actuate`."""

import math
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ..errors import InputError, quoted
from ..report.output_files import save_figure, written_whole
from .common import Command, about, data_and_figure, pairs, read_changed, say, say_written, settings_option

if TYPE_CHECKING:
    from ..study import Actuation


@click.command("actuate", cls=Command)
@click.argument("name", metavar="SCENE")
@click.option("--until", required=True, metavar="TIME", help='The last instant, such as "6.5 s"; the first is 0.')
@click.option(
    "--steps", metavar="N", type=click.IntRange(1, 100_000), default=499,
    help="Instants after the first, equally spaced; default: 499.",
)  # fmt: skip
@settings_option
@click.option("--out", metavar="FILE.nc", help="Write netCDF: voltage, temperature, force, tip and fields over time.")
@click.option(
    "--plot", metavar="FILE",
    help="Draw a figure, or the motion as an animation; its name says the format (.png, .pdf ...; .gif, .mp4).",
)  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def actuate_command(
    name: str,
    until: str,
    steps: int,
    settings: tuple[str, ...],
    out: str | None,
    plot: str | None,
    as_json: bool,
) -> int:
    """Find how an arm moves under the voltage on its muscles.

    A muscle hotter than its limit is a warning. The exit status is 1 if a muscle makes no tension or if at an instant
    the arm has no equilibrium; files are written all the same.

    \b
    Examples:
      cosserat-jax actuate octopus-tcam --until "6.5 s"
      cosserat-jax actuate octopus-tcam --until "1 min" --set "muscles.0.tcam.conductance=0.086 W/K" --json
      cosserat-jax actuate octopus-tcam --until "6.5 s" --steps 100 --out octopus.nc --plot octopus.gif
    """
    import numpy as np

    from ..report.text import actuation_json, actuation_text, overheated_lines
    from ..study import actuate

    file = read_changed(name, pairs("--set", settings))
    times = np.linspace(0, _last_instant(until), steps + 1)
    data, picture = data_and_figure(out, plot, _animations(plot))
    with about(file.name):
        actuation = actuate(file.scene, times)
    if data is not None:
        with written_whole(data) as beside:
            actuation.to_xarray().to_netcdf(beside, engine="h5netcdf")
    if picture is not None:
        _draw(actuation, picture)
    if as_json:
        click.echo(actuation_json(file.name, actuation))
    else:
        click.echo(actuation_text(file.name, actuation))
        say_written(data, picture)
    for line in overheated_lines(actuation):
        say(f"warning: {line}")
    return 0 if bool(actuation.solution.converged.all()) else 1  # a muscle without tension leaves no equilibrium


def _last_instant(text: str) -> float:
    from ..scene import to_si

    seconds = to_si(text, "s", "--until")
    if not 0 < seconds < math.inf:
        raise InputError(f"--until must be a finite time of more than 0 s, but is {quoted(text)}")
    return seconds


def _animations(plot: str | None) -> list[str]:
    """The suffixes of a plot that is an animation."""
    if plot is None:
        return []
    from ..report.figures import animation_suffixes

    known = animation_suffixes()
    if Path(plot).suffix.lower() == ".mp4" and ".mp4" not in known:
        raise InputError(f"--plot {plot!r}: matplotlib finds no ffmpeg to write it; allowed: {', '.join(known)}")
    return known


def _draw(actuation: "Actuation", place: Path) -> None:
    from ..report.figures import actuation_figure, animation_suffixes, save_animation

    if place.suffix.lower() in animation_suffixes():
        save_animation(actuation, place)
    else:
        save_figure(actuation_figure(actuation), place)
