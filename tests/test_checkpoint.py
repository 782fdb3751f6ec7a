"""Batches on disk under faults: what is damaged is solved again, what is another's is left alone."""

import errno
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cosserat_jax.errors import InputError, OutputError
from cosserat_jax.report.output_files import written_whole
from cosserat_jax.study.checkpoint import Checkpoint, remove

IDENTITY = {"scene": "an arm", "grid": "0, 1", "version of diffrax": "1"}
ROWS = 3
ARRAYS = [np.linspace(0.0, 1.0, 12).reshape(ROWS, 4), np.arange(ROWS)]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A sweep of which batches 0 and 1 are kept."""
    store = Checkpoint(tmp_path / "kept", IDENTITY)
    store.save(0, ARRAYS)
    store.save(1, [2 * array for array in ARRAYS])
    store.close()
    return tmp_path / "kept"


def test_what_was_kept_comes_back_to_the_bit_and_nothing_else_stays(folder: Path) -> None:
    store = Checkpoint(folder, IDENTITY)
    for array, kept in zip(ARRAYS, store.load(0, ROWS) or [], strict=True):
        np.testing.assert_array_equal(array, kept)
    assert store.load(2, ROWS) is None
    store.close()
    assert sorted(os.listdir(folder)) == ["batch-000000.npz", "batch-000001.npz", "identity", "lock"]
    remove(folder)
    assert not folder.exists()


def flip(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 3] ^= 1
    path.write_bytes(content)


def other_sweep(path: Path) -> None:
    other = Checkpoint(path.parent / "other", {"scene": "another"})
    other.save(0, ARRAYS)
    other.close()
    shutil.move(path.parent / "other/batch-000000.npz", path)


def rewritten(arrays: list[np.ndarray]) -> Callable[[Path], None]:
    def damage(path: Path) -> None:
        with np.load(path) as kept:
            label = kept["label"]
        np.savez(path, *arrays, label=label)

    return damage


DAMAGES: dict[str, Callable[[Path], object]] = {
    "truncated": lambda path: os.truncate(path, 100),
    "no bytes": lambda path: os.truncate(path, 0),
    "zeros": lambda path: path.write_bytes(bytes(1000)),
    "a flipped bit": flip,
    "another batch": lambda path: shutil.copy(path.with_name("batch-000001.npz"), path),
    "another sweep": other_sweep,
    "fewer rows": rewritten([array[:2] for array in ARRAYS]),
    "single precision": rewritten([ARRAYS[0].astype(np.float32), ARRAYS[1]]),
    "a pickle": rewritten([np.array([print, print, print], dtype=object), ARRAYS[1]]),
    "nothing": rewritten([]),
    "a folder": lambda path: (path.unlink(), path.mkdir()),
}


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_a_damaged_batch_counts_as_absent_with_a_warning(damage: Callable[[Path], object], folder: Path) -> None:
    damage(folder / "batch-000000.npz")
    store = Checkpoint(folder, IDENTITY)
    with pytest.warns(UserWarning, match=r"batch-000000\.npz is damaged or not of this sweep"):
        assert store.load(0, ROWS) is None
    np.testing.assert_array_equal(store.load(1, ROWS)[1], [0, 2, 4])
    store.close()


def test_another_sweep_is_told_what_differs(folder: Path) -> None:
    with pytest.raises(InputError, match="holds those of one with another scene and version of diffrax;"):
        Checkpoint(folder, IDENTITY | {"scene": "another arm", "version of diffrax": "2"})
    (folder / "identity").write_bytes(b"\xff\x00")
    with pytest.raises(InputError, match="another version"):
        Checkpoint(folder, IDENTITY)


def test_a_second_run_on_one_folder_is_refused_until_the_first_ends(folder: Path) -> None:
    first = Checkpoint(folder, IDENTITY)
    with pytest.raises(InputError, match="another run works on it"):
        Checkpoint(folder, IDENTITY)
    first.close()
    Checkpoint(folder, IDENTITY).close()


def test_a_full_disk_is_one_line_and_keeps_what_is_there(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    store, before = Checkpoint(folder, IDENTITY), sorted(os.listdir(folder))
    with monkeypatch.context() as patch:
        patch.setattr(np, "savez", full)
        with pytest.raises(OutputError, match=r"No space left .*; the batches before it are kept in"):
            store.save(2, ARRAYS)
    assert sorted(os.listdir(folder)) == before
    store.close()


def test_files_of_the_user_and_links_are_left_alone(folder: Path, tmp_path: Path) -> None:
    (folder / "thesis.txt").write_text("the only copy")
    remove(folder)
    assert os.listdir(folder) == ["thesis.txt"]
    with pytest.raises(InputError, match="holds something else"):
        Checkpoint(folder, IDENTITY)
    (tmp_path / "link").symlink_to(folder)
    with pytest.raises(InputError, match="holds something else"):
        Checkpoint(tmp_path / "link", IDENTITY)


def test_an_output_is_written_to_a_new_file_that_no_link_leads_elsewhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "diary.txt").write_text("the only copy")
    monkeypatch.setattr("cosserat_jax.report.output_files._beside", lambda place: tmp_path / "beside")
    (tmp_path / "beside").symlink_to(tmp_path / "diary.txt")
    with pytest.raises(OutputError), written_whole(tmp_path / "a.nc") as beside:
        beside.write_text("new")
    assert (tmp_path / "diary.txt").read_text() == "the only copy"
    assert not (tmp_path / "a.nc").exists()
