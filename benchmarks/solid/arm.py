"""The arm of the paper's case study and what acts on its sections, for the solid and the rod of this folder.

A cross-section is known by the mean r of its material points and by d = beta b, the in-plane director b = (-sin theta,
cos theta) times the cross-section scale beta. From these and their slopes along the arc length s of the straight arm
follow the two loads of Golestaneh, Cichella & Lamuta, "Quasi-Static Continuum Model of Octopus-Like Soft Robot Arm
Under Water Actuated by TCAMs", that depend on the shape:

    tendon  r_c = r + y d,  t_c = r_c,s,  pulled with T t_c (unnormalized) or T t_c / |t_c| (unit)
    water   x = r + X d,  X = R(s) on the ventral surface,  u_t = x_s / |x_s|,  u_n = k x u_t,
            v_t = v e1.u_t,  v_n = v e1.u_n,  q = pi rho_w |d| R,
            f = q |v_n| v_n u_n + (q (v_n^2 + 2 v_t v_n) - 2 pi R |d| mu_v v_t / h) u_t,  m = (X d) x f

Functions take complex numbers too, so that their exact slopes come from a complex step (Squire & Trapp 1998, "Using
complex variables to estimate derivatives of real functions", SIAM Review 40).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Vector = tuple[Array, Array]  # components along e1, e2


class Arm(NamedTuple):
    """Table II of the paper, SI units; `boundary_layer` h has no value there and hardly matters."""

    length: float = 0.418
    base_radius: float = 0.015
    tip_radius: float = 0.004
    modulus: float = 10e6
    poisson_ratio: float = 0.5
    density: float = 1100.0
    base_offset: float = 0.012
    end_offset: float = 0.001

    @property
    def radius_slope(self) -> float:
        return (self.tip_radius - self.base_radius) / self.length

    @property
    def offset_slope(self) -> float:
        return (self.end_offset - self.base_offset) / self.length

    def radius(self, s: ArrayLike) -> Array:
        """R(s) [m]."""
        return self.base_radius + self.radius_slope * np.asarray(s)

    def offset(self, s: ArrayLike) -> Array:
        """y(s) [m], of the tendon from the centerline."""
        return self.base_offset + self.offset_slope * np.asarray(s)


class Loads(NamedTuple):
    """What acts on the arm. `tension` T [N], `unit` tangents or not; `velocity` v [m/s] of the water, None in air;
    `gravity` [m/s^2]; a dead `tip_force` along e2 [N] and a `tip_moment` [N m]."""

    tension: float = 0.0
    unit: bool = False
    velocity: float | None = None
    gravity: float = 0.0
    tip_force: float = 0.0
    tip_moment: float = 0.0
    water_density: float = 998.0
    viscosity: float = 1.002e-3
    boundary_layer: float = 0.02

    def weight(self, arm: Arm) -> float:
        """Weight less buoyancy of a unit of volume [N/m^3], along -e2."""
        return self.gravity * (arm.density - (0.0 if self.velocity is None else self.water_density))


def pull(loads: Loads, tangent: Vector) -> Vector:
    """T t_c or T t_c / |t_c| [N] of the tangent t_c."""
    t1, t2 = tangent
    scale = loads.tension / np.sqrt(t1**2 + t2**2) if loads.unit else loads.tension
    return scale * t1, scale * t2


def water(arm: Arm, loads: Loads, s: Array, r_s: Vector, d: Vector, d_s: Vector) -> tuple[Array, Array, Array]:
    """Force f1, f2 [N/m] and moment m [N] of the water per undeformed length; zero in air."""
    if not loads.velocity:
        return 0 * s, 0 * s, 0 * s
    radius = arm.radius(s)
    t1, t2 = (r + radius * slope + arm.radius_slope * own for r, slope, own in zip(r_s, d_s, d, strict=True))
    length = np.sqrt(t1**2 + t2**2)
    t1, t2 = t1 / length, t2 / length
    v_t, v_n = loads.velocity * t1, -loads.velocity * t2
    girth = np.pi * radius * np.sqrt(d[0] ** 2 + d[1] ** 2)
    normal = loads.water_density * girth * np.sign(v_n.real) * v_n**2
    along = loads.water_density * girth * (v_n**2 + 2 * v_t * v_n)
    along = along - 2 * girth * loads.viscosity * v_t / loads.boundary_layer
    f1, f2 = along * t1 - normal * t2, along * t2 + normal * t1
    return f1, f2, radius * (d[0] * f2 - d[1] * f1)
