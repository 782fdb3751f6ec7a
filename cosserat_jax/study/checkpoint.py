"""Batches of a long sweep, kept on disk until all of them are done."""

import contextlib
import hashlib
import json
import os
import warnings
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO

import numpy as np

from ..errors import InputError, OutputError

try:
    import fcntl
except ImportError:  # where there is no such lock, two runs on one folder are not told from each other
    fcntl = None

_BATCHES = "batch-*.npz"
_KINDS = "fib"  # of the arrays of a solution: floats, whole numbers, truths


class Checkpoint:
    """A folder with one file per finished batch, and the identity of the sweep they belong to, {what: its text}.

    Raises `InputError` for a folder that holds another sweep, or anything else, or that another run works on. A file is
    written beside its place and moved in whole, so a sweep that is stopped leaves no half batch; each carries its
    number and the identity. One that cannot be read, or is not what it says, counts as absent: it is solved again.
    """

    def __init__(self, folder: Path, identity: Mapping[str, str]) -> None:
        self.folder = folder
        kept = {what: hashlib.sha256(text.encode()).hexdigest() for what, text in identity.items()}
        self.identity = json.dumps(kept)
        if folder.is_symlink() or (folder.exists() and not is_checkpoint(folder)):
            raise InputError(f"{folder} must be the folder of a sweep, but holds something else; name another folder")
        folder.mkdir(parents=True, exist_ok=True)
        self._lock()
        name = folder / "identity"
        if not name.is_file():
            with _written(name) as file:
                file.write(self.identity.encode())
        elif changed := _changed(name, kept):
            self.close()
            raise InputError(
                f"{folder} must hold the batches of this sweep, but holds those of one with another "
                f"{' and '.join(changed)}; name another folder, or start over"
            )

    def load(self, index: int, rows: int) -> list[np.ndarray] | None:
        """The arrays of batch `index`, each with so many rows, or None if it is not there or damaged."""
        path = self._path(index)
        if not path.exists():
            return None
        try:
            with np.load(path, allow_pickle=False) as kept:
                label, arrays = str(kept["label"]), [kept[f"arr_{i}"] for i in range(len(kept.files) - 1)]
        except (OSError, ValueError, KeyError, EOFError, NotImplementedError, zipfile.BadZipFile):
            label, arrays = "", []
        wide = [np.dtype(array.dtype).kind == "f" and array.dtype != np.float64 for array in arrays]
        fits = [array.ndim > 0 and array.shape[0] == rows and array.dtype.kind in _KINDS for array in arrays]
        if label != self._label(index) or not arrays or any(wide) or not all(fits):
            warnings.warn(f"{path} is damaged or not of this sweep; its rods are solved again", stacklevel=2)
            return None
        return arrays

    def save(self, index: int, arrays: list[np.ndarray]) -> None:
        """Keeps the arrays of batch `index`. Raises `OutputError` if they cannot be written; those before stay."""
        path = self._path(index)
        try:
            with _written(path) as file:
                np.savez(file, *arrays, label=np.array(self._label(index)))
        except OSError as error:
            raise OutputError(
                f"{path}: cannot be written: {error.strerror or error}; the batches before it are kept in {self.folder}"
            ) from None

    def close(self) -> None:
        """Lets other runs work on the folder."""
        os.close(self._held)

    def _lock(self) -> None:
        self._held = os.open(self.folder / "lock", os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0))
        try:
            if fcntl is not None:
                fcntl.flock(self._held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self.close()
            raise InputError(f"{self.folder} must be free, but another run works on it; wait for it to end") from None

    def _label(self, index: int) -> str:
        return f"{index} {self.identity}"

    def _path(self, index: int) -> Path:
        return self.folder / f"batch-{index:06d}.npz"


def is_checkpoint(folder: Path) -> bool:
    """Whether a folder is empty or that of a sweep."""
    return folder.is_dir() and ((folder / "identity").is_file() or {*os.listdir(folder)} <= {"lock"})


def holds_batches(folder: Path) -> bool:
    """Whether a stopped sweep has left finished batches there."""
    return any(folder.glob(_BATCHES))


def remove(folder: Path) -> None:
    """Removes what a `Checkpoint` wrote into the folder, and the folder if nothing else is in it."""
    for path in [*folder.glob(f"{_BATCHES}*"), folder / "identity", folder / "identity.unfinished", folder / "lock"]:
        path.unlink(missing_ok=True)
    with contextlib.suppress(OSError):
        folder.rmdir()


@contextlib.contextmanager
def _written(path: Path) -> Iterator[IO[bytes]]:
    """A new file beside `path` that is moved there once it is whole; nothing stays of one that cannot be written."""
    beside = path.with_name(f"{path.name}.unfinished")
    try:
        beside.unlink(missing_ok=True)
        with open(beside, "xb") as file:
            yield file
        os.replace(beside, path)
    except OSError:
        with contextlib.suppress(OSError):
            beside.unlink(missing_ok=True)
        raise


def _changed(name: Path, identity: Mapping[str, str]) -> list[str]:
    """What differs between the identity in a file and this one."""
    try:
        kept = json.loads(name.read_text(encoding="utf-8"))
        return [what for what in {**identity, **kept} if identity.get(what) != kept.get(what)]
    except (ValueError, TypeError, AttributeError):
        return ["version"]
