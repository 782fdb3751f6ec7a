"""The in-plane stretch beta of the cross-section, from the local preservation of volume, and its slope beta_s.

    g(beta) = beta (nu - beta X mu) - 1 = 0        X = ventral R        (paper, Eq. LocalVolumePreservationDefinition)

with nu and mu the strains that the section's load gives at that beta. The root is the one that continues beta = 1 of
the unloaded section; it ends where dg/dbeta = 0, where the constraint folds. beta_s is the total derivative of the root
along the rod (paper, Eq. Beta_s_LocallyVolumePreservationConstraint),

    beta_s = -(dg/ds + dg/dF.a (F.a)_s + dg/dF.b (F.b)_s + dg/dM M_s) / (dg/dbeta)

The shear and the water feel beta_s themselves, weakly, so the rates of the load are taken at the last value of it in a
few passes. So is the beta_s in |t_c| of a unit tangent, through which alone beta_s acts on beta.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax

from ..scene import Arm
from ..scene.quantity import Scalar
from .implicit import differentiable_root, newton
from .section import SectionLoad, radius_at, stiffness_at, strains_at

_PASSES = 3  # each gains the factor by which the rates feel beta_s: 1e-4 on the paper's arm, 1e-2 on extreme ones


class LoadRates(NamedTuple):
    """(F.a)_s, (F.b)_s [N/m] and M_s [N] of a section's load along the rod."""

    axial: Scalar
    shear: Scalar
    moment: Scalar


def stretch_at(
    arm: Arm, s: Scalar, load: SectionLoad, rates_at: Callable[[Scalar, Scalar], LoadRates]
) -> tuple[Scalar, Scalar]:
    """beta and beta_s; `rates_at` gives the load's rates at a stretch and slope. Past a fold g(beta) is not zero."""
    flat = jnp.zeros_like(load.axial)
    if any(pull.unit for pull in load.pulls):

        def refine_both(_: Any, both: tuple[Scalar, Scalar]) -> tuple[Scalar, Scalar]:
            beta = _root(arm, s, load, both[1])
            return beta, _slope(arm, s, load, beta, both[1], rates_at)

        return lax.fori_loop(0, _PASSES, refine_both, (flat, flat))
    beta = _root(arm, s, load, flat)
    return beta, lax.fori_loop(0, _PASSES, lambda _, beta_s: _slope(arm, s, load, beta, beta_s, rates_at), flat)


def volume_defect(beta: Scalar, params: tuple[Arm, Scalar, SectionLoad, Scalar]) -> Scalar:
    """g(beta) at the strains that arm, s, load and beta_s give: zero where the volume is kept."""
    arm, s, load, beta_s = params
    strains = strains_at(stiffness_at(arm, s, beta), load, beta, beta_s)
    return beta * (1 + strains.extension - beta * arm.ventral * radius_at(arm, s) * strains.curvature) - 1


def _root(arm: Arm, s: Scalar, load: SectionLoad, beta_s: Scalar) -> Scalar:
    params = (arm, s, load, beta_s)
    held = lax.stop_gradient(params)
    return differentiable_root(volume_defect, newton(volume_defect, jnp.ones(()), held, max_step=0.25), params)


def _slope(
    arm: Arm,
    s: Scalar,
    load: SectionLoad,
    beta: Scalar,
    beta_s: Scalar,
    rates_at: Callable[[Scalar, Scalar], LoadRates],
) -> Scalar:
    """beta_s with the rates of the load, and |t_c|, taken at the `beta_s` given."""
    drift = _defect_rate(arm, s, load, beta, beta_s, s_rate=1.0, rates=rates_at(beta, beta_s))
    return -drift / _defect_rate(arm, s, load, beta, beta_s, beta_rate=1.0)


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
