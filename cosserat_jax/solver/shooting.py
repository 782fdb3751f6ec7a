"""Finds the pose of the tip for which the base comes out clamped, following the equilibrium as the loads are raised.

The residual r(u; lambda) of the tip's pose u = (theta,) or (theta, x / L, y / L) is the error of the base's pose when
all loads are lambda times their own. At lambda = 0 the arm is straight and u is known; a probe at a small lambda gives
its linear response. From there on the pose at the next load is predicted along the last secant and corrected by
Newton with the exact Jacobian, the full load first. A pose counts only if Newton contracts fast and ends near its
prediction, for that is what ties it to the branch it came from; otherwise the load step is cut. So an arm of moderate
response is solved at once, and one that might be lured to another branch is led along its own. One loop does all of
it, one integration with its Jacobian a pass, and rods of a batch in different states run side by side.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from ..physics.implicit import solve_linear, value_and_jacobian
from ..physics.rod import Rod
from ..scene import Scene
from ..scene.validate import is_allowed
from .integrate import Shot, shoot
from .method import Shooting
from .outcome import Outcome

_PROBE = 1e-4  # load fraction at which the linear response is taken
_MOST_STEPS = 8  # of Newton at one load
_CUT, _GROWTH = 0.5, 2.0  # of the load step, after a failure and a success
_ILL_CONDITIONED = 1e8  # amplification from tip to base past which double precision cannot place the tip
# What ties a pose to the branch it came from, in radians and lengths:
_REACH = 2.0  # a prediction moves the tip's pose by at most this,
_TRUST = 0.5  # Newton's steps from it together by at most this,
_CONTRACTION = 0.5  # and each by at most this times the one before


class Found(NamedTuple):
    """The tip's pose, and what came of looking for it."""

    tip_pose: Float[Array, " unknowns"]
    outcome: Outcome
    load_fraction: Float[Array, ""]
    iterations: Int[Array, ""]


class _Walk(NamedTuple):
    """State of the loop. Behind: the last equilibrium, and the slope of the pose over the load to it. Ahead: the load
    on trial, Newton's pose there, its last step, the sum and number of its steps."""

    pose: Array
    load: Array
    slope: Array
    load_step: Array
    trial_load: Array
    trial_pose: Array
    last_step: Array
    drift: Array
    newton_steps: Array
    iterations: Array
    outcome: Outcome
    running: Array


def find_tip_pose(scene: Scene, method: Shooting) -> Found:
    """The tip's pose at equilibrium, without derivatives; see the module."""
    scene = lax.stop_gradient(scene)
    start = _straight_pose(scene)
    allowed = is_allowed(scene)
    zero, one, none = jnp.zeros(()), jnp.ones(()), jnp.zeros((), int)
    walk = _Walk(
        pose=start, load=zero, slope=jnp.zeros_like(start), load_step=one,
        trial_load=_PROBE * one, trial_pose=start, last_step=jnp.inf * one, drift=zero, newton_steps=none,
        iterations=none, outcome=Outcome.where(allowed, Outcome.converged, Outcome.bad_input), running=allowed,
    )  # fmt: skip
    walk = lax.while_loop(lambda walk: walk.running, lambda walk: _pass(scene, method, walk), walk)
    return Found(walk.pose, walk.outcome, walk.load, walk.iterations)


def base_error(rod: Rod, shot: Shot) -> Float[Array, " unknowns"]:
    """Error of the base's pose: its angle [rad] and, with three unknowns, its place in lengths of the arm."""
    error = [shot.base.theta - rod.arm.base_angle]
    if rod.depends_on_position:
        error += [shot.base.x / rod.arm.length, shot.base.y / rod.arm.length]
    return jnp.stack(error)


def _straight_pose(scene: Scene) -> Float[Array, " unknowns"]:
    angle = jnp.asarray(scene.arm.base_angle, float)
    pose = [angle, jnp.cos(angle), jnp.sin(angle)]
    return jnp.stack(pose if Rod.of(scene).depends_on_position else pose[:1])


def _pass(scene: Scene, method: Shooting, walk: _Walk) -> _Walk:
    """One integration at the trial load, then another Newton step, or on to the next load, or back to a smaller."""

    def error_of(pose: Array) -> tuple[Array, Shot]:
        rod = Rod.of(scene, walk.trial_load)
        shot = shoot(rod, pose, method)
        return base_error(rod, shot), shot

    (error, shot), jacobian = value_and_jacobian(error_of, walk.trial_pose, has_aux=True)
    newton, determinant = solve_linear(jacobian, -error)
    pose, size = walk.trial_pose + newton, jnp.max(jnp.abs(newton))
    drift, newton_steps = walk.drift + size, walk.newton_steps + 1
    is_probe = walk.load == 0
    settled = is_probe | (jnp.maximum(size, jnp.max(jnp.abs(error))) < method.newton_tol)
    contracts = settled | (size <= _CONTRACTION * walk.last_step)
    healthy = shot.finished & (determinant > 0) & contracts & (drift <= _TRUST)
    accepted = healthy & settled
    rejected = ~healthy | (~settled & (newton_steps >= _MOST_STEPS))
    turning = accepted | rejected

    here_pose = jnp.where(accepted, pose, walk.pose)
    here_load = jnp.where(accepted, walk.trial_load, walk.load)
    slope = jnp.where(accepted, (pose - walk.pose) / (walk.trial_load - walk.load), walk.slope)
    load_step = walk.load_step * jnp.where(accepted & ~is_probe, _GROWTH, jnp.where(rejected, _CUT, 1.0))
    load_step = jnp.minimum(load_step, _REACH / jnp.maximum(jnp.max(jnp.abs(slope)), _REACH))
    next_load = jnp.minimum(here_load + load_step, 1.0)

    arrived = accepted & (walk.trial_load >= 1)
    stuck = rejected & (load_step < method.min_load_step)
    exhausted = ~arrived & (walk.iterations + 1 >= method.max_iterations)
    outcome = Outcome.where(exhausted, Outcome.iterations_exhausted, walk.outcome)
    outcome = Outcome.where(stuck, _reason(shot, determinant), outcome)
    return _Walk(
        pose=here_pose, load=here_load, slope=slope, load_step=load_step,
        trial_load=jnp.where(turning, next_load, walk.trial_load),
        trial_pose=jnp.where(turning, here_pose + (next_load - here_load) * slope, pose),
        last_step=jnp.where(turning, jnp.inf, size),
        drift=jnp.where(turning, 0.0, drift),
        newton_steps=jnp.where(turning, 0, newton_steps),
        iterations=walk.iterations + 1,
        outcome=outcome,
        running=~(arrived | stuck | exhausted),
    )  # fmt: skip


def _reason(shot: Shot, determinant: Array) -> Outcome:
    """Why the load could not be raised further, from the last integration that failed."""
    reason = Outcome.where(jnp.abs(determinant) > _ILL_CONDITIONED, Outcome.ill_conditioned, Outcome.limit_point)
    reason = Outcome.where(shot.finished, reason, Outcome.integration_failed)
    return Outcome.where(shot.folded, Outcome.volume_constraint_folded, reason)
