"""What the tests of the command line share."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple


class Ran(NamedTuple):
    """What a command did: its exit status, and what it wrote on stdout and stderr."""

    status: int
    out: str
    err: str


Run = Callable[..., Ran]


# the start of a good scene file, up to the muscle's tension or tcam
ARM_FILE = """
[arm]
length = "418 mm"
base_radius = "15 mm"
tip_radius = "4 mm"
youngs_modulus = "10 MPa"
poisson_ratio = 0.5
density = "1.1 kg/dm^3"

[[muscles]]
base_offset = "12 mm"
end_offset = "1 mm"
"""


def contents(folder: Path) -> dict[str, bytes | None]:
    """Every file below `folder` with its bytes, and every folder."""
    return {str(path): path.read_bytes() if path.is_file() else None for path in folder.rglob("*")}


def assert_one_line_and_nothing_left(run: Run, folder: Path, words: list[str], named: list[str]) -> None:
    """That the command refuses its input in one line that names all of `named`, and leaves `folder` as it was."""
    before = contents(folder)
    ran = run(*words)
    assert (ran.status, ran.out) == (2, "")
    assert ran.err.startswith("cosserat-jax: error: ")
    assert ran.err.count("\n") == 1
    for part in named:
        assert part in ran.err
    assert contents(folder) == before
