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

from ..scene import Arm
from ..scene.quantity import Scalar
from .implicit import batched_with, differentiable_root, newton
from .section import SectionLoad, radius_at, stiffness_at, strains_at

_PASSES = 3  # of the secant method
_MOST_FELT = 0.5  # the largest |d(rates)/d(beta_s)| that it believes


class LoadRates(NamedTuple):
    """(F.a)_s, (F.b)_s [N/m] and M_s [N] of a section's load along the rod."""

    axial: Scalar
    shear: Scalar
    moment: Scalar


def stretch_at(
    arm: Arm, s: Scalar, load: SectionLoad, rates_at: Callable[[Scalar, Scalar], LoadRates]
) -> tuple[Scalar, Scalar]:
    """beta and beta_s; `rates_at` gives the load's rates at a stretch and slope. Past a fold g(beta) is not zero."""
    flat = 0.0 * load.axial  # batched with it, for the loops to come: see `batched_with`
    unit = any(pull.unit for pull in load.pulls)
    held = flat if unit else _root(arm, s, load, flat)
    held_slope = flat if unit else constraint_slope(arm, s, load, held, flat)

    def refine(_: Any, last: tuple[Scalar, Scalar, Scalar, Scalar]) -> tuple[Scalar, Scalar, Scalar, Scalar]:
        _, given, before, found_before = last
        beta = _root(arm, s, load, given) if unit else held
        slope = constraint_slope(arm, s, load, beta, given) if unit else held_slope
        found = -_defect_rate(arm, s, load, beta, given, s_rate=1.0, rates=rates_at(beta, given)) / slope
        return beta, _secant(given, found, before, found_before), given, found

    return lax.fori_loop(0, _PASSES, refine, (held, flat, flat, flat))[:2]


def _secant(given: Scalar, found: Scalar, before: Scalar, found_before: Scalar) -> Scalar:
    """The x that f(x) = x would have on the line through f(given) = found and f(before) = found_before."""
    apart = given - before
    rate = jnp.where(apart == 0, 0.0, (found - found_before) / jnp.where(apart == 0, 1.0, apart))
    rate = jnp.clip(rate, -_MOST_FELT, _MOST_FELT)  # in the last digits it is noise
    return given + (found - given) / (1 - lax.stop_gradient(rate))


def volume_defect(beta: Scalar, params: tuple[Arm, Scalar, SectionLoad, Scalar]) -> Scalar:
    """g(beta) at the strains that arm, s, load and beta_s give: zero where the volume is kept."""
    arm, s, load, beta_s = params
    strains = strains_at(stiffness_at(arm, s, beta), load, beta, beta_s)
    return beta * (1 + strains.extension - beta * arm.ventral * radius_at(arm, s) * strains.curvature) - 1


def constraint_slope(arm: Arm, s: Scalar, load: SectionLoad, beta: Scalar, beta_s: Scalar) -> Scalar:
    """dg/dbeta at given load: 1 at rest, 0 where the constraint folds."""
    return _defect_rate(arm, s, load, beta, beta_s, beta_rate=1.0)


def _root(arm: Arm, s: Scalar, load: SectionLoad, beta_s: Scalar) -> Scalar:
    params = (arm, s, load, beta_s)
    held = lax.stop_gradient(params)
    start = batched_with(held[2].axial, 1.0)
    return differentiable_root(volume_defect, newton(volume_defect, start, held, max_step=0.25), params)


def _defect_rate(
    arm: Arm, s: Scalar, load: SectionLoad, beta: Scalar, beta_s: Scalar, *,
    beta_rate: float = 0.0, s_rate: float = 0.0, rates: LoadRates | None = None,
) -> Scalar:  # fmt: skip
    """How fast g changes as beta, s and the load change at these rates; a muscle's offset changes with s."""

    def moved(step: Scalar) -> Scalar:
        axial, shear, moment = load[:3]
        if rates is not None:
            axial, shear, moment = axial + rates.axial * step, shear + rates.shear * step, moment + rates.moment * step
        pulls = load.pulls
        if s_rate:
            pulls = tuple(eqx.tree_at(lambda p: p.offset, pull, pull.offset + pull.slope * step) for pull in pulls)
        at = (arm, s + s_rate * step, SectionLoad(axial, shear, moment, pulls), beta_s)
        return volume_defect(beta + beta_rate * step, at)

    return jax.jvp(moved, (jnp.zeros(()),), (jnp.ones(()),))[1]
