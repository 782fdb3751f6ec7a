"""`cosserat-jax fit`."""

import click

from ..report.output_files import figure_place, output_place, save_figure, written_whole
from .common import (
    WithFree,
    about,
    free_bounds,
    free_option,
    pairs,
    plot_option,
    read_changed,
    said_at_once,
    say,
    say_written,
    settings_option,
)


@click.command("fit", cls=WithFree)
@click.argument("name", metavar="SCENE")
@click.argument("tables", metavar="DATA.csv...", nargs=-1, required=True)
@free_option
@click.option(
    "--sigma", "errors", multiple=True, metavar='"NAME=ERROR UNIT"',
    help="Standard error of a measurement; may be repeated. A column sigma(NAME) gives one for each row.",
)  # fmt: skip
@click.option(
    "--loss", type=click.Choice(["linear", "soft_l1", "huber", "cauchy"]), default="linear",
    help="linear (least squares; the default), or robust against outliers.",
)  # fmt: skip
@click.option("--starts", metavar="N", type=click.IntRange(1, 1000), default=1, help="Searches; default: 1.")
@settings_option
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
@click.option("--out", metavar="FITTED.toml", help="Write the fitted scene.")
@plot_option
def fit_command(
    name: str,
    tables: tuple[str, ...],
    free: tuple[str, ...],
    errors: tuple[str, ...],
    loss: str,
    starts: int,
    settings: tuple[str, ...],
    as_json: bool,
    out: str | None,
    plot: str | None,
) -> int:
    """Fit parameters of a scene to measurements, by least squares.

    The heads of the columns are paths with units: of parameters that were set, of what was measured (tip.x, tip.y,
    tip.theta; markers, as "y@200 mm [cm]"; muscles.0.tcam.temperature and so on over "time [s]"), and sigma(tip.y).
    Parameters start from the scene's values. The exit status is 1 if no minimum was found; a parameter that the data
    do not tell is a warning.

    \b
    Examples:
      cosserat-jax fit octopus tips.csv --free arm.youngs_modulus
      cosserat-jax fit octopus tips.csv --free arm.youngs_modulus water.inlet_fraction --sigma "tip.y=0.005 cm"
      cosserat-jax fit octopus-tcam heat.csv --free "muscles.0.tcam.conductance=0.001:0.1 W/K" --out mine.toml
    """
    from ..report.calibration_text import calibration_json, calibration_text
    from ..scene import dumps, unit_of
    from ..study import fit, read_measurements

    file = read_changed(name, pairs("--set", settings))
    scene_place = None if out is None else output_place("--out", out, [".toml"])
    figure = None if plot is None else figure_place("--plot", plot)
    sigma = pairs("--sigma", errors) or None
    measured = [read_measurements(file.scene, table, sigma) for table in tables]
    with about(file.name):
        bounds = free_bounds(file.scene, free, unit_of)
        with said_at_once():
            found = fit(file.scene, measured, bounds, loss=loss, starts=starts)  # pyright: ignore[reportArgumentType]
    if scene_place is not None:
        with about(file.name), written_whole(scene_place) as beside:
            beside.write_text(dumps(found.fitted))
    if figure is not None:
        from ..report.figures import calibration_figure

        save_figure(calibration_figure(found), figure)
    if as_json:
        click.echo(calibration_json(file.name, found))
    else:
        click.echo(calibration_text(file.name, found))
        say_written(scene_place, figure)
    for line in found.warnings[len(found.noted) :]:
        say(f"warning: {line}")
    return 0 if found.converged else 1
