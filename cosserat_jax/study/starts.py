"""Where searches start, from the images of a grid over the box, and which of several for one target is kept.

A search finds what is least near its start. On a grid coarse as it is, the images of neighbours tell where there may be
another: each place that is better than all its neighbours is a start. On an arm of three links, the nearest of 216
images alone misses 2 of 200 targets; all such places together miss none.
"""

import math

import numpy as np
from jaxtyping import Float, Int

from .closest import Effort, Images, Search

_STARTS = 4  # searches for one target, at most
_START_EFFORT = 1e-3  # what effort counts beside the squared distance, in the choice of starts


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
    n = box.shape[1]
    near = 1.01 / (shape[0] - 1) if shape is not None else len(box) ** (-1 / n)
    neighbours = (np.abs(box[:, None] - box[None]) <= near).all(axis=-1)
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
