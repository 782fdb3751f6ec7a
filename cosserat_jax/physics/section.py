"""The section law: from the total force and moment on a cross-section to its strains.

Over the muscles active at s, with t_c = (nu - y beta mu) a + (eta + (y beta)_s) b the tangent of each,

    F.a = c E A (nu - 1) + sum T (nu - y beta mu)             A = pi (beta R)^2
    F.b = c G A eta      + sum T (eta + (y beta)_s)           G = E / (2 (1 + nu_p))
    M   = c E J mu       - sum T y beta (nu - y beta mu)      J = pi (beta R)^4 / 4
    beta (nu - beta X mu) = 1                                 X = ventral R,   (y beta)_s = y_s beta + y beta_s

(paper, Eqs. BulkForceNHMConstitutive, ConcentratedTCAMsForce, LocalVolumePreservationDefinition, with the muscles'
tension counted to the total). At given beta the first and third are linear in the strains. A muscle with unit tangent
pulls with T / |t_c| in place of T, and the strains follow from three equations together. The last equation, for beta,
is solved in `stretch`.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from ..scene import Arm
from ..scene.quantity import Scalar
from .implicit import differentiable_root, newton
from .muscles import Pull


class Stiffness(NamedTuple):
    """c E A, c G A and c E J of a cross-section: axial [N], shear [N], bending [N m^2]."""

    axial: Scalar
    shear: Scalar
    bending: Scalar


class Strains(NamedTuple):
    """Of the centerline and the section: extension nu - 1, shear eta, curvature mu [1/m]."""

    extension: Scalar
    shear: Scalar
    curvature: Scalar


class Section(NamedTuple):
    """An undeformed cross-section: radius R [m], offset X = ventral R of its ventral surface [m], both with their
    slopes along the arm, and its stiffness."""

    radius: Scalar
    taper: Scalar
    surface: Scalar
    surface_slope: Scalar
    stiffness: Stiffness

    def moved(self, step: Scalar) -> "Section":
        """The section a step [m] further along the arm."""
        growth = 1 + step * self.taper / self.radius
        return self._replace(
            radius=growth * self.radius, surface=growth * self.surface, stiffness=stretched(self.stiffness, growth)
        )


class SectionLoad(NamedTuple):
    """What a cross-section carries: total force along a and b [N], total moment [N m], and the muscles' pulls."""

    axial: Scalar
    shear: Scalar
    moment: Scalar
    pulls: tuple[Pull, ...]

    @property
    def has_unit_tangents(self) -> bool:
        """Whether any muscle pulls with its unit tangent, so that the strains depend on beta_s and on one another."""
        return any(pull.unit for pull in self.pulls)


def taper_of(arm: Arm) -> Scalar:
    """dR/ds of the undeformed arm."""
    return (arm.tip_radius - arm.base_radius) / arm.length


def radius_at(arm: Arm, s: Scalar) -> Scalar:
    """R(s) = R_base + (R_tip - R_base) s / L of the undeformed arm [m]. Source: paper, Eq. RodRadius."""
    return arm.base_radius + taper_of(arm) * s


def stiffness_at(arm: Arm, s: Scalar) -> Stiffness:
    """Stiffness of the undeformed section, or the constants given in place of a modulus."""
    if arm.stiffness is not None:
        given = (arm.stiffness.axial, arm.stiffness.shear, arm.stiffness.bending)
        return Stiffness(*(arm.stiffness_factor * constant for constant in given))
    assert arm.youngs_modulus is not None  # a valid scene has the moduli or the stiffness
    assert arm.poisson_ratio is not None
    square = radius_at(arm, s) ** 2
    axial = arm.stiffness_factor * arm.youngs_modulus * jnp.pi * square
    return Stiffness(axial, axial / (2 * (1 + arm.poisson_ratio)), axial * square / 4)


def section_at(arm: Arm, s: Scalar) -> Section:
    """The undeformed section at `s`."""
    radius, taper = radius_at(arm, s), taper_of(arm)
    return Section(radius, taper, arm.ventral * radius, arm.ventral * taper, stiffness_at(arm, s))


def stretched(stiffness: Stiffness, beta: Scalar) -> Stiffness:
    """Stiffness of a section with a modulus, stretched in its plane by beta: A grows by beta^2, J by beta^4."""
    area = beta * beta
    return Stiffness(stiffness.axial * area, stiffness.shear * area, stiffness.bending * (area * area))


def pull_moments(pulls: tuple[Pull, ...]) -> tuple[Scalar, Scalar, Scalar]:
    """sum T, sum T y and sum T y^2 over the muscles of a cross-section [N, N m, N m^2]."""
    tension = sum(pull.tension for pull in pulls)
    first = sum(pull.tension * pull.offset for pull in pulls)
    second = sum(pull.tension * pull.offset * pull.offset for pull in pulls)
    return tension, first, second


def strains_at(stiffness: Stiffness, load: SectionLoad, beta: Scalar, beta_s: Scalar) -> Strains:
    """The strains at given beta and beta_s, of a section of this stiffness, that of the stretched section."""
    extension, curvature = bend(stiffness, load, beta)
    rise = sum(pull.tension * (pull.slope * beta + pull.offset * beta_s) for pull in load.pulls)
    tension = sum(pull.tension for pull in load.pulls)
    strains = Strains(extension, (load.shear - rise) / (stiffness.shear + tension), curvature)
    if not load.has_unit_tangents:
        return strains
    params = (stiffness, load, beta, beta_s)
    start, held = lax.stop_gradient((jnp.stack(strains), params))
    return Strains(*differentiable_root(_unbalance, newton(_unbalance, start, held), params))


def shear_slope(stiffness: Stiffness, load: SectionLoad) -> Scalar:
    """d(eta)/d(beta_s) with printed tangents."""
    tension, first, _ = pull_moments(load.pulls)
    return -first / (stiffness.shear + tension)


def bend(stiffness: Stiffness, load: SectionLoad, beta: Scalar) -> tuple[Scalar, Scalar]:
    """Extension e = nu - 1 and curvature mu at given beta with printed tangents:

        (c E A + sum T) e   - beta sum(T y) mu                    = F.a - sum T
        - beta sum(T y) e   + (c E J + beta^2 sum(T y^2)) mu      = M + beta sum(T y)

    The extension is eliminated, so an infinite axial stiffness is allowed.
    """
    tension, first, second = pull_moments(load.pulls)
    axial, moment = load.axial - tension, load.moment + beta * first
    stretching = stiffness.axial + tension
    coupling = beta * first / stretching
    curvature = (moment + coupling * axial) / (stiffness.bending + beta * (beta * second - coupling * first))
    return axial / stretching + coupling * curvature, curvature


def _unbalance(strains: Float[Array, "3"], params: tuple[Stiffness, SectionLoad, Scalar, Scalar]) -> Float[Array, "3"]:
    """Force along a and b and moment that the strains leave unbalanced, where a muscle pulls with T t_c / |t_c|."""
    stiffness, load, beta, beta_s = params
    extension, shear, curvature = strains
    axial_force, shear_force = stiffness.axial * extension, stiffness.shear * shear
    moment = stiffness.bending * curvature
    for pull in load.pulls:
        along = 1 + extension - pull.offset * beta * curvature
        across = shear + pull.slope * beta + pull.offset * beta_s
        tension = pull.tension / jnp.sqrt(along**2 + across**2) if pull.unit else pull.tension
        axial_force += tension * along
        shear_force += tension * across
        moment -= tension * pull.offset * beta * along
    return jnp.stack([axial_force - load.axial, shear_force - load.shear, moment - load.moment])
