"""Tensions that are unknown: those of muscles whose contraction is given; see `physics.lengths`.

Whichever formulation shoots, it has the tension of each as a further unknown, in units of T_1, and the error of each
length as a further equation. On the unloaded arm lengths do not depend on the pose, so that there the determinant of
the whole is that of the muscles' compliance, by which the rows of the lengths are divided: it is 1 at rest, as it is
without such muscles, and falls to zero at a limit point.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..physics.implicit import solve_columns
from ..physics.lengths import length_error, units_of
from ..physics.muscles import active_stretches
from ..physics.rod import Rod, derivative, tip_state
from ..scene.quantity import Scalar
from .continuation import Found
from .outcome import Outcome

_REDUNDANT = 1e-8  # singular value of the muscles' compliance below which lengths do not tell tensions apart
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)  # of a quadrature along a stretch of the unloaded arm

Shortenings = tuple[Scalar, ...] | None


def pulled(rod: Rod, scaled: Float[Array, " found"] | None) -> Rod:
    """The rod with these unknown tensions, in their units."""
    controlled = rod.length_controlled
    if scaled is None or not controlled:
        return rod
    tensions = zip(controlled, list(scaled), strict=True)
    return dataclasses.replace(rod, found=tuple(units_of(rod.muscles[i], rod.arm).tension * t for i, t in tensions))


def length_errors(rod: Rod, shortenings: Shortenings) -> list[tuple[Scalar, Bool[Array, ""]]]:
    """`length_error` of every muscle whose contraction is given."""
    muscles: list[Any] = [rod.muscles[i] for i in rod.length_controlled]
    return [
        length_error(shortening, rod.load_fraction * muscle.contraction, tension, units_of(muscle, rod.arm))
        for muscle, shortening, tension in zip(muscles, shortenings or (), rod.found, strict=True)
    ]


def taut_at(rod: Rod, shortenings: Shortenings) -> Bool[Array, " found"]:
    """Which of those muscles are taut."""
    return jnp.stack([is_taut for _, is_taut in length_errors(rod, shortenings)])


def tensions_of(rod: Rod, shortenings: Shortenings) -> Float[Array, " muscles"]:
    """The tension [N] of every muscle, zero without round-off for a slack one."""
    tensions = [rod.tension(i) for i in range(len(rod.muscles))]
    for i, (_, is_taut) in zip(rod.length_controlled, length_errors(rod, shortenings), strict=True):
        tensions[i] = jnp.where(is_taut, tensions[i], 0.0)
    return jnp.stack(tensions) if tensions else jnp.zeros(0)


def compliance_at_rest(rod: Rod) -> Float[Array, "found found"] | None:
    """d(contraction / lever)/d(tension), in units of each muscle, on the unloaded arm; None without such a muscle.

    There F and M stay zero whatever pulls, so that it is the integral of the sections' own compliance.
    """
    units = [units_of(rod.muscles[i], rod.arm) for i in rod.length_controlled]
    if not units:
        return None
    ends, active = active_stretches(rod.muscles, rod.arm)
    unloaded = dataclasses.replace(rod, load_fraction=0.0)
    state = tip_state(unloaded, jnp.zeros(()), jnp.zeros(()), jnp.zeros(()))

    def rates(scaled: Array, s: Array, active: Bool[Array, " muscles"]) -> Array:
        slope = derivative(pulled(unloaded, scaled), s, state, active)[0]
        return jnp.stack([-rate / unit.lever for rate, unit in zip(slope.shortenings or (), units, strict=True)])

    def over_stretch(start: Array, end: Array, active: Array) -> Array:
        s = (start + end) / 2 + (start - end) / 2 * _NODES
        at = jax.vmap(lambda s: jax.jacfwd(rates)(jnp.zeros(len(units)), s, active))(s)
        return (start - end) / 2 * jnp.tensordot(jnp.asarray(_WEIGHTS), at, 1)

    return jax.vmap(over_stretch)(ends[:-1], ends[1:], active).sum(axis=0)


def over_compliance(rows: Float[Array, "found n"], compliance: Array, taut: Array) -> Float[Array, "found n"]:
    """The rows of the lengths in a Jacobian over those of the unloaded arm."""
    return solve_columns(_among(taut, compliance), rows)


def without_redundant(found: Found, compliance: Array | None, scaled: Float[Array, " found"] | None) -> Found:
    """What was found, unless two sets of tensions shorten the muscles alike, as those of two on one path do."""
    if compliance is None or scaled is None:
        return found
    pulling = (scaled > 0) | (found.outcome != Outcome.converged)
    apart = jnp.linalg.svd(_among(pulling, compliance), compute_uv=False)[-1] > _REDUNDANT
    outcome = Outcome.where(apart | (found.outcome == Outcome.bad_input), found.outcome, Outcome.muscles_redundant)
    return found._replace(outcome=outcome)


class LinearLengths(NamedTuple):
    """The equations of the given contractions: error, derivatives by every state and by parameters; which are taut.

    The last of the parameters are the unknown tensions.
    """

    error: Float[Array, " found"]
    growth: Float[Array, "intervals found size"]
    rates: Float[Array, "found params"]
    taut: Bool[Array, " found"]

    def close(self, change: Float[Array, "nodes size columns"]) -> tuple[Array, Array, Float[Array, "found found"]]:
        """From the change of states, Newton's step and one a parameter, those with the tensions following; the changes
        of the tensions, and the Jacobian of lengths by tensions."""
        count = self.error.size
        of_states = jnp.einsum("iks,isc->kc", self.growth, change[:-1])
        columns = of_states + jnp.concatenate([self.error[:, None], self.rates], axis=1)
        jacobian = columns[:, -count:]
        tensions = -solve_columns(jacobian, columns[:, :-count])
        return change[..., :-count] + change[..., -count:] @ tensions, tensions, jacobian


def linear_lengths(
    rod_of: Callable[[Array], Rod],
    params: Float[Array, " params"],
    shortenings: Shortenings,
    rates: Float[Array, "intervals found size+params"],
) -> LinearLengths:
    """The equations of the lengths, from how much shorter every interval's part of the muscles is, by state and by
    parameters."""

    def errors(shortenings: Any, params: Array) -> Array:
        return jnp.stack([error for error, _ in length_errors(rod_of(params), shortenings)])

    by_shortening, by_params = jax.jacfwd(errors, argnums=(0, 1))(shortenings, params)
    rates = jnp.einsum("kj,ijp->ikp", jnp.stack(by_shortening, axis=1), rates)
    return LinearLengths(
        error=errors(shortenings, params),
        growth=rates[..., : -params.size],
        rates=by_params + rates[..., -params.size :].sum(axis=0),
        taut=taut_at(rod_of(params), shortenings),
    )


def _among(taut: Bool[Array, " found"], compliance: Float[Array, "found found"]) -> Float[Array, "found found"]:
    """The compliance of the taut muscles; a slack one has the equation T = 0."""
    return jnp.where(taut[:, None], compliance, jnp.eye(len(compliance)))
