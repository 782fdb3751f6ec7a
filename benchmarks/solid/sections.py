"""What acts on the sections of the solid: tendon, weight, water, tip load, all through the means of each section.

A section at s is known by the mean r of its places and by d = mean(Y x) / mean(Y^2), which is beta b where it stays
plane. Between stations of nodes g = (r, d) is quadratic in s. The potential and the work on these means are

    tendon  T int |t_c| ds (unit tangents) or T / 2 int |t_c|^2 ds (unnormalized),   t_c = (r + y d)_s
    water   int f . dr + m (d x dd) / |d|^2 ds,    weight  int w . dr ds,    tip  P e2 . dr + M (d x dd) / |d|^2

so that tendons follow the arm with a symmetric stiffness. Slopes are exact, by complex steps (see `arm`).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from .arm import Array, Loads, Vector, pull, water
from .mesh import GAUSS_POINTS, GAUSS_WEIGHTS, Mesh, line_shapes

TINY = 1e-30


@dataclass(frozen=True)
class Sections:
    """The sections of a mesh under loads. `frozen` are section means [stations, 4] on which the water is evaluated once
    and for all, as in one-way coupling; None lets the water follow the arm."""

    mesh: Mesh
    loads: Loads
    frozen: Array | None = None

    @cached_property
    def matrix(self) -> sparse.csr_array:
        """B [4 * stations, 3 * nodes]: from the places of the nodes to (r, d) of every station."""
        mesh = self.mesh
        count, size = len(mesh.stations), len(mesh.disk)
        k, n = np.meshgrid(np.arange(count), np.arange(size), indexing="ij")
        scale = np.stack([np.ones(count), 1 / mesh.arm.radius(mesh.stations)])
        parts = [
            (scale[row // 2, k] * mesh.moments[row // 2, n], (4 * k + row, 3 * (size * k + n) + row % 2))
            for row in range(4)
        ]
        values, places = zip(*parts, strict=True)
        rows, columns = (np.stack(each).ravel() for each in zip(*places, strict=True))
        return sparse.csr_array((np.stack(values).ravel(), (rows, columns)), shape=(4 * count, 3 * size * count))

    def along(self, g: Array) -> tuple[Array, Array]:
        """Residual [along, 12] of tendon, weight and water on the means g [stations, 4] of the three stations of each
        layer, and its slope [along, 12, 12]."""
        layers = self.mesh.layers
        own, frozen = g[layers], None if self.frozen is None else self.frozen[layers]
        moved = (own.reshape(-1, 12) + 1j * TINY * np.eye(12)[:, None]).reshape(12, -1, 3, 4)
        slope = self.residual(moved, frozen).imag.reshape(12, -1, 12) / TINY
        return self.residual(own, frozen).reshape(-1, 12), np.moveaxis(slope, 0, 2)

    def residual(self, g: Array, frozen: Array | None) -> Array:
        """Of means g [..., along, 3, 4], layer by layer; `frozen` as they are."""
        arm, loads = self.mesh.arm, self.loads
        stations = self.mesh.stations[self.mesh.layers]
        half = (stations[:, 2] - stations[:, 0])[:, None] / 2
        values, slopes = line_shapes(GAUSS_POINTS)
        s, weights = stations @ values.T, half * GAUSS_WEIGHTS

        def means(g: Array) -> tuple[Vector, Vector, Vector]:
            """r_s, d, d_s at the Gauss points [..., along, 3]."""
            at = np.moveaxis(np.einsum("qn,...enc->...eqc", values, g), -1, 0)
            rate = np.moveaxis(np.einsum("qn,...enc->...eqc", slopes, g), -1, 0) / half
            return (rate[0], rate[1]), (at[2], at[3]), (rate[2], rate[3])

        r_s, d, d_s = means(g)
        y, y_s = arm.offset(s), arm.offset_slope
        t1, t2 = pull(loads, (r_s[0] + y * d_s[0] + y_s * d[0], r_s[1] + y * d_s[1] + y_s * d[1]))
        f1, f2, m = water(arm, loads, s, *means(g if frozen is None else frozen))
        f2 = f2 - loads.weight(arm) * np.pi * arm.radius(s) ** 2
        turn = m / (d[0] ** 2 + d[1] ** 2)
        on_g = np.stack(np.broadcast_arrays(-f1, -f2, y_s * t1 + turn * d[1], y_s * t2 - turn * d[0]), -1)
        on_slope = np.stack([t1, t2, y * t1, y * t2], -1)
        on_g, on_slope = on_g * weights[..., None], on_slope * (weights / half)[..., None]
        return np.einsum("qn,...eqc->...enc", values, on_g) + np.einsum("qn,...eqc->...enc", slopes, on_slope)

    def at_tip(self, g: Array) -> tuple[Array, Array]:
        """Residual [4] of a dead force along e2 and a moment on the means g [4] of the last section, and its slope."""

        def residual(g: Array) -> Array:
            turn = self.loads.tip_moment / (g[2] ** 2 + g[3] ** 2)
            return np.stack([0 * turn, 0 * turn - self.loads.tip_force, turn * g[3], -turn * g[2]])

        return residual(g), residual(g[:, None] + 1j * TINY * np.eye(4)).imag / TINY
