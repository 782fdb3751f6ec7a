"""What the commands share: options, scenes as the command's words change them, places of outputs, lines on stderr."""

import contextlib
from collections.abc import Collection, Iterator
from pathlib import Path

import click

from ..report.writing import OutputError, figure_place, output_place
from ..scene import SceneError, SceneFile, read, replace

settings_option = click.option(
    "--set", "settings", multiple=True, metavar="PATH=VALUE", help="Change a parameter of the scene; may be repeated."
)
plot_option = click.option(
    "--plot", metavar="FILE", help="Draw a figure; its name says the format (.png, .pdf, .svg ...)."
)


class Stopped(click.ClickException):
    """Ctrl-C."""

    exit_code = 130


def say(message: str) -> None:
    """One line on stderr."""
    click.echo("cosserat-jax: " + " ".join(message.splitlines()), err=True)


@contextlib.contextmanager
def about(where: str) -> Iterator[None]:
    """Puts `where` in front of what a `SceneError` says."""
    try:
        yield
    except SceneError as error:
        raise SceneError(f"{where}: {error}") from None


def pairs(option: str, texts: tuple[str, ...]) -> dict[str, str]:
    """The paths with their values as `option` gives them, PATH=VALUE."""
    found: dict[str, str] = {}
    for text in texts:
        path, equals, value = text.partition("=")
        if not equals:
            raise SceneError(f"{option} {text!r} is not allowed; allowed: {option} PATH=VALUE")
        if path.strip() in found:
            raise SceneError(f"{option} {text!r}: {path.strip()} is given twice; allowed: once")
        found[path.strip()] = value.strip()
    return found


def read_changed(name: str, changes: dict[str, str]) -> SceneFile:
    """The scene file `name` with what --set changes."""
    file = read(name)
    with about(f"{file.name}: --set"):
        return file._replace(scene=replace(file.scene, changes))


def data_and_figure(out: str | None, plot: str | None, more: Collection[str] = ()) -> tuple[Path | None, Path | None]:
    """The places of --out, netCDF, and of --plot, a figure or a file with one of `more` suffixes; None: not asked for.

    Raises `OutputError` where it is plain that one of them cannot be written.
    """
    if out is not None and plot is not None and Path(out).resolve() == Path(plot).resolve():
        raise OutputError(f"--out and --plot are both {out!r}; allowed: two files")
    data = None if out is None else output_place("--out", out, [".nc"])
    return data, None if plot is None else figure_place("--plot", plot, more)


def say_written(*places: Path | None) -> None:
    """A line on stdout for each of the outputs that were asked for."""
    for place in places:
        if place is not None:
            click.echo(f"  written      {place}")
