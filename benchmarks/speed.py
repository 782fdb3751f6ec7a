"""How fast the solver is: compile time apart from run time, gradients and batches beside one solve, SciPy beside all.

    python benchmarks/speed.py [--quick]

Needs SciPy and the folder tests/ next to this one, for tests/reference.py. The rod is the preset "octopus": a tapered
arm in water, bent by one muscle.

- Compile time: `jax.jit(f).trace(scene)`, `.lower()` and `.compile()`, each timed once, JAX's caches cleared before and
  its persistent cache off. For sweeps: the first call less the median of the warm ones, Python's part included.
- Run time: median of calls that wait for their result, quartiles in brackets. Calls compared by a ratio are taken in
  turn, so that a slow spell of the machine meets both; only SciPy runs before the sweeps it is compared with.
  "Gradient" is of the tip's y with respect to every float of the scene, computed together with the whole `Solution`.
- Error: distance [m] of the tip from that of a tight solution, `Shooting(rtol=1e-12, atol=1e-12)`; the largest over the
  rods named. `solve_bvp` reaches the same tips from another formulation, so its error at its tightest tolerance vouches
  for the tight solution.
- `solve_bvp`: the reference formulation of the tests on six rods of the 82, one after another. "continued" raises the
  load from zero in steps as the tests do, collocating coarsely, and refines at the end; "cold" starts from the straight
  arm at full load. Rods that it does not find so count in no mean and no ratio. The ratio is taken at the tolerance of
  `solve_bvp` whose error on its rods is nearest to ours on the same rods.
"""

import sys
from functools import partial

import jax
import numpy as np
from collocation import plain, reference
from timing import compiled, in_turn, line, machine, seconds, spread

from cosserat_jax import Scene, Shooting, load, replace, solve, sweep

CLAIM = """\
Claim: at equal error a rod of the 82-rod sweep takes under 1/50 of scipy.integrate.solve_bvp's time, cold or continued;
       a solve with its gradient with respect to every float of the scene takes less than two solves."""

QUICK = "--quick" in sys.argv[1:]
GRID = {"muscles.0.tension": np.linspace(0.0, 20.0, 41), "water.velocity": np.array([0.2, 0.4])}
LARGE_GRID = {"muscles.0.tension": np.linspace(0.0, 20.0, 64), "water.velocity": np.linspace(0.1, 0.5, 64)}
COMPARED = np.linspace(0, 81, 6).round().astype(int)  # rods of GRID: 0, 4, .. 20 N, the first three in the slower water
OUR_TOLERANCES = (1e-6, 1e-9) if QUICK else (1e-6, 1e-7, 1e-8, 1e-9)
BVP_TOLERANCES = (1e-3, 1e-6, 1e-9) if QUICK else (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9)


def one_rod(scene: Scene) -> float:
    """Prints compile and run time of one rod and its gradient; ratio of value and gradient to a solve."""

    def tip_height(scene: Scene):
        solution = solve(scene, throw=False)
        return solution.tip.y, solution

    print("\nCompile time, one rod")
    run = compiled("solve (first in the process)", lambda scene: solve(scene, throw=False), scene)
    run_gradient = compiled("value and gradient", jax.value_and_grad(tip_height, has_aux=True), scene)
    plain, gradient, called = in_turn(run, run_gradient, partial(solve, scene), repeats=5 if QUICK else 25)
    ratio = float(np.median(gradient) / np.median(plain))
    print("\nRun time, one rod")
    line("solve, compiled", spread(plain))
    line(f"value and gradient by {len(jax.tree.leaves(scene))} floats", spread(gradient), f"{ratio:.2f} solves")
    line("solve(scene) as called, edge in Python included", spread(called))
    return ratio


def batches(scene: Scene) -> None:
    """Prints first and warm time of the two sweeps at the default tolerances."""
    print("\nSweeps, default method, as called")
    for grid in (GRID,) if QUICK else (GRID, LARGE_GRID):
        run = partial(sweep, scene, grid)
        first = seconds(run)
        times, one = in_turn(run, partial(solve, scene), repeats=5 if QUICK or grid is LARGE_GRID else 15)
        count = len(grid["muscles.0.tension"]) * len(grid["water.velocity"])
        line(f"{count} rods: trace, lower and compile", f"{first - np.median(times):9.2f} s")
        line(f"{count} rods in batches of {min(count, 256)}", spread(times))
        line("  per rod", spread(times, count), f"{np.median(times) / np.median(one) / count:.4f} of solve(scene)")


def collocated(rods: list[dict], exact: np.ndarray, cold: bool) -> dict[float, tuple[np.ndarray, float, float]]:
    """`solve_bvp` at each tolerance: {tol: (rods found, largest tip error [m], mean of the rods' median times [s])}."""
    results = {}
    for tol in BVP_TOLERANCES:
        run = partial(reference.solve, tol=tol, cold=cold)
        tips = [run(rod) for rod in rods]
        found = np.array([tip.converged for tip in tips])
        outcome = f"{found.sum()} of {len(rods)} rods found"
        if found.any():
            error = max(np.hypot(*(np.array([[tip.x, tip.y] for tip in tips]) - exact)[found].T))
            chosen = [rod for rod, there in zip(rods, found, strict=True) if there]
            samples = [[seconds(partial(run, rod)) for rod in chosen] for _ in range(1 if QUICK else 3)]
            results[tol] = found, error, np.median(samples, axis=0).mean()
            outcome = f"{error:.1e} m   {1e3 * results[tol][2]:9.3f} ms a rod   {outcome}"
        line(f"{'cold' if cold else 'continued'}, tol {tol:.0e}", outcome)
    return results


def against_scipy(scene: Scene) -> float:
    """Prints error and time of both; the smallest ratio of time per rod at equal error."""

    def swept(tol: float) -> tuple[np.ndarray, list[float]]:
        run = partial(sweep, scene, GRID, Shooting(rtol=tol, atol=tol))
        tip = run().solution.tip
        return np.stack([tip.x.ravel(), tip.y.ravel()], axis=1), in_turn(run, repeats=5 if QUICK else 15)[0]

    exact, _ = swept(1e-12)
    mesh = [axis.ravel() for axis in np.meshgrid(*GRID.values(), indexing="ij")]
    scenes = [replace(scene, {path: axis[i] for path, axis in zip(GRID, mesh, strict=True)}) for i in COMPARED]
    rods = [plain(rod) for rod in scenes]
    print(f"\nsolve_bvp on {len(rods)} of the 82 rods: largest tip error, mean time")
    results = {start: collocated(rods, exact[COMPARED], start == "cold") for start in ("continued", "cold")}

    print("\ncosserat_jax on the 82 rods in one batch: largest tip error, time; solve_bvp at equal error beside it")
    ratios = []
    for tol in OUR_TOLERANCES:
        tips, times = swept(tol)
        errors, rod_time = np.hypot(*(tips - exact).T), np.median(times) / len(exact)
        line(f"rtol = atol = {tol:.0e}", f"{errors.max():.1e} m   {spread(times)}", f"{1e3 * rod_time:.3f} ms a rod")
        for start, by_tol in results.items():
            ours = {other: errors[COMPARED][found].max() for other, (found, _, _) in by_tol.items()}
            equal = min(by_tol, key=lambda other: abs(np.log(by_tol[other][1] / ours[other])))
            ratios.append(by_tol[equal][2] / rod_time)
            of_both = f"its error {by_tol[equal][1]:.1e} m, ours {ours[equal]:.1e} m"
            line(f"  solve_bvp {start}, tol {equal:.0e}", of_both, f"{ratios[-1]:.0f} times as long a rod")
    return min(ratios)


if __name__ == "__main__":
    print(CLAIM)
    jax.config.update("jax_enable_compilation_cache", False)
    machine()
    gradient_ratio = one_rod(load("octopus"))
    batches(load("octopus"))
    scipy_ratio = against_scipy(load("octopus"))
    held = "held" if gradient_ratio < 2 and scipy_ratio > 50 else "DID NOT HOLD"
    print(f"\nThe claim {held} in this run: at equal error solve_bvp took at least {scipy_ratio:.0f} times as long,")
    print(f"value and gradient took {gradient_ratio:.2f} solves.")
