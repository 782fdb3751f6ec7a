"""Finds the pose of the tip for which the base comes out clamped, following the equilibrium as the loads are raised.

The residual r(u; lambda) of the tip's pose u = (theta,) or (theta, x / L, y / L) is the error of the base's pose when
all loads are lambda times their own. At lambda = 0 the arm is straight and u is known. Newton is tried at the full
load first; the result counts only if its steps contract fast and end near the linear prediction, which is what ties it
to the branch it started from. Otherwise the load step is cut and the branch is followed with a secant predictor. A rod
for which plain Newton is safe pays nothing for that. One loop does all of it, one integration with its Jacobian a pass,
so that rods of a batch in different states run side by side.
"""

from typing import NamedTuple

import diffrax
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from ..physics.implicit import differentiable_root, solve_linear, value_and_jacobian
from ..physics.rod import Rod
from ..scene import Scene
from ..scene.validate import is_allowed
from .integrate import shoot
from .method import Shooting
from .outcome import Outcome

_CONTRACTION = 0.4  # a Newton step must be at most this times the one before it
_TRUST = 0.5  # radians or lengths by which all steps after the first may move the tip
_CUT, _GROWTH = 0.25, 2.0  # of the load step, after a failure and a success
_MOST_STEPS = 8  # of Newton at one load


class Found(NamedTuple):
    """The tip's pose, and what came of looking for it."""

    tip_pose: Float[Array, " unknowns"]
    outcome: Outcome
    load_fraction: Float[Array, ""]
    iterations: Int[Array, ""]


class _Walk(NamedTuple):
    """State of the loop: two equilibria behind, the load being tried, Newton's iteration there, and the tally."""

    pose: Array
    load: Array
    pose_before: Array
    load_before: Array
    trial_load: Array
    trial_pose: Array
    step_size: Array
    drift: Array
    newton_steps: Array
    load_step: Array
    iterations: Array
    outcome: Outcome
    running: Array


def find_tip_pose(scene: Scene, method: Shooting) -> Found:
    """The tip's pose at equilibrium, with the derivatives of the implicit function theorem; see the module."""
    found = _follow(lax.stop_gradient(scene), method)

    def residual(tip_pose: Array, scene: Scene) -> Array:
        return base_error(scene, 1.0, tip_pose, method, diffrax.DirectAdjoint())[0]

    return found._replace(tip_pose=differentiable_root(residual, found.tip_pose, scene))


def base_error(
    scene: Scene, load_fraction: Array | float, tip_pose: Array, method: Shooting, adjoint: diffrax.AbstractAdjoint
) -> tuple[Float[Array, " unknowns"], tuple]:
    """Error of the base's pose: its angle [rad] and, with three unknowns, its place in lengths of the arm."""
    rod = Rod.of(scene, load_fraction)
    shot = shoot(rod, tip_pose, method, adjoint)
    error = [shot.base.theta - scene.arm.base_angle]
    if rod.depends_on_position:
        error += [shot.base.x / scene.arm.length, shot.base.y / scene.arm.length]
    return jnp.stack(error), (shot.finished, shot.folded)


def straight_pose(scene: Scene) -> Float[Array, " unknowns"]:
    """The tip's pose of the unloaded arm."""
    angle = jnp.asarray(scene.arm.base_angle, float)
    pose = [angle, jnp.cos(angle), jnp.sin(angle)]
    return jnp.stack(pose if Rod.of(scene).depends_on_position else pose[:1])


def _follow(scene: Scene, method: Shooting) -> Found:
    start = straight_pose(scene)
    allowed = is_allowed(scene)
    zero, one = jnp.zeros(()), jnp.ones(())
    walk = _Walk(
        pose=start, load=zero, pose_before=start, load_before=-one, trial_load=one, trial_pose=start,
        step_size=jnp.inf * one, drift=zero, newton_steps=jnp.zeros((), int), load_step=one,
        iterations=jnp.zeros((), int), outcome=Outcome.where(allowed, Outcome.converged, Outcome.bad_input),
        running=allowed,
    )  # fmt: skip
    walk = lax.while_loop(lambda w: w.running, lambda w: _pass(scene, method, w), walk)
    return Found(walk.pose, walk.outcome, walk.load, walk.iterations)


def _pass(scene: Scene, method: Shooting, walk: _Walk) -> _Walk:
    """One integration at the trial load, then: another Newton step, or the load accepted, or the load step cut."""
    # Newton
    def error_of(pose: Array) -> tuple[Array, tuple]:
        return base_error(scene, walk.trial_load, pose, method, diffrax.ForwardMode())

    (error, (finished, folded)), jacobian = value_and_jacobian(error_of, walk.trial_pose, has_aux=True)
    step, determinant = solve_linear(jacobian, -error)
    pose, size = walk.trial_pose + step, jnp.max(jnp.abs(step))
    is_first = walk.newton_steps == 0
    drift = walk.drift + jnp.where(is_first, 0.0, size)
    settled = size < method.newton_tol
    contracts = is_first | settled | (size <= _CONTRACTION * walk.step_size)
    healthy = finished & jnp.isfinite(size) & (determinant > 0) & contracts & (drift < _TRUST)
    accepted = healthy & settled
    rejected = ~healthy | (~settled & (walk.newton_steps + 1 >= _MOST_STEPS))

    # the load
    arrived = accepted & (walk.trial_load >= 1)
    load_step = jnp.where(accepted, _GROWTH * walk.load_step, jnp.where(rejected, _CUT * walk.load_step, walk.load_step))
    stuck = rejected & (load_step < method.min_load_step)
    iterations = walk.iterations + 1
    exhausted = iterations >= method.max_iterations

    behind = jax.tree.map(
        lambda new, old: jnp.where(accepted, new, old),
        (pose, walk.trial_load, walk.pose, walk.load),
        (walk.pose, walk.load, walk.pose_before, walk.load_before),
    )
    now_pose, now_load, before_pose, before_load = behind
    next_load = jnp.minimum(now_load + load_step, 1.0)
    ahead = (next_load - now_load) / (now_load - before_load)
    predicted = now_pose + ahead * (now_pose - before_pose)

    turning = accepted | rejected
    failure = Outcome.where(
        folded, Outcome.volume_constraint_folded, Outcome.where(finished, Outcome.limit_point, Outcome.integration_failed)
    )
    outcome = Outcome.where(stuck, failure, Outcome.where(exhausted & ~arrived, Outcome.iterations_exhausted, walk.outcome))
    return _Walk(
        pose=now_pose, load=now_load, pose_before=before_pose, load_before=before_load,
        trial_load=jnp.where(turning, next_load, walk.trial_load),
        trial_pose=jnp.where(turning, predicted, pose),
        step_size=jnp.where(turning, jnp.inf, size),
        drift=jnp.where(turning, 0.0, drift),
        newton_steps=jnp.where(turning, 0, walk.newton_steps + 1),
        load_step=load_step, iterations=iterations, outcome=outcome,
        running=~(arrived | stuck | exhausted),
    )  # fmt: skip
