"""Muscles as tendons: where each runs at a cross-section and how it pulls there."""

from collections.abc import Iterable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..scene import Arm, Muscle
from ..scene.quantity import Scalar


class Pull(eqx.Module):
    """One muscle at one cross-section: tension T [N], signed offset y [m], slope y_s, and whether t_c is normalised."""

    tension: Scalar
    offset: Scalar
    slope: Scalar
    unit: bool = eqx.field(static=True)


def pull_at(muscle: Muscle, arm: Arm, s: Scalar, active_to: Scalar, load_fraction: Scalar) -> Pull:
    """The pull of `muscle` at `s`, in the stretch of the arm that reaches to `active_to`.

    y(s) = side (a + (b - a) s / L_i); the tension is zero past the muscle's end L_i. Source: paper, Eq. TCAMsDistance.
    """
    end = arm.length if muscle.end is None else muscle.end
    slope = muscle.side * (muscle.end_offset - muscle.base_offset) / end
    given: Any = muscle.tension  # None only in scenes that `actuate` takes, which gives it
    tension = load_fraction * given
    if muscle.end is not None:
        tension = jnp.where(muscle.end >= active_to, tension, 0.0)
    return Pull(tension, muscle.side * muscle.base_offset + slope * s, slope, muscle.tangent == "unit")


def segment_ends(muscles: Iterable[Muscle], arm: Arm) -> Float[Array, " segments+1"]:
    """The arc lengths, from the tip to the base, between which no muscle ends: L, every given end L_i, 0.

    A muscle without an `end` of its own runs to the tip and cuts nothing; its program has one segment.
    """
    ends = [jnp.asarray(muscle.end, float) for muscle in muscles if muscle.end is not None]
    inner = [jnp.sort(jnp.stack(ends), descending=True)] if ends else []
    return jnp.concatenate([jnp.asarray([arm.length], float), *inner, jnp.zeros(1)])
