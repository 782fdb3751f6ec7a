"""One brick after another: residual and stiffness of 27-node bricks with a pressure of their own.

The displacement u is quadratic in each of the three directions of a brick, the pressure p linear in the brick and free
to jump between bricks: the Q2/P1 pair of Sussman & Bathe 1987, "A finite element formulation for nonlinear
incompressible elastic and inelastic analysis", Computers & Structures 26. It holds the volume without locking, which
bricks of 8 nodes do not. With N_n the shapes of the 27 nodes and Q_m = 1, xi, eta, zeta those of p,

    F = x_n (x) grad N_n       r_ni = int P_iJ N_n,J dV        r_m = int Q_m (J - 1 - p / lambda) dV

and the stiffness is the exact slope of the two. Arrays run over [bricks, 27 Gauss points, ...].
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .arm import Array
from .material import Rubber
from .mesh import Mesh, brick_shapes


@dataclass(frozen=True)
class Bricks:
    """The bricks of a mesh, of one material; energies count both halves of the arm."""

    mesh: Mesh
    rubber: Rubber

    @cached_property
    def reference(self) -> tuple[Array, Array, Array]:
        """Slopes [bricks, 27 points, 27 nodes, 3], weights [bricks, 27] of both halves, shapes of p [27, 4]."""
        places, weights, _, slopes = brick_shapes()
        jacobian = np.einsum("eni,qnd->eqid", self.mesh.nodes[self.mesh.bricks], slopes)
        gradient = np.einsum("qnd,eqdi->eqni", slopes, np.linalg.inv(jacobian))
        return gradient, 2 * np.abs(np.linalg.det(jacobian)) * weights, np.hstack([np.ones((27, 1)), places])

    def system(self, x: Array, p: Array) -> tuple[Array, Array]:
        """Residual [bricks, 85] and its slope [bricks, 85, 85] in u (81, node by node) and p (4) of each brick."""
        gradient, weights, shapes = self.reference
        f = np.einsum("eni,eqnj->eqij", x[self.mesh.bricks], gradient)
        pressure = p @ shapes.T
        piola, slope, cofactor, volume = self.rubber.stress(f, pressure)
        count = len(f)
        residual, matrix = np.zeros((count, 85)), np.zeros((count, 85, 85))
        residual[:, :81] = np.einsum("eqij,eqnj,eq->eni", piola, gradient, weights, optimize=True).reshape(count, 81)
        gap = (volume - 1 - self.rubber.compliance * pressure) * weights
        residual[:, 81:] = gap @ shapes
        # dP_iJ / du_bk at each point, then with N_a,J summed over points and J
        half = np.einsum("eqiJkL,eqbL,eq->eiqJbk", slope, gradient, weights, optimize=True).reshape(count, 3, 81, 81)
        rows = np.moveaxis(gradient, 2, 1).reshape(count, 1, 27, 81)
        matrix[:, :81, :81] = np.swapaxes(rows @ half, 1, 2).reshape(count, 81, 81)
        # dP_iJ / dp = cof F_iJ, whose transpose is d(J - 1) / dF
        mixed = np.einsum("eqij,eqnj,eq,qm->enim", cofactor, gradient, weights, shapes, optimize=True)
        matrix[:, :81, 81:] = mixed.reshape(count, 81, 4)
        matrix[:, 81:, :81] = np.swapaxes(matrix[:, :81, 81:], 1, 2)
        matrix[:, 81:, 81:] = -self.rubber.compliance * np.einsum("qm,qn,eq->emn", shapes, shapes, weights)
        return residual, matrix
