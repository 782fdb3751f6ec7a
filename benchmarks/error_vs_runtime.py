"""Error against run time of `solve`: six diffrax solvers, adaptive and fixed steps, one rod and a batch, four scenes.

    python benchmarks/error_vs_runtime.py [--quick] [--out FOLDER]

Needs SciPy and the folder tests/ next to this one, for tests/reference.py.

- Scenes: (a) the preset "octopus"; (b) a slender soft arm in air, hanging from its base; (c) the octopus in 1 m/s of
  current; (d) an arm of 1 GPa that tapers to 1 mm. (b) and (d) have three muscles, two of which end before the tip.
- A batch is 64 rods of the scene, all tensions times factors from 0 to 1; its time is per rod, its error the largest.
- Error: of the tip, its distance in lengths L of the arm; of the fields, the largest at 21 points of x / L, y / L,
  theta, beta and mu L. What is exact comes from Dopri8 at rtol = atol = 1e-13 and is vouched for by `solve_bvp`.
- Tolerances are rtol = atol, by decades from 1e-3 to where a solver's steps reach the thousands. So that one program
  serves them all, the tolerance is an argument of it; the default, `Shooting()`, is compiled as it is, beside them. A
  number of fixed steps, `Shooting(steps=N)`, counts for each stretch between muscle ends. Adaptive steps are at most a
  tenth of a stretch long, at least 1e-6 of one; it is the first of these that bounds the error from above.
- Run time: compiled, median of calls taken in turn, quartiles in brackets; a call of over 1 s is timed once. Where a
  solver's call takes over 3 s, or 15 s in a batch, tighter tolerances are not tried, and the row says so.
- Compile time: trace, lower and compile of each program, JAX's caches cleared before, its persistent cache off.
- `solve_bvp`: the reference formulation of the tests, one rod, load raised in steps ("load-stepped") and from the
  straight arm at full load ("cold"), timed once.
- Single precision: the batch by the function behind `solve`, which itself refuses it; once as it stands and once with
  those of the package's thresholds that lie below single precision's rounding widened.
- `--out` writes error_vs_runtime.csv, and .._one.png and .._batch.png, which show the error of the fields.
"""

import importlib
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple
from unittest import mock

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from collocation import plain, reference
from matplotlib.figure import Figure
from timing import in_turn, line, machine, options, spread, stages, table, timed

from cosserat_jax import Arm, Gravity, Muscle, Scene, Shooting, Solution, load, replace, solve
from cosserat_jax.scene.quantity import as_floats
from cosserat_jax.solver import outcome_codes

CLAIM = """\
Claim: on every scene, for one rod and for a batch, the default, Dopri8 with adaptive steps at 1e-9, takes at most
       twice the time of the fastest run of no larger error in the fields."""


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
    "(a) octopus": load("octopus"),
    "(b) slender, soft, in air": in_air(0.4, (0.008, 0.002), 1e6, SOFT),
    "(c) strong current": replace(load("octopus"), {"water.velocity": 1.0}),
    "(d) stiff": in_air(0.418, (0.015, 0.001), 1e9, HARD),
}
TIGHTEST = {"Heun": 1e-6, "Tsit5": 1e-11, "Dopri5": 1e-11, "Dopri8": 1e-11, "Kvaerno3": 1e-6, "Kvaerno5": 1e-9}
FIXED = {"Heun": (16, 64, 256), "Tsit5": (8, 32, 128), "Dopri5": (8, 32, 128), "Dopri8": (4, 16, 64)}
SOLVERS = {name: getattr(diffrax, name)() for name in TIGHTEST}
RODS, POINTS, EXACT = 64, 21, 1e-13
TIMED_ONCE, TOO_SLOW = 1.0, {1: 3.0, RODS: 15.0}  # seconds a call


class Adaptive(Shooting):
    """`Shooting` whose tolerance JAX traces."""

    tolerance: Any = 1e-9

    @property
    def controller(self) -> diffrax.AbstractStepSizeController:
        return eqx.tree_at(lambda pid: (pid.rtol, pid.atol), super().controller, (self.tolerance, self.tolerance))


class Plan(NamedTuple):
    """What is run: "adaptive" to the tolerance, "fixed" with that many steps, or the "default"."""

    solver: str
    control: str
    setting: float

    def __str__(self) -> str:
        how = f"{self.setting:.0f} fixed steps" if self.control == "fixed" else f"{self.setting:.0e}"
        return f"{self.solver} {how}{', the default' if self.control == 'default' else ''}"


class Run(NamedTuple):
    """One plan on one scene; errors are NaN unless every rod converged, the time is per rod and infinite if unknown."""

    scene: str
    rods: int
    solver: str
    control: str
    setting: float
    steps: int
    tip_error: float
    fields_error: float
    milliseconds: float
    outcome: str
    compile_s: float = np.nan


def plans(quick: bool, rods: int) -> list[Plan]:
    """In the order in which they are tried."""
    decades, solvers, fixed = range(3, 12), tuple(SOLVERS), FIXED
    if rods > 1:  # only what could be best there
        decades, solvers, fixed = range(3, 12, 2), ("Tsit5", "Dopri5", "Dopri8"), {}
    if quick:
        decades = (3, 6, 9, 11)
        solvers, fixed = (("Tsit5", "Dopri8"), {"Dopri8": (16,)}) if rods == 1 else (("Dopri8",), {})
    tolerances = [(solver, 10.0**-i) for solver in solvers for i in decades if 10.0**-i > 0.9 * TIGHTEST[solver]]
    return [
        Plan("Dopri8", "default", 1e-9),
        *(Plan(solver, "adaptive", tolerance) for solver, tolerance in tolerances),
        *(Plan(solver, "fixed", count) for solver, counts in fixed.items() for count in counts),
    ]


def rods_by(solver: Callable[[Scene], Solution], scene: Scene, factors: Any) -> Solution:
    """`scene` solved with all tensions times each factor, one or many."""

    def one(factor: Any) -> Solution:
        pulled = {f"muscles.{i}.tension": muscle.tension * factor for i, muscle in enumerate(scene.muscles)}
        return solver(replace(scene, pulled))

    return one(factors) if jnp.ndim(factors) == 0 else jax.vmap(one)(factors)


def factors_of(rods: int) -> Any:
    return jnp.ones(()) if rods == 1 else jnp.linspace(0.0, 1.0, rods)


@cache
def program(tree: Any, solver: str, control: str, steps: int | None, rods: int) -> tuple[Callable, float]:
    """(scene, factors, tolerance) -> `Solution`, compiled for all scenes of one structure, and the seconds it took."""

    def run(argument: tuple) -> Solution:
        scene, factors, tolerance = argument
        method = Shooting(SOLVERS[solver], steps=steps, points=POINTS)
        if control == "adaptive":
            method = Adaptive(SOLVERS[solver], tolerance=tolerance, points=POINTS)
        return rods_by(lambda scene: solve(scene, method, throw=False), scene, factors)

    like = jax.tree.unflatten(tree, [1.0] * tree.num_leaves), factors_of(rods), 1e-9
    compiled, times = stages(run, like)
    return compiled, sum(times)


def call_of(scene: Scene, plan: Plan, rods: int) -> tuple[Callable[[], Solution], float]:
    """The compiled call, and the seconds that compiling its program took."""
    steps = int(plan.setting) if plan.control == "fixed" else None
    compiled, spent = program(jax.tree.structure(scene), plan.solver, plan.control, steps, rods)
    return partial(compiled, (scene, factors_of(rods), float(plan.setting))), spent


def scaled(fields: Any, length: float) -> np.ndarray:
    """x / L, y / L, theta, beta, mu L, of shape (5, [rods,] points)."""
    scales = {"x": length, "y": length, "theta": 1.0, "beta": 1.0, "mu": 1 / length}
    return np.stack([np.asarray(getattr(fields, name), float) / scale for name, scale in scales.items()])


def errors(ours: np.ndarray, exact: np.ndarray) -> tuple[float, float]:
    """The largest of the tip and of the fields; NaN where a rod has no solution."""
    gap = ours - exact
    return float(np.max(np.hypot(*gap[:2, ..., -1]))), float(np.max(np.abs(gap)))


def outcome_of(solution: Solution) -> str:
    names = {code: name for name, code in outcome_codes().items()}
    counts = Counter(names[int(code)] for code in np.ravel(solution.outcome._value))
    return ", ".join(f"{count} {name}" for name, count in counts.items()) if len(counts) > 1 else next(iter(counts))


def exact_batch(scene: Scene) -> np.ndarray:
    """The fields of the batch, the scene itself last."""
    call, _ = call_of(scene, Plan("Dopri8", "adaptive", EXACT), RODS)
    return scaled(call().fields, float(scene.arm.length))


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
            runs.append(Run(name, 1, "solve_bvp", control, tol, 0, tip, fields, 1e3 * spent, found.message))
            shown(runs[-1], f"solve_bvp {tol:.0e}, {control}", f"{1e3 * spent:9.3f} ms  once")
    return runs


def shown(run: Run, what: str, timing: str) -> None:
    """Prints one run, or why it has no errors."""
    value = f"{run.tip_error:.1e}   {run.fields_error:.1e}   {timing}"
    if np.isnan(run.tip_error):
        line(what, run.outcome, timing)
    else:
        line(what, value, f"{run.steps} steps" if run.steps else "")


def measured(name: str, rods: int, exact: np.ndarray, quick: bool) -> list[Run]:
    """Prints and returns what every plan does on one rod or a batch of one scene."""
    scene, runs, calls = SCENES[name], [], {}
    print(f"\n{name}, {'one rod' if rods == 1 else f'{rods} rods, time per rod'}: error of tip, of fields, run time")
    slow: dict[str, str] = {}
    for plan in plans(quick, rods):
        if plan.control == "adaptive" and plan.solver in slow:
            runs.append(Run(name, rods, *plan, 0, np.nan, np.nan, np.inf, slow[plan.solver]))
            continue
        call, spent = call_of(scene, plan, rods)
        found, once = timed(call)
        if once > TOO_SLOW[rods]:
            slow[plan.solver] = f"not tried: {once:.0f} s at {plan.setting:.0e}"
        if once < TIMED_ONCE:
            calls[len(runs)] = call
        both = errors(scaled(found.fields, float(scene.arm.length)), exact)
        steps = int(np.max(found.steps))
        runs.append(Run(name, rods, *plan, steps, *both, 1e3 * once / rods, outcome_of(found), spent))
    samples = dict(zip(calls, in_turn(*calls.values(), repeats=3 if quick else 7), strict=True))
    for i, run in enumerate(runs):
        timing = f"{run.milliseconds:9.3f} ms  once" if np.isfinite(run.milliseconds) else ""
        if i in samples:
            runs[i] = run._replace(milliseconds=1e3 * float(np.median(samples[i])) / rods)
            timing = spread(samples[i], rods)
        shown(runs[i], str(Plan(*run[2:5])), timing)
    return runs


def compile_times(runs: list[Run]) -> None:
    """Prints the median and the range over the programs of each kind."""
    print("\nCompile time of a program, trace and lower included")
    kinds: dict[str, set[float]] = {}
    for run in runs:
        if np.isfinite(run.compile_s):
            rods = "one rod" if run.rods == 1 else f"{run.rods} rods"
            kinds.setdefault(f"{run.solver}, {run.control}, {rods}", set()).add(run.compile_s)
    for kind, spent in kinds.items():
        line(kind, f"{np.median(list(spent)):9.2f} s  [{min(spent):.2f} .. {max(spent):.2f}]", f"{len(spent)} programs")


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
            line(f"{what}: {limit}", f"{best.milliseconds:9.3f} ms   {Plan(*best[2:5])}", beside)
    return max(ratios)


def inner(scene: Scene, method: Shooting) -> Solution:
    """The function behind `solve`, which does not look at the precision."""
    return importlib.import_module("cosserat_jax.solver.solve")._solve(as_floats(scene), method)


@contextmanager
def widened() -> Iterator[None]:
    """The package's thresholds on the volume constraint and the clamp's residual, fit for single precision."""
    section, shooting = (importlib.import_module(f"cosserat_jax.{name}") for name in ("physics.rod", "solver.solve"))
    with mock.patch.object(section, "_VOLUME_TOL", 1e-5), mock.patch.object(shooting, "_ACCEPTED_RESIDUAL", 1e-4):
        yield


def single_precision(name: str, exact: np.ndarray, wide: bool, quick: bool) -> list[Run]:
    """Prints and returns the batch in single precision beside double at the same tolerances."""
    scene, runs, control = SCENES[name], [], "float32, widened" if wide else "float32"
    newton_tol = 1e-4 if wide else Shooting().newton_tol

    def run(argument: tuple) -> Solution:
        scene, factors, tolerance = argument
        method = Adaptive(tolerance=tolerance, newton_tol=newton_tol, points=POINTS)
        return rods_by(lambda scene: inner(scene, method), scene, factors)

    def called(call: Callable[[Any], Any], tolerance: float) -> Any:
        with jax.enable_x64(False), widened() if wide else nullcontext():
            return call(jax.tree.map(jnp.float32, (scene, factors_of(RODS), tolerance)))

    compiled, times = called(partial(stages, run), 1e-3)
    line(f"{name}, {control}", f"compiled in {sum(times):.1f} s")
    for tolerance in (1e-3, 1e-6) if quick else (1e-3, 1e-4, 1e-5, 1e-6):
        call = partial(called, compiled, tolerance)
        double, _ = call_of(scene, Plan("Dopri8", "adaptive", tolerance), RODS)
        found, _ = timed(call)
        rival, spent = in_turn(double, call, repeats=3 if quick else 5)
        there = np.asarray(found.converged)
        error = errors(scaled(found.fields, float(scene.arm.length))[:, there], exact[:, there]) if there.any() else ()
        tip, fields = error or (np.nan, np.nan)
        ratio = np.median(rival) / np.median(spent)
        time = 1e3 * float(np.median(spent)) / RODS
        steps = int(np.max(found.steps))
        runs.append(
            Run(name, RODS, "Dopri8", control, tolerance, steps, tip, fields, time, outcome_of(found), sum(times))
        )
        value = f"{there.mean():4.0%} converged   {tip:.1e}   {fields:.1e}   {time:7.3f} ms"
        line(f"  {tolerance:.0e}", value, f"{ratio:.2f} times as fast as double; {runs[-1].outcome}")
    return runs


def limits_of(singles: list[Run]) -> str:
    """What limits single precision, in words."""
    past = [run for run in singles if run.control.endswith("widened") and run.tip_error > 0]
    tips, fields = ([getattr(run, error) for run in past] for error in ("tip_error", "fields_error"))
    return f"""\
  As it stands single precision solves nothing, for it rounds at 6e-8: the volume constraint counts as kept below 1e-8,
  the clamp as held below 1e-7. With both widened tips are off by {min(tips):.0e} to {max(tips):.0e} L, fields by
  {min(fields):.0e} to {max(fields):.0e}: rounding, amplified along the rod, which no tighter tolerance takes away."""


def drawn(path: Path, runs: list[Run], rods: int) -> None:
    """Run time over the error of the fields, one panel a scene."""
    looks = zip(SOLVERS, "v^so<D", ("0.55", "0.35", "0.6", "0", "0.7", "0.45"), strict=True)
    figure = Figure(figsize=(7.4, 7.4), layout="constrained")
    panels = figure.subplots(2, 2, sharex=True, sharey=True)
    shapes = {solver: (marker, grey) for solver, marker, grey in looks}
    for axes, name in zip(panels.ravel(), SCENES, strict=True):
        here = [run for run in runs if (run.scene, run.rods) == (name, rods) and run.fields_error > 0]

        def points(solver: str, control: str, here: list[Run] = here) -> np.ndarray:
            chosen = [
                (run.fields_error, run.milliseconds) for run in here if (run.solver, run.control) == (solver, control)
            ]
            return np.array(chosen).reshape(-1, 2).T

        for solver, (marker, grey) in shapes.items():
            shape = {"marker": marker, "color": grey, "markersize": 5, "linewidth": 1}
            axes.loglog(*points(solver, "adaptive"), **shape, label=f"{solver}, adaptive")
            if solver in FIXED:
                look = shape | {"linestyle": ":", "markerfacecolor": "white"}
                axes.loglog(*points(solver, "fixed"), **look, label=f"{solver}, fixed")
        for control, marker in (("load-stepped", "x"), ("cold", "+")):
            if rods == 1:
                axes.loglog(*points("solve_bvp", control), marker, color="0", label=f"solve_bvp, {control}")
        axes.loglog(
            *points("Dopri8", "default"), "*", color="0", markersize=15, markerfacecolor="white", label="default"
        )
        axes.set_title(name if here else f"{name}: not run", fontsize=10)
        axes.grid(color="0.92")
        axes.set(xlabel="error of the fields", ylabel=f"run time / ms{'' if rods == 1 else ' per rod'}")
        axes.label_outer()
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False, fontsize=8)
    figure.savefig(path, dpi=200)


def everything(quick: bool) -> tuple[list[Run], list[Run]]:
    """All runs in double precision, and those in single."""
    names = list(SCENES)[:1] if quick else list(SCENES)
    exact, runs = {}, []
    for name in names:
        exact[name] = exact_batch(SCENES[name])
        runs += measured(name, 1, exact[name][:, -1], quick)
        runs += collocated(name, exact[name][:, -1], quick)
        runs += measured(name, RODS, exact[name], quick)
    print("\nWhat is exact beside solve_bvp at 1e-9: distance of the tips, largest difference of the fields")
    for run in runs:
        if (run.solver, run.control, run.setting) == ("solve_bvp", "load-stepped", 1e-9):
            line(run.scene, f"{run.tip_error:.1e} L   {run.fields_error:.1e}")
    print("\nSingle precision, batch: rods converged, largest error of their tips, of their fields, run time per rod")
    singles = [] if quick else single_precision(names[0], exact[names[0]], wide=False, quick=quick)
    for name in names:
        singles += single_precision(name, exact[name], wide=True, quick=quick)
    return runs, singles


if __name__ == "__main__":
    chosen = options(quick="one scene, two solvers, few tolerances")
    print(CLAIM)
    jax.config.update("jax_enable_compilation_cache", False)
    about = machine()
    runs, singles = everything(chosen.quick)
    print(limits_of(singles))
    compile_times(runs + singles)
    if chosen.out is not None:
        table(chosen.out / "error_vs_runtime.csv", about, Run._fields, runs + singles)
        drawn(chosen.out / "error_vs_runtime_one.png", runs, 1)
        drawn(chosen.out / "error_vs_runtime_batch.png", runs, RODS)
    judged(runs, "tip_error")
    worst = judged(runs, "fields_error")
    print(f"\nThe claim {'held' if worst <= 2 else 'DID NOT HOLD'} in this run: the default took at most {worst:.2f}")
    print("times the time of the fastest run of no larger error in the fields.")
