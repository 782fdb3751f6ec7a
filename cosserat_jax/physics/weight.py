"""The weight of the arm and, under water, its buoyancy."""

import jax.numpy as jnp

from ..scene.quantity import Scalar
from .loads import AbstractLoad, CrossSection


class Weight(AbstractLoad):
    """f = -(rho - rho_w) g A nu e2 at the centerline, A = pi (beta R)^2; rho_w is zero in air.

    The weight is the paper's Eq. WeightSegmentRod; the hydrostatic force that its Eq. ForceLeftNormalRod leaves open,
    integrated over the closed surface, is the buoyancy. `excess_density` rho - rho_w [kg/m^3], `acceleration` g [m/s^2].
    """

    excess_density: Scalar
    acceleration: Scalar

    @property
    def depends_on_position(self) -> bool:
        return False

    def per_length(self, section: CrossSection) -> tuple[Scalar, Scalar, Scalar]:
        area = jnp.pi * (section.beta * section.radius) ** 2
        return 0.0, -self.excess_density * self.acceleration * area * section.nu, 0.0
