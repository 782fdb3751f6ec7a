"""The scene a user describes: an arm, its muscles, and what surrounds it. SI units throughout.

Each part is an equinox module, so a scene is a pytree: its numbers are leaves that JAX traces, batches and
differentiates; its choices are static and decide which program is compiled; a part that is absent is None and leaves
no trace in that program.

The arm lies along e1 from its clamped base, e2 points up, and s in [0, L] is the arc length of its undeformed
centerline. Water flows along e1, gravity pulls along -e2. Symbols follow Golestaneh, Cichella & Lamuta,
"Quasi-static continuum model of octopus-like soft robot arm under water actuated by TCAMs".
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Literal

import equinox as eqx

from .quantity import (
    ANY,
    NOT_NEGATIVE,
    POSITIVE,
    POSITIVE_OR_INFINITE,
    Interval,
    Scalar,
    choice,
    function,
    quantity,
    vector,
)
from .tcam import TCAM
from .validate import validate


class SectionStiffness(eqx.Module):
    """Stiffnesses of the section given directly, constant along the rod: EA [N], GA [N], EI [N m^2].

    For the classic benchmark rods. An infinite axial or shear stiffness is an inextensible or unshearable rod. The
    weight of such a rod is that of its undeformed length.
    """

    axial: Scalar = quantity("N", POSITIVE_OR_INFINITE)
    shear: Scalar = quantity("N", POSITIVE_OR_INFINITE)
    bending: Scalar = quantity("N*m^2", POSITIVE)


class Arm(eqx.Module):
    """A straight arm of circular section with a linear taper, R(s) = base_radius + (tip_radius - base_radius) s / L.

    - `length` [m], `base_radius` [m], `tip_radius` [m], `density` [kg/m^3] of the undeformed arm.
    - `youngs_modulus` E [Pa] and `poisson_ratio` nu_p, with G = E / (2 (1 + nu_p)).
    - `stiffness_factor` c multiplies the section law: 1 is linear elasticity; 2 is the paper's printed law,
      N = 2 E (nu - 1).
    - `base_angle` [rad]: direction in which the base is clamped, from e1.
    - `cross_section`: "volume-preserving" lets the section stretch in its plane by beta so that the local volume is
      kept; "rigid" is the standard Cosserat rod, beta = 1.
    - `ventral`: the side, +1 (along b) or -1, of the surface that the water meets and on which volume is kept.
    - `stiffness`: a `SectionStiffness` in place of `youngs_modulus` and `poisson_ratio`; the section is then rigid.
    - `section_law`: an `AbstractSectionLaw` of your own in place of the two, such as a `StrainEnergy`.
    """

    length: Scalar = quantity("m", POSITIVE)
    base_radius: Scalar = quantity("m", POSITIVE)
    tip_radius: Scalar = quantity("m", POSITIVE)
    density: Scalar = quantity("kg/m^3", POSITIVE)
    youngs_modulus: Scalar | None = quantity("Pa", POSITIVE, default=None)
    poisson_ratio: Scalar | None = quantity("1", Interval(0.0, 0.5), default=None)
    stiffness_factor: Scalar = quantity("1", POSITIVE, default=1.0)
    base_angle: Scalar = quantity("rad", ANY, default=0.0)
    cross_section: Literal["volume-preserving", "rigid"] = choice(
        "volume-preserving", "rigid", default="volume-preserving"
    )
    ventral: Literal[1, -1] = choice(1, -1, default=1)
    stiffness: SectionStiffness | None = None
    section_law: Any = function(default=None)


_OTHER_SIDE = "a muscle on the other side of the arm has side = -1"


class Muscle(eqx.Module):
    """A muscle from the base to s = `end`, at the signed offset y(s) = side (a + (b - a) s / end) from the centerline.

    - `base_offset` a [m], `end_offset` b [m], `end` [m] (None: the arm's length).
    - `tension` T [N]; or `displacement` [m], the tendon displacement by which it is wound in at the base, its
      tension T >= 0 then found; or `tcam`, a `TCAM` whose voltage makes the tension: see `actuate`. Exactly one of
      the three.
    - `tangent`: "unnormalized" pulls with T t_c as the paper does, t_c = d r_c / ds not normalised; "unit" with
      T t_c / |t_c|, the frictionless tendon of the tendon-robot literature. A unit muscle may run outside the arm.

    The path of a muscle is shorter than on the straight unloaded arm by int_0^end (sqrt(1 + y_s^2) - |t_c|) ds, t_c not
    normalised, whatever `tangent` is. That is the given tendon displacement, if negative one paid out; or more
    than it, for a tendon cannot push: then it is slack, T = 0. The displacement is raised in proportion, as all loads
    are.
    """

    base_offset: Scalar = quantity("m", NOT_NEGATIVE, _OTHER_SIDE)
    end_offset: Scalar = quantity("m", NOT_NEGATIVE, _OTHER_SIDE)
    tension: Scalar | None = quantity("N", NOT_NEGATIVE, default=None)
    end: Scalar | None = quantity("m", POSITIVE, default=None)
    side: Literal[1, -1] = choice(1, -1, default=1)
    tangent: Literal["unnormalized", "unit"] = choice("unnormalized", "unit", default="unnormalized")
    tcam: TCAM | None = None
    displacement: Scalar | None = quantity("m", ANY, default=None)


class Water(eqx.Module):
    """Steady water, flowing along e1 with speed velocity + velocity_gradient * (height over the base).

    - `velocity` [m/s] (negative: toward the base). `density` [kg/m^3] and `viscosity` [Pa s], by default of fresh water
      at 20 degC; `boundary_layer` h_inf [m].
    - `inlet_fraction`: tangential speed at the inlet of the control volume as a fraction of the free stream's.
      The paper does not say where the inlet is; 1 is the free stream, 0.19 its printed profile at h_inf / 10.
    - `velocity_gradient` [1/s]: None is a uniform current, whose program needs one shooting unknown, not three.
    """

    velocity: Scalar = quantity("m/s")
    density: Scalar = quantity("kg/m^3", POSITIVE, default=998.2)
    viscosity: Scalar = quantity("Pa*s", NOT_NEGATIVE, default=1.002e-3)
    boundary_layer: Scalar = quantity("m", POSITIVE, default=0.02)
    inlet_fraction: Scalar = quantity("1", Interval(0.0, 1.0), default=1.0)
    velocity_gradient: Scalar | None = quantity("1/s", default=None)


class Gravity(eqx.Module):
    """Weight, and in water buoyancy: `acceleration` [m/s^2] along -e2; a negative one pulls up."""

    acceleration: Scalar = quantity("m/s^2", default=9.81)


class Tip(eqx.Module):
    """A force [N] and a moment [N m] on the tip.

    `follower` False: `force` holds the components along e1 and e2 (a dead load). True: along the directors a(L), b(L)
    of the tip's section, so the force turns with it.
    """

    force: tuple[Scalar, Scalar] = vector("N", 2, default=(0.0, 0.0))
    moment: Scalar = quantity("N*m", default=0.0)
    follower: bool = choice(False, True, default=False)


class Notes:
    """What a scene file says beside the scene: its title, and the ranges of its sweep as they were written.

    All notes are equal, so that a program compiled for one scene serves another of another title.
    """

    def __init__(self, title: str = "", sweep: Mapping[str, Any] = MappingProxyType({})) -> None:
        self.title, self.sweep = title, sweep

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Notes)

    def __hash__(self) -> int:
        return hash(Notes)

    def __repr__(self) -> str:
        return f"Notes({self.title!r})"


class Scene(eqx.Module):
    """An arm, its muscles, and the loads on it. Raises `InputError` where a value that can be looked at is not allowed.

    `water` None is an arm in air, `gravity` None a weightless one, `tip` None a free tip. `loads` are distributed loads
    of your own, each an `AbstractLoad`. `notes` are the title and the sweep of a file, which are kept with the scene.
    """

    arm: Arm
    muscles: tuple[Muscle, ...] = ()
    water: Water | None = None
    gravity: Gravity | None = None
    tip: Tip | None = None
    loads: tuple[Any, ...] = function(default=())
    notes: Notes = eqx.field(static=True, default=Notes())

    def __check_init__(self) -> None:
        validate(self)
