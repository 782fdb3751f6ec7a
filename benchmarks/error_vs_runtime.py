"""Error against run time of `solve`: three Runge-Kutta methods over numbers of steps, one rod and a batch, four scenes.

    python benchmarks/error_vs_runtime.py [--quick] [--out FOLDER]

Needs SciPy and the folder tests/ next to this one, for tests/reference.py.

- Scenes: (a) the preset "octopus"; (b) a slender soft arm in air, hanging from its base; (c) the octopus in 1 m/s of
  current; (d) an arm of 1 GPa that tapers to 1 mm. (b) and (d) have three muscles, two of which end before the tip.
- A batch is 64 rods of the scene, all tensions times factors from 0 to 1; its time is per rod, its error the largest.
- Runs: `SingleShooting(steps=(n, n + 2))` in each segment between muscle ends, the branch followed on a third as many,
  at least three; its solution is that of n + 2 steps. The number is data, so that one program serves all of a solver.
  Beside them the default, `Automatic()`, as `solve` and `sweep` call it.
- Error: of the tip, the largest of x / L, y / L and theta, as `Solution.error` estimates it; of the fields, the largest
  at 21 points of x / L, y / L, theta, beta and mu L. What is exact comes from Dopri8 in 256 steps and is vouched for by
  `solve_bvp`.
- Run time: as called, compiled, median of calls taken in turn, quartiles in brackets; a call of over 1 s is timed once.
- First call: of each program, with its compilation, JAX's persistent cache off.
- `solve_bvp`: the reference formulation of the tests, one rod, load raised in steps ("load-stepped") and from the
  straight arm at full load ("cold"), timed once.
- `--out` writes error_vs_runtime.csv, and .._one.png and .._batch.png, which show the error of the tip.
"""

from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import diffrax
import jax
import numpy as np
from collocation import plain, reference
from matplotlib.figure import Figure
from timing import in_turn, line, machine, options, spread, table, timed

from cosserat_jax import Arm, Automatic, Gravity, Muscle, Scene, SingleShooting, Solution, load_scene, replace, solve
from cosserat_jax.solver import Method, outcome_codes
from cosserat_jax.solver.solve import places_of
from cosserat_jax.study.batch import solve_rods

CLAIM = """\
Claim: on every scene, for one rod and for a batch, the default takes at most twice the time of the fastest run of no
       larger error of the tip, and its estimated error is no smaller than the true one, where that is above 1e-12."""


def in_air(length: float, radii: tuple[float, float], modulus: float, muscles: list[tuple]) -> Scene:
    """An arm under its weight; a muscle is (tension, end in lengths of the arm, base offset, end offset, side)."""
    names = ("tension", "end", "base_offset", "end_offset", "side")
    given = [dict(zip(names, muscle, strict=True)) for muscle in muscles]
    return Scene(
        arm=Arm(length, *radii, density=1100.0, youngs_modulus=modulus, poisson_ratio=0.5),
        muscles=tuple(Muscle(**muscle | {"end": muscle["end"] and length * muscle["end"]}) for muscle in given),
        gravity=Gravity(9.81),
    )


SOFT = [(1.0, 0.69, 0.006, 0.0025, 1), (0.1, None, 0.006, 0.0015, -1), (0.3, 0.42, 0.006, 0.004, 1)]
HARD = [(600.0, 0.69, 0.012, 0.002, 1), (100.0, None, 0.012, 0.0008, -1), (150.0, 0.46, 0.012, 0.005, 1)]
SCENES = {
    "(a) octopus": load_scene("octopus"),
    "(b) slender, soft, in air": in_air(0.4, (0.008, 0.002), 1e6, SOFT),
    "(c) strong current": replace(load_scene("octopus"), {"water.velocity": 1.0}),
    "(d) stiff": in_air(0.418, (0.015, 0.001), 1e9, HARD),
}
SOLVERS = {name: getattr(diffrax, name)() for name in ("Dopri8", "Dopri5", "Tsit5")}
STEPS = (6, 7, 8, 10, 12, 14, 16, 20, 24, 28, 34, 40)
RODS, POINTS, EXACT = 64, 21, 256
TIMED_ONCE, ROUNDING = 1.0, 1e-12


class Fixed(SingleShooting):
    """`SingleShooting` with room for more steps, so that one program serves all."""

    @property
    def rooms(self) -> tuple[int, int]:
        most, coarse = super().rooms
        return max(STEPS[-1] + 2, most), max(STEPS[-1] // 3, coarse)


def fixed(solver: str, steps: int) -> Method:
    """The method that ends on this number of steps, whatever the error is estimated to be."""
    fewer = (steps - 2, steps)
    return Fixed(np.inf, steps=fewer, coarse_steps=max(3, fewer[0] // 3), solver=SOLVERS[solver])


class Run(NamedTuple):
    """One way to solve one scene; errors are NaN unless every rod converged, the time is per rod.

    `control` is "fixed" with so many steps, or the "default"; of `solve_bvp` "load-stepped" or "cold" at a tolerance.
    """

    scene: str
    rods: int
    solver: str
    control: str
    setting: float
    tip_error: float
    estimated: float
    fields_error: float
    milliseconds: float
    outcome: str
    first_call_s: float = np.nan

    @property
    def name(self) -> str:
        """What is run."""
        if self.control == "fixed":
            return f"{self.solver}, {self.setting:.0f} steps"
        return "the default" if self.control == "default" else f"{self.solver} {self.setting:.0e}, {self.control}"


def call_of(scene: Scene, method: Method | None, rods: int) -> Callable[[], Solution]:
    """Solves the scene, or a batch of it, as `solve` and `sweep` do."""
    if rods == 1:
        return partial(solve, scene, method, points=POINTS, throw=False)
    factors = np.linspace(0.0, 1.0, rods)
    pulled = {f"muscles.{i}.tension": muscle.tension * factors for i, muscle in enumerate(scene.muscles)}
    return partial(solve_rods, replace(scene, pulled), method, places_of(POINTS), rods)


def scaled(fields: Any, length: float) -> np.ndarray:
    """x / L, y / L, theta, beta, mu L, of shape (5, [rods,] points)."""
    scales = {"x": length, "y": length, "theta": 1.0, "beta": 1.0, "mu": 1 / length}
    return np.stack([np.asarray(getattr(fields, name), float) / scale for name, scale in scales.items()])


def errors(ours: np.ndarray, exact: np.ndarray) -> tuple[float, float]:
    """The largest of the tip and of the fields; NaN where a rod has no solution."""
    gap = np.abs(ours - exact)
    return float(np.max(gap[:3, ..., -1])), float(np.max(gap))


def outcome_of(solution: Solution) -> str:
    names = {code: name for name, code in outcome_codes().items()}
    counts = Counter(names[int(code)] for code in np.ravel(solution.outcome._value))
    return ", ".join(f"{count} {name}" for name, count in counts.items()) if len(counts) > 1 else next(iter(counts))


def exact_batch(scene: Scene) -> np.ndarray:
    """The fields of the batch, the scene itself last."""
    found = call_of(scene, fixed("Dopri8", EXACT), RODS)()
    return scaled(found.fields, float(scene.arm.length))


def collocated(name: str, exact: np.ndarray, quick: bool) -> list[Run]:
    """`solve_bvp` on the scene, load-stepped and cold."""
    scene, runs = SCENES[name], []
    for cold in (False, True):
        for tol in (1e-3, 1e-9) if quick or cold else (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9):
            found, spent = timed(partial(reference.solve, plain(scene), tol, cold))
            along = found.fields(np.linspace(0.0, scene.arm.length, POINTS))
            ours = np.stack([along[key] for key in ("x", "y", "theta", "beta", "mu")])
            ours *= np.array([1 / scene.arm.length, 1 / scene.arm.length, 1, 1, scene.arm.length])[:, None]
            tip, fields = errors(ours, exact) if found.converged else (np.nan, np.nan)
            control = "cold" if cold else "load-stepped"
            runs.append(Run(name, 1, "solve_bvp", control, tol, tip, np.nan, fields, 1e3 * spent, found.message))
            shown(runs[-1], f"{1e3 * spent:9.3f} ms  once")
    return runs


def shown(run: Run, timing: str) -> None:
    """Prints one run, or why it has no errors."""
    if np.isnan(run.tip_error):
        line(run.name, run.outcome, timing)
    else:
        estimated = "       " if np.isnan(run.estimated) else f"{run.estimated:.1e}"
        line(run.name, f"{run.tip_error:.1e}   {estimated}   {run.fields_error:.1e}", timing)


def measured(name: str, rods: int, exact: np.ndarray, quick: bool) -> list[Run]:
    """Prints and returns what every method does on one rod or a batch of one scene."""
    scene, runs, calls, known = SCENES[name], [], {}, set()
    what = "one rod" if rods == 1 else f"{rods} rods, time per rod"
    print(f"\n{name}, {what}: error of the tip, as estimated, of the fields, run time")
    ways: list[tuple[str, str, float, Method]] = [("Dopri8", "default", Automatic().error, Automatic())]
    for solver in list(SOLVERS)[: 2 if quick else None]:
        ways += [(solver, "fixed", n + 2, fixed(solver, n + 2)) for n in (STEPS[::3] if quick else STEPS)]
    for solver, control, setting, method in ways:
        call = call_of(scene, method, rods)
        first = np.nan
        if (solver, control) not in known:
            _, first = timed(call)
            known.add((solver, control))
        found, once = timed(call)
        if once < TIMED_ONCE:
            calls[len(runs)] = call
        tip, fields = errors(scaled(found.fields, float(scene.arm.length)), exact)
        estimated = float(np.max(found.error))
        row = (tip, estimated, fields, 1e3 * once / rods, outcome_of(found), first)
        runs.append(Run(name, rods, solver, control, setting, *row))
    samples = dict(zip(calls, in_turn(*calls.values(), repeats=5 if quick else 9), strict=True))
    for i, run in enumerate(runs):
        timing = f"{run.milliseconds:9.3f} ms  once"
        if i in samples:
            runs[i] = run._replace(milliseconds=1e3 * float(np.median(samples[i])) / rods)
            timing = spread(samples[i], rods)
        shown(runs[i], timing)
    return runs


def first_calls(runs: list[Run]) -> None:
    """Prints the median and the range over the programs of each kind."""
    print("\nFirst call, compilation included")
    kinds: dict[str, list[float]] = {}
    for run in runs:
        if run.first_call_s > 1.0:  # else compiled for a scene before
            rods = "one rod" if run.rods == 1 else f"{run.rods} rods"
            kinds.setdefault(f"{run.solver}, {run.control}, {rods}", []).append(run.first_call_s)
    for kind, spent in kinds.items():
        line(kind, f"{np.median(spent):9.2f} s  [{min(spent):.2f} .. {max(spent):.2f}]", f"{len(spent)} programs")


def judged(runs: list[Run], error: str) -> float:
    """Prints the default beside the fastest of no larger error, and the fastest at 1e-6 and 1e-9; the worst ratio."""
    ratios = []
    print(f"\nBy the error of the {error.removesuffix('_error')}")
    for default in (run for run in runs if run.control == "default"):
        rivals = [run for run in runs if (run.scene, run.rods) == (default.scene, default.rods)]
        what = f"{default.scene}, {default.rods} rod{'s' if default.rods > 1 else ''}"
        limits = {"the default's error": getattr(default, error), "1e-06": 1e-6, "1e-09": 1e-9}
        for limit, value in limits.items():
            able = [run for run in rivals if getattr(run, error) <= value]
            if not able:
                line(f"{what}: {limit}", "none reaches it")
                continue
            best = min(able, key=lambda run: run.milliseconds)
            ratio = default.milliseconds / best.milliseconds
            ratios += [ratio] if value == getattr(default, error) else []
            within = getattr(default, error) <= value
            beside = f"default {ratio:.2f} times" if within else "the default does not reach it"
            line(f"{what}: {limit}", f"{best.milliseconds:9.3f} ms   {best.name}", beside)
    return max(ratios)


def estimates(runs: list[Run]) -> bool:
    """Prints estimated over true errors where these are more than rounding; whether the default's were none too low."""
    print("\nEstimated over true error of the tip, where that is above 1e-12")
    for control in ("default", "fixed"):
        for solver in SOLVERS:
            some = [run for run in runs if (run.solver, run.control) == (solver, control) and run.tip_error > ROUNDING]
            if some:
                ratios = np.array([run.estimated / run.tip_error for run in some])
                value = f"{np.median(ratios):.3g} in the median, {ratios.min():.3g} to {ratios.max():.3g}"
                line(f"{solver}, {control}", value, f"below 1 in {(ratios < 1).sum()} of {len(some)} runs")
    defaults = [run for run in runs if run.control == "default"]
    return all(run.estimated >= run.tip_error or run.tip_error < ROUNDING for run in defaults)


def drawn(path: Path, runs: list[Run], rods: int) -> None:
    """Run time over the error of the tip, true and estimated, one panel a scene."""
    shapes = dict(zip(SOLVERS, (("o", "0"), ("s", "0.65"), ("^", "0.4")), strict=True))
    figure = Figure(figsize=(7.4, 7.4), layout="constrained")
    panels = figure.subplots(2, 2, sharex=True, sharey=True)
    for axes, name in zip(panels.ravel(), SCENES, strict=True):
        here = [run for run in runs if (run.scene, run.rods) == (name, rods) and run.tip_error > 0]

        def points(solver: str, control: str, error: str = "tip_error", here: list[Run] = here) -> np.ndarray:
            chosen = [run for run in here if (run.solver, run.control) == (solver, control)]
            return np.array([(getattr(run, error), run.milliseconds) for run in chosen]).reshape(-1, 2).T

        for error, what, look in (
            ("tip_error", "", {}),
            ("estimated", ", estimated", {"linestyle": ":", "markerfacecolor": "white"}),
        ):
            for solver, (marker, grey) in shapes.items():
                shape = {"marker": marker, "color": grey, "markersize": 4, "linewidth": 1} | look
                axes.loglog(*points(solver, "fixed", error), **shape, label=f"{solver}{what}")
        for control, marker in (("load-stepped", "x"), ("cold", "+")):
            if rods == 1:
                axes.loglog(*points("solve_bvp", control), marker, color="0", label=f"solve_bvp, {control}")
        star = {"color": "0", "markersize": 14, "markerfacecolor": "white", "zorder": 3}
        axes.loglog(*points("Dopri8", "default"), "*", **star, label="default")
        axes.set_title(name if here else f"{name}: not run", fontsize=10)
        axes.grid(color="0.92")
        axes.yaxis.set_major_formatter("{x:g}")
        axes.yaxis.set_minor_formatter(lambda time, _: f"{time:g}" if f"{time:e}"[0] == "3" else "")
        axes.set(xlabel="error of the tip", ylabel=f"run time / ms{'' if rods == 1 else ' per rod'}")
        axes.label_outer()
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False, fontsize=8)
    figure.savefig(path, dpi=200)


def everything(quick: bool) -> list[Run]:
    """All runs."""
    exact, runs = {}, []
    for name in list(SCENES)[:1] if quick else list(SCENES):
        exact[name] = exact_batch(SCENES[name])
        runs += measured(name, 1, exact[name][:, -1], quick)
        runs += collocated(name, exact[name][:, -1], quick)
        runs += measured(name, RODS, exact[name], quick)
    print("\nWhat is exact beside solve_bvp at 1e-9: largest difference of the tip, of the fields")
    for run in runs:
        if (run.solver, run.control, run.setting) == ("solve_bvp", "load-stepped", 1e-9):
            line(run.scene, f"{run.tip_error:.1e}   {run.fields_error:.1e}")
    return runs


if __name__ == "__main__":
    chosen = options(quick="one scene, two solvers, few numbers of steps")
    print(CLAIM)
    jax.config.update("jax_enable_compilation_cache", False)
    about = machine()
    runs = everything(chosen.quick)
    first_calls(runs)
    if chosen.out is not None:
        table(chosen.out / "error_vs_runtime.csv", about, Run._fields, runs)
        drawn(chosen.out / "error_vs_runtime_one.png", runs, 1)
        drawn(chosen.out / "error_vs_runtime_batch.png", runs, RODS)
    sure = estimates(runs)
    judged(runs, "fields_error")
    worst = judged(runs, "tip_error")
    print(f"\nThe claim {'held' if worst <= 2 and sure else 'DID NOT HOLD'} in this run: the default took at most")
    print(f"{worst:.2f} times the time of the fastest run of no larger error of the tip.")
