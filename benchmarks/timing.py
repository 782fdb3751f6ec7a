"""What the benchmarks share: machine, options, compile time by stages, run times taken in turn, lines and tables."""

import argparse
import csv
import importlib.metadata
import os
import platform
import time
from collections.abc import Callable, Iterable
from functools import partial
from operator import methodcaller
from pathlib import Path
from typing import Any

import jax
import numpy as np


def timed(call: Callable[[], Any]) -> tuple[Any, float]:
    """The result of one call, and the seconds until it is there."""
    start = time.perf_counter()
    result = jax.block_until_ready(call())
    return result, time.perf_counter() - start


def seconds(call: Callable[[], Any]) -> float:
    """Of one call, until its result is there."""
    return timed(call)[1]


def in_turn(*calls: Callable[[], Any], repeats: int) -> list[list[float]]:
    """Seconds of `repeats` warm calls of each, taken in turn."""
    for call in calls:
        jax.block_until_ready(call())
    rounds = [[seconds(call) for call in calls] for _ in range(repeats)]
    return [list(times) for times in zip(*rounds, strict=True)]


def cpu_in_turn(
    calls: dict[str, Callable[[], Any]], repeats: int, limit: float = 30.0, least: float = 0.02
) -> dict[str, list[float]]:
    """CPU seconds of each, all threads counted, taken in turn; a sample is the mean of calls that take `least` seconds.

    All were called before. What has taken more than `limit` seconds in all sits out the rounds that remain.
    """
    count = {name: 1 + int(least / max(cpu(call), 1e-6)) for name, call in calls.items()}
    samples: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(repeats):
        for name, call in calls.items():
            if sum(samples[name]) * count[name] < limit:
                samples[name].append(sum(cpu(call) for _ in range(count[name])) / count[name])
    return samples


def cpu(call: Callable[[], Any]) -> float:
    """CPU seconds of one call, until its result is there."""
    start = time.process_time()
    jax.block_until_ready(call())
    return time.process_time() - start


def spread(times: list[float], per: int = 1) -> str:
    """Median and quartiles in milliseconds."""
    low, middle, high = 1e3 / per * np.quantile(times, [0.25, 0.5, 0.75])
    return f"{middle:9.3f} ms  [{low:.3f} .. {high:.3f}]"


def line(what: str, value: str, ratio: str = "") -> None:
    print(f"  {what:<48} {value:<52} {ratio}".rstrip(), flush=True)


def about() -> dict[str, str]:
    """Processor, versions and the device that JAX runs on."""
    rows = info.read_text().splitlines() if (info := Path("/proc/cpuinfo")).exists() else []
    models = [row.split(":", 1)[1].strip() for row in rows if row.startswith("model name")]
    versions = [f"{name} {importlib.metadata.version(name)}" for name in ("jax", "jaxlib", "diffrax", "numpy", "scipy")]
    return {
        "processor": f"{models[0] if models else platform.processor()}, {os.cpu_count()} cores",
        "system": f"{platform.platform()}, Python {platform.python_version()}",
        "versions": ", ".join(versions),
        "JAX device": f"{jax.devices()[0].platform}: {jax.devices()[0].device_kind}",
    }


def machine() -> dict[str, str]:
    """`about()`, printed and given back."""
    rows = about()
    print("\nMachine")
    for what, value in rows.items():
        line(what, value)
    return rows


def options(quick: str) -> argparse.Namespace:
    """`--quick`, which does what `quick` says, and `--out FOLDER`, which is made."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--quick", action="store_true", help=quick)
    parser.add_argument("--out", type=Path, metavar="FOLDER")
    chosen = parser.parse_args()
    if chosen.out is not None:
        chosen.out.mkdir(parents=True, exist_ok=True)
    return chosen


def table(path: Path, about: dict[str, str], columns: Iterable[str], rows: Iterable[Iterable[Any]]) -> None:
    """Writes comma-separated values, below comment lines that name the machine and the versions."""
    with path.open("w", newline="") as file:
        file.writelines(f"# {what}: {value}\n" for what, value in about.items())
        csv.writer(file).writerows([columns, *rows])


def stages(
    function: Callable, argument: Any, clock: Callable[[], float] = time.perf_counter
) -> tuple[Callable[[Any], Any], list[float]]:
    """`function` compiled for arguments like this one, and the seconds that tracing, lowering and compiling took."""
    jax.clear_caches()
    stage, times = jax.jit(function), []
    for proceed in (methodcaller("trace", argument), methodcaller("lower"), methodcaller("compile")):
        start = clock()
        stage = proceed(stage)
        times.append(clock() - start)
    return stage, times


def compiled(what: str, function: Callable, argument: Any) -> Callable[[], Any]:
    """`function(argument)` compiled with the times of the three stages printed."""
    run, times = stages(function, argument)
    line(what, "trace {:.2f} s, lower {:.2f} s, compile {:.2f} s".format(*times), f"{sum(times):.2f} s in all")
    return partial(run, argument)
