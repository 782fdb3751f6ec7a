"""27-node bricks that fill half of a tapered arm of circular section, e3 >= 0; the other half is its mirror image.

Every section of nodes is the same half-disk of 9-node quadrilaterals, scaled by the radius there: a core of quads of
`core` by `core` in each quadrant, around it `rings` layers out to the circle. Sections follow
one another along e1, two for each of the `along` layers of bricks.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from .arm import Arm, Array

Integers = NDArray[np.int64]
GAUSS_POINTS, GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(3)


def line_shapes(t: Array) -> tuple[Array, Array]:
    """Quadratic polynomials of the nodes -1, 0, 1, and their slopes, [points, 3]."""
    return np.stack([t * (t - 1) / 2, 1 - t**2, t * (t + 1) / 2], 1), np.stack([t - 0.5, -2 * t, t + 0.5], 1)


def brick_shapes() -> tuple[Array, Array, Array, Array]:
    """At the 27 Gauss points of a brick: places [27, 3], weights [27], shapes [27, 27] and slopes [27, 27, 3].

    Nodes and points are numbered with the coordinate along the arm slowest.
    """
    values, slopes = line_shapes(GAUSS_POINTS)
    places = np.stack(np.meshgrid(*[GAUSS_POINTS] * 3, indexing="ij"), -1).reshape(27, 3)
    weights = np.einsum("i,j,k->ijk", *[GAUSS_WEIGHTS] * 3).ravel()

    def product(*factors: Array) -> Array:
        return np.einsum("ia,jb,kc->ijkabc", *factors).reshape(27, 27)

    gradient = [product(*(slopes if i == direction else values for i in range(3))) for direction in range(3)]
    return places, weights, product(values, values, values), np.stack(gradient, -1)


def half_disk(core: int, rings: int) -> tuple[Array, Integers]:
    """Nodes [nodes, 2] of a half disk of area pi / 2, and the nodes [quads, 9] of its 9-node quadrilaterals.

    Its edge is one of parabolas, so its nodes lie a little outside the unit circle.
    """

    def patch(inner: Array, outer: Array, along: int, across: int) -> Array:
        """Grid of nodes between two curves, each given at 2 along + 1 points."""
        share = np.linspace(0, 1, 2 * across + 1)[:, None, None]
        return (1 - share) * inner + share * outer

    t = np.linspace(0, 1, 2 * core + 1)[:, None]
    side, corner = 0.55, 0.43

    def quadrant() -> list[Array]:
        bottom = t * [side, 0.0]
        right = (1 - t) * [side, 0.0] + t * [corner, corner]
        top = (1 - t) * [0.0, side] + t * [corner, corner]
        arcs = [np.hstack([np.cos(a), np.sin(a)]) for a in (t * np.pi / 4, np.pi / 2 - t * np.pi / 4)]
        return [
            patch(bottom, top, core, core),
            patch(right, arcs[0], core, rings),
            patch(top, arcs[1], core, rings)[:, ::-1],
        ]

    grids = [*quadrant(), *(grid[:, ::-1] * [-1.0, 1.0] for grid in quadrant())]
    quads, nodes = [], []
    for grid in grids:
        numbers = len(nodes) + np.arange(grid[..., 0].size).reshape(grid.shape[:2])
        nodes += list(grid.reshape(-1, 2))
        quads += [
            numbers[i : i + 3, j : j + 3]
            for i in range(0, grid.shape[0] - 2, 2)
            for j in range(0, grid.shape[1] - 2, 2)
        ]
    _, first, merged = np.unique(np.round(nodes, 9), axis=0, return_index=True, return_inverse=True)
    disk, quads = np.array(nodes)[first], merged.ravel()[np.array(quads)].reshape(-1, 9)
    _, area = quad_points(disk, quads)
    return disk * np.sqrt(np.pi / 2 / area.sum()), quads


def quad_points(disk: Array, quads: Integers) -> tuple[Array, Array]:
    """Places [quads, 9, 2] of the Gauss points and the areas [quads, 9] that they stand for."""
    values, slopes = line_shapes(GAUSS_POINTS)
    gradients = np.stack([plane(slopes, values), plane(values, slopes)])
    jacobian = np.einsum("dqn,eni->eqdi", gradients, disk[quads])
    area = np.abs(np.linalg.det(jacobian)) * np.outer(GAUSS_WEIGHTS, GAUSS_WEIGHTS).ravel()
    return np.einsum("qn,eni->eqi", plane(values, values), disk[quads]), area


def plane(first: Array, second: Array) -> Array:
    """Shapes of a quadrilateral, [9 points, 9 nodes], from those of its two directions."""
    return np.einsum("ia,jb->ijab", first, second).reshape(9, 9)


@dataclass(frozen=True)
class Mesh:
    """Sections of nodes at `stations` [m], an odd number of them, and in each the half-disk `disk`, `quads`."""

    arm: Arm
    stations: Array
    disk: Array
    quads: Integers

    @classmethod
    def of(cls, arm: Arm, along: int, core: int = 1, rings: int = 1) -> "Mesh":
        """`along` layers of bricks, whose lengths follow the root of the radius; `core`, `rings` of the sections."""
        root = np.sqrt(arm.radius([0, arm.length])) if arm.radius_slope else np.array([0.0, 1.0])
        share = np.linspace(*root, along + 1)
        ends = (share**2 - share[0] ** 2) / arm.radius_slope if arm.radius_slope else share * arm.length
        stations = np.interp(np.arange(2 * along + 1) / 2, np.arange(along + 1), ends)
        stations[-1] = arm.length
        return cls(arm, stations, *half_disk(core, rings))

    @property
    def size(self) -> int:
        """Number of bricks."""
        return (len(self.stations) - 1) // 2 * len(self.quads)

    @cached_property
    def nodes(self) -> Array:
        """Coordinates [stations * nodes of a section, 3] in the straight arm."""
        places = self.arm.radius(self.stations)[:, None, None] * self.disk
        along = np.broadcast_to(self.stations[:, None, None], (*places.shape[:2], 1))
        return np.concatenate([along, places], -1).reshape(-1, 3)

    @cached_property
    def bricks(self) -> Integers:
        """Nodes [bricks, 27]."""
        first = np.arange(0, len(self.stations) - 1, 2)[:, None, None]
        section = (first + np.arange(3)[None, :, None]) * len(self.disk)
        return (section[:, None, :, :] + self.quads[None, :, None, :]).reshape(-1, 27)

    @cached_property
    def layers(self) -> Integers:
        """Stations [along, 3] of the layers of bricks."""
        return np.arange(0, len(self.stations) - 1, 2)[:, None] + np.arange(3)

    @cached_property
    def moments(self) -> Array:
        """Of the unit section, [3, nodes of a section]: weights of the mean over the section, of the first moment
        along e2 over the second moment of area, and of the one along e3, both halves counted."""
        place, area = quad_points(self.disk, self.quads)
        values, _ = line_shapes(GAUSS_POINTS)
        rows = []
        for factor in (np.ones_like(area), place[..., 0], place[..., 1]):
            share = np.einsum("eq,eq,qn->en", area, factor, plane(values, values))
            rows.append(np.bincount(self.quads.ravel(), share.ravel(), len(self.disk)))
        second = np.einsum("eq,eqi,eqi->i", area, place, place)
        return np.stack([rows[0] / area.sum(), rows[1] / second[0], rows[2] / second[1]])
