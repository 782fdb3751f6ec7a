"""Section laws: from the strains of a cross-section to the internal force and moment that it carries.

The internal force n and moment m are resultants over the deformed section, n.a along its normal, n.b along b. In linear
elasticity

    n.a = c E A (nu - 1)      n.b = c G A eta      m = c E J mu      A = pi (beta R)^2      J = pi (beta R)^4 / 4

with G = E / (2 (1 + nu_p)) and the stiffness factor c, 1 in linear elasticity, 2 in the printed law N = 2 E (nu - 1) of
Golestaneh, Cichella & Lamuta, "Quasi-static continuum model of octopus-like soft robot arm under water actuated by
TCAMs", constitutive equations of the section.
"""

import abc
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from ..scene.quantity import Scalar


class ReferenceSection(NamedTuple):
    """What a section law may look at: the arc length s [m], the radius R [m] of the undeformed section, and the
    cross-section scale beta."""

    s: Scalar
    radius: Scalar
    beta: Scalar = 1.0


class Stiffness(NamedTuple):
    """Axial [N], shear [N] and bending [N m^2] stiffness of a cross-section."""

    axial: Scalar
    shear: Scalar
    bending: Scalar


class AbstractSectionLaw(eqx.Module):
    """From the strains nu, eta, mu of a cross-section to its resultants n.a, n.b [N] and m [N m].

    A user's own law is a subclass, or, from a strain energy, one of `StrainEnergy`; it is given to an arm in place of
    its modulus, `Arm(section_law=...)`. Written with operations of `jax.numpy` that act element by element. The strains
    that carry a given load are found by Newton's method from the unloaded section.
    """

    @abc.abstractmethod
    def resultants(
        self, section: ReferenceSection, nu: Scalar, eta: Scalar, mu: Scalar
    ) -> tuple[Scalar, Scalar, Scalar]:
        """n.a [N], n.b [N] and m [N m]; all zero at nu = 1, eta = mu = 0 and beta = 1."""

    def area(self, section: ReferenceSection) -> Scalar:
        """A [m^2] of the deformed section, here a circle."""
        return jnp.pi * (section.beta * section.radius) ** 2

    def second_moment(self, section: ReferenceSection) -> Scalar:
        """J [m^4] of the deformed section, here a circle."""
        return self.area(section) ** 2 / (4 * jnp.pi)

    def stiffness(self, section: ReferenceSection) -> Stiffness:
        """The slopes of the resultants at rest; of a linear law everywhere."""
        zero = jnp.zeros_like(section.radius)

        def slope(direction: int) -> Scalar:
            moved = tuple(jnp.ones_like(zero) if i == direction else zero for i in range(3))
            _, rates = jax.jvp(lambda *strains: self.resultants(section, *strains), (1 + zero, zero, zero), moved)
            return rates[direction]

        return Stiffness(slope(0), slope(1), slope(2))


class StrainEnergy(AbstractSectionLaw):
    """A hyperelastic section, n.a = psi_nu, n.b = psi_eta, m = psi_mu: a subclass gives the energy, JAX the slopes."""

    @abc.abstractmethod
    def energy(self, section: ReferenceSection, nu: Scalar, eta: Scalar, mu: Scalar) -> Scalar:
        """psi(nu, eta, mu) [N], the energy per undeformed length [J/m]."""

    def resultants(
        self, section: ReferenceSection, nu: Scalar, eta: Scalar, mu: Scalar
    ) -> tuple[Scalar, Scalar, Scalar]:
        strains = jnp.broadcast_arrays(nu, eta, mu)
        psi, back = jax.vjp(
            lambda *strains: jnp.broadcast_to(self.energy(section, *strains), strains[0].shape), *strains
        )
        return back(jnp.ones_like(psi))


class AbstractLinearLaw(AbstractSectionLaw):
    """A law whose resultants are its stiffness times nu - 1, eta and mu: strains follow from loads in closed form."""

    def resultants(
        self, section: ReferenceSection, nu: Scalar, eta: Scalar, mu: Scalar
    ) -> tuple[Scalar, Scalar, Scalar]:
        stiffness = self.stiffness(section)
        return stiffness.axial * (nu - 1), stiffness.shear * eta, stiffness.bending * mu

    @abc.abstractmethod
    def stiffness(self, section: ReferenceSection) -> Stiffness:
        """c E A, c G A and c E J of the deformed section."""


class LinearElastic(AbstractLinearLaw):
    """Linear elasticity: `axial_modulus` c E and `shear_modulus` c G [Pa]."""

    axial_modulus: Scalar
    shear_modulus: Scalar

    def stiffness(self, section: ReferenceSection) -> Stiffness:
        area = self.area(section)
        axial = self.axial_modulus * area
        return Stiffness(axial, self.shear_modulus * area, axial * (area / (4 * jnp.pi)))


class GivenStiffness(AbstractLinearLaw):
    """Stiffnesses given directly, constant along the rod: `axial`, `shear` [N] and `bending` [N m^2].

    An infinite axial or shear stiffness is an inextensible or unshearable rod.
    """

    axial: Scalar
    shear: Scalar
    bending: Scalar

    def stiffness(self, section: ReferenceSection) -> Stiffness:
        return Stiffness(self.axial, self.shear, self.bending)
