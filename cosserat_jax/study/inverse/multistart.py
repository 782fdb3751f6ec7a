"""Where searches start, from the images of a grid over the box, and which of several for one target is kept.

A search finds what is least near its start. Coarse as a grid is, the images of neighbours tell where there may be
another: each place that is better than all its neighbours is a start. On an arm of three links, the nearest of 216
images alone misses 2 of 200 targets; all such places together miss none.

Two muscles against each other make a workspace so thin that this is not enough: pulled harder together they move the
tip by less than a hundredth of what either does alone. The images that come within a step of a target lie along a
valley across the box, and a search that lets effort decide first slides down to its end. So a target that was missed,
but has such a valley, is searched for once more, from places all along it.
"""

import math

import numpy as np
from jaxtyping import Float, Int

from .box_least_squares import Effort, Images, Search, newton_step

_STARTS = 4  # searches for one target, at most
_START_EFFORT = 1e-3  # what effort counts beside the squared distance, in the choice of starts
_VALLEY = 0.03  # lengths: a place counts as in the valley of a target if its Jacobian predicts a step to within this
_ALONG_VALLEY, _APART = 12, 1.5  # searches at most, and spacings of the grid between them


def grid(n: int, count: int) -> tuple[Float[np.ndarray, "rods n"], tuple[int, ...] | None]:
    """At most `count` places of the box [0, 1]^n: a grid with its corners, or where it would be too coarse the
    additive recurrence of Roberts (2018), "The unreasonable effectiveness of quasirandom sequences"."""
    per_axis = math.floor(count ** (1 / n) * (1 + 1e-12))
    if per_axis >= 3:
        axes = [np.linspace(0.0, 1.0, per_axis)] * n
        mesh = np.meshgrid(*axes, indexing="ij")
        return np.stack([axis.ravel() for axis in mesh], axis=-1), (per_axis,) * n
    ratio = 2.0
    for _ in range(50):
        ratio = (1 + ratio) ** (1 / (n + 1))  # the root of x^(n + 1) = x + 1
    return (0.5 + np.arange(1, count + 1)[:, None] * ratio ** -np.arange(1.0, n + 1)) % 1.0, None


def starts(
    targets: np.ndarray, box: np.ndarray, shape: tuple[int, ...] | None, known: Images, effort: Effort
) -> tuple[np.ndarray, np.ndarray]:
    """Where the searches start: of which target each is, and its place in the box.

    For each target the best of the places at which squared distance and a little effort together are less than at all
    neighbours.
    """
    neighbours = _within(box, 1.01 * _spacing(box, shape))
    owner, places = [], []
    for i, target in enumerate(targets):
        score = np.sum((known.r - target) ** 2, axis=-1) + _START_EFFORT * effort.of(box)
        score = np.where(known.exists, score, np.inf)
        lowest = np.where(neighbours, score, np.inf).min(axis=1)
        minima = np.flatnonzero(known.exists & (score <= lowest))
        chosen = minima[np.argsort(score[minima], kind="stable")][:_STARTS]
        owner += [i] * len(chosen)
        places.append(box[chosen])
    return np.array(owner, int), np.concatenate(places)


def starts_along_valleys(
    targets: np.ndarray, box: np.ndarray, shape: tuple[int, ...] | None, known: Images
) -> tuple[np.ndarray, np.ndarray]:
    """As `starts`, places from which a step within their spacing should come near the target, spread over all of them.

    None for a target that is far from all images.
    """
    spacing = _spacing(box, shape)
    close = _within(box, _APART * spacing)
    jacobian = np.where(known.exists[:, None, None], known.jacobian, 0.0)  # an arm without equilibrium has none
    hessian = np.einsum("kmi,kmj->kij", jacobian, jacobian)
    owner, places = [], [np.zeros((0, box.shape[1]))]
    for i, target in enumerate(targets):
        error = np.where(known.exists[:, None], known.r - target, 0.0)
        step = newton_step(box, np.einsum("kmi,km->ki", jacobian, error), hessian, np.full(len(box), spacing))
        left = np.linalg.norm(error + np.einsum("kmi,ki->km", jacobian, step), axis=-1)
        left = np.where(known.exists, left, np.inf)
        for _ in range(_ALONG_VALLEY):
            k = int(np.argmin(left))
            if left[k] > _VALLEY:
                break
            owner.append(i)
            places.append(box[k : k + 1])
            left = np.where(close[k], np.inf, left)
    return np.array(owner, int), np.concatenate(places)


def best_of(
    search: Search, owner: Int[np.ndarray, " searches"], targets: int, effort: Effort, near: float
) -> Int[np.ndarray, " targets"]:
    """For each target the search that came as `near` as that with least effort, or else closest; -1: there was none."""
    spent = effort.of(search.u)
    best = np.full(targets, -1)
    for i in range(targets):
        mine = np.flatnonzero(owner == i)
        if mine.size:
            there = search.distance[mine] <= near
            best[i] = mine[np.argmin(np.where(there, spent[mine], 1e6 + search.distance[mine]))]
    return best


def _spacing(box: np.ndarray, shape: tuple[int, ...] | None) -> float:
    return 1 / (shape[0] - 1) if shape is not None else len(box) ** (-1 / box.shape[1])


def _within(box: np.ndarray, distance: float) -> np.ndarray:
    """Which places are within this distance of which, in each direction."""
    return np.max(np.abs(box[:, None] - box[None]), axis=-1) <= distance
