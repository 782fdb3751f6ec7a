"""The strains of a cross-section, its scale beta, and the slope of beta along the rod.

Over the tendons active at s, t_c the tangent of each,

    F.a = n.a + sum T (nu - y beta mu)
    F.b = n.b + sum T (eta + (y beta)_s)              (y beta)_s = y_s beta + y beta_s
    M   = m   - sum T y beta (nu - y beta mu)
    g   = beta (nu - beta X mu) - 1 = 0               X = ventral R

(Golestaneh, Cichella & Lamuta: force and moment of the section with the pull of the muscles counted to the total;
local volume preservation). At given beta the first three make the strains: in closed form where the section law is
linear and no tangent is normalized, by Newton's method otherwise. beta is carried along the rod by its slope

    beta_s = -(g_s + g_Fa (F.a)_s + g_Fb (F.b)_s + g_M M_s) / g_beta

the total derivative of the root (their equation for beta_s), so that a root is looked for only where a segment begins.
It continues beta = 1 of the unloaded section and ends where g_beta = 0, where the constraint folds.

The shear and the water feel beta_s themselves, by a factor of 1e-4 on the paper's arm and up to 0.1 on extreme ones, so
the loads are evaluated at three values of it, by the secant method.

In closed form, with P = sum T y, Q = sum T y^2, S = c E A + sum T, K = c E J / beta^2 + Q and w = S K - P^2,

    beta w (nu - 1) = K beta (F.a - sum T) + P (M + beta P)      =: N_e
    beta^2 w mu     = S (M + beta P) + P beta (F.a - sum T)      =: N_m
    G(beta) = w g   = (beta - 1) w + N_e - X N_m

so that the constraint is a polynomial of beta and the strains take one division.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeGuard

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array

from ..numerics import newton
from ..scene.quantity import Scalar
from .section_laws import AbstractLinearLaw, AbstractSectionLaw, ReferenceSection
from .tendon import Pull, tangent

_MOST_FELT = 0.5  # the largest |d(rates)/d(beta_s)| that is believed: in the last digits it is noise
_EVALUATIONS = 3  # of the loads in the search for beta_s
_ROOT_STEP = 0.25  # the longest step of Newton towards beta
_NO_LENGTH = 1e-6  # |t_c|, from which a tendon counts as one of zero length


class SectionLoad(NamedTuple):
    """What a cross-section carries: total force along a and b [N], total moment [N m]."""

    axial: Scalar
    shear: Scalar
    moment: Scalar


class Place(NamedTuple):
    """A cross-section of the undeformed arm: s [m], radius R [m] and its slope, offset X = ventral R of the ventral
    surface [m] and its slope, and the pulls of the tendons."""

    s: Scalar
    radius: Scalar
    radius_slope: Scalar
    surface: Scalar
    surface_slope: Scalar
    pulls: Sequence[Pull]

    def moved(self, step: Scalar) -> "Place":
        """The section a step [m] further along the arm."""
        pulls = [pull.moved(step) for pull in self.pulls]
        return self._replace(
            s=self.s + step,
            radius=self.radius + self.radius_slope * step,
            surface=self.surface + self.surface_slope * step,
            pulls=pulls,
        )


class Strained(NamedTuple):
    """The strains nu, eta, mu of a section, beta and beta_s, what its loads make at these (the second result of
    `loads`), and `margin` = g_beta at given load: 1 at rest, 0 where the constraint folds."""

    nu: Scalar
    eta: Scalar
    mu: Scalar
    beta: Scalar
    beta_s: Scalar
    loads: Any
    margin: Scalar


class KnownSlope(NamedTuple):
    """A known beta_s, and what a linearization around it need not find again: 1 / (1 - d(beta_s)/d(beta_s)), as the
    loads feel it, and the derivative of what else the loads make."""

    beta_s: Scalar
    gain: Scalar
    loads: Any


# from (nu, eta, mu, beta, beta_s) to the rates (F.a)_s, (F.b)_s, M_s of the section's load, and what else is asked
Loads = Callable[[Scalar, Scalar, Scalar, Scalar, Scalar], tuple[SectionLoad, Any]]


def strained(
    law: AbstractSectionLaw, place: Place, load: SectionLoad, beta: Scalar | None, loads: Loads,
    known: KnownSlope | None = None,
) -> Strained:  # fmt: skip
    """The section under its load, at a given scale `beta`, None where the section is rigid.

    With `known`, of the same section, beta_s is not looked for: the loads are evaluated once, and the derivatives are
    the same. That is what a linearization is made of.
    """
    if beta is None:
        if _is_closed(law, place):
            nu, eta, mu = _linear_strains(law, place, load)
        else:
            nu, eta, mu = _strains(law, place, load, 1.0, 0.0)
        return Strained(nu, eta, mu, 1.0, 0.0, loads(nu, eta, mu, 1.0, 0.0)[1], 1.0)
    slope_at, strained_at, search = _pieces(law, place, load, beta, loads)
    if known is None:
        beta_s, more = search()
    else:  # one step of Newton from the root
        found, more = slope_at(known.beta_s)
        move = (found - known.beta_s) * known.gain
        beta_s, more = known.beta_s + move, jax.tree.map(lambda m, d: m + d * move, more, known.loads)
    return strained_at(beta_s, more)


def known_slope(
    law: AbstractSectionLaw, place: Place, load: SectionLoad, beta: Scalar, loads: Loads, beta_s: Scalar
) -> KnownSlope:  # fmt: skip
    """What `strained` may be given where `beta_s` is what it has found, or near that."""
    slope_at, _, _ = _pieces(law, place, load, beta, loads)
    (found, _), (rate, more) = jax.jvp(slope_at, (beta_s,), (jnp.ones_like(beta_s),))
    gain = 1 / (1 - rate)
    return KnownSlope(beta_s + (found - beta_s) * gain, gain, more)


def _is_closed(law: AbstractSectionLaw, place: Place) -> TypeGuard[AbstractLinearLaw]:
    """Whether the strains have a closed form at given beta: of a linear law, where no tangent is normalized."""
    return isinstance(law, AbstractLinearLaw) and not any(pull.unit for pull in place.pulls)


class _Pieces(NamedTuple):
    """Of a section: the beta_s that follows from a beta_s, by what the loads make there, and what else they make; the
    section at the beta_s found; and the search for it."""

    slope_at: Callable[[Scalar], tuple[Scalar, Any]]
    strained_at: Callable[[Scalar, Any], Strained]
    search: Callable[[], tuple[Scalar, Any]]


def _pieces(law: AbstractSectionLaw, place: Place, load: SectionLoad, beta: Scalar, loads: Loads) -> _Pieces:
    if _is_closed(law, place):
        return _closed(law, place, load, beta, loads)
    return _general(law, place, load, beta, loads)


def scale_root(law: AbstractSectionLaw, place: Place, load: SectionLoad) -> Scalar:
    """The beta of the section under its load that continues the 1 of the unloaded one; no number that keeps the volume
    where there is none. The part that beta_s has in |t_c| of a unit tangent is left out."""
    start = (jnp.ones_like(load.axial),)
    return newton.root(_volume, start, (law, place, load), max_step=_ROOT_STEP)[0]


def volume_defect(nu: Scalar, mu: Scalar, beta: Scalar, surface: Scalar) -> Scalar:
    """g = beta (nu - beta X mu) - 1."""
    return beta * (nu - beta * surface * mu) - 1


def _volume(x: tuple[Array, ...], params: tuple[AbstractSectionLaw, Place, SectionLoad]) -> tuple[Any]:
    (beta,), (law, place, load) = x, params
    if _is_closed(law, place):
        sums = _sums(law, place)
        terms = _terms(sums, load, beta)
        return ((beta - 1) + (terms.extension - place.surface * terms.curvature) / terms.w,)
    nu, _, mu = _strains(law, place, load, beta, 0.0)
    return (volume_defect(nu, mu, beta, place.surface),)


def _linear_strains(law: AbstractLinearLaw, place: Place, load: SectionLoad) -> tuple[Scalar, Scalar, Scalar]:
    """Of a rigid section. The extension is eliminated, so that an infinite axial stiffness is allowed."""
    stiffness = law.stiffness(ReferenceSection(place.s, place.radius))
    tension = sum(pull.tension for pull in place.pulls)
    first = sum(pull.tension * pull.offset for pull in place.pulls)
    second = sum(pull.tension * pull.offset * pull.offset for pull in place.pulls)
    rise = sum(pull.tension * pull.slope for pull in place.pulls)
    compliance = 1 / (stiffness.axial + tension)
    axial, coupling = load.axial - tension, first * compliance
    mu = (load.moment + first + coupling * axial) / (stiffness.bending + second - coupling * first)
    return 1 + axial * compliance + coupling * mu, (load.shear - rise) / (stiffness.shear + tension), mu


class _Sums(NamedTuple):
    """Of a linear law: stiffnesses c E A and c E J at beta = 1 and c G A, and sums over the tendons; slopes by s."""

    axial: Scalar
    axial_s: Scalar
    bending: Scalar
    bending_s: Scalar
    shear: Scalar
    tension: Scalar
    first: Scalar
    first_s: Scalar
    second: Scalar
    second_s: Scalar


def _sums(law: AbstractLinearLaw, place: Place) -> _Sums:
    def stiffness(step: Scalar) -> Any:
        moved = place.moved(step)
        return law.stiffness(ReferenceSection(moved.s, moved.radius))

    zero = jnp.zeros_like(jnp.asarray(place.radius))
    at, rate = jax.jvp(stiffness, (zero,), (jnp.ones_like(zero),))
    pulls = place.pulls
    return _Sums(
        at.axial, rate.axial, at.bending, rate.bending, at.shear,
        tension=sum(p.tension for p in pulls),
        first=sum(p.tension * p.offset for p in pulls),
        first_s=sum(p.tension * p.slope for p in pulls),
        second=sum(p.tension * (p.offset * p.offset) for p in pulls),
        second_s=sum(p.tension * (2 * p.offset * p.slope) for p in pulls),
    )  # fmt: skip


class _Terms(NamedTuple):
    """beta^2, S, K, F.a - sum T, beta P, w, M + beta P, N_e and N_m of the closed form."""

    square: Scalar
    stretching: Scalar
    bending: Scalar
    axial: Scalar
    lever: Scalar
    w: Scalar
    moment: Scalar
    extension: Scalar
    curvature: Scalar


def _terms(sums: _Sums, load: SectionLoad, beta: Scalar) -> _Terms:
    """With `extension` and `curvature` such that g = beta - 1 + (extension - X curvature) / w."""
    square = beta * beta
    stretching, bending = sums.axial * square + sums.tension, sums.bending * square + sums.second
    axial, lever = load.axial - sums.tension, beta * sums.first
    moment = load.moment + lever
    return _Terms(
        square, stretching, bending, axial, lever,
        w=stretching * bending - sums.first * sums.first,
        moment=moment,
        extension=axial * bending * beta + sums.first * moment,
        curvature=stretching * moment + lever * axial,
    )  # fmt: skip


def _closed(law: AbstractLinearLaw, place: Place, load: SectionLoad, beta: Scalar, loads: Loads) -> _Pieces:
    sums = _sums(law, place)
    t = _terms(sums, load, beta)
    surface, first = place.surface, sums.first
    inverse = 1 / (t.square * t.w)
    nu, mu = 1 + t.extension * beta * inverse, t.curvature * inverse

    # G by beta, by s, by F.a and by M
    stretching_b, bending_b = 2 * sums.axial * beta, 2 * sums.bending * beta
    w_b = stretching_b * t.bending + t.stretching * bending_b
    by_beta = t.w + (beta - 1) * w_b + t.axial * (t.bending + beta * bending_b) + first * first
    by_beta -= surface * (stretching_b * t.moment + t.stretching * first + first * t.axial)
    stretching_s, bending_s = sums.axial_s * t.square, sums.bending_s * t.square + sums.second_s
    lever_s = beta * sums.first_s
    w_s = stretching_s * t.bending + t.stretching * bending_s - 2 * first * sums.first_s
    by_s = (beta - 1) * w_s + t.axial * bending_s * beta + sums.first_s * t.moment + first * lever_s
    by_s -= place.surface_slope * t.curvature
    by_s -= surface * (stretching_s * t.moment + t.stretching * lever_s + lever_s * t.axial)
    by_axial, by_moment = t.bending * beta - surface * t.lever, first - surface * t.stretching

    flexible = 1 / (sums.shear * t.square + sums.tension)
    eta, slip = (load.shear - sums.first_s * beta) * flexible, -first * flexible  # eta at beta_s = 0, and its slope
    falling = -1 / by_beta

    def slope_at(beta_s: Scalar) -> tuple[Scalar, Any]:
        rates, more = loads(nu, eta + slip * beta_s, mu, beta, beta_s)
        return (by_s + by_axial * rates.axial + by_moment * rates.moment) * falling, more

    def strained_at(beta_s: Scalar, more: Any) -> Strained:
        return Strained(nu, eta + slip * beta_s, mu, beta, beta_s, more, by_beta / t.w)

    return _Pieces(slope_at, strained_at, lambda: _consistent(slope_at, beta, looped=False))


def _consistent(slope_at: Callable[[Scalar], tuple[Scalar, Any]], like: Scalar, *, looped: bool) -> tuple[Scalar, Any]:
    """The beta_s that `slope_at` gives back, and what else it gives there: by the secant method from zero, with three
    evaluations, of which the last two make the line that leads to the result. Two leave 7e-7 lengths in the tip of an
    extreme arm, where three leave 1e-13.

    Where `slope_at` is a large program it stands in a loop, once."""

    def onward(carry: tuple) -> tuple:
        before, found_before, more_before, at = carry
        found, more = slope_at(at)
        apart = at - before
        moves = apart != 0
        apart = jnp.where(moves, apart, 1.0)
        rate = jnp.where(moves, (found - found_before) / apart, 0.0)
        move = (found - at) / (1 - jnp.clip(rate, -_MOST_FELT, _MOST_FELT))
        part = jnp.where(moves, move / apart, 0.0)
        return at, found, more, at + move, jax.tree.map(lambda a, b: b + (b - a) * part, more_before, more)

    zero = jnp.zeros_like(like)
    nothing = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape), jax.eval_shape(slope_at, zero)[1])
    carry = (zero, zero, nothing, zero, nothing)
    if looped:
        carry = lax.fori_loop(0, _EVALUATIONS, lambda _, carry: onward(carry[:4]), carry)
    else:
        for _ in range(_EVALUATIONS):
            carry = onward(carry[:4])
    return carry[3:]


def _strains(
    law: AbstractSectionLaw, place: Place, load: SectionLoad, beta: Scalar, beta_s: Scalar
) -> tuple[Array, Array, Array]:
    """By Newton's method, from the strains of the tangents that are not normalized where the law is linear."""
    shape = jnp.broadcast_shapes(*(jnp.shape(part) for part in (*load, place.radius, beta, beta_s)))
    one, zero = jnp.ones(shape), jnp.zeros(shape)
    params = (law, place, load, beta, beta_s)
    nu, eta, mu = newton.root(_unbalance, (one, zero, zero), params)
    return nu, eta, mu


def _unbalance(strains: tuple[Array, ...], params: Any) -> tuple[Array, Array, Array]:
    """Force along a and b and moment that the strains leave unbalanced; of a linear law the strains that they are off,
    so that an infinite stiffness is allowed."""
    law, place, load, beta, beta_s = params
    nu, eta, mu = strains
    axial, shear, moment = load
    for pull in place.pulls:
        along, across = tangent(pull, nu, eta, mu, beta, beta_s)
        tension = pull.tension / jnp.sqrt(along**2 + across**2) if pull.unit else pull.tension
        axial -= tension * along
        shear -= tension * across
        moment += tension * pull.offset * beta * along
    section = ReferenceSection(place.s, place.radius, beta)
    if isinstance(law, AbstractLinearLaw):
        stiffness = law.stiffness(section)
        return nu - 1 - axial / stiffness.axial, eta - shear / stiffness.shear, mu - moment / stiffness.bending
    carried = law.resultants(section, nu, eta, mu)
    return carried[0] - axial, carried[1] - shear, carried[2] - moment


def is_tendon_lost(law: AbstractSectionLaw, place: Place, load: SectionLoad, section: Any, pull: Pull) -> Array:
    """Whether t_c of a tendon that pulls along its unit tangent is zero at a section, or turns around in the next step
    of Newton's method: beyond zero length no strains balance the section, and Newton's method goes to and fro."""
    nu, eta, mu = jnp.broadcast_arrays(section.nu, section.eta, section.mu)
    params = (law, place, load, section.beta, section.beta_s)
    unbalance, matrix = newton.jacobian(lambda strains: _unbalance(strains, params), (nu, eta, mu))
    step = newton.solve(matrix, -jnp.stack(jnp.broadcast_arrays(*unbalance)))
    along, across = tangent(pull, nu, eta, mu, section.beta, section.beta_s)
    nu, eta, mu = nu + step[0], eta + step[1], mu + step[2]
    next_along, next_across = tangent(pull, nu, eta, mu, section.beta, section.beta_s)
    goes_on = along * next_along + across * next_across > 0
    is_known = jnp.isfinite(load.axial + load.moment + along + across)
    return is_known & (pull.tension > 0) & ~(goes_on & (along**2 + across**2 > _NO_LENGTH**2))


def _general(law: AbstractSectionLaw, place: Place, load: SectionLoad, beta: Scalar, loads: Loads) -> _Pieces:
    """With the slopes of g by JAX: that of the strains by the adjoint of the three equations they solve.

    Here g itself feels beta_s, through |t_c| of a unit tangent. Carried along the rod is the root without that part,
    whose slope is known; the section's own scale is a step of Newton away from it.
    """
    strains = _strains(law, place, load, beta, 0.0)
    nu, _, mu = strains
    zero = jnp.zeros_like(nu)
    _, matrix = newton.jacobian(lambda e: _unbalance(e, (law, place, load, beta, 0.0)), strains)
    by_strains = jnp.stack([jnp.broadcast_to(beta, nu.shape), zero, -beta * beta * place.surface + zero])
    adjoint = newton.solve(jnp.swapaxes(matrix, 0, 1), by_strains)

    def constraint(beta: Scalar, step: Scalar, axial: Scalar, shear: Scalar, moment: Scalar) -> Scalar:
        moved = place.moved(step)
        unbalance = _unbalance(strains, (law, moved, SectionLoad(axial, shear, moment), beta, 0.0))
        of_strains = sum(weight * force for weight, force in zip(adjoint, unbalance, strict=True))
        return volume_defect(nu, mu, beta, moved.surface) - of_strains

    at = [jnp.broadcast_to(part, nu.shape) for part in (beta, zero, *load)]
    _, back = jax.vjp(constraint, *at)
    by_beta, by_s, *by_load = back(jnp.ones_like(nu))

    def section_at(beta_s: Scalar) -> tuple[tuple[Scalar, Scalar, Scalar], Scalar]:
        """Its strains and its own scale."""
        found = _strains(law, place, load, beta, beta_s)
        if not any(pull.unit for pull in place.pulls):  # whose constraint does not feel beta_s
            return found, beta
        nu, _, mu = found
        scale = beta - volume_defect(nu, mu, beta, place.surface) / by_beta
        return _strains(law, place, load, scale, beta_s), scale

    def slope_at(beta_s: Scalar) -> tuple[Scalar, Any]:
        strains, scale = section_at(beta_s)
        rates, more = loads(*strains, scale, beta_s)
        return -(by_s + sum(slope * rate for slope, rate in zip(by_load, rates, strict=True))) / by_beta, more

    def strained_at(beta_s: Scalar, more: Any) -> Strained:
        (nu, eta, mu), scale = section_at(beta_s)
        return Strained(nu, eta, mu, scale, beta_s, more, lax.stop_gradient(by_beta))

    return _Pieces(slope_at, strained_at, lambda: _consistent(slope_at, nu, looped=True))
