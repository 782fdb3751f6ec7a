"""Integrates the rod with diffrax from the tip, where its loads are known, to the base."""

from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from ..physics.muscles import segment_ends
from ..physics.rod import Rod, RodState, derivative, tip_state
from ..physics.section import stiffness_at
from .method import Shooting

_FIRST_STEP = 0.1  # of a segment; choosing it from the equations would compile them twice more


class Shot(NamedTuple):
    """One integration: the states at tip, base and asked points, the steps taken, and whether it came through."""

    tip: RodState
    base: RodState
    saved: RodState | None
    steps: Int[Array, ""]
    finished: Bool[Array, ""]
    folded: Bool[Array, ""]


def shoot(
    rod: Rod,
    tip_pose: Float[Array, " unknowns"],
    method: Shooting,
    points: Float[Array, " points"] | None = None,
) -> Shot:
    """Integrates from the tip at `tip_pose`, (theta,) or (theta, x / L, y / L), to the base.

    Each stretch between muscle ends is mapped to tau in [0, 1] and integrated on its own, so that no step straddles
    the end of a muscle; all stretches share one compiled integration. `points` are arc lengths in ascending order at
    which the state is kept.
    """
    ends = segment_ends(rod.muscles, rod.arm)
    scale = _scales(rod)
    tip = _tip(rod, tip_pose)
    dt0 = _FIRST_STEP if method.steps is None else 1.0 / method.steps
    max_steps = method.max_steps if method.steps is None else method.steps

    def segment(state: RodState, span: tuple[Array, Array]) -> tuple[RodState, tuple]:
        start, end = span

        def slope(tau: Any, scaled: Any, _: Any) -> RodState:
            s = start + (end - start) * tau
            d_ds = derivative(rod, s, jax.tree.map(jnp.multiply, scaled, scale), start)[0]
            return jax.tree.map(lambda d, unit: d * (end - start) / unit, d_ds, scale)

        saveat = diffrax.SaveAt(t1=True)
        if points is not None:
            length = jnp.where(start > end, start - end, 1.0)  # a stretch between equal ends has none
            asked = jnp.clip((start - points[::-1]) / length, 0.0, 1.0)
            saveat = diffrax.SaveAt(subs=[diffrax.SubSaveAt(t1=True), diffrax.SubSaveAt(ts=asked)])
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(slope),
            method.solver,
            t0=0.0,
            t1=1.0,
            dt0=dt0,
            y0=jax.tree.map(jnp.divide, state, scale),
            saveat=saveat,
            stepsize_controller=method.controller,
            adjoint=diffrax.ForwardMode(),  # reverse mode goes through `at_root`, by forward mode
            max_steps=max_steps,
            throw=False,
        )
        ys: Any = solution.ys
        at_end, at_points = (ys, None) if points is None else ys
        at_end = jax.tree.map(lambda y, unit: y[-1] * unit, at_end, scale)
        return at_end, (at_points, solution.stats["num_steps"], solution.result)

    base, (at_points, steps, results) = lax.scan(segment, tip, (ends[:-1], ends[1:]))
    saved = None if points is None else _gather(at_points, ends, points, scale)
    finished = (results == diffrax.RESULTS.successful).all()
    folded = (results == diffrax.RESULTS.dt_min_reached).any() & (not rod.is_rigid)
    return Shot(tip, base, saved, steps.sum(), finished, folded)


def _tip(rod: Rod, tip_pose: Float[Array, " unknowns"]) -> RodState:
    x, y = tip_pose[1:] * rod.arm.length if rod.depends_on_position else jnp.zeros(2)
    return tip_state(rod, x, y, tip_pose[0])


def _scales(rod: Rod) -> RodState:
    """Units in which the state is integrated, so that one tolerance suits a whale's arm and a needle."""
    length = rod.arm.length
    bending = stiffness_at(rod.arm, length, 1.0).bending
    force = bending / length**2
    return lax.stop_gradient(RodState(length, length, 1.0, 1.0, 1.0, force, force, bending / length))


def _gather(at_points: RodState, ends: Array, points: Array, scale: RodState) -> RodState:
    """Of the states saved in every stretch, those of the stretch in which each point lies, the lower at its end."""
    stretch = jnp.sum(points[:, None] <= ends[None, 1:-1], axis=1)
    return jax.tree.map(lambda y, unit: y[:, ::-1][stretch, jnp.arange(len(points))] * unit, at_points, scale)
