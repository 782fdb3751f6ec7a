"""How fast the package is: compile time, solves, batches, derivatives, other solvers, one table after another.

    python benchmarks/throughput.py [--quick] [--out FILE.csv|FILE.md] [--floor FILE.cpp]

Needs the folder tests/ next to this one, for tests/reference.py. The rod is the preset "octopus" unless another is
named: a tapered arm in water, bent by one muscle.

- Time is CPU time, all threads counted, so that other work on the machine adds little to it; "wall" is by the clock.
  Calls compared by a ratio are taken in turn; a row gives the least and the median of the rounds. What takes long sits
  out some of them.
- Compile time: `jax.jit(solve).trace`, `.lower` and `.compile`, JAX's caches cleared before. The persistent cache is
  off, but for the two commands that say so: they share a folder, empty at first.
- Memory: the most that the process has held so far, so of use where it grows from row to row.
- Derivatives come together with the whole `Solution`, as a plain solve gives it. In the batch of 256 rods every float
  of the scene has an entry a rod.
- Other solvers: see other_solvers.py. The error is the distance of the tip from that of the reference formulation of
  the tests at a tolerance of 1e-10, for the tendon robot from the ten digits in tests/test_benchmarks.py. What is
  compiled or imported is so before the clock starts.
- `--floor`: a C++ program that prints what a rod of the sweep takes at the least, as "12.3 us/rod", of which the
  smallest number counts. It is compiled by `g++ -O3 -march=native -ffast-math` and run before and after the rounds;
  the tables then say how many times as long a rod takes here.
"""

import argparse
import csv
import dataclasses
import importlib.util
import io
import os
import re
import resource
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import time
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np
from collocation import plain, reference
from other_solvers import SCENES, TIPS, TRIALS
from timing import about, cpu, cpu_in_turn, stages

from cosserat_jax import Gravity, Muscle, Scene, load_scene, parameters, replace, solve, sweep
from cosserat_jax.scene.quantity import as_floats

OCTOPUS = load_scene("octopus")
OWN_SWEEP = {"muscles.0.tension": np.linspace(0.0, 20.0, 41), "water.velocity": np.array([0.2, 0.4])}  # the preset's
SIZES = (1024, 4096, 65536)
BATCH = 256
VARIED = (
    "muscles.0.tension", "water.velocity", "arm.youngs_modulus", "arm.length", "arm.base_radius", "arm.tip_radius",
    "muscles.0.base_offset", "water.density",
)  # fmt: skip


def full_scene() -> Scene:
    """The octopus arm in a shear current, under its weight, with three muscles that make two segments."""
    water = dataclasses.replace(OCTOPUS.water, velocity_gradient=0.1)
    muscles = (
        Muscle(base_offset=0.012, end_offset=0.001, tension=10.0),
        Muscle(base_offset=0.010, end_offset=0.005, tension=5.0, end=0.2, side=-1),
        Muscle(base_offset=0.010, end_offset=0.005, tension=2.0, end=0.2),
    )
    return dataclasses.replace(OCTOPUS, water=water, gravity=Gravity(9.81), muscles=muscles)


def grid(count: int) -> dict[str, np.ndarray]:
    """Tension times velocity, `count` rods of them."""
    side = round(count**0.5)
    return {"muscles.0.tension": np.linspace(0.0, 20.0, side), "water.velocity": np.linspace(0.1, 0.5, side)}


def rods(over: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The values of each rod of a grid."""
    return {path: axis.ravel() for path, axis in zip(over, np.meshgrid(*over.values(), indexing="ij"), strict=True)}


def peak() -> float:
    """The most memory that this process has held [MiB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024 ** (2 if sys.platform == "darwin" else 1)


class Report:
    """Prints tables as they come, and keeps the file up to date."""

    def __init__(self, path: Path | None) -> None:
        self.path, self.text = path, io.StringIO()

    def table(self, title: str, columns: Iterable[str], rows: Iterable[Iterable[Any]]) -> None:
        """One table; numbers are rounded to four digits."""
        rows = [list(row) for row in rows]
        cells = [list(columns), *([_shown(cell) for cell in row] for row in rows)]
        widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
        numeric = [any(isinstance(cell, float | int) for cell in column) for column in zip(*rows, strict=True)]
        sides = [">" if of_numbers else "<" for of_numbers in numeric]
        print(f"\n{title}")
        for row in cells:
            aligned = [f"{cell:{side}{width}}" for cell, side, width in zip(row, sides, widths, strict=True)]
            print("  " + "  ".join(aligned).rstrip(), flush=True)
        if self.path is None:
            return
        if self.path.suffix == ".md":
            body = [cells[0], ["---:" if side == ">" else "---" for side in sides], *cells[1:]]
            self.text.write(f"## {title}\n\n" + "".join(f"| {' | '.join(row)} |\n" for row in body) + "\n")
        else:
            self.text.write(f"# {title}\n")
            csv.writer(self.text, lineterminator="\n").writerows([*cells, []])
        self.path.write_text(self.text.getvalue())


def _shown(cell: Any) -> str:
    if not isinstance(cell, float):
        return str(cell)
    return np.format_float_positional(cell, precision=4, unique=False, fractional=False, trim="-")


def compile_times(report: Report) -> None:
    """Of the program that solves one rod."""
    rows = []
    for name, scene in {"octopus": OCTOPUS, "two-segments": load_scene("two-segments"), "full": full_scene()}.items():
        times = stages(lambda scene: solve(scene, throw=False), as_floats(scene), time.process_time)[1]
        jax.clear_caches()
        wall = time.perf_counter()
        first = cpu(partial(solve, scene, throw=False))
        wall = time.perf_counter() - wall
        rows.append([name, *times, sum(times), first, wall, "yes" if solve(scene, throw=False).converged else "NO"])
    columns = ("scene", "trace, s", "lower, s", "compile, s", "all three, s", "first call, s", "s wall", "converged")
    report.table("Compile time of a solve", columns, rows)


def process(command: list[str], **environment: str) -> tuple[float, float]:
    """CPU and wall seconds of a process from start to end."""

    def spent() -> float:
        usage = resource.getrusage(resource.RUSAGE_CHILDREN)
        return usage.ru_utime + usage.ru_stime

    wall, cpu = time.perf_counter(), spent()
    subprocess.run(command, env=os.environ | environment, stdout=subprocess.DEVNULL, check=True)
    return spent() - cpu, time.perf_counter() - wall


def process_times(report: Report) -> None:
    """Of the command line, beside what it imports."""
    command = [shutil.which("cosserat-jax", path=sysconfig.get_path("scripts")), "solve", "octopus"]
    off = {"JAX_ENABLE_COMPILATION_CACHE": "false"}
    rows = [
        [f'python -c "{code}"', *process([sys.executable, "-c", code])]
        for code in ("import jax, diffrax", "import cosserat_jax")
    ]
    rows += [[f"cosserat-jax solve octopus, no cache, run {i}", *process(command, **off)] for i in (1, 2)]
    with tempfile.TemporaryDirectory() as folder:
        on = {
            "JAX_ENABLE_COMPILATION_CACHE": "true", "JAX_COMPILATION_CACHE_DIR": folder,
            "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0", "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
        }  # fmt: skip
        for what in ("fills the cache", "reads the cache"):
            rows.append([f"cosserat-jax solve octopus, {what}", *process(command, **on)])
    report.table("Whole processes", ("process", "s", "s wall"), rows)


class Floor:
    """What a rod takes at the least, by a C++ program: the unit of a column, left out where there is no program."""

    def __init__(self, source: Path | None) -> None:
        self.folder = tempfile.TemporaryDirectory()
        self.program = None if source is None else Path(self.folder.name) / "floor"
        self.least = np.inf
        if source is not None:
            subprocess.run(["g++", "-O3", "-march=native", "-ffast-math", source, "-o", self.program], check=True)

    def measure(self) -> None:
        """One run of the program."""
        if self.program is not None:
            text = subprocess.run([self.program], check=True, capture_output=True, text=True).stdout
            self.least = min([self.least, *map(float, re.findall(r"([\d.]+) us/rod", text))])

    def columns(self) -> list[str]:
        """The heading of the column."""
        return [] if self.program is None else [f"times C++ ({self.least:.3g} us)"]

    def cells(self, microseconds: float) -> list[float]:
        """The cell of a row."""
        return [] if self.program is None else [microseconds / self.least]


def measured(calls: dict[str, Callable[[], Any]], floor: Floor, repeats: int) -> dict[str, list[float]]:
    """CPU microseconds of the calls taken in turn, the floor before and after."""
    floor.measure()
    samples = cpu_in_turn(calls, repeats)
    floor.measure()
    return {name: [1e6 * sample for sample in of_call] for name, of_call in samples.items()}


def batches(report: Report, floor: Floor, quick: bool) -> None:
    """One rod and many."""
    floats, many = as_floats(OCTOPUS), rods(grid(1024))
    one = jax.jit(lambda scene: solve(scene, throw=False))
    mapped = jax.jit(jax.vmap(lambda scene, one: solve(replace(scene, one), throw=False), in_axes=(None, 0)))
    overs = {"82 rods, the preset's own": OWN_SWEEP} | {f"{n} rods": grid(n) for n in (SIZES[:1] if quick else SIZES)}
    calls: dict[str, tuple[int, Callable[[], Any]]] = {
        "solve(scene)": (1, partial(solve, OCTOPUS)),
        "jit(solve)(scene)": (1, partial(one, floats)),
        **{f"sweep of {name}": (len(rods(over)["water.velocity"]), partial(sweep, OCTOPUS, over))
           for name, over in overs.items()},
        "jit(vmap(solve)) of 1024 rods": (1024, partial(mapped, floats, many)),
    }  # fmt: skip
    firsts, peaks = {}, {}
    for name, (_, call) in calls.items():
        firsts[name], peaks[name] = cpu(call), peak()
    samples = measured({name: call for name, (_, call) in calls.items()}, floor, 3 if quick else 7)
    rows = []
    for name, (count, _) in calls.items():
        least, median = np.min(samples[name]) / count, np.median(samples[name]) / count
        rows.append([name, firsts[name], least, median, len(samples[name]), peaks[name], *floor.cells(least)])
    columns = ("call", "first call, s", "us a rod, least", "us, median", "rounds", "peak MiB")
    report.table("One rod and many", [*columns, *floor.columns()], rows)


def derivatives(report: Report, floor: Floor, quick: bool) -> None:
    """Gradient and Jacobians, in plain solves."""
    floats, paths = as_floats(OCTOPUS), list(parameters(OCTOPUS))
    scenes = jax.vmap(lambda one: as_floats(replace(floats, one)))(rods(grid(BATCH)))

    def plain_solve(scene: Scene) -> Any:
        return solve(scene, throw=False)

    def height(scene: Scene) -> Any:
        solution = solve(scene, throw=False)
        return solution.tip.y, solution

    def pose_by(names: Iterable[str], scene: Scene) -> Any:
        def pose(values: dict) -> Any:
            solution = solve(replace(scene, values), throw=False)
            return (solution.tip.x, solution.tip.y, solution.tip.theta), solution

        given = parameters(scene)
        return jax.jacfwd(pose, has_aux=True)({name: given[name] for name in names})

    gradient = jax.value_and_grad(height, has_aux=True)
    jacobians = [VARIED[:1], paths] if quick else [VARIED[:1], VARIED[:2], VARIED, paths]
    functions = {
        "plain solve": plain_solve,
        f"value and gradient of tip.y by all {len(paths)}": gradient,
        **{f"Jacobian of the tip's pose by {len(names)}": partial(pose_by, names) for names in jacobians},
    }
    rows = []
    for what, count, argument, wrap in (
        ("one rod", 1, floats, lambda f: f),
        (f"{BATCH} rods", BATCH, scenes, jax.vmap),
    ):
        calls = {name: partial(jax.jit(wrap(function)), argument) for name, function in functions.items()}
        if count == 1:
            calls["value and gradient as called, no jit"] = partial(gradient, floats)
        firsts = {name: cpu(call) for name, call in calls.items()}
        samples = measured(calls, floor, 3 if quick else 9)
        base = samples["plain solve"]
        for name, times in samples.items():
            least, median = np.min(times), np.median(times)
            ratios = least / np.min(base), median / np.median(base)
            times_a_rod = least / count, median / count
            rows.append([f"{name}, {what}", firsts[name], *times_a_rod, *ratios, *floor.cells(least / count)])
    columns = ("derivative", "first call, s", "us a rod, least", "us, median", "in solves, least", "in solves, median")
    report.table("Derivatives", [*columns, *floor.columns()], rows)


def other_solvers(report: Report, quick: bool) -> None:
    """Error and time of other solvers, beside ours."""
    columns = ("scene", "solver", "error of the tip, m", "ms a rod, least", "ms, median", "in our solves")
    ours, swept = "cosserat_jax, solve", "cosserat_jax, sweep of 82"
    rows = []
    for name, scene in SCENES.items():
        truth = TIPS[name] if name in TIPS else _reference_tip(scene)
        calls: dict[str, Callable[[], Any]] = {ours: partial(_tip, scene)}
        if name == "octopus":
            calls[swept] = partial(_swept_tip, scene)
        missing = []
        for trial in (trial for trial in TRIALS if trial.scene == name):
            if importlib.util.find_spec(trial.module) is None:
                missing.append([name, trial.package, "not installed", "", "", ""])
                continue
            for value in trial.values[:1] if quick else trial.values:
                calls[f"{trial.package}, {value:g} {trial.setting}"] = trial.solver(scene, value)
        errors = {solver: float(np.hypot(*np.subtract(call(), truth))) for solver, call in calls.items()}
        samples = cpu_in_turn(calls, 3 if quick else 7, limit=5.0)
        for solver, times in samples.items():
            milliseconds = 1e3 * np.array(times) / (82 if solver == swept else 1)
            least, median = milliseconds.min(), np.median(milliseconds)
            ratio = least / (1e3 * np.min(samples[ours]))
            rows.append([name, solver, f"{errors[solver]:.1e}", least, median, ratio])
        rows += missing
    report.table("Other solvers, one rod", columns, rows)


def _reference_tip(scene: Scene) -> tuple[float, float]:
    found = reference.solve(plain(scene), tol=1e-10)
    return found.x, found.y


def _tip(scene: Scene) -> tuple[float, float]:
    tip = solve(scene).tip
    return float(tip.x), float(tip.y)


def _swept_tip(scene: Scene) -> tuple[float, float]:
    tip = sweep(scene, OWN_SWEEP).solution.tip  # of which the scene is the rod of the last tension, the first velocity
    return float(tip.x[-1, 0]), float(tip.y[-1, 0])


def main() -> None:
    """All tables."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--quick", action="store_true", help="fewer rods, derivatives, settings and rounds")
    parser.add_argument("--out", type=Path, metavar="FILE", help="the tables as .csv or .md")
    parser.add_argument("--floor", type=Path, metavar="FILE.cpp", help="the program whose time is the unit of a column")
    chosen = parser.parse_args()
    if chosen.out is not None and chosen.out.suffix not in (".csv", ".md"):
        parser.error(f"--out: {chosen.out} ends neither in .csv nor in .md")
    if chosen.floor is not None and shutil.which("g++") is None:
        parser.error("--floor: needs g++")
    report, floor = Report(chosen.out), Floor(chosen.floor)
    jax.config.update("jax_enable_compilation_cache", False)
    report.table("Machine", ("what", "which"), about().items())
    compile_times(report)
    process_times(report)
    batches(report, floor, chosen.quick)
    derivatives(report, floor, chosen.quick)
    other_solvers(report, chosen.quick)


if __name__ == "__main__":
    main()
