"""What the benchmarks share: the machine, compile time by stages, run times taken in turn, and the lines they print."""

import importlib.metadata
import os
import platform
import time
from collections.abc import Callable
from functools import partial
from operator import methodcaller
from pathlib import Path
from typing import Any

import jax
import numpy as np


def seconds(call: Callable[[], Any]) -> float:
    """Of one call, until its result is there."""
    start = time.perf_counter()
    jax.block_until_ready(call())
    return time.perf_counter() - start


def in_turn(*calls: Callable[[], Any], repeats: int) -> list[list[float]]:
    """Seconds of `repeats` warm calls of each, taken in turn."""
    for call in calls:
        jax.block_until_ready(call())
    rounds = [[seconds(call) for call in calls] for _ in range(repeats)]
    return [list(times) for times in zip(*rounds, strict=True)]


def spread(times: list[float], per: int = 1) -> str:
    """Median and quartiles in milliseconds."""
    low, middle, high = 1e3 / per * np.quantile(times, [0.25, 0.5, 0.75])
    return f"{middle:9.3f} ms  [{low:.3f} .. {high:.3f}]"


def line(what: str, value: str, ratio: str = "") -> None:
    print(f"  {what:<48} {value:<52} {ratio}".rstrip(), flush=True)


def machine() -> None:
    """Processor, versions and the device that JAX runs on."""
    rows = info.read_text().splitlines() if (info := Path("/proc/cpuinfo")).exists() else []
    models = [row.split(":", 1)[1].strip() for row in rows if row.startswith("model name")]
    versions = [f"{name} {importlib.metadata.version(name)}" for name in ("jax", "jaxlib", "diffrax", "numpy", "scipy")]
    print("\nMachine")
    line("processor", f"{models[0] if models else platform.processor()}, {os.cpu_count()} cores")
    line("system", f"{platform.platform()}, Python {platform.python_version()}")
    line("versions", ", ".join(versions))
    line("JAX device", f"{jax.devices()[0].platform}: {jax.devices()[0].device_kind}")


def stages(function: Callable, argument: Any) -> tuple[Callable[[Any], Any], list[float]]:
    """`function` compiled for arguments like this one, and the seconds that tracing, lowering and compiling took."""
    jax.clear_caches()
    stage, times = jax.jit(function), []
    for proceed in (methodcaller("trace", argument), methodcaller("lower"), methodcaller("compile")):
        start = time.perf_counter()
        stage = proceed(stage)
        times.append(time.perf_counter() - start)
    return stage, times


def compiled(what: str, function: Callable, argument: Any) -> Callable[[], Any]:
    """`function(argument)` compiled with the times of the three stages printed."""
    run, times = stages(function, argument)
    line(what, "trace {:.2f} s, lower {:.2f} s, compile {:.2f} s".format(*times), f"{sum(times):.2f} s in all")
    return partial(run, argument)
