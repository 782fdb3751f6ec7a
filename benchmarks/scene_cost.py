"""What each part of a scene costs: measured as parts are taken away, beside what the formulas should cost.

    python benchmarks/scene_cost.py [--quick] [--out FOLDER]

Needs pytest and the folder tests/ next to this one: the scenes are those of tests/test_program_size.py, to which are
added the full one without any muscle, with unit tangents, and with a load on its tip.

- Measured: compiled, median of calls of all scenes taken in turn, quartiles in brackets; one rod, and a batch of 64
  rods whose Young's moduli run from 0.8 to 1.2 times the scene's, its time per rod. Three points keep the fields small.
  Both by `SingleShooting()`, which `solve` uses under `jit` and `vmap`.
- Operations: those lowered for the compiler, as the test counts them. Compile time: trace, lower and compile of one
  rod, JAX's caches cleared before, its persistent cache off.
- Predicted: the arithmetic operations (add, multiply, divide, root, ..: one each) of one right-hand side, counted in
  its jaxpr, times how often it is evaluated, with those by which the integrator combines its stages. A loop counts as
  often as it runs; Newton's in a cross-section, which runs until it has converged, as 4 steps: from 1 its errors go
  7e-2, 5e-3, 2e-5, 1e-10. An integration takes, in every segment between muscle ends, steps times stages evaluations.
  An iteration is one integration on the coarse grid, and one more for each unknown; then comes one on each finer grid
  up to the last, and on that a second. How many iterations, and which grid is the last, is taken from the solution, in
  a batch the largest, for it runs until its slowest rod is there. Not counted is what XLA and diffrax spend on a step
  whatever is in it, so a step of little arithmetic takes longer than predicted; nor are the fields, and a section's
  start in each segment.
- `--out` writes scene_cost.csv and .png.
"""

import dataclasses
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure
from timing import in_turn, line, machine, options, spread, stages, table

from cosserat_jax import Scene, SingleShooting, Solution, Tip, replace, solve
from cosserat_jax.physics.rod import Rod, derivative, tip_state
from cosserat_jax.physics.segments import active_at
from cosserat_jax.scene.quantity import as_floats
from cosserat_jax.solver.method import tableau_of
from cosserat_jax.solver.unknowns import Unknowns

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from test_program_size import SCENES, operations

CLAIM = """\
Claim: a part that a scene does not have costs nothing, for one rod and in a batch: without it the solve takes no longer
       (5 % allowed for the clock), and where the counted operations fall by over a tenth, the time falls by at least
       half as much."""

METHOD, POINTS = SingleShooting(), 3
RODS, NEWTON_STEPS = 64, 4
WIDEST = 1.3  # of the panels of the picture, in times of the full scene
FULL, NONE, MORE = "full", "none of it", ("with unit tangents", "with a load on its tip")
ARITHMETIC = {
    "abs", "add", "add_any", "clamp", "cos", "div", "dot_general", "exp", "integer_pow", "log", "max", "min", "mul",
    "neg", "pow", "reduce_max", "reduce_sum", "rem", "rsqrt", "sign", "sin", "sqrt", "square", "sub", "tan",
}  # fmt: skip


def scenes() -> dict[str, Scene]:
    """The full scene first, then without one part after the other, then with more."""
    full = SCENES[FULL]
    unit = {f"muscles.{i}.tangent": "unit" for i in range(len(full.muscles))}
    return {
        **{name: scene for name, scene in SCENES.items() if name != NONE},
        "without muscles": dataclasses.replace(full, muscles=()),
        NONE: SCENES[NONE],
        MORE[0]: replace(full, unit),
        MORE[1]: dataclasses.replace(full, tip=Tip(force=(0.0, -0.1), moment=0.001)),
    }


class Cost(NamedTuple):
    """Of one scene. Milliseconds are per rod; operations predicted are those of the whole solve, per rod."""

    scene: str
    lowered_operations: int
    trace_s: float
    lower_s: float
    compile_s: float
    unknowns: int
    segments: int
    operations_of_right_hand_side: int
    iterations_one: int
    steps_one: int
    predicted_one: int
    milliseconds_one: float
    iterations_batch: int
    steps_batch: int
    predicted_batch: int
    milliseconds_batch: float


def counted(jaxpr: Any) -> int:
    """Arithmetic operations of a jaxpr, those of a loop as often as it runs."""
    total = 0
    for equation in jaxpr.eqns:
        inner = [part for value in equation.params.values() for part in jax.tree.leaves(value, is_leaf=_is_jaxpr)]
        repeats = {"scan": equation.params.get("length"), "while": NEWTON_STEPS}.get(equation.primitive.name, 1)
        total += repeats * sum(counted(getattr(part, "jaxpr", part)) for part in inner if _is_jaxpr(part))
        if equation.primitive.name in ARITHMETIC:
            total += max(variable.aval.size for variable in (*equation.invars, *equation.outvars))
    return total


def _is_jaxpr(part: Any) -> bool:
    return hasattr(part, "eqns") or hasattr(part, "jaxpr")


class Shape(NamedTuple):
    """Of a scene's equations: operations of one evaluation, numbers of the state, unknowns, segments."""

    evaluation: int
    state: int
    unknowns: int
    segments: int


def shape_of(scene: Scene) -> Shape:
    """What the prediction is made from."""
    rod = Rod.of(as_floats(scene))
    state, s = tip_state(rod, jnp.ones(()), jnp.ones(()), jnp.ones(())), jnp.ones(())
    slope = jax.make_jaxpr(lambda state: derivative(rod, s, state, active_at(rod.tendons, s))[0])(state)
    ends = sum(muscle.end is not None for muscle in scene.muscles)
    return Shape(counted(slope.jaxpr), len(jax.tree.leaves(state)), Unknowns.of(rod).size, 1 + ends)


def predicted(shape: Shape, solution: Solution) -> tuple[int, int, int]:
    """Iterations, steps of the last grid, and operations of one rod's solve."""
    iterations, last = int(np.max(solution.iterations)), int(np.max(solution.steps))
    stages = len(tableau_of(METHOD.solver).places)
    combined = 2 * (stages + 1) * stages * shape.state
    steps = iterations * (1 + shape.unknowns) * METHOD.coarse_steps
    steps += sum(count for count in METHOD.steps if count <= last) + last
    return iterations, last, shape.segments * steps * (stages * shape.evaluation + combined)


def solved(scene: Scene) -> Solution:
    return solve(scene, METHOD, points=POINTS, throw=False)


def batch_of(scene: Scene) -> Solution:
    """64 rods whose Young's moduli differ."""
    moduli = scene.arm.youngs_modulus * jnp.linspace(0.8, 1.2, RODS)
    return jax.vmap(lambda modulus: solved(replace(scene, {"arm.youngs_modulus": modulus})))(moduli)


def measured(chosen: dict[str, Scene], repeats: int) -> list[Cost]:
    """Prints and returns the cost of every scene."""
    print("\nCompile time of one rod")
    ones: dict[str, Callable] = {}
    batches: dict[str, Callable] = {}
    spent, lowered = {}, {}
    for name, scene in chosen.items():
        lowered[name] = operations(scene)
        run, spent[name] = stages(solved, scene)
        ones[name], batches[name] = partial(run, scene), partial(stages(batch_of, scene)[0], scene)
        value = "trace {:.2f} s, lower {:.2f} s, compile {:.2f} s".format(*spent[name])
        line(name, value, f"{lowered[name]} operations lowered")
    costs = []
    times_one = dict(zip(chosen, in_turn(*ones.values(), repeats=repeats), strict=True))
    times_batch = dict(zip(chosen, in_turn(*batches.values(), repeats=repeats), strict=True))
    print("\nRun time of one rod")
    for name, scene in chosen.items():
        shape = shape_of(scene)
        solutions = ones[name](), batches[name]()
        assert all(solution.converged.all() for solution in solutions), f"{name} has no solution"
        one, batch = (predicted(shape, solution) for solution in solutions)
        median_one, median_batch = (1e3 * float(np.median(t[name])) for t in (times_one, times_batch))
        of_one, of_batch = (*one, median_one), (*batch, median_batch / RODS)
        equations = shape.unknowns, shape.segments, shape.evaluation
        costs.append(Cost(name, lowered[name], *spent[name], *equations, *of_one, *of_batch))
        line(name, spread(times_one[name]), f"{one[0]} iterations, then up to {one[1]} steps")
    print(f"\nRun time per rod of {RODS}")
    for cost in costs:
        how = f"{cost.iterations_batch} iterations, then up to {cost.steps_batch} steps"
        line(cost.scene, spread(times_batch[cost.scene], RODS), how)
    return costs


def beside(costs: list[Cost], kind: str) -> dict[str, tuple[float, float]]:
    """For "one" or "batch": {scene: time measured and predicted, in parts of the full scene's}."""

    def values(cost: Cost) -> np.ndarray:
        return np.array([getattr(cost, f"milliseconds_{kind}"), getattr(cost, f"predicted_{kind}")])

    return {cost.scene: tuple(values(cost) / values(costs[0])) for cost in costs}


def drawn(path: Path, ratios: dict[str, dict[str, tuple[float, float]]]) -> None:
    """Time of a solve in parts of the full scene's; a bar that leaves the panel has its number there."""
    figure = Figure(figsize=(7.4, 1.2 + 0.55 * len(ratios["one"])), layout="constrained")
    looks = {"measured": {"color": "0.25"}, "predicted": {"color": "0.85", "edgecolor": "0.25", "hatch": "///"}}
    for axes, (kind, of_scenes) in zip(figure.subplots(1, 2, sharey=True), ratios.items(), strict=True):
        for i, (label, look) in enumerate(looks.items()):
            places, values = np.arange(len(of_scenes)) + 0.4 * i - 0.2, [values[i] for values in of_scenes.values()]
            axes.barh(places, values, 0.36, label=label, **look)
            for place, value in zip(places, values, strict=True):
                axes.text(min(value, WIDEST) + 0.02, place, f"{value:.2g}", va="center", fontsize=7)
        axes.set_yticks(np.arange(len(of_scenes)), list(of_scenes))
        axes.axvline(1.0, color="0.5", linewidth=0.8, zorder=0)
        title = "one rod" if kind == "one" else f"batch of {RODS} rods"
        axes.set(title=title, xlabel="time / full scene's", xlim=(0.0, WIDEST))
        axes.tick_params(axis="y", length=0)
    axes.invert_yaxis()
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False)
    figure.savefig(path, dpi=200)


if __name__ == "__main__":
    chosen = options(quick="three scenes")
    print(CLAIM)
    jax.config.update("jax_enable_compilation_cache", False)
    about = machine()
    kept = scenes()
    if chosen.quick:
        kept = {name: kept[name] for name in (FULL, "rigid section", NONE)}
    costs = measured(kept, repeats=5 if chosen.quick else 15)
    print("\nOperations of one evaluation of the right-hand side")
    for cost in costs:
        counts = f"unknowns {cost.unknowns}, segments {cost.segments}"
        line(cost.scene, f"{cost.operations_of_right_hand_side:6d}", counts)
    ratios = {kind: beside(costs, kind) for kind in ("one", "batch")}
    for kind, of_scenes in ratios.items():
        print(f"\nIn parts of the full scene's, {kind}: time measured, time predicted")
        for name, (time, work) in of_scenes.items():
            line(name, f"{time:6.3f}   {work:6.3f}")
    if chosen.out is not None:
        table(chosen.out / "scene_cost.csv", about, Cost._fields, costs)
        drawn(chosen.out / "scene_cost.png", ratios)
    fewer = [values for of_scenes in ratios.values() for name, values in of_scenes.items() if name not in (FULL, *MORE)]
    longest = max(time for time, _ in fewer)
    least = min((1 - time) / (1 - work) for time, work in fewer if work < 0.9)
    held = "held" if longest <= 1.05 and least >= 0.5 else "DID NOT HOLD"
    print(
        f"\nThe claim {held} in this run: without a part a solve took at most {longest:.2f} times as long as in full,"
    )
    print(f"and the time fell by at least {least:.2f} times what the counted operations fell by.")
