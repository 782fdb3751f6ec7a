"""Follows the equilibrium as all loads are raised in proportion, from the unloaded arm to the full load.

The pose at the next load is predicted from the last equilibrium and corrected by Newton, the full load first. A pose
counts only if Newton contracts fast and ends near its prediction, for that is what ties it to the branch it came from;
otherwise the load step is cut. So an arm of moderate response is solved at once, and one that might be lured to another
branch is led along its own. One loop does all of it, one integration with its Jacobian a pass, and rods of a batch in
different states run side by side.
"""

import abc
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from ..physics.implicit import batched_with, solve_linear
from .integrate import Progress
from .method import Shooting
from .outcome import Outcome

_MOST_STEPS = 8  # of Newton at one load
_EASY_STEPS = 4  # of Newton, up to which the next load step is longer
_CUT, _GROWTH = 0.5, 2.0  # of the load step, after a failure and a success
_TINY_LOAD = 1e-9  # fraction of the load that counts as none
# What ties a pose to the branch it came from, in radians and lengths:
_TRUST = 0.5  # Newton's steps from a prediction together move the pose by at most this,
_CONTRACTION = 0.5  # and each by at most this times the one before;
_LOSS = 0.6  # a load step may be predicted to take at most this part of the determinant, which is zero at a limit point

Pose = Any  # a pytree: what Newton's unknowns are is the formulation's affair


class Attempt(NamedTuple):
    """One integration at one load from one pose: Newton's next pose, and how good the given one was.

    - `pose`, `step`: the next pose, and the largest change of an angle [rad] or place [lengths] to it.
    - `error`: of the given pose, in the same units.
    - `rate`: d(pose)/d(load) at equilibrium, or None where the formulation takes the secant.
    - `jacobian`: of the last equation solved, that of the clamp; its determinant is positive along the branch.
    - `progress` of the integration.
    """

    pose: Pose
    step: Float[Array, ""]
    error: Float[Array, ""]
    rate: Pose | None
    jacobian: Float[Array, "unknowns unknowns"]
    progress: Progress


class Formulation(eqx.Module):
    """What Newton solves at one load: single or multiple shooting."""

    @property
    @abc.abstractmethod
    def unknowns(self) -> int:
        """Of the equation that clamps the base."""

    @property
    @abc.abstractmethod
    def first_load(self) -> float:
        """Fraction of the load at which Newton's first step is taken, as it is, for the linear response."""

    @property
    @abc.abstractmethod
    def first_step(self) -> float:
        """The longest load step to begin with."""

    @property
    @abc.abstractmethod
    def reach(self) -> float:
        """A prediction moves the pose by at most this [rad and lengths of the arm]."""

    @abc.abstractmethod
    def rest(self) -> Pose:
        """The pose of the unloaded arm."""

    @abc.abstractmethod
    def attempt(self, load: Float[Array, ""], pose: Pose) -> Attempt:
        """One Newton step at a fraction of the load."""

    @abc.abstractmethod
    def predict(self, pose: Pose, rate: Pose, load: Float[Array, ""], ahead: Float[Array, ""]) -> Pose:
        """The pose at the load `ahead`, from the equilibrium at `load` and its rate."""

    @abc.abstractmethod
    def size(self, change: Pose) -> Float[Array, ""]:
        """The largest change of an angle [rad] or place [lengths of the arm] in a change of the pose."""

    @abc.abstractmethod
    def reason(self, attempt: Attempt, at: Float[Array, "unknowns unknowns"]) -> Outcome:
        """Why the load could not be raised, from the attempt that failed and the Jacobian at the last equilibrium."""


class Found(NamedTuple):
    """The pose at equilibrium, and what came of looking for it.

    `jacobian` is that of the clamp's equation at the last equilibrium, `stopped_at` the arc length [m] at which the
    last integration ended, 0 where it came through.
    """

    pose: Pose
    outcome: Outcome
    load_fraction: Float[Array, ""]
    iterations: Int[Array, ""]
    jacobian: Float[Array, "unknowns unknowns"]
    stopped_at: Float[Array, ""]


class _Walk(NamedTuple):
    """State of the loop. Behind: the last equilibrium, the rate of its pose over the load, and how fast the determinant
    falls. Ahead: the load on trial, Newton's pose there, its last step, the sum and number of its steps."""

    pose: Pose
    load: Array
    rate: Pose
    jacobian: Array
    loss: Array
    load_step: Array
    trial_load: Array
    trial_pose: Pose
    last_step: Array
    drift: Array
    newton_steps: Array
    iterations: Array
    outcome: Outcome
    stopped_at: Array
    running: Array


def follow(formulation: Formulation, allowed: Bool[Array, ""], method: Shooting) -> Found:
    """The pose at full load of the branch that starts at rest, or how far it was followed, without derivatives."""
    start = formulation.rest()
    zero, one, none = jnp.zeros(()), jnp.ones(()), jnp.zeros((), int)
    walk = _Walk(
        pose=start, load=zero, rate=jax.tree.map(jnp.zeros_like, start), jacobian=jnp.eye(formulation.unknowns),
        loss=zero, load_step=formulation.first_step * one, trial_load=formulation.first_load * one,
        trial_pose=start, last_step=jnp.inf * one, drift=zero, newton_steps=none, iterations=none,
        outcome=Outcome.where(allowed, Outcome.converged, Outcome.bad_input), stopped_at=zero, running=allowed,
    )  # fmt: skip
    walk = batched_with(formulation, walk)
    walk = lax.while_loop(lambda walk: walk.running, lambda walk: _pass(formulation, method, walk), walk)
    return Found(walk.pose, walk.outcome, walk.load, walk.iterations, walk.jacobian, walk.stopped_at)


def _pass(formulation: Formulation, method: Shooting, walk: _Walk) -> _Walk:
    """One integration at the trial load, then another Newton step, or on to the next load, or back to a smaller."""
    attempt = formulation.attempt(walk.trial_load, walk.trial_pose)
    drift, newton_steps = walk.drift + attempt.step, walk.newton_steps + 1
    is_first = walk.iterations == 0
    settled = is_first | (jnp.maximum(attempt.step, attempt.error) < method.newton_tol)
    contracts = settled | (attempt.step <= _CONTRACTION * walk.last_step)
    determinant, before = _determinant(attempt.jacobian), _determinant(walk.jacobian)
    healthy = attempt.progress.finished & (determinant > 0) & contracts & (drift <= _TRUST)
    accepted = healthy & settled
    rejected = ~healthy | (~settled & (newton_steps >= _MOST_STEPS))
    turning = accepted | rejected

    def chosen(where: Array, new: Any, old: Any) -> Any:
        return jax.tree.map(lambda a, b: jnp.where(where, a, b), new, old)

    rate = attempt.rate
    if rate is None:
        rate = jax.tree.map(lambda new, old: (new - old) / (walk.trial_load - walk.load), attempt.pose, walk.pose)
    here_pose, here_rate = chosen(accepted, (attempt.pose, rate), (walk.pose, walk.rate))
    here_load = jnp.where(accepted, walk.trial_load, walk.load)
    jacobian = jnp.where(accepted, attempt.jacobian, walk.jacobian)
    easy = accepted & ~is_first & (newton_steps <= _EASY_STEPS)
    load_step = walk.load_step * jnp.where(easy, _GROWTH, jnp.where(rejected, _CUT, 1.0))
    reach = formulation.reach
    load_step = jnp.minimum(load_step, reach / jnp.maximum(formulation.size(here_rate), reach))
    loss = jnp.where(accepted, (before - determinant) / jnp.maximum(walk.trial_load - walk.load, _TINY_LOAD), walk.loss)
    load_step = jnp.minimum(load_step, _LOSS * _determinant(jacobian) / jnp.maximum(loss, _TINY_LOAD))
    next_load = jnp.minimum(here_load + load_step, 1.0)
    prediction = formulation.predict(here_pose, here_rate, here_load, next_load)

    arrived = accepted & (walk.trial_load >= 1)
    stuck = rejected & (load_step < method.min_load_step * jnp.maximum(here_load, _TINY_LOAD))
    exhausted = ~arrived & (walk.iterations + 1 >= method.max_iterations)
    outcome = Outcome.where(exhausted, Outcome.iterations_exhausted, walk.outcome)
    outcome = Outcome.where(stuck, formulation.reason(attempt, jacobian), outcome)
    return _Walk(
        pose=here_pose, load=here_load, rate=here_rate, jacobian=jacobian, loss=loss, load_step=load_step,
        trial_load=jnp.where(turning, next_load, walk.trial_load),
        trial_pose=chosen(turning, prediction, attempt.pose),
        last_step=jnp.where(turning, jnp.inf, attempt.step),
        drift=jnp.where(turning, 0.0, drift),
        newton_steps=jnp.where(turning, 0, newton_steps),
        iterations=walk.iterations + 1,
        outcome=outcome,
        stopped_at=attempt.progress.stopped_at,
        running=~(arrived | stuck | exhausted),
    )  # fmt: skip


def _determinant(matrix: Float[Array, "unknowns unknowns"]) -> Float[Array, ""]:
    return solve_linear(matrix, jnp.zeros(len(matrix)))[1]
