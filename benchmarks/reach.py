"""Where `reach` gets, and how long it takes, beside SciPy's solvers with bounds around the same compiled solve.

    python benchmarks/reach.py [--quick] [--out FOLDER]

- Targets that can be reached: tips of arms whose tensions are drawn at random between zero and the default limits. Each
  must be reached, which a solve of its own confirms: the distance is that of its tip.
- Targets that cannot: the same, moved along the ray from the base to 1.1 to 1.5 lengths of the arm, which a muscle can
  only shorten. None may be reached.
- SciPy: SLSQP, least effort subject to the tip at the target, and, for those out of reach, `least_squares` with trf;
  both with the exact Jacobian, one target at a time, by one rod's compiled solve, from the nearest of the grid's tips.
  A target counts as reached at 1e-8 m.
- Times: the second of two calls, so without compilation, `reach` with its grid of 256 rods.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import least_squares, minimize
from timing import line, machine, options, seconds, table, timed

from cosserat_jax import Reach, Scene, SingleShooting, load_scene, reach, replace, solve
from cosserat_jax.study.inverse.multistart import grid
from cosserat_jax.study.inverse.workspace import Arms

CLAIM = """\
Claim: of 200 random targets within reach all are reached to 1e-8 m, of targets out of reach none, for two and three
       muscles, with no more effort than SLSQP needs. Times stand beside SciPy's, which looks from one start only."""

METHOD = SingleShooting()


def scenes() -> dict[str, Scene]:
    """The octopus arm with an antagonist, and the arm with three muscles; both in water, with weight."""
    octopus = load_scene("octopus")
    pair = (octopus.muscles[0], dataclasses.replace(octopus.muscles[0], side=-1))
    return {"two muscles": dataclasses.replace(octopus, muscles=pair), "three muscles": load_scene("two-segments")}


def one_case(name: str, scene: Scene, targets: int, compared: int) -> list[Any]:
    """Prints the results of one scene, and returns them as a row of the table."""
    free = [f"muscles.{i}.tension" for i in range(len(scene.muscles))]
    arms = Arms.of(scene, free, None, METHOD)
    rng = np.random.default_rng(2026)
    drawn = arms.images(rng.uniform(size=(targets, len(free))))
    tips = drawn.r[drawn.exists] * arms.length
    beyond = tips * (rng.uniform(1.1, 1.5, len(tips)) * arms.length / np.linalg.norm(tips, axis=1))[:, None]
    beyond = beyond[: max(len(tips) // 4, compared)]

    print(f"\n{name}: {len(tips)} targets within reach, {len(beyond)} out of it")
    reach(scene, tips[:1], free, method=METHOD)
    found, spent = timed(lambda: reach(scene, tips, free, method=METHOD))
    single = seconds(lambda: reach(scene, tips[0], free, method=METHOD).distance)
    missed, spent_missed = timed(lambda: reach(scene, beyond, free, method=METHOD))
    apart = [_distance(scene, found, i) for i in range(len(tips))]
    line("reached of those within reach", f"{found.reached.sum()} of {len(tips)}", f"farthest {max(apart):.1e} m")
    line("reached of those out of reach", f"{missed.reached.sum()} of {len(beyond)}")
    line("steps of the search", _quantiles(found.iterations), f"out of reach {_quantiles(missed.iterations)}")
    line("time for a target, all in one call", f"{1e3 * spent / len(tips):.0f} ms")
    line("  out of reach", f"{1e3 * spent_missed / len(beyond):.0f} ms")
    line("time for a target on its own", f"{1e3 * single:.0f} ms")

    slsqp = [_slsqp(arms, found, i) for i in range(compared)]
    times, distances, efforts = (np.array(column) for column in zip(*slsqp, strict=True))
    there = distances < 1e-8
    excess = (efforts / found.effort[:compared] - 1)[there]
    line("SLSQP: reached", f"{there.sum()} of {compared}", f"{1e3 * times.mean():.0f} ms a target")
    line("  its effort over ours, less 1", f"{excess.min():+.1e} to {excess.max():+.1e}")
    trf = [_trf(arms, missed, i) for i in range(compared)]
    times_trf, nearest = (np.array(column) for column in zip(*trf, strict=True))
    excess_trf = nearest / missed.distance[:compared] - 1
    line("trf, out of reach: its distance over ours, less 1", f"{excess_trf.min():+.1e} to {excess_trf.max():+.1e}",
         f"{1e3 * times_trf.mean():.0f} ms a target")  # fmt: skip
    return [
        name, len(tips), int(found.reached.sum()), max(apart), len(beyond), int(missed.reached.sum()),
        spent / len(tips), single, times.mean(), int(there.sum()), compared, excess.min(), times_trf.mean(),
    ]  # fmt: skip


def _distance(scene: Scene, found: Reach, i: int) -> float:
    """Of the target from the tip that a solve of its own finds."""
    tip = _tip(scene, jnp.array([value[i] for value in found.unknowns.values()]))[0]
    return float(np.linalg.norm(np.asarray(tip) - found.target[i]))


@jax.jit
def _tip(scene: Scene, tensions: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The tip [m] of one arm and its rates by the tensions."""

    def of(tensions: jax.Array) -> tuple[jax.Array, jax.Array]:
        tip = solve(replace(scene, {f"muscles.{i}.tension": t for i, t in enumerate(tensions)}), METHOD).tip
        return jnp.stack([tip.x, tip.y]), jnp.stack([tip.x, tip.y])

    rates, tip = jax.jacfwd(of, has_aux=True)(tensions)
    return tip, rates


class _Kept:
    """One rod's tip in lengths and its rates by u, the last kept: SciPy asks for the two apart."""

    def __init__(self, arms: Arms, found: Reach, i: int) -> None:
        self.arms, self.target, self.u = arms, found.target[i] / arms.length, np.zeros(0)
        box, _ = grid(len(arms.controls), 256)
        apart = found.workspace.points[:, 0] / arms.length - self.target
        self.start = box[np.argmin(np.linalg.norm(apart, axis=1))]

    def at(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if not np.array_equal(u, self.u):
            tip, rates = _tip(self.arms.scene, jnp.asarray(self.arms.low + self.arms.width * u))
            self.error = np.asarray(tip) / self.arms.length - self.target
            self.rates, self.u = np.asarray(rates) * self.arms.width / self.arms.length, u.copy()
        return self.error, self.rates


def _slsqp(arms: Arms, found: Reach, i: int) -> tuple[float, float, float]:
    """Seconds, distance [m] and effort."""
    kept, n = _Kept(arms, found, i), len(arms.controls)
    constraint = {"type": "eq", "fun": lambda u: kept.at(u)[0], "jac": lambda u: kept.at(u)[1]}
    ended, spent = timed(
        lambda: minimize(
            lambda u: u @ u, kept.start, jac=lambda u: 2 * u, method="SLSQP", bounds=[(0, 1)] * n,
            constraints=constraint, options={"ftol": 1e-12, "maxiter": 200},
        ).x
    )  # fmt: skip
    return spent, float(np.linalg.norm(kept.at(ended)[0])) * arms.length, float(ended @ ended)


def _trf(arms: Arms, missed: Reach, i: int) -> tuple[float, float]:
    """Seconds and distance [m]."""
    kept = _Kept(arms, missed, i)
    start = np.clip(kept.start, 1e-3, 1 - 1e-3)
    ended, spent = timed(
        lambda: (
            least_squares(
                lambda u: kept.at(u)[0],
                start,
                lambda u: kept.at(u)[1],
                bounds=(0, 1),
                xtol=1e-12,
                ftol=1e-12,
                gtol=1e-12,
            ).x
        )
    )
    return spent, float(np.linalg.norm(kept.at(ended)[0])) * arms.length


def _quantiles(values: np.ndarray) -> str:
    low, middle, high = np.quantile(values, [0.0, 0.5, 1.0])
    return f"{middle:.0f} ({low:.0f} to {high:.0f})"


def main() -> None:
    chosen = options("20 targets in place of 200")
    print(CLAIM)
    about = machine()
    targets, compared = (20, 3) if chosen.quick else (200, 8)
    rows = [one_case(name, scene, targets, compared) for name, scene in scenes().items()]
    holds = all(row[1] == row[2] and row[3] < 1e-8 and row[5] == 0 and row[11] > -1e-6 for row in rows)
    print(f"\nThe claim holds: {'yes' if holds else 'NO'}")
    if chosen.out is not None:
        columns = [
            "scene", "within_reach", "of_them_reached", "farthest_m", "out_of_reach", "of_them_reached",
            "seconds_a_target", "seconds_single", "seconds_slsqp", "slsqp_reached", "slsqp_tried",
            "slsqp_least_excess_effort", "seconds_trf",
        ]  # fmt: skip
        table(chosen.out / "reach.csv", about, columns, rows)


if __name__ == "__main__":
    main()
