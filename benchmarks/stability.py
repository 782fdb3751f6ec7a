"""Does it find the equilibrium? Thousands of hard scenes, by the package and by what one would write without it.

    python benchmarks/stability.py [--scenes N] [--compared N] [--graded N] [--map N] [--seed N] [--out FOLDER]
                                   [--against FILE.csv]
    python benchmarks/stability.py --replay NUMBER

Scenes are drawn from the ranges of tests/hard.py: five decades of stiffness over thickness, up to three muscles pulling
up to 6 E pi R_tip^3 / (4 L), currents of up to 2 m/s either way. NUMBER names one; `--replay` prints it as a file, and
what each method makes of it.

- "default": `solve` as called, that is single shooting from the tip on two grids, then on finer ones, then multiple
  shooting, each for the rods that the one before has lost.
- "from the base": plain single shooting, Newton (optimistix) on the force and moment at the base, cold at full load;
  20 iterations, 200 steps between muscle ends.
- "cold", "load-stepped": `scipy.integrate.solve_bvp` on the reference formulation of the tests, on the first of the
  scenes, each given up after 15 s of CPU time. Load-stepped it may step over a limit point whose snap is small.
- The equilibrium meant is the one that raising all loads in proportion reaches. Where the default finds that it ends
  before the full load, single shooting on its finer grids is asked, and where that does not stop within 1 % of the same
  load, multiple shooting with twice the intervals.
- Gradients: of the tip's y by all floats of a scene, along a random direction, against a central difference of fourth
  order, whose own noise is some 1e-6 of it. Where the equilibrium is a hair from a limit point it is not drawn.
- Error: as the default estimates it, beside the distance from the tip of load-stepped collocation at 1e-8.
- Time: compiled, of batches of 64 rods of one structure, multiple shooting one by one.
- `--seed`: of another set of scenes. `--against`: the table of an earlier run of the same scenes; every scene is listed
  whose outcome differs, whose load fraction does by 1 %, or whose tip by 1e-7 of the length.
"""

import argparse
import csv
from collections import Counter
from functools import cache, partial
from pathlib import Path
from typing import Any

import jax
import numpy as np
from collocation import Tip, collocated, hard
from from_base import BATCH, by_structure, from_base, stacked
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from timing import line, machine, table, timed

from cosserat_jax import (
    Automatic,
    MultipleShooting,
    Scene,
    SingleShooting,
    Solution,
    dumps,
    load_scene,
    replace,
    solve,
    sweep,
)
from cosserat_jax.scene.quantity import as_floats
from cosserat_jax.solver import Method, outcome_codes
from cosserat_jax.solver.method import methods_of
from cosserat_jax.solver.solve import is_lost, places_of, solve_batch

CLAIM = """\
Claim: of scenes that load-stepped collocation solves, the default finds at least 98 % to 1e-6 of the length, and no rod
       that it calls converged lies elsewhere; every rod without an equilibrium is confirmed by another formulation, or
       by one twice as fine."""

SEED = 2026
METHOD, POINTS = Automatic(), 3
FINE, MULTIPLE = METHOD.methods[1:3]
FINER = MultipleShooting(intervals=128, max_iterations=1000)
NAMES = {code: name for name, code in outcome_codes().items()}
COLOURS = {
    "converged": "0.8",
    "limit_point": "tab:orange",
    "volume_constraint_folded": "tab:blue",
    "integration_failed": "tab:red",
    "iterations_exhausted": "tab:purple",
    "inaccurate": "tab:green",
    "ill_conditioned": "k",
}


def solved(scenes: list[Scene], method: Method) -> tuple[Solution, list[tuple[int, float]]]:
    """Solutions of all scenes in one; and of each method tried, rods and the seconds they took, compiling apart."""
    parts: dict[int, Any] = {}
    kinds, places = methods_of(method), places_of(POINTS)
    spent = [(0, 0.0)] * len(kinds)
    for numbers in by_structure(scenes):
        for number, kind in enumerate(kinds):
            left = [i for i in numbers if number == 0 or is_lost(parts[i], kinds[number - 1])]
            size = 1 if isinstance(kind, MultipleShooting) else BATCH  # side by side, it waits for the slowest
            for start in range(0, len(left), size):
                some = left[start : start + size]
                call = partial(solve_batch, stacked([scenes[i] for i in np.resize(some, size)]), kind, places)
                if start == 0:
                    jax.block_until_ready(call())
                solution, seconds = timed(call)
                rods, so_far = spent[number]
                spent[number] = rods + len(some), so_far + seconds * len(some) / size
                parts |= {i: jax.tree.map(lambda leaf, j=j: np.asarray(leaf[j]), solution) for j, i in enumerate(some)}
    return jax.tree.map(lambda *leaves: np.stack(leaves), *(parts[i] for i in range(len(scenes)))), spent


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
    """Of `count` converged scenes that took long: the gradient's error."""
    took_long = np.asarray(solution.converged) & (solution.iterations > 8) & (solution.condition < 1e3)
    hard_ones = np.flatnonzero(took_long)
    rng, errors = np.random.default_rng(0), []
    # the same number of steps wherever it is asked, fine enough
    single = SingleShooting(1e-6, steps=(20, 24), coarse_steps=FINE.coarse_steps)
    multiple = MultipleShooting(steps=2 * MULTIPLE.steps, newton_tol=1e-10)
    height = jax.jit(lambda scene, method: solve(scene, method, points=POINTS, throw=False).tip.y, static_argnums=1)
    slope = cache(lambda method: jax.jit(jax.grad(lambda scene: height(scene, method))))
    for number in hard_ones:
        if len(errors) == count:
            break
        # off the end of its range, past which a difference quotient would step
        scene = as_floats(replace(scenes[number], {"water.inlet_fraction": 0.9}))
        chosen = single if solve(scene, single, throw=False).converged else multiple
        if not solve(scene, chosen, throw=False).converged:
            continue  # for want of that current
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
    octopus = replace(load_scene("octopus"), {"arm.youngs_modulus": 1e6, "water.velocity": -0.3})
    pulled = replace(octopus, {"muscles.0.tension": 1.0})
    length, tension = np.geomspace(0.15, 1.5, size), np.linspace(0.0, 4.0, size)
    modulus, speed = np.geomspace(2e5, 1e9, size), np.linspace(-2.0, 2.0, size)
    figure, (left, right) = two_panels()
    codes = [
        draw_map(left, octopus, {"arm.length": length, "muscles.0.tension": tension}, 1 / octopus.arm.base_radius),
        draw_map(right, pulled, {"arm.youngs_modulus": modulus, "water.velocity": speed}),
    ]
    left.set(xlabel="slenderness, length / base radius", ylabel="tension [N]")
    left.set_title("octopus arm of 1 MPa in a current of $-0.3$ m/s", fontsize=10)
    right.set(xlabel="Young's modulus [Pa]", ylabel="current [m/s]")
    right.set_title("octopus arm pulled by 1 N", fontsize=10)
    save_with_legend(figure, path, [NAMES[code] for code in np.unique(codes)])


def draw_map(axes: Axes, scene: Scene, over: dict[str, np.ndarray], scale: float = 1.0) -> np.ndarray:
    """Draws, and gives back, the outcome at every combination; the first parameter, times `scale`, to the right."""
    codes = np.asarray(sweep(scene, over, METHOD, points=POINTS, batch=256).solution.outcome._value)
    places = np.vectorize(lambda code: list(COLOURS).index(NAMES[code]))(codes)
    x, y = over.values()
    colours = ListedColormap(list(COLOURS.values()))
    axes.pcolormesh(x * scale, y, places.T, cmap=colours, vmin=0, vmax=len(COLOURS) - 1, shading="nearest")
    axes.set_xscale("log")
    return codes


def drawn_map(path: Path, plains: list[dict], names: np.ndarray) -> None:
    """Where in the ranges the drawn scenes have an equilibrium: pull over slenderness, current over modulus."""
    arms = [plain["arm"] for plain in plains]
    unit = [arm["youngs_modulus"] * np.pi * arm["tip_radius"] ** 3 / (4 * arm["length"]) for arm in arms]
    pull = np.array([max(muscle["tension"] for muscle in plain["muscles"]) for plain in plains])
    slender = np.array([arm["length"] / arm["tip_radius"] for arm in arms])
    moduli = np.array([arm["youngs_modulus"] for arm in arms])
    currents = np.array([plain.get("water", {}).get("velocity", np.nan) for plain in plains])
    figure, (left, right) = two_panels()
    seen = [name for name in COLOURS if name in names]
    for name in seen:
        at = names == name
        left.scatter(slender[at], (pull / unit)[at], s=9, c=COLOURS[name], linewidths=0)
        right.scatter(moduli[at], currents[at], s=9, c=COLOURS[name], linewidths=0)
    left.set(xscale="log", xlabel="length / tip radius", ylabel=r"largest pull / ($E \pi R_{tip}^3 / 4 L$)")
    right.set(xscale="log", xlabel="Young's modulus [Pa]", ylabel="current [m/s]")
    save_with_legend(figure, path, seen)


def two_panels() -> tuple[Figure, np.ndarray]:
    figure = Figure(figsize=(10.0, 4.6), layout="constrained")
    return figure, figure.subplots(1, 2)


def save_with_legend(figure: Figure, path: Path, outcomes: list[str]) -> None:
    handles = [Patch(color=COLOURS[name], label=name.replace("_", " ")) for name in outcomes]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False)
    figure.savefig(path, dpi=110)


def replay(seed: int, number: int) -> None:
    """Prints one scene and what each method makes of it."""
    plain = hard.drawn(seed, number)
    scene = hard.alike(plain)
    print(dumps(scene))
    for name, method in {"default": METHOD, "single": FINE, "multiple": MULTIPLE, "128 intervals": FINER}.items():
        solution = solve(scene, method, points=POINTS, throw=False)
        how = f"{int(solution.iterations)} iterations, condition {float(solution.condition):.1e}"
        how += f", error {float(solution.error):.0e}"
        line(name, f"x {float(solution.tip.x):.9f} y {float(solution.tip.y):.9f} m, {how}", solution.message)
    for name, cold in {"solve_bvp, load-stepped": False, "solve_bvp, cold": True}.items():
        tip = collocated(plain, cold, limit=120)
        line(name, f"x {tip.x:.9f} y {tip.y:.9f} m, {tip.seconds:.1f} s", tip.how)


def main(chosen: argparse.Namespace) -> None:
    count, folder = chosen.scenes, chosen.out
    about = machine()
    plains = [hard.drawn(chosen.seed, number) for number in range(count)]
    scenes = [hard.alike(plain) for plain in plains]
    columns: dict[str, Any] = {"scene": range(count)}

    def keep(**more: Any) -> None:
        columns.update(more)
        if folder is not None:
            table(folder / "stability.csv", about, columns, zip(*columns.values(), strict=True))

    print(f"\n{count} scenes of {len(by_structure(scenes))} structures")
    solution, spent = solved(scenes, METHOD)
    names = np.array([NAMES[code] for code in solution.outcome._value])
    for name, many in Counter(names).most_common():
        line(name, f"{many:6d}   {100 * many / count:5.1f} %")
    line("default", f"{1e3 * sum(seconds for _, seconds in spent) / count:9.2f} ms a rod")
    methods = "two grids", "finer grids", "multiple shooting", "in four times as many intervals"
    for what, (rods, seconds) in zip(methods, spent, strict=False):  # fewer where nothing is left to solve
        line(f"  {what}", f"{1e3 * seconds / max(rods, 1):9.2f} ms a rod", f"{rods} rods")
    assert np.isnan(solution.tip.x[names != "converged"]).all()
    assert np.isfinite(solution.tip.x[names == "converged"]).all()
    keep(outcome=names, **statistics(solution))
    if folder is not None:
        drawn_map(folder / "stability_drawn.png", plains, names)

    if chosen.against is not None:
        list_changes(chosen.against, plains, solution, names)

    ends = [i for i in range(count) if names[i] != "converged"]
    beyond = unlike(scenes, solution, ends, FINE)
    line("no equilibrium: single shooting stops alike", f"{len(ends) - len(beyond)} of {len(ends)}")
    doubted = unlike(scenes, solution, beyond, FINER)
    alike = f"{len(beyond) - len(doubted)} of the other {len(beyond)}"
    line("multiple shooting with 128 intervals does", alike, f"not: {doubted}" if doubted else "")

    print("\nBeside other methods, tips within 1e-6 of the length counting as the same")
    base, base_spent = from_base(scenes)
    against("single shooting from the base", plains, solution, base)
    line("", f"{1e3 * base_spent / count:9.2f} ms a rod")
    keep(from_the_base=found_by(base, count))
    some = plains[: chosen.compared]
    stepped = [collocated(plain, cold=False) for plain in some]
    found, alike, differ = against("solve_bvp, load-stepped", some, solution, stepped)
    keep(solve_bvp=found_by(stepped, count))
    gaps = [apart(some[i], solution, i, tip) for i, tip in enumerate(stepped) if tip.found and names[i] == "converged"]
    guessed = [float(solution.error[i]) for i, tip in enumerate(stepped) if tip.found and names[i] == "converged"]
    if gaps:
        value = f"median {np.median(gaps):.1e}, largest {max(gaps):.1e} of the length"
        line("  distance of the tips", value, f"estimated {np.median(guessed):.1e}, {max(guessed):.1e}")
    for i in differ:
        line(f"scene {i}", f"{names[i]} at {float(solution.load_fraction[i]):.4f}", f"solve_bvp: {stepped[i].how}")
    cold = [collocated(plain, cold=True) for plain in some]
    against("solve_bvp, cold", some, solution, cold)
    keep(solve_bvp_cold=found_by(cold, count))
    for name, tips in (("load-stepped", stepped), ("cold", cold)):
        times = [tip.seconds for tip in tips if tip.found] or [np.nan]
        line(f"solve_bvp, {name}: found ones", f"median {np.median(times):6.2f} s, mean {np.mean(times):.2f} s a rod")

    print("\nGradients against central differences")
    errors = gradient_errors(scenes, solution, chosen.graded) if chosen.graded else [(0, np.nan)]
    worst = sorted(errors, key=lambda error: -error[1])[:3]
    line(f"{len(errors)} hard scenes", f"median {np.median([e for _, e in errors]):.1e}, largest {worst[0][1]:.1e}")
    line("largest", ", ".join(f"scene {number}: {error:.1e}" for number, error in worst))

    print("\nWorst cases (--replay NUMBER)")
    for what in ("iterations", "condition", "steps"):
        value = np.where(names == "converged", getattr(solution, what), 0)
        most = np.argsort(value)[::-1][:5]
        line(f"converged, most {what}", ", ".join(f"{i}: {float(value[i]):.3g}" for i in most))

    if folder is not None:
        outcome_maps(folder / "stability_maps.png", chosen.map)
    held = alike >= 0.98 * found and not doubted
    print(f"\nThe claim {'held' if held else 'DID NOT HOLD'} in this run: {alike} of {found} agree,")
    print(f"{len(doubted)} of {len(ends)} without equilibrium are in doubt.")


def unlike(scenes: list[Scene], solution: Solution, numbers: list[int], method: Method) -> list[int]:
    """Of these scenes, those that `method` does not find to end within 1 % of the same load."""
    if not numbers:
        return []
    again, _ = solved([scenes[i] for i in numbers], method)
    ratio = np.asarray(again.load_fraction) / np.asarray(solution.load_fraction)[numbers]
    return [i for i, r in zip(numbers, ratio, strict=True) if not abs(r - 1) < 0.01]


def statistics(solution: Solution) -> dict[str, list[str]]:
    """The columns that the solutions fill."""
    values = {"load_fraction": solution.load_fraction, "tip_x_m": solution.tip.x, "tip_y_m": solution.tip.y}
    values |= {"iterations": solution.iterations, "steps": solution.steps, "residual": solution.residual}
    values |= {"condition": solution.condition, "error": solution.error, "failed_at_m": solution.failed_at}
    return {name: [f"{float(number):.8g}" for number in column] for name, column in values.items()}


def list_changes(before: Path, plains: list[dict], solution: Solution, names: np.ndarray) -> None:
    """Prints what differs from an earlier run."""
    with before.open() as file:
        rows = list(csv.DictReader(row for row in file if not row.startswith("#")))[: len(plains)]
    print(f"\nBeside {before.name} of an earlier run, {len(rows)} scenes")
    changed, moved = 0, []
    for i, row in enumerate(rows):
        x, y, load_fraction = (float(row[name]) for name in ("tip_x_m", "tip_y_m", "load_fraction"))
        loads = load_fraction, float(solution.load_fraction[i])
        gap = apart(plains[i], solution, i, Tip(True, x, y, "", 0.0))
        moved += [gap] if np.isfinite(gap) else []
        if row["outcome"] != names[i] or abs(loads[1] / loads[0] - 1) > 0.01 or gap > 1e-7:
            changed += 1
            what = f"{row['outcome']} at {loads[0]:.4f}, then {names[i]} at {loads[1]:.4f}"
            line(f"scene {i}", what, f"tips {gap:.1e} of the length apart" if np.isfinite(gap) else "")
    apart_by = f"tips found in both apart by {np.median(moved):.1e}, at most {max(moved):.1e}"
    line("changed", f"{changed} of {len(rows)}", apart_by)


def found_by(tips: list[Tip], count: int) -> list[str]:
    return [str(tip.found) for tip in tips] + [""] * (count - len(tips))


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--scenes", type=int, default=2000, help="drawn from the ranges")
    parser.add_argument("--compared", type=int, default=100, help="of them, with solve_bvp, which is slow")
    parser.add_argument("--graded", type=int, default=50, help="of them, whose gradient is checked")
    parser.add_argument("--map", type=int, default=40, help="points of a map along each axis")
    parser.add_argument("--seed", type=int, default=SEED, help="of the scenes")
    parser.add_argument("--out", type=Path, metavar="FOLDER")
    parser.add_argument("--against", type=Path, metavar="FILE.csv", help="the table of an earlier run")
    parser.add_argument("--replay", type=int, metavar="NUMBER")
    chosen = parser.parse_args()
    if chosen.replay is not None:
        replay(chosen.seed, chosen.replay)
    else:
        print(CLAIM)
        main(chosen)
