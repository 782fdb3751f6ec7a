"""`reach`: from where the arm is to be, to the tensions or voltages that bring it there."""

from collections.abc import Iterable, Mapping
from typing import Any

import jax
import numpy as np
from jax.typing import ArrayLike

from ...scene import InputError, Scene
from ...solver import Method, outcome_codes
from .box_least_squares import LAST_EPS, Effort, Search, closest
from .multistart import best_of, grid, starts, starts_along_valleys
from .result import Reach, ReachOutcome
from .workspace import Arms, Workspace

_REACHED = 1e-9  # lengths
_GRID = 256  # rods from which searches start


def reach(
    scene: Scene,
    target: ArrayLike,
    free: Iterable[str] | Mapping[str, Any],
    at: ArrayLike | None = None,
    method: Method | None = None,
) -> Reach:
    """The values of the `free` parameters that bring the arm to `target` [m], within bounds and with least effort.

        minimise |r(s; values) - target|, and among equals sum (value / limit)^2,   lower <= value <= upper

    with limit the larger of |lower| and |upper|. The point r is the tip, or that `at` an arc length s [m]; with several
    `at`, the target is a whole shape of as many points, met in least squares. `target`: (2,) or (targets, 2); of a
    shape (at, 2) or (targets, at, 2). All targets are searched for side by side in one compiled batch.

    `free`: paths, or {path: (lower, upper)} with numbers in SI or strings with a unit, None for what is the default. A
    tension is at least zero and by default at most what would bend the arm by half a turn; the result says which. The
    path of a TCAM's voltage, `muscles.0.tcam.voltage`, stands for the constant voltage that holds the arm there, up to
    the muscle's `limit_temperature`; its effort is that of the tension. A TCAM without a voltage is cold and does not
    pull. Any other parameter needs bounds, its own range or given ones. What the scene has as values does not count.

    The searches start from the nearest of 256 equilibria over the box, several for one target where the grid has
    several nearest ones. A target that no search comes to within 1e-9 of the arm's length has the outcome
    `out_of_reach`, with the values that bring the arm closest; see `ReachOutcome`. What comes of a target does not
    raise. Rods are solved by single shooting; `MultipleShooting()` as `method` is for arms under high axial
    tension.

    Raises `InputError` for a target, a path, bounds or an arc length that is not allowed. Needs values at hand: not for
    use under `jit`, `grad` or `vmap`; to differentiate, use `solve` at `scene_at`.
    """
    arms = Arms.of(scene, free, at, method)
    targets, given = _targets(target, arms)
    box, shape = grid(len(arms.controls), _GRID)
    known, effort = arms.images(box), _effort(arms)
    owner, places = starts(targets, box, shape, known, effort)
    search = closest(arms.images, targets[owner], places, effort)
    best = best_of(search, owner, len(targets), effort, _reached(search))
    missed = np.flatnonzero((best < 0) | (search.distance[best] > _reached(search))) if owner.size else np.zeros(0, int)
    again, places = starts_along_valleys(targets[missed], box, shape, known)
    if again.size:
        search = search.and_also(closest(arms.images, targets[missed[again]], places, effort, LAST_EPS))
        owner = np.concatenate([owner, missed[again]])
        best = best_of(search, owner, len(targets), effort, _reached(search))
    count = np.bincount(owner, minlength=len(targets))
    return _result(arms, given, search, best, count, arms.workspace(box, shape, known))


def _effort(arms: Arms) -> Effort:
    """(value / limit)^2 of each unknown."""
    high = arms.low + arms.width
    limit = np.maximum(np.abs(arms.low), np.abs(high))
    return Effort(arms.low / limit, arms.width / limit)


def _targets(target: ArrayLike, arms: Arms) -> tuple[np.ndarray, np.ndarray]:
    """The targets in lengths of the arm, (targets, 2 at), and as they were given [m]."""
    try:
        given = np.asarray(target, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"target: {target!r} is not allowed; allowed: numbers in m") from None
    wanted = (2,) if arms.at.size == 1 else (arms.at.size, 2)
    if given.size == 0 or given.ndim > len(wanted) + 1 or given.shape[-len(wanted) :] != wanted:
        one = ", ".join(map(str, wanted))
        raise InputError(f"target: of shape {given.shape}; allowed: ({one}), or (targets, {one}) for several")
    if not np.isfinite(given).all():
        raise InputError(f"target: {given[~np.isfinite(given)][0]:g} is not allowed; allowed: finite numbers in m")
    return given.reshape(-1, 2 * arms.at.size) / arms.length, given


def _reached(search: Search) -> float:
    """|e| of a target that counts as reached: 1e-9 root mean square over its points."""
    return _REACHED * float(np.sqrt(search.target.shape[1] / 2))


def _codes(search: Search, best: np.ndarray) -> np.ndarray:
    """The outcome of each target by its best search."""
    lost = search.lost & ~search.settled
    exhausted = ~lost & ~search.settled & search.exhausted
    there = search.distance <= _reached(search)
    cases = [best < 0, there[best], lost[best], exhausted[best]] if best.size and search.u.size else [best < 0]
    names = ["no_equilibrium", "reached", "equilibrium_lost", "iterations_exhausted"][: len(cases)]
    known = outcome_codes(ReachOutcome)
    return np.select(cases, [known[name] for name in names], known["out_of_reach"]).astype(np.int32)


def _result(
    arms: Arms, given: np.ndarray, search: Search, best: np.ndarray, starts: np.ndarray, known: Workspace
) -> Reach:
    found = best >= 0
    nowhere = np.zeros((len(best), len(arms.controls)))
    u = np.where(found[:, None], search.u[best], nowhere) if found.any() else nowhere
    unknowns = np.where(found[:, None], arms.unknowns(u), np.nan)
    solution = arms.solutions(u)
    chosen = np.array(arms.places)
    points = np.stack([solution.fields.x[:, chosen], solution.fields.y[:, chosen]], axis=-1)
    apart = np.linalg.norm(points - given.reshape(points.shape), axis=-1)
    result = Reach(
        scene=arms.scene,
        free=arms.free,
        at=arms.at,
        target=given,
        values={one.free.path: one.values(unknowns[:, i]) for i, one in enumerate(arms.controls)},
        unknowns={one.path: unknowns[:, i] for i, one in enumerate(arms.controls)},
        points=points.reshape(-1, *given.shape[-1 if arms.at.size == 1 else -2 :]),
        solution=solution,
        outcome=jax.tree.map(lambda _: _codes(search, best), ReachOutcome.reached),
        distance=np.sqrt(np.mean(apart**2, axis=-1)),
        effort=np.where(found, _effort(arms).of(u), np.nan),
        iterations=np.where(found, search.iterations[best], 0) if found.any() else np.zeros(len(best), int),
        starts=starts,
        workspace=known,
    )
    return result if given.ndim > (1 if arms.at.size == 1 else 2) else result.first
