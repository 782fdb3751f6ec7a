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


class SectionLoad(NamedTuple):
    """What a cross-section carries: total force along a and b [N], total moment [N m], and the muscles' pulls."""

    axial: Scalar
    shear: Scalar
    moment: Scalar
    pulls: tuple[Pull, ...]


def radius_at(arm: Arm, s: Scalar) -> Scalar:
    """R(s) = R_base + (R_tip - R_base) s / L of the undeformed arm [m]. Source: paper, Eq. RodRadius."""
    return arm.base_radius + (arm.tip_radius - arm.base_radius) / arm.length * s


def stiffness_at(arm: Arm, s: Scalar, beta: Scalar) -> Stiffness:
    """Stiffness of the deformed section, or the constants given in place of a modulus."""
    if arm.stiffness is not None:
        given = (arm.stiffness.axial, arm.stiffness.shear, arm.stiffness.bending)
        return Stiffness(*(arm.stiffness_factor * constant for constant in given))
    assert arm.youngs_modulus is not None  # a valid scene has the moduli or the stiffness
    assert arm.poisson_ratio is not None
    area_radius = (radius_at(arm, s) * beta) ** 2
    axial = arm.stiffness_factor * arm.youngs_modulus * jnp.pi * area_radius
    return Stiffness(axial, axial / (2 * (1 + arm.poisson_ratio)), axial * area_radius / 4)


def pull_moments(pulls: tuple[Pull, ...]) -> tuple[Scalar, Scalar, Scalar]:
    """sum T, sum T y and sum T y^2 over the muscles of a cross-section [N, N m, N m^2]."""
    tension = sum(pull.tension for pull in pulls)
    first = sum(pull.tension * pull.offset for pull in pulls)
    second = sum(pull.tension * pull.offset * pull.offset for pull in pulls)
    return tension, first, second


def strains_at(stiffness: Stiffness, load: SectionLoad, beta: Scalar, beta_s: Scalar) -> Strains:
    """The strains at given beta and beta_s."""
    tension, first, _ = pull_moments(load.pulls)
    extension, curvature = solve_bending(stiffness, load.pulls, beta, load.axial - tension, load.moment + beta * first)
    rise = sum(pull.tension * (pull.slope * beta + pull.offset * beta_s) for pull in load.pulls)
    strains = Strains(extension, (load.shear - rise) / (stiffness.shear + tension), curvature)
    if not any(pull.unit for pull in load.pulls):
        return strains
    params = (stiffness, load, beta, beta_s)
    start, held = lax.stop_gradient((jnp.stack(strains), params))
    return Strains(*differentiable_root(_unbalance, newton(_unbalance, start, held), params))


def solve_bending(
    stiffness: Stiffness, pulls: tuple[Pull, ...], beta: Scalar, axial: Scalar, moment: Scalar
) -> tuple[Scalar, Scalar]:
    """Solves for extension e and curvature mu, or for their rates, at given beta and printed tangents:

        (c E A + sum T) e   - beta sum(T y) mu                    = axial
        - beta sum(T y) e   + (c E J + beta^2 sum(T y^2)) mu      = moment

    The extension is eliminated, so an infinite axial stiffness is allowed.
    """
    tension, first, second = pull_moments(pulls)
    coupling = beta * first / (stiffness.axial + tension)
    curvature = (moment + coupling * axial) / (stiffness.bending + beta * (beta * second - coupling * first))
    return axial / (stiffness.axial + tension) + coupling * curvature, curvature


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
