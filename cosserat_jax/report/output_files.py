"""Output files: checked before the work, written beside their place and moved in whole."""

import contextlib
import itertools
import os
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import InputError, OutputError

_number = itertools.count()

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def output_place(option: str, file: str, suffixes: Collection[str]) -> Path:
    """The place that `file` names, links followed. Raises `InputError` where it is plain that it cannot be written."""
    where, place = f"{option} {file!r}", Path(os.path.realpath(file))
    if Path(file).suffix.lower() not in suffixes:
        raise InputError(f"{where}: not a name for this output; allowed: a name that ends in {', '.join(suffixes)}")
    if not place.parent.is_dir():
        raise InputError(f"{where}: cannot be written: there is no folder {str(place.parent)!r}")
    if place.is_dir():
        raise InputError(f"{where}: cannot be written: it is a folder; allowed: a file")
    if not os.access(place.parent, os.W_OK | os.X_OK):
        raise InputError(f"{where}: cannot be written: no permission to write in {str(place.parent)!r}")
    try:
        os.lstat(_beside(place))  # finds a name that is too long for the file system
    except FileNotFoundError:
        pass
    except OSError as error:
        raise InputError(f"{where}: cannot be written: {error.strerror}") from None
    return place


def figure_place(option: str, file: str, more: Collection[str] = ()) -> Path:
    """As `output_place`, for a figure in any format that matplotlib writes, or with one of `more` suffixes."""
    from matplotlib.backend_bases import FigureCanvasBase

    # matplotlib asks a TeX installation for the size of every word in a pgf figure
    kinds = sorted(kind for kind in FigureCanvasBase.get_supported_filetypes() if kind != "pgf")
    return output_place(option, file, list(dict.fromkeys([f".{kind}" for kind in kinds] + list(more))))


def batches_place(data: Path) -> Path:
    """The folder beside the output `data` that keeps the batches of a sweep while it runs.

    Raises `InputError` if something there is not such a folder: it is the user's and must not be emptied.
    """
    from ..study.checkpoint import is_checkpoint

    folder = data.with_name(f"{data.name}.partial")
    if not folder.is_symlink() and (is_checkpoint(folder) or not folder.exists()):
        return folder
    raise InputError(f"{folder}: in the way, and not the batches of an unfinished sweep; move it elsewhere")


def save_figure(figure: "Figure", place: Path) -> None:
    """Writes `figure` to `place`, whole or not at all."""
    with written_whole(place) as beside:
        figure.savefig(beside, format=place.suffix[1:].lower())


@contextlib.contextmanager
def written_whole(place: Path) -> Iterator[Path]:
    """Gives the path to write to, and moves what is written there to `place` at the end.

    A run that is stopped, or a write that fails, leaves `place` as it was. Raises `OutputError` if the write fails.
    """
    beside = _beside(place)
    try:
        with open(beside, "xb"):
            pass  # a file of our own, wherever a link of that name might lead
        yield beside
        os.replace(beside, place)
    except OSError as error:
        raise OutputError(f"{place}: cannot be written: {error.strerror or error}") from None
    finally:
        beside.unlink(missing_ok=True)


def _beside(place: Path) -> Path:
    """A name of this run's own."""
    return place.with_name(f".{place.name}.{os.getpid()}-{next(_number)}.unfinished")
