"""The equilibrium of the arm as a solid: section means as unknowns, Newton's method from the shape of a rod.

Sought is the stationary point, in displacements u, pressures p, section means g and multipliers l, of

    int W(F, p) dV  +  V(g)  +  sum_k l_k . (g_k - B_k x)

with W that of `material`, V that of `sections`, and B_k the means over the section at station k. (With g eliminated a
tendon would couple all nodes of a section with all of the next ones. Its stiffness and that of the solid that it
compresses nearly cancel, so that the slopes have to be exact.) Unknowns are ordered along the arm: the matrix is
banded and indefinite, and SciPy's SuperLU factors it in that order.

The plane e3 = 0 is one of symmetry. The base stays plane and is free to contract in its plane, the mean of its places
held, as the base of a rod; or, `clamped`, all its nodes are held.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from .arm import Array, Loads
from .bricks import Bricks
from .material import Rubber
from .mesh import Integers, Mesh, brick_shapes
from .rod import Rod, rod
from .sections import Sections

try:  # MKL's solver
    from pypardiso import spsolve as pardiso
except ImportError:
    pardiso = None


class Bent(NamedTuple):
    """An equilibrium: places `x` [nodes, 3] of the nodes, pressures `p` [bricks, 4], and at the stations `s` the means
    r [stations, 2], the directors d = beta b, and the scale of the section along e3. Newton's method took `iterations`;
    `error` is its last step over the arm's length."""

    s: Array
    x: Array
    p: Array
    r: Array
    d: Array
    scale_3: Array
    error: float
    iterations: int

    @property
    def theta(self) -> Array:
        """Angle of the sections [rad]."""
        return np.unwrap(np.arctan2(-self.d[:, 0], self.d[:, 1]))

    @property
    def beta(self) -> Array:
        """Cross-section scale in the plane."""
        return np.hypot(*self.d.T)

    @property
    def tip(self) -> Array:
        """x, y [m] and theta [rad] of the last section."""
        return np.array([*self.r[-1], self.theta[-1]])


@dataclass(frozen=True)
class Solid:
    """A mesh of a material under loads, its water frozen on given section means or not (`Sections`)."""

    mesh: Mesh
    rubber: Rubber
    loads: Loads
    clamped: bool = False
    frozen: Array | None = None

    @cached_property
    def bricks(self) -> Bricks:
        return Bricks(self.mesh, self.rubber)

    @cached_property
    def sections(self) -> Sections:
        return Sections(self.mesh, self.loads, self.frozen)

    @cached_property
    def first(self) -> Integers:
        """Where u, p, g and l begin among all unknowns, and their number."""
        count = 4 * len(self.mesh.stations)
        return np.cumsum([0, self.mesh.nodes.size, 4 * self.mesh.size, count, count])

    def split(self, unknowns: Array) -> tuple[Array, Array, Array, Array]:
        """u [nodes, 3], p [bricks, 4], g and l [stations, 4]; views of the one array."""
        u, p, g, multipliers = np.split(unknowns, self.first[1:-1])
        return u.reshape(-1, 3), p.reshape(-1, 4), g.reshape(-1, 4), multipliers.reshape(-1, 4)

    @cached_property
    def free(self) -> Integers:
        """The unknowns that are not held, in the order of their places along the arm."""
        mesh = self.mesh
        is_free, place = np.ones(self.first[-1], bool), np.empty(self.first[-1])
        u, _, g, _ = self.split(is_free)
        u[mesh.nodes[:, 2] < 1e-12, 2] = False
        u[mesh.nodes[:, 0] == 0, : 3 if self.clamped else 1] = False
        g[0, 1] = self.clamped  # the mean of the base along e2 is held by its nodes, or by itself
        u, p, *sections = self.split(place)
        u[:] = mesh.nodes[:, :1]
        p[:] = mesh.nodes[mesh.bricks, 0].mean(1, keepdims=True)
        for each in sections:
            each[:] = mesh.stations[:, None]
        order = np.argsort(place, kind="stable")
        return order[is_free[order]]

    def system(self, unknowns: Array) -> tuple[sparse.csr_array, Array]:
        """Slope and residual of the equations of all unknowns, held ones included."""
        mesh, first, means = self.mesh, self.first, self.sections.matrix
        u, p, g, multipliers = self.split(unknowns)
        x = mesh.nodes + u
        of_brick = np.hstack(
            [
                (3 * mesh.bricks[..., None] + np.arange(3)).reshape(-1, 81),
                first[1] + np.arange(p.size).reshape(-1, 4),
            ]
        )
        of_layer = first[2] + (4 * mesh.layers[..., None] + np.arange(4)).reshape(-1, 12)
        of_tip = first[3] - 4 + np.arange(4)[None]
        on_g, on_l = np.arange(first[2], first[3]), np.arange(first[3], first[4])

        residual, entries = np.zeros(first[4]), []
        for numbers, (part, slope) in (
            (of_brick, self.bricks.system(x, p)),
            (of_layer, self.sections.along(g)),
            (of_tip, self.sections.at_tip(g[-1])),
        ):
            residual += np.bincount(numbers.ravel(), part.ravel(), first[4])
            rows, columns = np.broadcast_arrays(numbers[:, :, None], numbers[:, None, :])
            entries.append((slope.ravel(), rows.ravel(), columns.ravel()))
        _, _, residual_g, residual_l = self.split(residual)
        residual[: first[1]] -= means.T @ multipliers.ravel()
        residual_g += multipliers
        residual_l[:] = g - (means @ x.ravel()).reshape(-1, 4)
        tie, one = means.tocoo(), np.ones(on_g.size)
        entries += [(-tie.data, tie.col, on_l[tie.row]), (-tie.data, on_l[tie.row], tie.col)]
        entries += [(one, on_g, on_l), (one, on_l, on_g)]
        values, rows, columns = (np.concatenate(each) for each in zip(*entries, strict=True))
        return sparse.csr_array((values, (rows, columns)), shape=(first[4], first[4])), residual

    def from_rod(self, shape: Rod) -> Array:
        """The unknowns of an incompressible solid whose sections are those of a rod."""
        mesh, unknowns = self.mesh, np.zeros(self.first[-1])
        u, p, g, _ = self.split(unknowns)

        def bent(nodes: Array) -> tuple[Array, Array]:
            """Places, and the pressure that keeps the sides of a fiber of stretch l free of stress, G (1 - 1 / l)."""
            at = shape.at(nodes[:, 0])
            y, z = at.beta * nodes[:, 1], at.beta * nodes[:, 2]
            x = np.stack([at.x - y * np.sin(at.theta), at.y + y * np.cos(at.theta), z], 1)
            return x, 2 * (self.rubber.c1 + self.rubber.c2) * (1 - 1 / (at.nu - y * at.mu))

        u[:] = bent(mesh.nodes)[0] - mesh.nodes
        if self.clamped:
            u[mesh.nodes[:, 0] == 0] = 0.0
        g[:] = (self.sections.matrix @ (mesh.nodes + u).ravel()).reshape(-1, 4)
        g[0, 1] = 0.0
        _, _, shapes, _ = brick_shapes()
        points = np.einsum("qn,eni->eqi", shapes, mesh.nodes[mesh.bricks]).reshape(-1, 3)
        p[:] = np.linalg.lstsq(self.bricks.reference[2], bent(points)[1].reshape(-1, 27).T)[0].T
        return unknowns

    def solve(self, start: Rod | None = None, iterations: int = 20, tolerance: float = 1e-7) -> Bent:
        """The equilibrium near the rod `start` (None: the incompressible one under the same loads), by Newton's method
        until a step moves no node by more than `tolerance` lengths: what is left is of the order of its square. Raises
        where that is not reached."""
        mesh = self.mesh
        unknowns = self.from_rod(rod(mesh.arm, self.loads) if start is None else start)
        step = np.inf
        for count in range(1, iterations + 1):
            matrix, residual = self.system(unknowns)
            change = linear_solve(matrix[self.free][:, self.free], residual[self.free])
            unknowns[self.free] -= change
            step = float(np.abs(change[self.free < self.first[1]]).max() / mesh.arm.length)
            if step < tolerance:
                return self.bent(unknowns, step, count)
        raise RuntimeError(f"Newton's last step is {step:.1e} of the length after {iterations} iterations")

    def bent(self, unknowns: Array, error: float, iterations: int) -> Bent:
        """What the unknowns say of the shape."""
        mesh = self.mesh
        u, p, g, _ = self.split(unknowns)
        x = mesh.nodes + u
        scale_3 = x[:, 2].reshape(len(mesh.stations), -1) @ mesh.moments[2] / mesh.arm.radius(mesh.stations)
        return Bent(mesh.stations, x, p, g[:, :2], g[:, 2:], scale_3, error, iterations)


def linear_solve(matrix: sparse.csr_array, right: Array) -> Array:
    """By pypardiso where it is installed, else by SciPy's SuperLU."""
    if pardiso is not None:
        return pardiso(matrix, right)
    return splu(matrix.tocsc(), permc_spec="NATURAL").solve(right)
