"""Muscles whose contraction is given, as a tendon wound in at the base: their lengths, and when they are slack.

The path of a muscle is shorter than on the straight unloaded arm by

    d = int_0^L_i (sqrt(1 + y_s^2) - |t_c|) ds        t_c = (nu - y beta mu) a + (eta + (y beta)_s) b

(the jumps of beta where other muscles end add nothing to it). Of a given contraction D the tension T is found from

    d >= D,   T >= 0,   and one of the two an equality        or        min((d - D) / h, T / T_1) = 0,

a tendon that is as short as its path or slack, for it cannot push. The lever h and the tension T_1 are units in which
the equation is near the identity on the unloaded arm; they do not act on its root. h^2 = E J / (E A) + y^2, half-way
along the muscle, is the contraction over the angle, in radians, by which the muscle bends the arm; T_1 = E J / (h L_i)
bends it by about one radian.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool

from ..scene import Arm, Muscle
from ..scene.quantity import Scalar
from .loads import CrossSection
from .muscles import Pull
from .section import stiffness_at


class Units(NamedTuple):
    """In which the equation of a muscle's length is solved: T_1 [N] and the lever h [m]."""

    tension: Scalar
    lever: Scalar


def length_controlled(muscles: Sequence[Muscle]) -> tuple[int, ...]:
    """The numbers of the muscles whose contraction is given and whose tension is unknown."""
    return tuple(i for i, muscle in enumerate(muscles) if muscle.contraction is not None)


def units_of(muscle: Muscle, arm: Arm) -> Units:
    """The units of one muscle, which no derivative goes through."""
    end = arm.length if muscle.end is None else muscle.end
    stiffness = stiffness_at(arm, end / 2)
    offset = (muscle.base_offset + muscle.end_offset) / 2
    lever = jnp.sqrt(stiffness.bending / stiffness.axial + offset**2)
    return lax.stop_gradient(Units(stiffness.bending / (lever * end), lever))


def shortening_rate(pull: Pull, section: CrossSection) -> Scalar:
    """d/ds of what is left of d from s to the muscle's end: |t_c| - sqrt(1 + y_s^2)."""
    along = section.nu - pull.offset * section.beta * section.mu
    across = section.eta + pull.slope * section.beta + pull.offset * section.beta_s
    return jnp.sqrt(along**2 + across**2) - jnp.sqrt(1 + pull.slope**2)


def length_error(
    shortening: Scalar, contraction: Scalar, tension: Scalar, units: Units
) -> tuple[Scalar, Bool[Array, ""]]:
    """min((d - D) / h, T / T_1), zero for a muscle that is taut at its contraction and for a slack one; which it is."""
    too_long, pulls = (shortening - contraction) / units.lever, tension / units.tension
    is_taut = jnp.asarray(too_long <= pulls)  # where they are equal a derivative is that of the taut side
    return jnp.where(is_taut, too_long, pulls), is_taut
