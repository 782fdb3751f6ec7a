"""Muscles as tendons: where each runs at a cross-section, how it pulls there, and how its length follows.

A tendon pulls with T t_c, or with T t_c / |t_c| where its tangent is the unit one,

    t_c = (nu - y beta mu) a + (eta + (y beta)_s) b        y(s) = side (a + (b - a) s / L_i)

(Golestaneh, Cichella & Lamuta, "TCAMs Actuation Model": distance of the muscles and their force). Its path is shorter
than on the straight unloaded arm by

    d = int_0^L_i (sqrt(1 + y_s^2) - |t_c|) ds

(the jumps of beta where other muscles end add nothing to it). Of a given displacement D the tension T is found from

    d >= D,   T >= 0,   and one of the two an equality        or        min((d - D) / h, T / T_1) = 0,

a tendon that is as short as its path or slack, for it cannot push. The lever h and the tension T_1 are units in which
the equation is near the identity on the unloaded arm; they do not act on its root. h^2 = E J / (E A) + y^2, half-way
along the tendon, is the displacement over the angle, in radians, by which it bends the arm; T_1 = E J / (h L_i) bends
it by about one radian.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool

from ..scene import Arm, Muscle
from ..scene.quantity import Scalar
from .loads import DeformedSection

_BRINK = 1e-3  # of a tendon's length, left where the load is given up


class Tendon(eqx.Module):
    """A muscle as the solver sees it: tension [N], signed offset from the centerline, y = offset + slope s [m], its end
    [m] (None: the tip), and where its length is given the displacement [m] by which it is wound in, the tension then
    being found."""

    tension: Scalar
    offset: Scalar
    slope: Scalar
    end: Scalar | None
    displacement: Scalar | None
    unit: bool = eqx.field(static=True)

    @classmethod
    def of(cls, muscle: Muscle, arm: Arm) -> "Tendon":
        """The tendon of a muscle; one without a tension has none yet."""
        end = arm.length if muscle.end is None else muscle.end
        slope = muscle.side * (muscle.end_offset - muscle.base_offset) / end
        tension: Any = 0.0 if muscle.tension is None else muscle.tension
        displacement = muscle.displacement
        return cls(tension, muscle.side * muscle.base_offset, slope, muscle.end, displacement, muscle.tangent == "unit")

    def offset_at(self, s: Any) -> Any:
        """y(s) [m]."""
        return self.offset + self.slope * s


class Pull(eqx.Module):
    """One tendon at one cross-section: tension T [N], signed offset y [m], slope y_s, and whether t_c is normalized."""

    tension: Scalar
    offset: Scalar
    slope: Scalar
    unit: bool = eqx.field(static=True)

    def moved(self, step: Scalar) -> "Pull":
        """The pull a step [m] further along the arm."""
        return Pull(self.tension, self.offset + self.slope * step, self.slope, self.unit)


def pull_at(tendon: Tendon, s: Scalar, is_active: Bool[Array, "..."] | bool) -> Pull:
    """The pull of `tendon` at `s`; zero where it is not active, that is past its end L_i."""
    tension = tendon.tension if tendon.end is None else jnp.where(is_active, tendon.tension, 0.0)
    return Pull(tension, tendon.offset_at(s), tendon.slope, tendon.unit)


def tangent(pull: Pull, nu: Scalar, eta: Scalar, mu: Scalar, beta: Scalar, beta_s: Scalar) -> tuple[Scalar, Scalar]:
    """t_c along a and b."""
    return nu - pull.offset * beta * mu, eta + pull.slope * beta + pull.offset * beta_s


def shortening_rate(pull: Pull, section: DeformedSection) -> Scalar:
    """d/ds of what is left of d from s to the tendon's end: |t_c| - sqrt(1 + y_s^2)."""
    along, across = tangent(pull, section.nu, section.eta, section.mu, section.beta, section.beta_s)
    return jnp.sqrt(along**2 + across**2) - jnp.sqrt(1 + pull.slope**2)


def length_error(
    shortening: Scalar, displacement: Scalar, tension: Scalar, unit_tension: Scalar, lever: Scalar
) -> tuple[Scalar, Bool[Array, "..."]]:
    """min((d - D) / h, T / T_1), zero for a tendon that is taut at its displacement and for a slack one; is it taut?"""
    too_long, pulls = (shortening - displacement) / lever, tension / unit_tension
    is_taut = jnp.asarray(too_long <= pulls)  # where they are equal a derivative is that of the taut side
    return jnp.where(is_taut, too_long, pulls), is_taut


def is_wound_in_whole(tendon: Tendon, arm_length: Scalar) -> Bool[Array, "..."]:
    """Whether a tendon of given displacement would have no length left, or hardly any."""
    length = jnp.sqrt(1 + tendon.slope**2) * (arm_length if tendon.end is None else tendon.end)
    return jnp.asarray(tendon.displacement) > (1 - _BRINK) * length
