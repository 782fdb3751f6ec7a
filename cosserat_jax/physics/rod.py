"""The rod's ordinary differential equations, from the tip to the base.

Carried along s are the centerline r, the angle theta and director a = (cos, sin) of the cross-section, and the *total*
force F and moment M, those of the section and of the tendons that pass through it,

    F = n + sum T t_c                    M = m - sum T y beta (nu - y beta mu)

which stay continuous where a tendon ends, and which at a free tip are zero:

    r_s = nu a + eta b        theta_s = mu        a_s = mu b        F_s = -f        M_s = -(r_s x F) - m

with f and m the distributed loads (Golestaneh, Cichella & Lamuta: local equilibrium of translation and rotation). The
director is carried beside theta because cosines are what costs time in a batch, and beside it the scale beta of the
cross-section, which jumps where a tendon ends.
"""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp

from ..scene import Scene, Tip
from ..scene.quantity import Scalar
from .loads import AbstractLoad, DeformedSection
from .section_laws import AbstractSectionLaw, GivenStiffness, LinearElastic
from .tendon import Pull, Tendon, pull_at, shortening_rate
from .volume import KnownSlope, Loads, Place, SectionLoad, Strained, known_slope, scale_root, strained
from .water import Flow
from .weight import Weight


class RodState(NamedTuple):
    """Integrated along s: centerline [m], angle [rad] and director of the section, total force [N] and moment [N m].

    And its scale beta, None where the section is rigid; and how much shorter the path of each tendon of given
    displacement has become from s to its end [m].
    """

    x: Any
    y: Any
    theta: Any
    cos: Any
    sin: Any
    force_x: Any
    force_y: Any
    moment: Any
    beta: Any
    shortenings: tuple[Any, ...] = ()


class Rod(eqx.Module):
    """A scene as the solver sees it, built once: the arm, its section law, its tendons, its loads and its ends."""

    length: Scalar
    base_angle: Scalar
    base_radius: Scalar
    radius_slope: Scalar
    law: AbstractSectionLaw
    tendons: tuple[Tendon, ...]
    loads: tuple[AbstractLoad, ...]
    tip: Tip | None
    load_fraction: Scalar
    ventral: int = eqx.field(static=True)
    is_rigid: bool = eqx.field(static=True)

    @classmethod
    def of(cls, scene: Scene) -> "Rod":
        """The rod of a scene at full load."""
        arm = scene.arm
        loads: list[Any] = [] if scene.water is None else [Flow(scene.water)]
        if scene.gravity is not None:
            displaced = 0.0 if scene.water is None else scene.water.density
            excess = arm.density - displaced
            loads.append(Weight(excess, scene.gravity.acceleration, follows_strain=arm.stiffness is None))
        return cls(
            length=arm.length,
            base_angle=arm.base_angle,
            base_radius=arm.base_radius,
            radius_slope=(arm.tip_radius - arm.base_radius) / arm.length,
            law=section_law(scene),
            tendons=tuple(Tendon.of(muscle, arm) for muscle in scene.muscles),
            loads=(*loads, *scene.loads),
            tip=scene.tip,
            load_fraction=1.0,
            ventral=arm.ventral,
            is_rigid=arm.cross_section == "rigid",
        )

    def at_load(self, fraction: Scalar) -> "Rod":
        """The rod with this fraction of all its loads, its tensions and its given displacements."""
        tendons = tuple(
            dataclasses.replace(tendon, tension=fraction * tendon.tension)
            if tendon.displacement is None
            else dataclasses.replace(tendon, displacement=fraction * tendon.displacement)
            for tendon in self.tendons
        )
        tip = self.tip
        if tip is not None:
            force = tuple(fraction * component for component in tip.force)
            tip = Tip(force=force, moment=fraction * tip.moment, follower=tip.follower)  # pyright: ignore[reportArgumentType]
        return dataclasses.replace(self, tendons=tendons, tip=tip, load_fraction=fraction * self.load_fraction)

    def with_tensions(self, tensions: Any) -> "Rod":
        """The rod with these tensions [N] of the tendons whose displacement is given."""
        found = iter(tensions)
        tendons = tuple(
            tendon if tendon.displacement is None else dataclasses.replace(tendon, tension=next(found))
            for tendon in self.tendons
        )
        return dataclasses.replace(self, tendons=tendons)

    @property
    def displaced(self) -> tuple[int, ...]:
        """The numbers of the tendons whose displacement is given and whose tension is to be found."""
        return tuple(i for i, tendon in enumerate(self.tendons) if tendon.displacement is not None)

    @property
    def depends_on_position(self) -> bool:
        """Whether any load asks where the arm is."""
        return any(load.depends_on_position for load in self.loads)

    def radius_at(self, s: Scalar) -> Scalar:
        """R(s) = R_base + (R_tip - R_base) s / L of the undeformed arm [m] (the paper's linear taper)."""
        return self.base_radius + self.radius_slope * s


def section_law(scene: Scene) -> AbstractSectionLaw:
    """The section law that the arm of a scene has, or that its moduli or its stiffness make."""
    arm = scene.arm
    if arm.section_law is not None:
        return arm.section_law
    factor = arm.stiffness_factor
    if arm.stiffness is not None:
        given = arm.stiffness
        return GivenStiffness(_times(factor, given.axial), _times(factor, given.shear), factor * given.bending)
    assert arm.youngs_modulus is not None  # a valid scene has the moduli, the stiffness or the law
    assert arm.poisson_ratio is not None
    axial = factor * arm.youngs_modulus
    return LinearElastic(axial, axial / (2 * (1 + arm.poisson_ratio)))


def _times(factor: Scalar, stiffness: Scalar) -> Scalar:
    """factor * stiffness, of which an infinite one has no slope; that of the product would be 0 * inf."""
    is_finite = jnp.isfinite(jnp.asarray(stiffness, float))
    return jnp.where(is_finite, factor * jnp.where(is_finite, stiffness, 1.0), jnp.inf)


def tip_state(rod: Rod, x: Scalar, y: Scalar, theta: Scalar) -> RodState:
    """The state at s = L for a given pose of the tip: the tip's own force and moment, zero at a free tip. Its beta is
    that of the unloaded section; see `restarted`."""
    cos, sin = jnp.cos(theta), jnp.sin(theta)
    zero = jnp.zeros_like(theta)
    f1 = f2 = moment = zero
    if rod.tip is not None:
        f1, f2 = rod.tip.force
        if rod.tip.follower:
            f1, f2 = f1 * cos - f2 * sin, f1 * sin + f2 * cos
        f1, f2, moment = f1 + zero, f2 + zero, rod.tip.moment + zero
    beta = None if rod.is_rigid else zero + 1
    return RodState(x, y, theta, cos, sin, f1, f2, moment, beta, tuple(zero for _ in rod.displaced))


def restarted(rod: Rod, s: Scalar, state: RodState, active: Any) -> RodState:
    """The state with the beta that the section has at `s` where these tendons are active."""
    if rod.is_rigid:
        return state
    return state._replace(beta=scale_root(rod.law, place_at(rod, s, active), section_load(state)))


def place_at(rod: Rod, s: Scalar, active: Any) -> Place:
    """The undeformed section at `s`, with the pulls of the tendons that are active there."""
    radius, slope = rod.radius_at(s), rod.radius_slope
    pulls = [pull_at(tendon, s, on) for tendon, on in zip(rod.tendons, active, strict=True)]
    return Place(s, radius, slope, rod.ventral * radius, rod.ventral * slope, pulls)


def section_load(state: RodState) -> SectionLoad:
    """The total force and moment in the section's own frame."""
    axial = state.force_x * state.cos + state.force_y * state.sin
    shear = state.force_y * state.cos - state.force_x * state.sin
    return SectionLoad(axial, shear, state.moment)


def derivative(
    rod: Rod, s: Scalar, state: RodState, active: Any, known: KnownSlope | None = None
) -> tuple[RodState, DeformedSection, Scalar]:
    """d(state)/ds at `s` with these tendons active, the cross-section there, and how far the volume constraint is from
    folding: d(volume)/d(beta) at given load, from 1 at rest to 0. For `known` see `strained`."""
    place, load = place_at(rod, s, active), section_load(state)
    found: Strained = strained(rod.law, place, load, state.beta, _loads(rod, place, load, state), known)
    nu, eta, mu = found.nu, found.eta, found.mu
    f1, f2, moment = found.loads
    section = _deformed(place, state, nu, eta, mu, found.beta, found.beta_s)
    rates = RodState(
        x=nu * state.cos - eta * state.sin,
        y=nu * state.sin + eta * state.cos,
        theta=mu,
        cos=-mu * state.sin,
        sin=mu * state.cos,
        force_x=-f1,
        force_y=-f2,
        moment=moment,
        beta=None if state.beta is None else found.beta_s,
        shortenings=tuple(_shortening(place.pulls[i], section, active[i]) for i in rod.displaced),
    )
    return rates, section, found.margin


def known_slope_at(rod: Rod, s: Scalar, state: RodState, active: Any, beta_s: Scalar) -> KnownSlope | None:
    """What `derivative` may be given where it has found `beta_s`; nothing of a rigid section."""
    if rod.is_rigid:
        return None
    place, load = place_at(rod, s, active), section_load(state)
    return known_slope(rod.law, place, load, state.beta, _loads(rod, place, load, state), beta_s)


def _deformed(
    place: Place, state: RodState, nu: Scalar, eta: Scalar, mu: Scalar, beta: Scalar, beta_s: Scalar
) -> DeformedSection:
    return DeformedSection(
        s=place.s, x=state.x, y=state.y, cos=state.cos, sin=state.sin, nu=nu, eta=eta, mu=mu, beta=beta, beta_s=beta_s,
        radius=place.radius, surface=place.surface, surface_slope=place.surface_slope,
    )  # fmt: skip


def _loads(rod: Rod, place: Place, load: SectionLoad, state: RodState) -> Loads:
    """What the loads along the arm make of the section's load, and with it the slopes of F and M."""

    def loads(nu: Scalar, eta: Scalar, mu: Scalar, beta: Scalar, beta_s: Scalar) -> tuple[SectionLoad, tuple]:
        f1, f2, m = _distributed(rod, _deformed(place, state, nu, eta, mu, beta, beta_s))
        # in the turning frame: (F.a)_s = F_s.a + mu F.b and (F.b)_s = F_s.b - mu F.a
        axial = mu * load.shear - (f1 * state.cos + f2 * state.sin)
        shear = -mu * load.axial - (f2 * state.cos - f1 * state.sin)
        moment = eta * load.axial - nu * load.shear - m
        return SectionLoad(axial, shear, moment), (f1, f2, moment)

    return loads


def _shortening(pull: Pull, section: DeformedSection, is_active: Any) -> Scalar:
    return jnp.where(is_active, shortening_rate(pull, section), 0.0)


def _distributed(rod: Rod, section: DeformedSection) -> tuple[Scalar, Scalar, Scalar]:
    """The distributed loads: force along e1 and e2 [N/m] and moment [N m/m]."""
    zero = jnp.zeros_like(section.cos)
    total = [zero, zero, zero]
    for load in rod.loads:
        total = [so_far + part for so_far, part in zip(total, load.per_length(section), strict=True)]
    return rod.load_fraction * total[0], rod.load_fraction * total[1], rod.load_fraction * total[2]
