"""The arm as a rod, by Chebyshev collocation: three cross-sections, among them the one of an incompressible solid.

Unknowns over s: the centerline r and angle theta, the total force F and moment M of section and tendon, the strains
nu, eta, mu, and the cross-section scale beta. With directors a, b and the tendon at y(s):

    r_s = nu a + eta b             theta_s = mu                  clamped at s = 0
    F_s = -f                       M_s = -r_s x F - m            F, M given at the tip; f, m per length
    F = n + T t_c                  M = m_section - y beta T t_c.a
    t_c = (nu - y beta mu) a + (eta + (y beta)_s) b

- "rigid": beta = 1, "paper": beta (nu - beta R mu) = 1, both with linear elasticity times the stiffness factor c,
  n.a = c E A (nu - 1), n.b = c G A eta, m = c E A^2 / (4 pi) mu, A = pi (beta R)^2.
- "incompressible": beta = nu^(-1/2), as all directions of the section of an incompressible solid are alike. Each fiber
  at Y carries the nominal stress (E / 3)(l - l^-2) of a neo-Hookean solid at its stretch l = nu - Y kappa,
  kappa = beta mu. Integrated over the circle, with A = pi R^2 and q = sqrt(nu^2 - kappa^2 R^2):

    n.a = (E A / 3)(nu - 2 / (q (nu + q)))     m = beta kappa (E A R^2 / 3)(1 / 4 + 2 / (q (nu + q)^2))    n.b = G A eta

All fields are polynomials through Chebyshev points (Trefethen 2000, "Spectral Methods in MATLAB", chapters 6 and 13),
the equations hold at these points, and Newton's slopes are exact by complex steps. This shares no code with
cosserat_jax, which has the first two of the three.
"""

from typing import Literal, NamedTuple

import numpy as np

from .arm import Arm, Array, Loads, pull, water

Section = Literal["paper", "rigid", "incompressible"]


class Rod(NamedTuple):
    """Fields at the points `s` [m], which ascend from base to tip; SI units."""

    s: Array
    x: Array
    y: Array
    theta: Array
    force_1: Array
    force_2: Array
    moment: Array
    nu: Array
    eta: Array
    mu: Array
    beta: Array

    def at(self, s: Array) -> "Rod":
        """The same fields at other points, by barycentric interpolation."""
        weights = (-1.0) ** np.arange(len(self.s))
        weights[[0, -1]] /= 2
        apart = s[:, None] - self.s
        hit = np.abs(apart) < 1e-14
        factors = weights / np.where(hit, 1.0, apart)
        factors = np.where(hit.any(1, keepdims=True), hit, factors)
        factors /= factors.sum(1, keepdims=True)
        return Rod(*(factors @ field for field in self))


def chebyshev(points: int, length: float) -> tuple[Array, Array]:
    """Points s on [0, length], ascending, and the matrix that differentiates a polynomial given there."""
    j = np.arange(points)
    t = -np.cos(np.pi * j / (points - 1))
    c = np.where((j == 0) | (j == points - 1), 2.0, 1.0) * (-1.0) ** j
    apart = t[:, None] - t + np.eye(points)
    matrix = np.outer(c, 1 / c) / apart
    matrix -= np.diag(matrix.sum(1))
    return length * (1 + t) / 2, matrix * 2 / length


def resultants(arm: Arm, section: Section, factor: float, s: Array, nu: Array, eta: Array, mu: Array, beta: Array):
    """n.a [N], n.b [N], m [N m], and the constraint on beta that has to vanish."""
    young, radius = factor * arm.modulus, arm.radius(s)
    shear = young / (2 * (1 + arm.poisson_ratio))
    if section == "incompressible":
        area, kappa = np.pi * radius**2, beta * mu
        q = np.sqrt(nu**2 - (kappa * radius) ** 2)
        axial = young * area / 3 * (nu - 2 / (q * (nu + q)))
        bending = beta * kappa * young * area * radius**2 / 3 * (1 / 4 + 2 / (q * (nu + q) ** 2))
        return axial, shear * area * eta, bending, beta - nu**-0.5
    area = np.pi * (beta * radius) ** 2
    constraint = beta - 1 if section == "rigid" else beta * (nu - beta * radius * mu) - 1
    return young * area * (nu - 1), shear * area * eta, young * area**2 / (4 * np.pi) * mu, constraint


def rod(
    arm: Arm, loads: Loads, section: Section = "incompressible", factor: float = 1.0, points: int = 32, steps: int = 8
) -> Rod:
    """The equilibrium that is reached as all loads grow together in `steps` steps; raises where Newton fails."""
    s, slope = chebyshev(points, arm.length)
    zero, one = 0 * s, 1 + 0 * s
    bending = arm.modulus * np.pi * arm.radius(arm.length / 2) ** 4 / 4
    force, moment = bending / arm.length**2, bending / arm.length
    unit = np.array([1.0, 1.0, 1.0, force, force, moment, 1.0, 1.0, 1.0 / arm.length, 1.0])[:, None]

    def residual(fields: Array, share: float) -> Array:
        x, y, theta, f1, f2, m, nu, eta, mu, beta = np.moveaxis(fields * unit, -2, 0)
        cos, sin = np.cos(theta), np.sin(theta)
        r_s = nu * cos - eta * sin, nu * sin + eta * cos
        offset, y_beta_s = arm.offset(s), (arm.offset(s) * beta) @ slope.T
        beta_s = beta @ slope.T
        pull_a, pull_b = pull(loads, (nu - offset * beta * mu, eta + y_beta_s))
        n_a, n_b, m_section, constraint = resultants(arm, section, factor, s, nu, eta, mu, beta)
        d, d_s = (-beta * sin, beta * cos), (-beta_s * sin - beta * mu * cos, beta_s * cos - beta * mu * sin)
        w1, w2, wm = water(arm, loads, s, r_s, d, d_s)
        w2 = w2 - loads.weight(arm) * np.pi * (beta * arm.radius(s)) ** 2 * nu
        rows = [
            x @ slope.T - r_s[0],
            y @ slope.T - r_s[1],
            theta @ slope.T - mu,
            f1 @ slope.T + share * w1,
            f2 @ slope.T + share * w2,
            m @ slope.T + r_s[0] * f2 - r_s[1] * f1 + share * wm,
            f1 * cos + f2 * sin - n_a - share * pull_a,
            f2 * cos - f1 * sin - n_b - share * pull_b,
            m - m_section + share * offset * beta * pull_a,
            constraint,
        ]
        ends = {0: x, 1: y, 2: theta, 3: f1, 4: f2 - share * loads.tip_force, 5: m - share * loads.tip_moment}
        for row, value in ends.items():
            end = 0 if row < 3 else -1
            rows[row][..., end] = value[..., end]
        scale = np.array([1, 1, 1, force, force, moment, force, force, moment, 1])
        return np.stack([row / size for row, size in zip(rows, scale, strict=True)], axis=-2)

    size, tiny = 10 * points, 1e-30
    directions = np.eye(size).reshape(size, 10, points) * 1j * tiny
    fields = np.stack([s, zero, zero, zero, zero, zero, one, zero, zero, one])
    for share in np.linspace(0, 1, steps + 1)[1:]:
        for _ in range(20):
            slopes = residual(fields + directions, share).imag / tiny
            change = np.linalg.solve(slopes.reshape(size, size).T, residual(fields, share).ravel())
            fields = fields - change.reshape(fields.shape)
            if np.abs(change).max() < 1e-9:
                break
        else:
            raise RuntimeError(f"no equilibrium of the {section} rod found at {share:.3f} of the load")
    return Rod(s, *(fields * unit))
