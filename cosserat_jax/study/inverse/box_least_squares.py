"""The point of a box whose image is closest to a target, and of all that are equally close the one of least effort.

Over u in [0, 1]^n, with the error e(u) = r(u) - target and the effort |w|^2, w = a + b u,

    phi(u) = |e(u)|^2 / 2 + eps |w(u)|^2 / 2        eps -> 0

whose minimiser tends to the lexicographic one: least distance first, then least effort. eps falls with the square of
the last step, so that the search never leaves the narrow valley of phi in which |e| is of the order of eps.

Steps are Newton's, with H = J^T J + sum e_i d2 e_i + eps b^2. The second term is what decides along directions in which
a redundant arm can move without moving its tip, and everywhere for a target out of reach, where Gauss-Newton without it
can fail to converge. It comes from differences of the exact J, whose n further images are computed in the same batch;
where there are no more unknowns than errors, only once a step of Gauss-Newton has not halved the distance.
Bounds are active where u stands at one and the gradient pushes outward (Bertsekas 1982, Projected Newton methods); what
a step would push through a bound is stopped there and the rest of the step computed anew. A trust region bounds the
step along each eigenvector of H, where H is negative it is taken by its absolute value (Dauphin et al. 2014).

optimistix has no bounds and SciPy's solvers with bounds take one target at a time, so this is written out, in NumPy:
the images, thousands of rods, are all the cost.
"""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

FIRST_EPS, LAST_EPS = 1e-3, 1e-8
_DIFFERENCE = 1e-4  # of the box, between the two J of a second derivative
_FIRST_RADIUS, _LAST_RADIUS = 0.25, 1e-9  # of the trust region, in parts of the box
_STEP = 1e-8  # of the box: the search ends before a step that is shorter
_NOISE = 1e-10  # of an image: the tip is known to 2e-11 lengths
_FLAT = 1e-12  # of the largest curvature: a direction with less is left alone
_ITERATIONS, _POLISHING = 80, 25
_NEAR, _EXACT = 1e-2, 1e-12  # distances: from where polishing may reach the target, and where it is good enough


class Images(NamedTuple):
    """Of points of the box: r, J = dr/du, and whether there is an image at all."""

    r: Float[np.ndarray, "points m"]
    jacobian: Float[np.ndarray, "points m n"]
    exists: Bool[np.ndarray, " points"]


Imaging = Callable[[Float[np.ndarray, "points n"]], Images]


class Effort(NamedTuple):
    """|a + b u|^2."""

    a: Float[np.ndarray, " n"]
    b: Float[np.ndarray, " n"]

    def weights(self, u: Float[np.ndarray, "... n"]) -> Float[np.ndarray, "... n"]:
        """a + b u."""
        return self.a + self.b * u

    def of(self, u: Float[np.ndarray, "... n"]) -> Float[np.ndarray, "..."]:
        """The effort at `u`."""
        return np.sum(self.weights(u) ** 2, axis=-1)


@dataclasses.dataclass
class Search:
    """Where each search stands, or ended: at `u`, with this error, Jacobian and curvature sum e_i d2 e_i.

    `curved`: whether the curvature is computed from here on; it is zero where it was not.
    `settled`: it ended where phi is least. `lost`: its last trial had no image, so it may have ended at the edge of
    what has one.
    """

    target: Float[np.ndarray, "searches m"]
    u: Float[np.ndarray, "searches n"]
    error: Float[np.ndarray, "searches m"]
    jacobian: Float[np.ndarray, "searches m n"]
    curvature: Float[np.ndarray, "searches n n"]
    eps: Float[np.ndarray, " searches"]
    radius: Float[np.ndarray, " searches"]
    curved: Bool[np.ndarray, " searches"]
    settled: Bool[np.ndarray, " searches"]
    lost: Bool[np.ndarray, " searches"]
    iterations: Int[np.ndarray, " searches"]

    def and_also(self, other: "Search") -> "Search":
        """These searches, then the others."""
        pairs = {one.name: (getattr(self, one.name), getattr(other, one.name)) for one in dataclasses.fields(self)}
        return Search(**{name: np.concatenate(pair) for name, pair in pairs.items()})

    @property
    def exhausted(self) -> Bool[np.ndarray, " searches"]:
        """Which used up their iterations."""
        return self.iterations >= _ITERATIONS

    @property
    def distance(self) -> Float[np.ndarray, " searches"]:
        """|e|."""
        return np.linalg.norm(self.error, axis=-1)

    def take(self, rows: np.ndarray, **values: np.ndarray) -> None:
        """Puts `values` in these rows."""
        for name, value in values.items():
            getattr(self, name)[rows] = value


def closest(
    imaging: Imaging,
    target: Float[np.ndarray, "searches m"],
    start: Float[np.ndarray, "searches n"],
    effort: Effort,
    eps: float = FIRST_EPS,
) -> Search:
    """Searches for each `target` from its `start`, which must have an image, all side by side.

    `eps` is the first one; with a small one a search does not leave the start for one of less effort.
    """
    search = _begin(imaging, target, start, eps)
    for _ in range(_ITERATIONS):
        rows = np.flatnonzero(~search.settled & (search.radius > _LAST_RADIUS))
        steps, promised = _next_steps(search, rows, effort)
        going = ~search.settled[rows]
        if not going.any():
            break
        _try(imaging, search, rows[going], steps[going], promised[going], effort)
    _polish(imaging, search)
    return search


def _begin(imaging: Imaging, target: np.ndarray, start: np.ndarray, eps: float) -> Search:
    count = len(target)
    curved = np.full(count, start.shape[1] > target.shape[1])
    error, jacobian, curvature, _ = _with_curvature(imaging, start, target, curved)
    return Search(
        target, start.copy(), error, jacobian, curvature, np.full(count, eps), np.full(count, _FIRST_RADIUS),
        curved, np.zeros(count, bool), np.zeros(count, bool), np.zeros(count, int),
    )  # fmt: skip


def _next_steps(search: Search, rows: np.ndarray, effort: Effort) -> tuple[np.ndarray, np.ndarray]:
    """The next step of each search and what its model promises, with eps lowered while the step is short for it.

    Marks as settled those whose step at the last eps is too short to be worth a trial.
    """
    while True:
        gradient, hessian = _model(search, rows, effort)
        step = newton_step(search.u[rows], gradient, hessian, search.radius[rows])
        size = np.abs(step).max(axis=-1, initial=0.0)
        eps = search.eps[rows]
        lower = (size**2 < eps) & (eps > LAST_EPS) & (size < search.radius[rows])
        if not lower.any():
            break
        search.eps[rows] = np.where(lower, np.maximum(LAST_EPS, np.minimum(size**2, 0.01 * eps)), eps)
    search.settled[rows] = size < _STEP
    promised = -np.einsum("ki,ki->k", gradient, step) - 0.5 * np.einsum("ki,kij,kj->k", step, hessian, step)
    return step, promised


def _model(search: Search, rows: np.ndarray, effort: Effort) -> tuple[np.ndarray, np.ndarray]:
    """Gradient and Hessian of phi."""
    jacobian, eps = search.jacobian[rows], search.eps[rows][:, None]
    gradient = np.einsum("kmi,km->ki", jacobian, search.error[rows]) + eps * effort.b * effort.weights(search.u[rows])
    hessian = np.einsum("kmi,kmj->kij", jacobian, jacobian) + search.curvature[rows]
    return gradient, hessian + eps[..., None] * np.diag(effort.b**2)


def _try(
    imaging: Imaging, search: Search, rows: np.ndarray, step: np.ndarray, promised: np.ndarray, effort: Effort
) -> None:
    """Takes the steps that lower phi; the ratio of actual to predicted decrease sets the size of the trust region."""
    u = np.clip(search.u[rows] + step, 0.0, 1.0)
    error, jacobian, curvature, exists = _with_curvature(imaging, u, search.target[rows], search.curved[rows])
    size, eps = np.abs(step).max(axis=-1), search.eps[rows]
    before = 0.5 * (search.distance[rows] ** 2 + eps * effort.of(search.u[rows]))
    after = np.where(exists, 0.5 * (np.sum(error**2, axis=-1) + eps * effort.of(u)), np.inf)
    gained, noise = before - after, _NOISE * search.distance[rows]
    taken = gained > -noise
    good = gained > 0.75 * promised - noise
    poor = gained < 0.25 * promised - noise
    radius = np.where(good, np.maximum(search.radius[rows], np.minimum(2 * size, 1.0)), search.radius[rows])
    radius = np.where(poor, 0.5 * size, radius)
    slow = ~(np.linalg.norm(error, axis=-1) < 0.5 * search.distance[rows])
    search.take(rows, radius=np.where(taken, radius, 0.25 * size), lost=~exists, iterations=search.iterations[rows] + 1)
    search.take(rows, curved=search.curved[rows] | slow)
    search.take(
        rows[taken], u=u[taken], error=error[taken], jacobian=jacobian[taken], curvature=curvature[taken]
    )  # fmt: skip


def newton_step(u: np.ndarray, gradient: np.ndarray, hessian: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """The step from each u that minimises its model inside the box and the trust region, nearly."""
    bound = ((u <= 0) & (gradient > 0)) | ((u >= 1) & (gradient < 0))
    step = np.zeros_like(u)
    for _ in range(u.shape[-1]):
        held = np.where(bound, step, 0.0)
        pull = np.where(bound, 0.0, gradient + np.einsum("kij,kj->ki", hessian, held))
        step = np.where(bound, held, _free_step(pull, hessian, ~bound, radius))
        through = ~bound & ((u + step < 0) | (u + step > 1))
        if not through.any():
            break
        step = np.where(through, np.clip(u + step, 0.0, 1.0) - u, step)
        bound |= through
    return np.clip(u + step, 0.0, 1.0) - u


def _free_step(pull: np.ndarray, hessian: np.ndarray, free: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """-|H|^-1 pull among the free variables, in each eigenvector of H at most `radius`."""
    among = hessian * (free[:, :, None] & free[:, None, :])
    values, vectors = np.linalg.eigh(among)
    values = np.abs(values)
    along = np.einsum("kij,ki->kj", vectors, pull)
    curved = values > _FLAT * np.max(values, axis=-1, keepdims=True)
    length = np.where(curved, -along / np.where(curved, values, 1.0), 0.0)
    return np.einsum("kij,kj->ki", vectors, np.clip(length, -radius[:, None], radius[:, None])) * free


def _with_curvature(
    imaging: Imaging, u: np.ndarray, target: np.ndarray, curved: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """e, J, sum e_i d2 e_i where `curved` and near by is an image, else zero, and whether there is an image at all."""
    count, n = u.shape
    sign = np.where(u[curved] < 0.5, _DIFFERENCE, -_DIFFERENCE)
    beside = u[curved][:, None, :] + sign[:, :, None] * np.eye(n)
    r, jacobian, exists = imaging(np.concatenate([u, beside.reshape(-1, n)]))
    error = r[:count] - target
    change = jacobian[count:].reshape(-1, n, *jacobian.shape[1:]) - jacobian[:count][curved][:, None]
    there = exists[count:].reshape(-1, n)
    second = np.einsum("kimj,km->kij", change / sign[:, :, None, None], error[curved])
    second = np.where(there[:, None] & there[:, :, None], second, 0.0)
    curvature = np.zeros((count, n, n))
    curvature[curved] = 0.5 * (second + np.swapaxes(second, 1, 2))
    return error, jacobian[:count], curvature, exists[:count]


def _polish(imaging: Imaging, search: Search) -> None:
    """From what phi at the last eps leaves of a target's distance to none, by the shortest Gauss-Newton steps.

    They move as little as possible, so the effort stays least to first order. What stands at a bound stays there.
    """
    rows = np.flatnonzero(search.distance < _NEAR)
    for _ in range(_POLISHING):
        rows = rows[search.distance[rows] > _EXACT]
        if rows.size == 0:
            break
        jacobian, error, u = search.jacobian[rows], search.error[rows], search.u[rows]
        gradient = np.einsum("kmi,km->ki", jacobian, error)
        hessian = np.einsum("kmi,kmj->kij", jacobian, jacobian)
        gradient[(u <= 0) | (u >= 1)] = 0.0
        free = (u > 0) & (u < 1)
        u = np.clip(u + _free_step(gradient, hessian, free, np.full(rows.size, _FIRST_RADIUS)), 0.0, 1.0)
        r, jacobian, exists = imaging(u)
        error = r - search.target[rows]
        better = exists & (np.linalg.norm(error, axis=-1) < 0.5 * search.distance[rows])
        rows = rows[better]
        search.take(rows, u=u[better], error=error[better], jacobian=jacobian[better])
