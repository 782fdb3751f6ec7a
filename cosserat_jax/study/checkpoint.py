"""Batches of a long sweep, kept on disk until all of them are done."""

import os
from pathlib import Path

import numpy as np

from ..scene import InputError


class Checkpoint:
    """A folder with one file per finished batch, and the identity of the sweep they belong to.

    Raises `InputError` for a folder that holds anything else. A file is written beside its place and moved in whole, so
    a sweep that is stopped leaves no half batch.
    """

    def __init__(self, folder: Path, identity: str) -> None:
        self.folder = folder
        name = folder / "identity"
        if name.is_file() and name.read_text() == identity:
            return
        if folder.exists() and not (folder.is_dir() and not any(folder.iterdir())):
            raise InputError(
                f"{folder}: holds something other than this sweep's batches; remove it or name another folder"
            )
        folder.mkdir(parents=True, exist_ok=True)
        beside = folder / "unfinished"
        beside.write_text(identity)
        os.replace(beside, name)

    def load(self, index: int) -> list[np.ndarray] | None:
        """The arrays of batch `index`, or None if it is not there."""
        path = self._path(index)
        if not path.exists():
            return None
        with np.load(path) as kept:
            return [kept[f"arr_{i}"] for i in range(len(kept.files))]

    def save(self, index: int, arrays: list[np.ndarray]) -> None:
        """Keeps the arrays of batch `index`."""
        beside = self.folder / "unfinished.npz"
        np.savez(beside, *arrays)
        os.replace(beside, self._path(index))

    def _path(self, index: int) -> Path:
        return self.folder / f"batch-{index:06d}.npz"
