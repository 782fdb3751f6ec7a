"""What the commands share: options, scenes as the command's words change them, places of outputs, lines on stderr."""

import contextlib
import logging
import sys
import threading
import warnings
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..errors import InputError, one_line, quoted
from ..report.output_files import figure_place, output_place
from .process import prepare

if TYPE_CHECKING:
    from ..scene import Scene, SceneFile

settings_option = click.option(
    "--set", "settings", multiple=True, metavar="PATH=VALUE", help="Change a parameter of the scene; may be repeated."
)
plot_option = click.option(
    "--plot", metavar="FILE", help="Draw a figure; its name says the format (.png, .pdf, .svg ...)."
)
free_option = click.option(
    "--free", multiple=True, required=True, metavar="PATH...",
    help='Parameters that may change, each a PATH or "PATH=LOWER:UPPER UNIT" with bounds of its own.',
)  # fmt: skip

_SLOW = 3.0  # seconds without a word

_NO_CACHE = f"{__name__}.no_cache"


def _remember(ctx: click.Context, _: click.Parameter, given: bool) -> None:
    ctx.meta[_NO_CACHE] = given or ctx.meta.get(_NO_CACHE)


no_cache_option = click.Option(
    ["--no-cache"], is_flag=True, expose_value=False, callback=_remember,
    help="Keep no compiled programs for the next run, and use none.",
)  # fmt: skip


class Command(click.Command):
    """A command that computes, with --no-cache behind its name as the group has it before."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.params.append(no_cache_option)

    def invoke(self, ctx: click.Context) -> Any:
        prepare(cached=not ctx.meta.get(_NO_CACHE))
        with word_if_slow():
            return super().invoke(ctx)


class WithFree(Command):
    """A command whose --free takes all words up to the next option, as well as being repeated."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        words, inside = [], False
        for word in args:
            if word.startswith("-"):
                inside = word == "--free"
            elif inside and words[-1] != "--free":
                words.append("--free")
            words.append(word)
        return super().parse_args(ctx, words)


@contextlib.contextmanager
def word_if_slow() -> Iterator[None]:
    """Says on a terminal what takes so long, once it does, and where the solver turns to a harder method."""
    word = threading.Timer(
        _SLOW, say, ["compiling, which the next run of a scene of this kind need not, or solving ..."]
    )
    word.daemon = True
    log, said = logging.getLogger("cosserat_jax"), _Said()
    if sys.stderr.isatty():
        word.start()
        log.addHandler(said)
        log.setLevel(logging.INFO)
    try:
        yield
    finally:
        word.cancel()
        log.removeHandler(said)


class _Said(logging.Handler):
    """What the package logs, each in one line on stderr."""

    def emit(self, record: logging.LogRecord) -> None:
        say(record.getMessage())


class Stopped(click.ClickException):
    """Ctrl-C."""

    exit_code = 130


def say(message: str) -> None:
    """One line on stderr."""
    click.echo(f"cosserat-jax: {one_line(message)}", err=True)


@contextlib.contextmanager
def said_at_once() -> Iterator[None]:
    """Has each Python warning said in one line."""
    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = lambda message, *_, **__: say(f"warning: {message}")
        yield


@contextlib.contextmanager
def about(where: str) -> Iterator[None]:
    """Puts `where` in front of what a `InputError` says."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def pairs(option: str, texts: tuple[str, ...]) -> dict[str, str]:
    """The paths with their values as `option` gives them, PATH=VALUE."""
    found: dict[str, str] = {}
    for text in texts:
        path, equals, value = text.partition("=")
        if not equals:
            raise InputError(f"{option} must be PATH=VALUE, but is {quoted(text)}")
        if path.strip() in found:
            raise InputError(f"{option} must name {path.strip()} once, but {quoted(text)} names it twice")
        found[path.strip()] = value.strip()
    return found


def read_changed(name: str, changes: dict[str, str]) -> "SceneFile":
    """The scene file `name` with what --set changes, and a hint on stderr at numbers that look like slips of a unit."""
    from ..scene import read, replace
    from ..scene.plausible import unit_hints

    file = read(name)
    with about(f"{file.name}: --set"):
        scene = replace(file.scene, changes)
    for hint in unit_hints(scene):
        say(f"hint: {file.name}: {hint}")
    return file._replace(scene=scene)


def free_bounds(
    scene: "Scene", texts: tuple[str, ...], unit: "Callable[[Scene, str], str]"
) -> dict[str, tuple[float, float] | None]:
    """The paths of --free with their bounds in SI, the `unit` of the path, or None for one without."""
    from ..scene import bounds_to_si

    found: dict[str, tuple[float, float] | None] = {}
    for text in texts:
        path, equals, bounds = (part.strip() for part in text.partition("="))
        if path in found:
            raise InputError(f"--free must name {path} once, but {quoted(text)} names it twice")
        found[path] = bounds_to_si(bounds, unit(scene, path), f"--free {path}") if equals else None
    return found


def data_and_figure(out: str | None, plot: str | None, more: Collection[str] = ()) -> tuple[Path | None, Path | None]:
    """The places of --out, netCDF, and of --plot, a figure or a file with one of `more` suffixes; None: not asked for.

    Raises `InputError` where it is plain that one of them cannot be written.
    """
    if out is not None and plot is not None and Path(out).resolve() == Path(plot).resolve():
        raise InputError(f"--out and --plot must be two files, but are both {out!r}")
    data = None if out is None else output_place("--out", out, [".nc"])
    return data, None if plot is None else figure_place("--plot", plot, more)


def say_written(*places: Path | None) -> None:
    """A line on stdout for each of the outputs that were asked for."""
    for place in places:
        if place is not None:
            click.echo(f"  written      {place}")
