"""Segments of the arm, between the ends of its tendons: in each the same tendons are active."""

from collections.abc import Sequence

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..scene.quantity import Scalar
from .tendon import Tendon


def active_at(tendons: Sequence[Tendon], s: Scalar) -> tuple[Bool[Array, "..."], ...]:
    """Which tendons reach to `s`."""
    return tuple(jnp.asarray(True) if tendon.end is None else jnp.asarray(tendon.end >= s) for tendon in tendons)


def segments_of(
    tendons: Sequence[Tendon], length: Scalar, cuts: Float[Array, " cuts"] | None = None
) -> tuple[Float[Array, "segments+1 ..."], tuple[Bool[Array, "segments ..."], ...]]:
    """The arc lengths, from the tip to the base, between which no tendon ends, and for each tendon where it is active.

    They are L, every given end L_i, any further `cuts` [m], and 0. A tendon without an `end` of its own runs to the tip
    and cuts nothing. Of two tendons that end at the same place each comes in at its own end, in the segment of no
    length between them too: so the derivative by the end of one is right.
    """
    ends = [tendon.end for tendon in tendons if tendon.end is not None]
    given = jnp.broadcast_arrays(jnp.asarray(length, float), *(jnp.asarray(end, float) for end in ends))
    places = jnp.stack(given)
    if cuts is not None:
        places = jnp.concatenate([places, cuts])
    places = jnp.concatenate([places, jnp.zeros_like(places[:1])])
    if len(places) == 2:
        return places, tuple(jnp.ones(1, bool) for _ in tendons)
    order = jnp.argsort(places, axis=0, descending=True, stable=True)
    rank = iter(jnp.argsort(order, axis=0)[1:])  # of the ends, in their turn
    passed = jnp.arange(len(places) - 1).reshape(-1, *(1,) * (places.ndim - 1))
    active = tuple(
        jnp.ones(len(passed), bool) if tendon.end is None else next(rank)[None] <= passed for tendon in tendons
    )
    return jnp.take_along_axis(places, order, axis=0), active
