"""Does it find the equilibrium? Thousands of hard scenes, by the package and by what one would write without it.

    python benchmarks/stability.py [--scenes N] [--compared N] [--graded N] [--map N] [--out FOLDER]
    python benchmarks/stability.py --replay NUMBER

Scenes are drawn from the ranges of tests/hard.py: five decades of stiffness over thickness, up to three muscles pulling
up to 6 E pi R_tip^3 / (4 L), currents of up to 2 m/s either way. NUMBER names one; `--replay` prints it as a file, and
what each method makes of it.

- "default": `solve` as called, that is single shooting from the tip and, where it loses the branch, multiple shooting.
- "from the base": plain single shooting, Newton (optimistix) on the force and moment at the base, cold at full load.
- "cold", "load-stepped": `scipy.integrate.solve_bvp` on the reference formulation of the tests, on the first of the
  scenes, each given up after 15 s. Load-stepped it may step over a limit point whose snap is small.
- The equilibrium meant is the one that raising all loads in proportion reaches. Where the default finds that it ends
  before the full load, single and multiple shooting are asked apart, and count as confirming each other where both
  stop within 1 % of the same load.
- Gradients: of the tip's y by all floats of a scene, along a random direction, against a central difference of fourth
  order, whose own noise is some 1e-6 of it. Where the equilibrium is a hair from a limit point it is not drawn.
- Time: compiled, of batches of 64 rods of one structure, multiple shooting one by one.
"""

import argparse
import signal
import time
from collections import Counter
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from collocation import hard, reference
from matplotlib.figure import Figure
from timing import line, machine, table

from cosserat_jax import Scene, Shooting, Solution, dumps, load, replace, solve, sweep
from cosserat_jax.physics.muscles import stretches
from cosserat_jax.physics.rod import Rod, RodState, derivative
from cosserat_jax.physics.section import stiffness_at
from cosserat_jax.scene.quantity import as_floats
from cosserat_jax.solver import outcome_codes
from cosserat_jax.study.batch import solve_rods

CLAIM = """\
Claim: of scenes that load-stepped collocation solves, the default finds at least 98 % to 1e-6 of the length, and no rod
       that it calls converged lies elsewhere; every rod without an equilibrium is confirmed by both formulations."""

SEED = 2026
BATCH = 64
METHOD = Shooting(points=3)
NAMES = {code: name for name, code in outcome_codes().items()}
LOOKS = {  # colour and marker of an outcome
    "converged": ("0.8", "s"),
    "limit_point": ("tab:orange", "s"),
    "volume_constraint_folded": ("tab:blue", "s"),
    "integration_failed": ("tab:red", "s"),
    "iterations_exhausted": ("tab:purple", "s"),
    "ill_conditioned": ("k", "s"),
}


class Tip(NamedTuple):
    """What a method makes of a scene: a tip [m] if it found one, and how."""

    found: bool
    x: float
    y: float
    how: str
    seconds: float


def stacked(scenes: list[Scene]) -> Scene:
    """Scenes of one structure as one, with an axis in front of every number."""
    return jax.tree.map(lambda *leaves: jnp.asarray(leaves, float), *scenes)


def by_structure(scenes: list[Scene]) -> list[list[int]]:
    """The numbers of the scenes, those that one program serves together."""
    groups: dict[Any, list[int]] = {}
    for number, scene in enumerate(scenes):
        groups.setdefault(jax.tree.structure(scene), []).append(number)
    return list(groups.values())


@eqx.filter_jit
def solve_batch(scenes: Scene, method: Shooting) -> Solution:
    return jax.vmap(lambda scene: solve(scene, method, throw=False))(scenes)


def solved(scenes: list[Scene], method: Shooting) -> tuple[Solution, float]:
    """Solutions of all scenes in one, and the seconds they took, compiling apart."""
    parts: dict[int, Any] = {}
    spent = 0.0
    for numbers in by_structure(scenes):
        for kind in (method.single, method.multiple) if method.intervals is None else (method,):
            solve_batch(stacked([scenes[numbers[0]]] * (1 if kind.is_multiple else BATCH)), kind)
        for start in range(0, len(numbers), BATCH):
            some = numbers[start : start + BATCH]
            rods = stacked([scenes[i] for i in np.resize(some, BATCH)])
            begin = time.perf_counter()
            solution = jax.block_until_ready(solve_rods(solve_batch, rods, method))
            spent += (time.perf_counter() - begin) * len(some) / BATCH
            parts |= {i: jax.tree.map(lambda leaf, j=j: np.asarray(leaf[j]), solution) for j, i in enumerate(some)}
    return jax.tree.map(lambda *leaves: np.stack(leaves), *(parts[i] for i in range(len(scenes)))), spent


@eqx.filter_jit
def shoot_from_base(scenes: Scene) -> tuple[jax.Array, ...]:
    """(found, x, y) of each rod by Newton on force and moment at the base, cold at full load."""

    def one(scene: Scene) -> tuple[jax.Array, ...]:
        rod = Rod.of(scene)
        length, bending = scene.arm.length, stiffness_at(scene.arm, 0.0, 1.0).bending
        units = jnp.stack([bending / length**2, bending / length**2, bending / length])
        ends, active = (part[::-1] for part in stretches(rod.muscles, rod.arm))

        def at_tip(clamp: jax.Array) -> tuple[RodState, jax.Array]:
            def segment(state: RodState, span: tuple) -> tuple[RodState, jax.Array]:
                begin, end, active = span

                def slope(tau: Any, state: Any, _: Any) -> RodState:
                    d_ds = derivative(rod, begin + (end - begin) * tau, state, active)[0]
                    return jax.tree.map(lambda d: d * (end - begin), d_ds)

                run = diffrax.diffeqsolve(
                    diffrax.ODETerm(slope), diffrax.Dopri8(), 0.0, 1.0, 0.1, state, max_steps=1000, throw=False,
                    stepsize_controller=diffrax.PIDController(1e-9, 1e-9, dtmin=1e-6, force_dtmin=False),
                    adjoint=diffrax.ForwardMode(),
                )  # fmt: skip
                return jax.tree.map(lambda y: y[-1], run.ys), run.result == diffrax.RESULTS.successful

            zero, angle = jnp.zeros(()), scene.arm.base_angle
            start = RodState(zero, zero, angle + zero, jnp.cos(angle), jnp.sin(angle), *(clamp * units))
            state, finished = jax.lax.scan(segment, start, (ends[:-1], ends[1:], active))
            return state, finished.all()

        def unbalanced(clamp: jax.Array, _: Any) -> jax.Array:
            state, _ = at_tip(clamp)
            return jnp.stack([state.force_x, state.force_y, state.moment]) / units

        newton = optx.Newton(rtol=1e-9, atol=1e-9)
        root = optx.root_find(unbalanced, newton, jnp.zeros(3), options={"jac": "fwd"}, max_steps=50, throw=False)
        state, finished = at_tip(root.value)
        small = jnp.max(jnp.abs(unbalanced(root.value, None))) < 1e-6
        return finished & small, state.x, state.y

    return jax.vmap(one)(scenes)


def from_base(scenes: list[Scene]) -> tuple[list[Tip], float]:
    """The tips that plain shooting from the base finds, and the seconds, compiling apart."""
    tips: dict[int, Tip] = {}
    spent = 0.0
    for numbers in by_structure(scenes):
        shoot_from_base(stacked([scenes[numbers[0]]] * BATCH))
        for start in range(0, len(numbers), BATCH):
            some = numbers[start : start + BATCH]
            begin = time.perf_counter()
            found, x, y = map(np.asarray, shoot_from_base(stacked([scenes[i] for i in np.resize(some, BATCH)])))
            seconds = time.perf_counter() - begin
            spent += seconds * len(some) / BATCH
            tips |= {i: Tip(bool(found[j]), x[j], y[j], "", seconds / BATCH) for j, i in enumerate(some)}
    return [tips[i] for i in range(len(scenes))], spent


def collocated(plain: dict[str, Any], cold: bool, limit: int = 15) -> Tip:
    """What `solve_bvp` makes of a scene within `limit` seconds."""

    def give_up(*_: Any) -> None:
        raise TimeoutError

    signal.signal(signal.SIGALRM, give_up)
    signal.alarm(limit)
    begin = time.perf_counter()
    try:
        found = reference.solve(plain, tol=1e-8, cold=cold)
        outcome = (found.converged, found.x, found.y, found.message)
    except TimeoutError:
        outcome = (False, np.nan, np.nan, f"given up after {limit} s")
    finally:
        signal.alarm(0)
    return Tip(*outcome, time.perf_counter() - begin)


def apart(plain: dict[str, Any], solution: Solution, number: int, tip: Tip) -> float:
    """Distance of the tips over the length."""
    return float(np.hypot(solution.tip.x[number] - tip.x, solution.tip.y[number] - tip.y) / plain["arm"]["length"])


def against(what: str, scenes: list[dict], solution: Solution, tips: list[Tip]) -> tuple[int, int, list[int]]:
    """Prints how a method compares with the default; how many both found, how many of them alike, and which differ."""
    ours = solution.outcome._value == outcome_codes()["converged"]
    both = [i for i, tip in enumerate(tips) if tip.found and ours[i]]
    differ = [i for i in both if apart(scenes[i], solution, i, tips[i]) > 1e-6]
    lost = [i for i, tip in enumerate(tips) if tip.found and not ours[i]]
    found = sum(tip.found for tip in tips)
    shares = f"finds {found} of {len(tips)}: {len(both) - len(differ)} as we do, {len(differ)} elsewhere"
    line(what, shares, f"{len(lost)} where we find none, {int(ours[: len(tips)].sum()) - len(both)} only we find")
    return found, len(both) - len(differ), sorted(differ + lost)


def gradient_errors(scenes: list[Scene], solution: Solution, count: int) -> list[tuple[int, float]]:
    """Of the first `count` converged scenes that took long: the gradient's error."""
    took_long = np.asarray(solution.converged) & (solution.iterations > 8) & (solution.condition < 1e3)
    hard_ones = np.flatnonzero(took_long)
    rng, errors = np.random.default_rng(0), []
    method = Shooting(points=3, rtol=1e-11, atol=1e-11)
    height = jax.jit(lambda scene, method: solve(scene, method, throw=False).tip.y, static_argnums=1)
    slope = cache(lambda method: jax.jit(jax.grad(lambda scene: solve(scene, method, throw=False).tip.y)))
    for number in hard_ones[:count]:
        scene = as_floats(scenes[number])
        chosen = method.single if solve(scene, method.single, throw=False).converged else method.multiple
        leaves, tree = jax.tree.flatten(scene)
        change = [leaf * float(rng.uniform(-1, 1)) for leaf in leaves]

        def at(step: float, leaves: list = leaves, change: list = change, tree: Any = tree, chosen: Any = chosen):
            moved = jax.tree.unflatten(tree, [leaf + step * d for leaf, d in zip(leaves, change, strict=True)])
            return float(height(moved, chosen))

        h = 1e-4 / max(1.0, float(solution.condition[number]) ** 0.5)
        numerical = (8 * (at(h) - at(-h)) - (at(2 * h) - at(-2 * h))) / (12 * h)
        gradient = jax.tree.leaves(slope(chosen)(scene))
        analytic = sum(float(g) * float(d) for g, d in zip(gradient, change, strict=True))
        errors.append((int(number), abs(analytic - numerical) / max(abs(numerical), 1e-6 * float(scene.arm.length))))
    return errors


def outcome_maps(path: Path, size: int) -> None:
    """Outcomes of a soft octopus arm over tension and slenderness, and over velocity and modulus."""
    octopus = replace(load("octopus"), {"arm.youngs_modulus": 1e6, "water.velocity": -0.3})
    tension, length = np.linspace(0.0, 4.0, size), np.geomspace(0.15, 1.5, size)
    speed, modulus = np.linspace(-2.0, 2.0, size), np.geomspace(2e5, 1e9, size)
    pulled = replace(octopus, {"muscles.0.tension": 1.0})
    maps = [
        (octopus, {"arm.length": length, "muscles.0.tension": tension}, "slenderness L / R_base", "tension / N"),
        (pulled, {"arm.youngs_modulus": modulus, "water.velocity": speed}, "Young's modulus / Pa", "current / (m/s)"),
    ]
    figure = Figure(figsize=(10.0, 4.6), layout="constrained")
    seen: dict[str, Any] = {}
    for axes, (scene, over, across, up) in zip(figure.subplots(1, 2), maps, strict=True):
        codes = np.asarray(sweep(scene, over, METHOD, batch=256).solution.outcome._value)
        x, y = over.values()
        x = x / scene.arm.base_radius if "slenderness" in across else x
        x_all, y_all = np.meshgrid(x, y, indexing="ij")
        for code in np.unique(codes):
            colour, marker = LOOKS[NAMES[code]]
            at, area = codes == code, (170 / size) ** 2
            seen[NAMES[code]] = axes.scatter(x_all[at], y_all[at], c=colour, marker=marker, s=area, linewidths=0)
        axes.set(xlabel=across, ylabel=up, xscale="log")
    figure.axes[0].set_title("octopus arm of 1 MPa in a current of -0.3 m/s", fontsize=10)
    figure.axes[1].set_title("octopus arm pulled by 1 N", fontsize=10)
    labels = [name.replace("_", " ") for name in seen]
    figure.legend(seen.values(), labels, loc="outside lower center", ncols=len(seen), frameon=False, markerscale=2)
    figure.savefig(path, dpi=130)


def drawn_map(path: Path, plains: list[dict], solution: Solution) -> None:
    """Where in the ranges the drawn scenes have an equilibrium: pull over slenderness, current over modulus."""
    figure = Figure(figsize=(10.0, 4.6), layout="constrained")
    pull = [max(muscle["tension"] for muscle in p["muscles"]) for p in plains]
    arms = [p["arm"] for p in plains]
    unit = [a["youngs_modulus"] * np.pi * a["tip_radius"] ** 3 / (4 * a["length"]) for a in arms]
    slender = [arm["length"] / arm["tip_radius"] for arm in arms]
    moduli = [arm["youngs_modulus"] for arm in arms]
    currents = [p.get("water", {}).get("velocity", np.nan) for p in plains]
    panels = [
        (slender, np.divide(pull, unit), "L / R_tip", "largest pull / (E pi R_tip^3 / 4 L)"),
        (moduli, currents, "Young's modulus / Pa", "current / (m/s)"),
    ]
    names = np.array([NAMES[code] for code in solution.outcome._value])
    for axes, (x, y, across, up) in zip(figure.subplots(1, 2), panels, strict=True):
        for name in dict.fromkeys(names):
            at = names == name
            colour, _ = LOOKS[name]
            axes.scatter(
                np.asarray(x)[at], np.asarray(y)[at], s=9, c=colour, linewidths=0, label=name.replace("_", " ")
            )
        axes.set(xlabel=across, ylabel=up, xscale="log")
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False, markerscale=2)
    figure.savefig(path, dpi=130)


def replay(number: int) -> None:
    """Prints one scene and what each method makes of it."""
    plain = hard.drawn(SEED, number)
    scene = hard.alike(plain)
    print(dumps(scene))
    for name, method in {"default": METHOD, "single": METHOD.single, "multiple": METHOD.multiple}.items():
        solution = solve(scene, method, throw=False)
        how = f"{int(solution.iterations)} iterations, condition {float(solution.condition):.1e}"
        line(name, f"x {float(solution.tip.x):.9f} y {float(solution.tip.y):.9f} m, {how}", solution.message)
    for name, cold in {"solve_bvp, load-stepped": False, "solve_bvp, cold": True}.items():
        tip = collocated(plain, cold, limit=120)
        line(name, f"x {tip.x:.9f} y {tip.y:.9f} m, {tip.seconds:.1f} s", tip.how)


def main(count: int, compared: int, graded: int, size: int, folder: Path | None) -> None:
    about = machine()
    plains = [hard.drawn(SEED, number) for number in range(count)]
    scenes = [hard.alike(plain) for plain in plains]
    print(f"\n{count} scenes of {len(by_structure(scenes))} structures")
    solution, spent = solved(scenes, METHOD)
    names = np.array([NAMES[code] for code in solution.outcome._value])
    for name, many in Counter(names).most_common():
        line(name, f"{many:6d}   {100 * many / count:5.1f} %")
    line("default", f"{1e3 * spent / count:9.2f} ms a rod")
    assert np.isnan(solution.tip.x[names != "converged"]).all()
    assert np.isfinite(solution.tip.x[names == "converged"]).all()

    ends = [i for i in range(count) if names[i] != "converged"]
    single, _ = solved([scenes[i] for i in ends], METHOD.single)
    ratio = np.asarray(single.load_fraction) / np.asarray(solution.load_fraction)[ends]
    doubted = [i for i, r in zip(ends, ratio, strict=True) if not abs(r - 1) < 0.01]
    line(
        "no equilibrium: both formulations stop alike", f"{len(ends) - len(doubted)} of {len(ends)}", f"not: {doubted}"
    )

    print("\nBeside other methods, tips within 1e-6 of the length counting as the same")
    base, base_spent = from_base(scenes)
    against("single shooting from the base", plains, solution, base)
    line("", f"{1e3 * base_spent / count:9.2f} ms a rod")
    some = plains[:compared]
    stepped, cold = ([collocated(plain, cold) for plain in some] for cold in (False, True))
    found, alike, differ = against("solve_bvp, load-stepped", some, solution, stepped)
    against("solve_bvp, cold", some, solution, cold)
    for name, tips in (("load-stepped", stepped), ("cold", cold)):
        times = [tip.seconds for tip in tips if tip.found]
        line(f"solve_bvp, {name}: found ones", f"median {np.median(times):6.2f} s, mean {np.mean(times):.2f} s a rod")
    for i in differ:
        line(f"scene {i}", f"{names[i]} at {float(solution.load_fraction[i]):.4f}", f"solve_bvp: {stepped[i].how}")

    print("\nGradients against central differences")
    errors = gradient_errors(scenes, solution, graded)
    worst = sorted(errors, key=lambda error: -error[1])[:3]
    line(f"{len(errors)} hard scenes", f"median {np.median([e for _, e in errors]):.1e}, largest {worst[0][1]:.1e}")
    line("largest", ", ".join(f"scene {number}: {error:.1e}" for number, error in worst))

    print("\nWorst cases (--replay NUMBER)")
    for what, value in (
        ("iterations", solution.iterations),
        ("condition", solution.condition),
        ("steps", solution.steps),
    ):
        order = np.argsort(np.where(names == "converged", value, 0))[::-1][:5]
        line(f"converged, most {what}", ", ".join(f"{i}: {float(value[i]):.3g}" for i in order))

    if folder is not None:
        columns = ["scene", "outcome", "load_fraction", "tip_x_m", "tip_y_m", "iterations", "steps", "residual"]
        columns += ["condition", "failed_at_m", "from_the_base", "solve_bvp", "solve_bvp_cold"]
        stats = (solution.load_fraction, solution.tip.x, solution.tip.y, solution.iterations, solution.steps)
        stats += (solution.residual, solution.condition, solution.failed_at)
        others = [[str(tip.found) for tip in tips] + [""] * (count - len(tips)) for tips in (base, stepped, cold)]
        numbers = [[f"{float(value):.8g}" for value in stat] for stat in stats]
        table(folder / "stability.csv", about, columns, zip(range(count), names, *numbers, *others, strict=True))
        drawn_map(folder / "stability_drawn.png", plains, solution)
        outcome_maps(folder / "stability_maps.png", size)
    held = alike >= 0.98 * found and not doubted
    print(f"\nThe claim {'held' if held else 'DID NOT HOLD'} in this run: {alike} of {found} agree,")
    print(f"{len(doubted)} of {len(ends)} without equilibrium are in doubt.")


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--scenes", type=int, default=2000, help="drawn from the ranges")
    parser.add_argument("--compared", type=int, default=100, help="of them, with solve_bvp, which is slow")
    parser.add_argument("--graded", type=int, default=50, help="of them, whose gradient is checked")
    parser.add_argument("--map", type=int, default=40, help="points of a map along each axis")
    parser.add_argument("--out", type=Path, metavar="FOLDER")
    parser.add_argument("--replay", type=int, metavar="NUMBER")
    chosen = parser.parse_args()
    if chosen.replay is not None:
        replay(chosen.replay)
    else:
        print(CLAIM)
        main(chosen.scenes, chosen.compared, chosen.graded, chosen.map, chosen.out)
