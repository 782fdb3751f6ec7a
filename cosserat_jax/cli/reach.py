"""`cosserat-jax reach`."""

import math
from typing import TYPE_CHECKING

import click

from ..errors import InputError, quoted
from ..report.output_files import figure_place, save_figure
from .common import (
    WithFree,
    about,
    free_bounds,
    free_option,
    pairs,
    plot_option,
    read_changed,
    say_written,
    settings_option,
)

if TYPE_CHECKING:
    import numpy as np


@click.command("reach", cls=WithFree)
@click.argument("name", metavar="SCENE")
@click.option(
    "--target", "targets", multiple=True, required=True, metavar='"X, Y UNIT"',
    help="Where the point of the arm is to be; may be repeated, each target is one of its own.",
)  # fmt: skip
@free_option
@click.option("--at", metavar='"S UNIT"', help="The arc length of the point of the arm; default: the tip.")
@settings_option
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object a line, in the order of the targets.")
@plot_option
def reach_command(
    name: str,
    targets: tuple[str, ...],
    free: tuple[str, ...],
    at: str | None,
    settings: tuple[str, ...],
    as_json: bool,
    plot: str | None,
) -> int:
    """Find the tensions, voltages or other parameters that bring an arm to a target.

    Of all values within the bounds those that come closest are taken, and of those the ones of least effort. A tension
    without bounds of its own is at most what bends the arm by half a turn; muscles.0.tcam.voltage is the constant
    voltage that holds the arm there. The exit status is 1 if a target is out of reach; the figure is written all the
    same.

    \b
    Examples:
      cosserat-jax reach octopus --target "35, 8 cm" --free muscles.0.tension "water.velocity=0:0.5 m/s"
      cosserat-jax reach two-segments --target "0.35, 0.05 m" --target "0.3, -0.1 m" \\
          --free muscles.0.tension muscles.1.tension muscles.2.tension --json --plot reach.png
      cosserat-jax reach octopus-tcam --target "0.4, 0.05 m" --free muscles.0.tcam.voltage --at "0.3 m"
    """
    import numpy as np

    from ..report.inverse_text import reach_json, reach_text
    from ..study import reach
    from ..study.inverse.controls import unit_of_control

    file = read_changed(name, pairs("--set", settings))
    points = np.array([_point(text) for text in targets])
    figure = None if plot is None else figure_place("--plot", plot)
    with about(file.name):
        bounds = free_bounds(file.scene, free, unit_of_control)
        place = None if at is None else _place(at, float(file.scene.arm.length))
        found = reach(file.scene, points, bounds, place)
    if figure is not None:
        from ..report.figures import reach_figure

        save_figure(reach_figure(found), figure)
    if as_json:
        click.echo("\n".join(reach_json(file.name, found)))
    else:
        click.echo(reach_text(file.name, found))
        say_written(figure)
    return 0 if bool(found.reached.all()) else 1


def _point(text: str) -> "np.ndarray":
    from ..scene import range_to_si

    error = InputError(f'--target must be "X, Y UNIT", such as "0.3, 0.1 m", but is {quoted(text)}')
    try:
        point = range_to_si(text, "m", "--target")
    except InputError as cause:
        raise cause if "unit" in str(cause) else error from None
    if ":" in text or point.shape != (2,):
        raise error
    return point


def _place(text: str, length: float) -> float:
    from ..scene import to_si

    place = to_si(text, "m", "--at")
    if not 0 < place <= length or math.isnan(place):
        raise InputError(f"--at must be on the arm, more than 0 to {length:g} m, but is {quoted(text)}")
    return place
