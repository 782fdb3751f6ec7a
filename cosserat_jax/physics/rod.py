"""The rod's ordinary differential equations, from the tip to the base.

Carried along s are the centerline r, the angle theta and director a = (cos, sin) of the cross-section, and the *total*
force F and moment M, those of the section and of the muscles that pass through it,

    F = n + sum T t_c                    M = m - sum T y beta (nu - y beta mu)

which stay continuous where a muscle ends, and which at a free tip are zero:

    r_s = nu a + eta b        theta_s = mu        a_s = mu b        F_s = -f        M_s = -(r_s x F) - m

with f and m the distributed loads (paper, Eqs. EquilibriumEqLocalTranslation and EquilibriumEqLocalRotation). The
director is carried beside theta because cosines are what costs time in a batch.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool

from ..scene import Arm, Muscle, Scene, Tip
from ..scene.quantity import Scalar
from .lengths import length_controlled, shortening_rate
from .loads import AbstractLoad, CrossSection
from .muscles import active_at, pull_at
from .section import SectionLoad, radius_at, stiffness_at, strains_at
from .stretch import LoadRates, constraint_slope, stretch_at
from .water import Flow
from .weight import Weight

_VOLUME_TOL = 1e-8  # Newton ends far below this wherever the constraint has a root


class RodState(NamedTuple):
    """Integrated along s: centerline [m], angle [rad] and director of the section, total force [N] and moment [N m].

    And how much shorter the path of each muscle of given contraction has become from s to its end [m]; None without
    one, where diffrax would stumble over an empty tuple.
    """

    x: Scalar
    y: Scalar
    theta: Scalar
    cos: Scalar
    sin: Scalar
    force_x: Scalar
    force_y: Scalar
    moment: Scalar
    shortenings: tuple[Scalar, ...] | None = None


class Rod(eqx.Module):
    """A scene as the solver sees it: the arm, its muscles, and its loads, all of them times `load_fraction`.

    `found` are the tensions [N], not times the load fraction, of the muscles whose contraction is given.
    """

    arm: Arm
    muscles: tuple[Muscle, ...]
    loads: tuple[AbstractLoad, ...]
    tip: Tip | None
    load_fraction: Scalar
    found: tuple[Scalar, ...] = ()

    @classmethod
    def of(cls, scene: Scene, load_fraction: Scalar = 1.0) -> "Rod":
        """The rod of a scene. A new distributed load is a new file and one line here."""
        loads: list[AbstractLoad] = []
        if scene.water is not None:
            loads.append(Flow(scene.water))
        if scene.gravity is not None:
            displaced = 0.0 if scene.water is None else scene.water.density
            excess = scene.arm.density - displaced
            loads.append(Weight(excess, scene.gravity.acceleration, follows_strain=scene.arm.stiffness is None))
        return cls(scene.arm, scene.muscles, tuple(loads), scene.tip, load_fraction)

    @property
    def depends_on_position(self) -> bool:
        """Whether any load asks where the arm is; shooting then needs three unknowns, the pose of the tip."""
        return any(load.depends_on_position for load in self.loads)

    @property
    def unknowns(self) -> int:
        """Of shooting: the angle of the tip, or its pose where a load depends on position."""
        return 3 if self.depends_on_position else 1

    @property
    def length_controlled(self) -> tuple[int, ...]:
        """The numbers of the muscles whose contraction is given: shooting has the tension of each as an unknown too."""
        return length_controlled(self.muscles)

    def tension(self, i: int) -> Scalar:
        """Of muscle `i` [N]."""
        given: Any = self.muscles[i].tension  # None in a scene that `actuate` takes, but it gives it
        if self.muscles[i].contraction is None:
            return self.load_fraction * given
        return self.found[self.length_controlled.index(i)]

    @property
    def is_rigid(self) -> bool:
        """Whether the cross-section keeps its size, so that the volume constraint is left out of the program."""
        return self.arm.cross_section == "rigid"


def tip_state(rod: Rod, x: Scalar, y: Scalar, theta: Scalar) -> RodState:
    """The state at s = L for a given pose of the tip: the tip's own force and moment, zero at a free tip."""
    cos, sin = jnp.cos(theta), jnp.sin(theta)
    zero = jnp.zeros_like(theta)
    none = tuple(zero for _ in rod.length_controlled) or None
    if rod.tip is None:
        return RodState(x, y, theta, cos, sin, zero, zero, zero, none)
    f1, f2 = (rod.load_fraction * component for component in rod.tip.force)
    if rod.tip.follower:
        f1, f2 = f1 * cos - f2 * sin, f1 * sin + f2 * cos
    return RodState(x, y, theta, cos, sin, f1 + zero, f2 + zero, rod.load_fraction * rod.tip.moment + zero, none)


def section_load(rod: Rod, s: Scalar, state: RodState, active: Bool[Array, " muscles"]) -> SectionLoad:
    """The force and moment on the section at `s` in its own frame, with the muscles that are active there."""
    axial = state.force_x * state.cos + state.force_y * state.sin
    shear = state.force_y * state.cos - state.force_x * state.sin
    pulls = tuple(pull_at(muscle, rod.arm, s, active[i], rod.tension(i)) for i, muscle in enumerate(rod.muscles))
    return SectionLoad(axial, shear, state.moment, pulls)


def derivative(rod: Rod, s: Scalar, state: RodState, active: Bool[Array, " muscles"]) -> tuple[RodState, CrossSection]:
    """d(state)/ds at `s` with these muscles active, and the cross-section there.

    theta's slope is NaN where the volume constraint has folded.
    """
    load = section_load(rod, s, state, active)

    def at(beta: Scalar, beta_s: Scalar) -> tuple[RodState, CrossSection]:
        section = _cross_section(rod.arm, s, state, load, beta, beta_s)
        rates = [jnp.where(active[i], shortening_rate(load.pulls[i], section), 0.0) for i in rod.length_controlled]
        return _balance(rod, state, load, section)._replace(shortenings=tuple(rates) or None), section

    if rod.is_rigid:
        return at(1.0, 0.0)

    def rates(beta: Scalar, beta_s: Scalar) -> LoadRates:
        slope, section = at(beta, beta_s)
        # in the turning frame: (F.a)_s = F_s.a + mu F.b and (F.b)_s = F_s.b - mu F.a
        axial = slope.force_x * state.cos + slope.force_y * state.sin + section.mu * load.shear
        shear = slope.force_y * state.cos - slope.force_x * state.sin - section.mu * load.axial
        return LoadRates(axial, shear, slope.moment)

    beta, beta_s = stretch_at(rod.arm, s, load, rates)
    slope, section = at(beta, beta_s)
    # where the constraint has folded there is no slope: NaN, so that the integrator stops there instead of walking on
    volume = beta * (section.nu - beta * section.surface * section.mu)
    folded = ~(jnp.abs(volume - 1) < _VOLUME_TOL)
    return slope._replace(theta=jnp.where(folded, jnp.nan, slope.theta)), section


def fold_margin(rod: Rod, s: Scalar, state: RodState, section: CrossSection) -> Scalar:
    """How far the volume constraint is from folding at `s`: d(volume)/d(beta) at given load, from 1 at rest to 0."""
    return constraint_slope(
        rod.arm, s, section_load(rod, s, state, active_at(rod.muscles, s)), section.beta, section.beta_s
    )


def _cross_section(
    arm: Arm, s: Scalar, state: RodState, load: SectionLoad, beta: Scalar, beta_s: Scalar
) -> CrossSection:
    strains = strains_at(stiffness_at(arm, s, beta), load, beta, beta_s)
    radius, taper = radius_at(arm, s), (arm.tip_radius - arm.base_radius) / arm.length
    return CrossSection(
        x=state.x, y=state.y, cos=state.cos, sin=state.sin,
        nu=1 + strains.extension, eta=strains.shear, mu=strains.curvature, beta=beta, beta_s=beta_s,
        radius=radius, surface=arm.ventral * radius, surface_slope=arm.ventral * taper,
    )  # fmt: skip


def _balance(rod: Rod, state: RodState, load: SectionLoad, section: CrossSection) -> RodState:
    """d(state)/ds from the strains of the section and the distributed loads on it."""
    nu, eta, mu = section.nu, section.eta, section.mu
    force_x = force_y = moment = jnp.zeros_like(mu)
    for distributed in rod.loads:
        f1, f2, m = distributed.per_length(section)
        force_x, force_y, moment = force_x + f1, force_y + f2, moment + m
    return RodState(
        x=nu * state.cos - eta * state.sin,
        y=nu * state.sin + eta * state.cos,
        theta=mu,
        cos=-mu * state.sin,
        sin=mu * state.cos,
        force_x=-rod.load_fraction * force_x,
        force_y=-rod.load_fraction * force_y,
        moment=eta * load.axial - nu * load.shear - rod.load_fraction * moment,
    )
