"""Follows the equilibrium as all loads are raised in proportion, from the unloaded arm to the full load.

The unknowns at the next load are predicted from the last equilibrium and corrected by Newton, the full load first. A
corrected point counts only if Newton contracts fast and ends near the prediction, for that is what ties it to the
branch it came from; otherwise the load step is cut. So an arm of moderate response is solved at once, and one that
might be lured to another branch is led along its own. Rods of a batch in different states advance side by side.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..numerics.linear_systems import determinant
from .outcome import Outcome, code_of

_MOST_CORRECTIONS = 8  # of Newton at one load
_EASY_CORRECTIONS = 4  # of Newton, up to which the next load step is longer
_CUT, _GROWTH = 0.5, 2.0  # of the load step, after a failure and a success
_TINY_LOAD = 1e-9  # fraction of the load that counts as none
# What ties a point to the branch it came from, in radians and lengths:
_DRIFT = 0.5  # Newton's steps from a prediction together move the pose by at most this,
_CONTRACTION = 0.5  # and each by at most this times the one before;
_IN_SIGHT = 1e-2  # part of the load reached within which the determinant must vanish for a limit point to be claimed
_DETERMINANT_LOSS = 0.6  # a load step may be predicted to take at most this part of the determinant, 0 at a limit point

Unknowns = Any  # a pytree of arrays [..., batch]: what Newton solves for is the formulation's affair


class Stepping(NamedTuple):
    """How a formulation steps: the load at which Newton's first step is taken, as it is, for the linear response; the
    longest load step to begin with; the most [rad, lengths] by which a prediction moves the pose; the size of a step at
    which Newton stops; the most corrections over all load steps; the part of the load reached below which a load step
    is given up."""

    first_load: float
    first_step: float
    reach: float
    newton_tol: Any
    max_iterations: Any
    min_load_step: Any


class Correction(NamedTuple):
    """One Newton step at one load.

    - `unknowns`, `step`: the next ones, and the largest change of an angle [rad] or place [lengths] to them.
    - `error`: of the given ones, in the same units.
    - `rate`: d(unknowns)/d(load) at equilibrium, or None where the formulation takes the secant.
    - `jacobian`: of the equation that clamps the base; its determinant is positive along the branch.
    - `usable`: whether the integration came through.
    - `reason`: why the load cannot be raised, should this be the last attempt.
    """

    unknowns: Unknowns
    step: Float[Array, "..."]
    error: Float[Array, "..."]
    rate: Unknowns | None
    jacobian: Float[Array, "n n ..."]
    usable: Bool[Array, "..."]


class Branch(NamedTuple):
    """Where the following of a branch stands. Behind: the last equilibrium, the rate of its unknowns over the load, and
    how fast the determinant falls. Ahead: the load on trial, the unknowns there, Newton's last step, the sum and number
    of its steps. Where it ended, the trial is the attempt that failed."""

    unknowns: Unknowns
    load: Array
    rate: Unknowns
    jacobian: Array
    loss: Array
    load_step: Array
    trial_load: Array
    trial: Unknowns
    last_step: Array
    drift: Array
    corrections: Array
    iterations: Array
    outcome: Any
    running: Array


def begin(rest: Unknowns, jacobian: Array, allowed: Bool[Array, "..."], stepping: Stepping) -> Branch:
    """At the unloaded arm, before the first correction."""
    zero = jnp.zeros(allowed.shape)
    none = jnp.zeros(allowed.shape, int)
    return Branch(
        unknowns=rest, load=zero, rate=jax.tree.map(jnp.zeros_like, rest), jacobian=jacobian, loss=zero,
        load_step=zero + stepping.first_step, trial_load=zero + stepping.first_load, trial=rest,
        last_step=zero + jnp.inf, drift=zero, corrections=none, iterations=none,
        outcome=jnp.where(allowed, code_of(Outcome.converged), code_of(Outcome.bad_input)), running=allowed,
    )  # fmt: skip


def advance(branch: Branch, correction: Correction, stepping: Stepping, predict: Any, size: Any, reason: Any) -> Branch:
    """After a correction at the trial load: another, or on to the next load, or back to a smaller.

    `predict(unknowns, rate, load, ahead)` gives the unknowns at the load `ahead`, `size` the largest change of an angle
    [rad] or place [lengths] in a change of the unknowns, and `reason(usable, jacobian)` the outcome where the load
    cannot be raised, the Jacobian being that of the last equilibrium.
    """
    drift, corrections = branch.drift + correction.step, branch.corrections + 1
    is_first = branch.iterations == 0
    settled = is_first | (jnp.maximum(correction.step, correction.error) < stepping.newton_tol)
    contracts = settled | (correction.step <= _CONTRACTION * branch.last_step)
    now, before = determinant(correction.jacobian), determinant(branch.jacobian)
    healthy = correction.usable & (now > 0) & contracts & (drift <= _DRIFT)
    accepted = healthy & settled
    rejected = ~healthy | (~settled & (corrections >= _MOST_CORRECTIONS))
    turning = accepted | rejected

    def chosen(where: Array, new: Any, old: Any) -> Any:
        return jax.tree.map(lambda a, b: jnp.where(where, a, b), new, old)

    rate = correction.rate
    if rate is None:
        ahead = branch.trial_load - branch.load
        rate = jax.tree.map(lambda new, old: (new - old) / ahead, correction.unknowns, branch.unknowns)
    here, here_rate = chosen(accepted, (correction.unknowns, rate), (branch.unknowns, branch.rate))
    here_load = jnp.where(accepted, branch.trial_load, branch.load)
    jacobian = jnp.where(accepted, correction.jacobian, branch.jacobian)
    easy = accepted & ~is_first & (corrections <= _EASY_CORRECTIONS)
    load_step = branch.load_step * jnp.where(easy, _GROWTH, jnp.where(rejected, _CUT, 1.0))
    load_step = jnp.minimum(load_step, stepping.reach / jnp.maximum(size(here_rate), stepping.reach))
    fallen = (before - now) / jnp.maximum(branch.trial_load - branch.load, _TINY_LOAD)
    loss = jnp.where(accepted, fallen, branch.loss)
    load_step = jnp.minimum(load_step, _DETERMINANT_LOSS * determinant(jacobian) / jnp.maximum(loss, _TINY_LOAD))
    next_load = jnp.minimum(here_load + load_step, 1.0)
    prediction = predict(here, here_rate, here_load, next_load)

    arrived = accepted & (branch.trial_load >= 1)
    stuck = rejected & (load_step < stepping.min_load_step * jnp.maximum(here_load, _TINY_LOAD))
    exhausted = ~arrived & (branch.iterations + 1 >= stepping.max_iterations)
    outcome = jnp.where(exhausted, code_of(Outcome.iterations_exhausted), branch.outcome)
    why = reason(correction.usable, jacobian)
    is_false = (why == code_of(Outcome.limit_point)) & (determinant(jacobian) > _IN_SIGHT * here_load * loss)
    outcome = jnp.where(stuck, jnp.where(is_false, code_of(Outcome.not_followed), why), outcome)
    onward = ~(arrived | stuck | exhausted)
    new = Branch(
        unknowns=here, load=here_load, rate=here_rate, jacobian=jacobian, loss=loss, load_step=load_step,
        trial_load=jnp.where(turning & onward, next_load, branch.trial_load),
        trial=chosen(turning & onward, prediction, chosen(onward, correction.unknowns, branch.trial)),
        last_step=jnp.where(turning, jnp.inf, correction.step),
        drift=jnp.where(turning, 0.0, drift),
        corrections=jnp.where(turning, 0, corrections),
        iterations=branch.iterations + 1,
        outcome=outcome,
        running=onward,
    )  # fmt: skip
    return chosen(branch.running, new, branch)
