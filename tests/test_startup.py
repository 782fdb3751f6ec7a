"""What starting costs: modules that are imported only where they are used, and programs kept for the next process."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from command import contents

SLOW = ("jax", "numpy", "scipy", "pint", "xarray", "h5netcdf", "matplotlib", "tqdm")
SOLVE = ["solve", "octopus", "--json"]


def run_python(code: str, **variables: str) -> subprocess.CompletedProcess[str]:
    """Runs `code` in a fresh process, in whose environment only `variables` are set of what JAX and XLA read."""
    others = {name: value for name, value in os.environ.items() if not name.startswith(("JAX_", "XLA_"))}
    words = [sys.executable, "-c", code]
    return subprocess.run(words, env=others | variables, capture_output=True, text=True, check=True)


def run_command(words: list[str], cache: Path, then: str = "", **variables: str) -> subprocess.CompletedProcess[str]:
    """Runs one command in a fresh process, and after it the code `then`; the user's cache folder is `cache`."""
    code = f"from cosserat_jax.cli import main; main({words})\n{then}"
    return run_python(code, XDG_CACHE_HOME=str(cache), **variables)


def imported(code: str) -> str:
    """Which of the slow modules `code` imports, as Python writes a list."""
    found = f"import sys; print([name for name in {SLOW} if name in sys.modules])"
    return run_python(f"{code}; {found}").stdout.splitlines()[-1]


# --- imports


def test_importing_the_package_imports_nothing_slow() -> None:
    assert imported("import cosserat_jax") == "[]"


@pytest.mark.parametrize("words", [["--help"], ["--version"], ["solve", "--help"], ["reach", "--help"], ["slove"]])
def test_help_and_typos_import_nothing_slow(words: list[str]) -> None:
    assert imported(f"from cosserat_jax.cli import main; main({words})") == "[]"


def test_shell_completion_imports_nothing_slow() -> None:
    asked = {"_COSSERAT_JAX_COMPLETE": "bash_complete", "COMP_WORDS": "cosserat-jax sweep --re", "COMP_CWORD": "2"}
    code = "import atexit, sys; atexit.register(lambda: print('jax' in sys.modules)); from cosserat_jax.cli import main"
    assert run_python(f"{code}; main()", **asked).stdout.split() == ["plain,--resume", "plain,--restart", "False"]


def test_every_public_name_is_there_and_listed() -> None:
    code = "import cosserat_jax as c; print({n for n in c.__all__ if getattr(c, n) is None or n not in dir(c)})"
    assert run_python(code).stdout == "set()\n"


def test_a_name_that_does_not_exist_is_an_attribute_error() -> None:
    code = "import cosserat_jax\ntry: cosserat_jax.slove\nexcept AttributeError as error: print(error)"
    assert run_python(code).stdout == "module 'cosserat_jax' has no attribute 'slove'\n"


@pytest.mark.parametrize("imports", ["jax, cosserat_jax", "cosserat_jax, jax"])
def test_double_precision_is_on_whichever_is_imported_first(imports: str) -> None:
    assert run_python(f"import {imports}; print(jax.numpy.ones(1).dtype)").stdout == "float64\n"


# --- what is kept for the next process


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the user's caches after a first solve."""
    folder = tmp_path_factory.mktemp("cache")
    assert run_command(SOLVE, folder).stderr == ""
    return folder


def test_a_second_process_compiles_nothing_anew(cache: Path) -> None:
    before = contents(cache)
    assert list(cache.glob("cosserat-jax/jit_*"))
    assert run_command(SOLVE, cache).stderr == ""
    assert contents(cache) == before


@pytest.mark.parametrize("words", [["--no-cache", "scenes"], ["scenes", "--no-cache"]])
def test_no_cache_writes_nothing(tmp_path: Path, words: list[str]) -> None:
    off = "import jax; jax.jit(lambda x: 2 * x)(1.0)"
    mine = {"JAX_COMPILATION_CACHE_DIR": str(tmp_path / "mine")}
    assert run_command(words, tmp_path, off, **mine).stderr == ""
    assert list(tmp_path.iterdir()) == []


def test_a_cache_that_cannot_be_written_is_done_without(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    ran = run_command(["scenes"], tmp_path / "file", "import jax; print(jax.jit(lambda x: 2 * x)(1.0))")
    assert (ran.stdout.splitlines()[-1], ran.stderr) == ("2.0", "")


def test_a_broken_file_of_units_is_done_without(cache: Path) -> None:
    for file in cache.rglob("*.pickle"):
        file.write_bytes(b"broken")
    assert run_command(["scenes"], cache).stderr == ""


def test_a_cache_that_has_grown_too_large_is_emptied(tmp_path: Path) -> None:
    old = tmp_path / "cosserat-jax" / "old"
    old.parent.mkdir()
    with old.open("wb") as file:
        file.truncate(2**31)  # takes no room on the disk
    run_command(["scenes"], tmp_path)
    assert not old.exists()


# --- XLA's options

OPTIONS_AT_WORK = """
import jax, jax.numpy as jnp
def compiled(function): return jax.jit(function).lower(jnp.ones(600)).compile().as_text()
loop = compiled(lambda x: jax.lax.while_loop(lambda x: x.sum() < 9, lambda x: jnp.sin(x) + 1, x))
print("small_call" in loop)  # a loop in one piece
"""


@pytest.mark.parametrize(
    ("given", "at_work"),
    [("", "True"), ("--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=1", "False")],
)
def test_xla_heeds_the_options_and_before_them_the_user_s(tmp_path: Path, given: str, at_work: str) -> None:
    ran = run_command(["--no-cache", "scenes"], tmp_path, OPTIONS_AT_WORK, XLA_FLAGS=given)
    assert ran.stdout.splitlines()[-1] == at_work


def test_the_name_of_a_file_with_xla_flags_stays(tmp_path: Path) -> None:
    (tmp_path / "flags").write_text("--xla_cpu_enable_fast_math=false")
    told = "import os, jax; jax.devices(); print(os.environ['XLA_FLAGS'])"
    name = str(tmp_path / "flags")
    assert run_command(["--no-cache", "scenes"], tmp_path, told, XLA_FLAGS=name).stdout.splitlines()[-1] == name
