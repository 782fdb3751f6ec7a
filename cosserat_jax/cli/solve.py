"""`cosserat-jax solve`."""

import click

from ..report.output_files import figure_place, save_figure
from .common import Command, about, pairs, plot_option, read_changed, settings_option


@click.command("solve", cls=Command)
@click.argument("scenes", metavar="SCENE...", nargs=-1, required=True)
@settings_option
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object a line, in the order of the scenes.")
@plot_option
def solve_command(scenes: tuple[str, ...], settings: tuple[str, ...], as_json: bool, plot: str | None) -> int:
    """Find the equilibrium of one or more scenes.

    The exit status is 1 if one of them has no solution.

    \b
    Examples:
      cosserat-jax solve octopus
      cosserat-jax solve octopus --set "muscles.0.tension=20 N" --set "water.velocity=0.4 m/s" --json
      cosserat-jax solve octopus octopus-printed my-arm.toml --plot arms.png
    """
    from ..report.text import json_line, solution_text
    from ..solver import check_steady, solve

    files = [read_changed(name, pairs("--set", settings)) for name in scenes]
    for file in files:
        with about(file.name):
            check_steady(file.scene)
    figure = None if plot is None else figure_place("--plot", plot)
    solutions = []
    for file in files:
        solutions.append(solve(file.scene, throw=False))
        click.echo(json_line(file.name, solutions[-1]) if as_json else solution_text(file.name, solutions[-1]))
    if figure is not None:
        from ..report.figures import solve_figure

        drawn = dict(zip(scenes, solutions, strict=True))
        save_figure(solve_figure({file.name: file.scene for file in files}, drawn), figure)
    return 0 if all(bool(solution.converged) for solution in solutions) else 1
