"""Muscles as tendons: where each runs at a cross-section and how it pulls there."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..scene import Arm, Muscle
from ..scene.quantity import Scalar


class Pull(eqx.Module):
    """One muscle at one cross-section: tension T [N], signed offset y [m], slope y_s, and whether t_c is normalised."""

    tension: Scalar
    offset: Scalar
    slope: Scalar
    unit: bool = eqx.field(static=True)


def pull_at(muscle: Muscle, arm: Arm, s: Scalar, is_active: Bool[Array, ""] | bool, tension: Scalar) -> Pull:
    """The pull of `muscle` at `s` at this tension; zero where the muscle is not active, that is past its end L_i.

    y(s) = side (a + (b - a) s / L_i). Source: paper, Eq. TCAMsDistance.
    """
    end = arm.length if muscle.end is None else muscle.end
    slope = muscle.side * (muscle.end_offset - muscle.base_offset) / end
    if muscle.end is not None:
        tension = jnp.where(is_active, tension, 0.0)
    return Pull(tension, muscle.side * muscle.base_offset + slope * s, slope, muscle.tangent == "unit")


def active_at(muscles: Sequence[Muscle], s: Scalar) -> Bool[Array, " muscles"]:
    """Which muscles reach to `s`."""
    reach = [jnp.asarray(True) if muscle.end is None else jnp.asarray(muscle.end >= s) for muscle in muscles]
    return jnp.stack(reach) if reach else jnp.zeros(0, bool)


def active_stretches(
    muscles: Sequence[Muscle], arm: Arm, cuts: Float[Array, " cuts"] | None = None
) -> tuple[Float[Array, " stretches+1"], Bool[Array, "stretches muscles"]]:
    """The arc lengths, from the tip to the base, between which no muscle ends, and which muscles are active there.

    They are L, every given end L_i, any further `cuts` [m], and 0. A muscle without an `end` of its own runs to the tip
    and cuts nothing. Of two muscles that end at the same place each comes in at its own end, in the stretch of no
    length between them too: so the derivative by the end of one is right.
    """
    length = jnp.asarray([arm.length], float)
    ends = [jnp.asarray(muscle.end, float)[None] for muscle in muscles if muscle.end is not None]
    places = jnp.concatenate([length, *ends, *([] if cuts is None else [cuts]), jnp.zeros(1)])
    order = jnp.argsort(places, descending=True, stable=True)
    rank = iter(jnp.argsort(order)[1:])  # of the ends, in their turn
    passed = jnp.arange(places.size - 1)
    active = [jnp.full(passed.shape, True) if muscle.end is None else next(rank) <= passed for muscle in muscles]
    return places[order], jnp.stack(active, axis=1) if active else jnp.zeros((passed.size, 0), bool)
