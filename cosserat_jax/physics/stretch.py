"""The in-plane stretch beta of the cross-section, from the local preservation of volume, and its slope beta_s.

    g(beta) = beta (nu - beta X mu) - 1 = 0        X = ventral R        (paper, Eq. LocalVolumePreservationDefinition)

with nu and mu the strains that the section's load gives at that beta. The root is the one that continues beta = 1 of
the unloaded section; it ends where dg/dbeta = 0, where the constraint folds. beta_s is the total derivative of the root
along the rod (paper, Eq. Beta_s_LocallyVolumePreservationConstraint),

    beta_s = -(dg/ds + dg/dF.a (F.a)_s + dg/dF.b (F.b)_s + dg/dM M_s) / (dg/dbeta)

The shear and the water feel beta_s themselves, by a factor of 1e-4 on the paper's arm and up to 0.1 on extreme ones, so
the rates of the load are taken at the last value of it, which the secant method improves. So is the beta_s in |t_c| of
a unit tangent, through which alone beta_s acts on beta.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax

from ..scene.quantity import Scalar
from .implicit import batched_with, differentiable_root, newton
from .section import Section, SectionLoad, Strains, bend, shear_slope, strains_at, stretched

_PASSES = 4  # over the load, the last with the third value of the secant method
_MOST_FELT = 0.5  # the largest |d(rates)/d(beta_s)| that it believes

Forces = tuple[Scalar, Scalar, Scalar]


class LoadRates(NamedTuple):
    """(F.a)_s, (F.b)_s [N/m] and M_s [N] of a section's load along the rod."""

    axial: Scalar
    shear: Scalar
    moment: Scalar


class StretchedSection(NamedTuple):
    """beta and beta_s of a section, its strains, and the distributed force along e1 and e2 and moment on it.

    `margin` is dg/dbeta at given load, 1 at rest, 0 where the constraint folds; past a fold g(beta) is not zero.
    """

    beta: Scalar
    beta_s: Scalar
    strains: Strains
    forces: Forces
    margin: Scalar


def stretch_at(
    section: Section, load: SectionLoad, loads_at: Callable[[Strains, Scalar, Scalar], tuple[Forces, LoadRates]]
) -> StretchedSection:
    """The stretch of a section; `loads_at` gives what it carries at given strains, beta and beta_s."""
    flat = 0.0 * load.axial  # batched with it, for the loops to come: see `batched_with`

    def constrained(beta_s: Scalar) -> tuple[StretchedSection, _Slopes]:
        beta = _root(section, load, beta_s)
        strains = strains_at(stretched(section.stiffness, beta), load, beta, beta_s)
        slopes = _slopes(section, load, beta, beta_s)
        return StretchedSection(beta, beta_s, strains, (flat, flat, flat), slopes.beta), slopes

    # with printed tangents beta_s acts on the shear alone
    held = None if load.has_unit_tangents else constrained(flat)
    if held is None:
        start, slip = StretchedSection(flat, flat, Strains(flat, flat, flat), (flat, flat, flat), flat), flat
    else:
        start, slip = held[0], shear_slope(stretched(section.stiffness, held[0].beta), load)

    def refine(_: Any, last: tuple) -> tuple[StretchedSection, Scalar, Scalar, Scalar]:
        stretch, given, before, found_before = last
        if held is None:
            stretch, slopes = constrained(given)
        else:
            strains, slopes = stretch.strains._replace(shear=start.strains.shear + slip * given), held[1]
            stretch = stretch._replace(beta_s=given, strains=strains)
        forces, rates = loads_at(stretch.strains, stretch.beta, given)
        change = slopes.s + slopes.axial * rates.axial + slopes.moment * rates.moment
        if held is None:
            change += slopes.shear * rates.shear
        found = -change / slopes.beta
        return stretch._replace(forces=forces), _secant(given, found, before, found_before), given, found

    return lax.fori_loop(0, _PASSES, refine, (start, flat, flat, flat))[0]


def _secant(given: Scalar, found: Scalar, before: Scalar, found_before: Scalar) -> Scalar:
    """The x that f(x) = x would have on the line through f(given) = found and f(before) = found_before."""
    apart = given - before
    rate = jnp.where(apart == 0, 0.0, (found - found_before) / jnp.where(apart == 0, 1.0, apart))
    rate = jnp.clip(rate, -_MOST_FELT, _MOST_FELT)  # in the last digits it is noise
    return given + (found - given) / (1 - lax.stop_gradient(rate))


def volume_defect(beta: Scalar, params: tuple[Section, SectionLoad, Scalar]) -> Scalar:
    """g(beta) of a section, its load and beta_s: zero where the volume is kept."""
    section, load, beta_s = params
    stiffness = stretched(section.stiffness, beta)
    if load.has_unit_tangents:
        extension, _, curvature = strains_at(stiffness, load, beta, beta_s)
    else:
        extension, curvature = bend(stiffness, load, beta)
    return beta * (1 + extension - beta * section.surface * curvature) - 1


def _root(section: Section, load: SectionLoad, beta_s: Scalar) -> Scalar:
    params = (section, load, beta_s)
    held = lax.stop_gradient(params)
    start = batched_with(load.axial, 1.0)
    return differentiable_root(volume_defect, newton(volume_defect, start, held, max_step=0.25), params)


class _Slopes(NamedTuple):
    """The partial derivatives of g: by beta, by s at a given load, and by the load."""

    beta: Scalar
    s: Scalar
    axial: Scalar
    shear: Scalar
    moment: Scalar


def _slopes(section: Section, load: SectionLoad, beta: Scalar, beta_s: Scalar) -> _Slopes:
    def defect(beta: Scalar, step: Scalar, axial: Scalar, shear: Scalar, moment: Scalar) -> Scalar:
        pulls = tuple(eqx.tree_at(lambda p: p.offset, pull, pull.offset + pull.slope * step) for pull in load.pulls)
        return volume_defect(beta, (section.moved(step), SectionLoad(axial, shear, moment, pulls), beta_s))

    at = (beta, jnp.zeros(()), load.axial, load.shear, load.moment)
    return _Slopes(*jax.grad(defect, argnums=(0, 1, 2, 3, 4))(*at))
