"""Shared by all tests: the `run` of a command, and a rank that grows by itself is an error."""

import gc
from pathlib import Path

import jax
import pytest
from command import Ran, Run

from cosserat_jax.cli import main

jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_disable_most_optimizations", True)  # compiling is what takes the time
gc.set_threshold(100_000, 20, 20)  # and before it tracing, a third of it in walks over what JAX keeps


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Runs one command in an empty folder."""
    monkeypatch.chdir(tmp_path)

    def run(*words: str) -> Ran:
        capsys.readouterr()
        status = main(words)
        return Ran(status, *capsys.readouterr())

    return run
