"""How fast the solver is: compile time apart from run time, gradients and batches beside one solve, SciPy beside all.

    python benchmarks/speed.py [--quick]

Needs SciPy (`pip install cosserat_jax[benchmarks]`) and the folder tests/ next to this one, for tests/reference.py. The
rod is the preset "octopus": a tapered arm in water, bent by one muscle.

- Compile time: `jax.jit(f).trace(scene)`, `.lower()`, `.compile()`, each timed once with JAX's caches cleared before and
  its persistent cache off. For sweeps: the first call less the median of the warm ones.
- Run time: median of calls that wait for their result, in brackets the quartiles; where a ratio follows, the two are
  called in turn, so that the machine's moods meet both alike. "Gradient" is of the tip's y with respect to every float of
  the scene, computed together with the whole `Solution`.
- Error: distance [m] of the tip's place from that of a tight solution, `Shooting(rtol=1e-12, atol=1e-12)`; the largest
  over the rods named. `solve_bvp` comes to the same places from another formulation of the same physics, so that its own
  error at its tightest tolerance vouches for the tight solution.
- `solve_bvp`: the reference formulation of the tests, on six rods of the 82, one after another in one process.
  "continued" raises the load from zero in steps as the tests do, collocating coarsely, and refines at the end; "cold"
  starts from the straight arm at full load and finds no equilibrium of some rods, which then do not count in its mean.
  Its error is steered by the tolerance: the ratio of a row is taken where the error is nearest to that row's.
"""

import dataclasses
import importlib.metadata
import os
import platform
import statistics
import sys
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import jax
import numpy as np

from cosserat_jax import Scene, Shooting, load, replace, solve, sweep

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
import reference  # noqa: E402

CLAIM = """\
Claim: at equal error a rod of the 82-rod sweep costs under 1/20 of scipy.integrate.solve_bvp, cold or continued;
       a solve with its gradient with respect to every float of the scene costs less than two solves."""

QUICK = "--quick" in sys.argv[1:]
GRID = {"muscles.0.tension": np.linspace(0.0, 20.0, 41), "water.velocity": np.array([0.2, 0.4])}
LARGE_GRID = {"muscles.0.tension": np.linspace(0.0, 20.0, 64), "water.velocity": np.linspace(0.1, 0.5, 64)}
COMPARED = np.linspace(0, 81, 6).round().astype(int)  # rods of GRID: 0, 4, .. 20 N, the first three in the slower water
OUR_TOLERANCES = (1e-6, 1e-9) if QUICK else (1e-6, 1e-7, 1e-8, 1e-9)
BVP_TOLERANCES = (1e-3, 1e-6, 1e-9) if QUICK else (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9)


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
    low, middle, high = (1e3 * quartile / per for quartile in statistics.quantiles(times, n=4, method="inclusive"))
    return f"{middle:9.3f} ms  [{low:.3f} .. {high:.3f}]"


def line(what: str, value: str, ratio: str = "") -> None:
    print(f"  {what:<46}{value:<40}{ratio}".rstrip(), flush=True)


def machine() -> None:
    """Processor, versions and the device that JAX runs on."""
    info = Path("/proc/cpuinfo")
    models = [row.split(":", 1)[1].strip() for row in info.read_text().splitlines() if row.startswith("model name")] \
        if info.exists() else []  # fmt: skip
    versions = [f"{name} {importlib.metadata.version(name)}" for name in ("jax", "jaxlib", "diffrax", "numpy", "scipy")]
    device = jax.devices()[0]
    print("\nMachine")
    line("processor", f"{models[0] if models else platform.processor()}, {os.cpu_count()} cores")
    line("system", f"{platform.platform()}, Python {platform.python_version()}")
    line("versions", ", ".join(versions))
    line("JAX device", f"{device.platform}: {device.device_kind}, {len(jax.devices())} in all")


def compiled(what: str, function: Callable, scene: Scene) -> Callable[[], Any]:
    """`function(scene)` compiled with the times of the three stages printed."""
    jax.clear_caches()
    start = time.perf_counter()
    traced = jax.jit(function).trace(scene)
    after_trace = time.perf_counter()
    lowered = traced.lower()
    after_lower = time.perf_counter()
    program = lowered.compile()
    trace, lower, built = after_trace - start, after_lower - after_trace, time.perf_counter() - after_lower
    line(what, f"trace {trace:.2f} s + lower {lower:.2f} s, compile {built:.2f} s", f"{trace + lower + built:.2f} s in all")
    return lambda: program(scene)


def one_rod(scene: Scene) -> float:
    """Prints compile and run time of one rod and its gradient; ratio of value and gradient to a solve."""

    def whole(scene: Scene):
        return solve(scene, throw=False)

    def tip_height(scene: Scene):
        solution = whole(scene)
        return solution.tip.y, solution

    print("\nCompile time, one rod")
    run = compiled("solve (first in the process)", whole, scene)
    run_gradient = compiled("value and gradient", jax.value_and_grad(tip_height, has_aux=True), scene)
    plain, gradient, called = in_turn(run, run_gradient, lambda: solve(scene), repeats=5 if QUICK else 25)
    ratio = statistics.median(gradient) / statistics.median(plain)
    print("\nRun time, one rod")
    line("solve, compiled", spread(plain), "1")
    line(f"value and gradient by {len(jax.tree.leaves(scene))} floats", spread(gradient), f"{ratio:.2f} solves")
    line("solve(scene) as called, edge in Python included", spread(called), ratio_of(called, plain, "solves"))
    return ratio


def ratio_of(times: list[float], baseline: list[float], unit: str) -> str:
    return f"{statistics.median(times) / statistics.median(baseline):.2f} {unit}"


def batches(scene: Scene) -> None:
    """Prints first and warm time of the two sweeps at the default tolerances."""
    print("\nSweeps, default method, Python included")
    one = in_turn(lambda: solve(scene), repeats=5 if QUICK else 15)[0]
    for grid in (GRID,) if QUICK else (GRID, LARGE_GRID):
        count = int(np.prod([len(values) for values in grid.values()]))
        first = seconds(lambda grid=grid: sweep(scene, grid).solution)
        times = in_turn(lambda grid=grid: sweep(scene, grid).solution, repeats=3 if count > 1000 else 15)[0]
        line(f"{count} rods: trace, lower and compile", f"{first - statistics.median(times):9.2f} s")
        line(f"{count} rods in batches of {min(count, 1024)}: all", spread(times))
        line(f"{count} rods: per rod", spread(times, count), ratio_of([t / count for t in times], one, "solve(scene)"))


def collocated(rods: list[dict], exact: np.ndarray, cold: bool) -> dict[float, tuple[float, float]]:
    """`solve_bvp` at each tolerance: {tol: (largest tip error [m], mean over the rods of their median time [s])}."""
    start, found = "cold" if cold else "continued", {}
    for tol in BVP_TOLERANCES:
        errors, times = [], []
        for rod, place in zip(rods, exact, strict=True):
            samples = []
            for _ in range(1 if QUICK else 3):
                begun = time.perf_counter()
                tip = reference.solve(rod, tol=tol, cold=cold)
                samples.append(time.perf_counter() - begun)
            if tip.converged:
                errors.append(float(np.hypot(tip.x - place[0], tip.y - place[1])))
                times.append(statistics.median(samples))
        count = f"{len(times)} of {len(rods)} rods found"
        if times:
            found[tol] = max(errors), statistics.fmean(times)
            count = f"{max(errors):.1e} m   {1e3 * found[tol][1]:9.3f} ms a rod   " + count
        line(f"solve_bvp {start}, tol {tol:.0e}", count)
    return found


def against_scipy(scene: Scene) -> float:
    """Prints error and time of both; the smallest ratio of time per rod at equal error."""

    def places(method: Shooting) -> tuple[np.ndarray, list[float]]:
        tip = sweep(scene, GRID, method).solution.tip
        times = in_turn(lambda: sweep(scene, GRID, method).solution, repeats=5 if QUICK else 15)[0]
        return np.stack([tip.x.ravel(), tip.y.ravel()], axis=1), times

    print(f"\nsolve_bvp on {len(COMPARED)} of the 82 rods: largest tip error, mean time")
    exact, _ = places(Shooting(rtol=1e-12, atol=1e-12))
    tension, velocity = (axis.ravel() for axis in np.meshgrid(*GRID.values(), indexing="ij"))
    scenes = [replace(scene, {"muscles.0.tension": tension[i], "water.velocity": velocity[i]}) for i in COMPARED]
    rods = [without_none(dataclasses.asdict(rod)) for rod in scenes]
    scipy_results = {start: collocated(rods, exact[COMPARED], start == "cold") for start in ("continued", "cold")}

    print("\ncosserat_jax on all 82 rods in one batch, and how many times as long solve_bvp takes per rod at equal error")
    ratios = []
    for tol in OUR_TOLERANCES:
        tips, times = places(Shooting(rtol=tol, atol=tol))
        errors = np.hypot(*(tips - exact).T)
        here, rod_time = errors[COMPARED].max(), statistics.median(times) / len(exact)
        beside = []
        for start, found in scipy_results.items():
            equal = min(found, key=lambda other: abs(np.log(found[other][0] / here)))
            ratios.append(found[equal][1] / rod_time)
            beside.append(f"{ratios[-1]:.0f} x {start} (tol {equal:.0e}, {found[equal][0]:.1e} m)")
        line(f"rtol = atol = {tol:.0e}: error, of those {len(COMPARED)}", f"{errors.max():.1e} m, {here:.1e} m")
        line("  82 rods", spread(times), f"{1e3 * rod_time:.3f} ms a rod")
        line("  solve_bvp at equal error", "; ".join(beside))
    return min(ratios)


def without_none(part: Any) -> Any:
    """The reference takes an absent entry for its default, where the package holds None."""
    if isinstance(part, dict):
        return {name: without_none(entry) for name, entry in part.items() if entry is not None}
    return [without_none(entry) for entry in part] if isinstance(part, Iterable) and not isinstance(part, str) else part


if __name__ == "__main__":
    print(CLAIM)
    jax.config.update("jax_enable_compilation_cache", False)
    machine()
    octopus = load("octopus")
    gradient_ratio = one_rod(octopus)
    batches(octopus)
    scipy_ratio = against_scipy(octopus)
    held = gradient_ratio < 2 and scipy_ratio > 20
    print(f"\nThe claim {'held' if held else 'DID NOT HOLD'} in this run: solve_bvp took at least {scipy_ratio:.0f} times")
    print(f"as long per rod at equal error, value and gradient took {gradient_ratio:.2f} solves.")
