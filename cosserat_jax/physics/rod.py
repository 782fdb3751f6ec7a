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
from .muscles import pull_at
from .section import Section, SectionLoad, Strains, section_at, strains_at
from .stretch import Forces, LoadRates, stretch_at
from .water import Flow
from .weight import Weight

_VOLUME_TOL = 1e-8  # Newton ends far below this wherever the constraint has a root


class RodState(NamedTuple):
    """Integrated along s: centerline [m], angle [rad] and director of the section, total force [N] and moment [N m].

    And how much shorter the path of each muscle of given contraction has become from s to its end [m]; None where
    there is none.
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


def derivative(
    rod: Rod, s: Scalar, state: RodState, active: Bool[Array, " muscles"]
) -> tuple[RodState, CrossSection, Scalar]:
    """d(state)/ds at `s` with these muscles active, the cross-section there, and how far the volume constraint is from
    folding: d(volume)/d(beta) at given load, from 1 at rest to 0.

    theta's slope is NaN where the volume constraint has folded.
    """
    load, section = section_load(rod, s, state, active), section_at(rod.arm, s)

    def balance(cross: CrossSection, forces: Forces) -> RodState:
        rates = [jnp.where(active[i], shortening_rate(load.pulls[i], cross), 0.0) for i in rod.length_controlled]
        return _balance(state, load, cross, forces)._replace(shortenings=tuple(rates) or None)

    if rod.is_rigid:
        cross = _cross_section(section, state, strains_at(section.stiffness, load, 1.0, 0.0), 1.0, 0.0)
        return balance(cross, _forces(rod, cross)), cross, 1.0

    def loads_at(strains: Strains, beta: Scalar, beta_s: Scalar) -> tuple[Forces, LoadRates]:
        cross = _cross_section(section, state, strains, beta, beta_s)
        force_x, force_y, moment = forces = _forces(rod, cross)
        # in the turning frame: (F.a)_s = F_s.a + mu F.b and (F.b)_s = F_s.b - mu F.a
        axial = cross.mu * load.shear - (force_x * state.cos + force_y * state.sin)
        shear = -cross.mu * load.axial - (force_y * state.cos - force_x * state.sin)
        return forces, LoadRates(axial, shear, cross.eta * load.axial - cross.nu * load.shear - moment)

    stretch = stretch_at(section, load, loads_at)
    cross = _cross_section(section, state, stretch.strains, stretch.beta, stretch.beta_s)
    slope = balance(cross, stretch.forces)
    # where the constraint has folded there is no slope: NaN, so that the integrator stops there instead of walking on
    volume = cross.beta * (cross.nu - cross.beta * cross.surface * cross.mu)
    folded = ~(jnp.abs(volume - 1) < _VOLUME_TOL)
    return slope._replace(theta=jnp.where(folded, jnp.nan, slope.theta)), cross, stretch.margin


def _cross_section(section: Section, state: RodState, strains: Strains, beta: Scalar, beta_s: Scalar) -> CrossSection:
    return CrossSection(
        x=state.x, y=state.y, cos=state.cos, sin=state.sin,
        nu=1 + strains.extension, eta=strains.shear, mu=strains.curvature, beta=beta, beta_s=beta_s,
        radius=section.radius, surface=section.surface, surface_slope=section.surface_slope,
    )  # fmt: skip


def _forces(rod: Rod, cross: CrossSection) -> Forces:
    """The distributed loads: force along e1 and e2 [N/m] and moment [N m/m]."""
    force_x = force_y = moment = jnp.zeros_like(cross.mu)
    for load in rod.loads:
        f1, f2, m = load.per_length(cross)
        force_x, force_y, moment = force_x + f1, force_y + f2, moment + m
    return rod.load_fraction * force_x, rod.load_fraction * force_y, rod.load_fraction * moment


def _balance(state: RodState, load: SectionLoad, cross: CrossSection, forces: Forces) -> RodState:
    """d(state)/ds from the strains of the section and the distributed loads on it."""
    nu, eta, mu = cross.nu, cross.eta, cross.mu
    force_x, force_y, moment = forces
    return RodState(
        x=nu * state.cos - eta * state.sin,
        y=nu * state.sin + eta * state.cos,
        theta=mu,
        cos=-mu * state.sin,
        sin=mu * state.cos,
        force_x=-force_x,
        force_y=-force_y,
        moment=eta * load.axial - nu * load.shear - moment,
    )
