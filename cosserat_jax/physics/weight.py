"""The weight of the arm and, under water, its buoyancy."""

import equinox as eqx
import jax.numpy as jnp

from ..scene.quantity import Scalar
from .loads import AbstractLoad, DeformedSection


class Weight(AbstractLoad):
    """f = -(rho - rho_w) g A nu e2 at the centerline, A = pi (beta R)^2; rho_w is zero in air.

    A rod whose section stiffness is given directly has a section that does not follow its strains: its weight is that
    of the undeformed rod, f = -(rho - rho_w) g pi R^2 e2 (`follows_strain` False), as is usual in the rod literature.

    The weight is the paper's Eq. WeightSegmentRod; the hydrostatic force that its Eq. ForceLeftNormalRod leaves open,
    integrated over the closed surface, is the buoyancy. `excess_density` rho - rho_w [kg/m^3],
    `acceleration` g [m/s^2].
    """

    excess_density: Scalar
    acceleration: Scalar
    follows_strain: bool = eqx.field(static=True, default=True)

    @property
    def depends_on_position(self) -> bool:
        return False

    def per_length(self, section: DeformedSection) -> tuple[Scalar, Scalar, Scalar]:
        volume = jnp.pi * (section.beta * section.radius) ** 2
        if self.follows_strain:
            volume = volume * section.nu
        return 0.0, -self.excess_density * self.acceleration * volume, 0.0
