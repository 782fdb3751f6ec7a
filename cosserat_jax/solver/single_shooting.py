"""Single shooting: the unknowns at the tip for which the base comes out clamped, of a whole batch of rods at once.

One loop runs one compiled integration from tip to base, again and again; what a pass is for is data. First the branch
is followed in the load on a coarse grid (see `continuation`): a pass at the unknowns and one for each of them moved a
little, whose differences are Newton's Jacobian. (That of the unloaded arm is known.) Then the equilibrium is polished
on finer grids, with the Jacobian of the coarse one: what changes from one grid to the next shows the error, and the
first grid whose error is small enough is the last. Newton's last correction, of 1e-8 or so, is not integrated again:
the differences on the coarse grid say how it changes the whole arm.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from ..numerics import linear_systems
from ..numerics.runge_kutta import Nodes, Tableau
from ..physics.rod import Rod, RodState, derivative
from ..physics.volume import volume_defect
from ..scene import Scene
from ..scene.validate import is_allowed
from . import continuation
from .continuation import Branch, Correction, Stepping
from .integrate import Trajectory, shoot
from .outcome import Outcome, code_of
from .unknowns import Unknowns

_PROBE = 1e-4  # fraction of the load at which the linear response of the arm is taken
_PROBE_STEPS = 2  # for it
_REACH = 2.0  # radians and lengths by which a prediction moves the tip at most
_DIFFERENCE = 1e-7  # of an unknown, for the Jacobian
_NEARLY_SINGULAR = 0.3  # determinant of the clamp's equation, 1 for the unloaded arm, 0 at a limit point
_SETTLED = 1e-4  # correction on a finer grid from which on it is as good as the root
_POLISHED = 1e-12, 1e-10  # what is left in the result, a hundredth of the error asked for within these bounds
# Errors fall at least at this order with the number of steps: at the eighth where all is smooth, at the third or fourth
# where a current changes sides along the arm.
_SURE_ORDER = 3
_TINY = 1e-300
_CONTRACTION = 3e3  # of the corrections on a finer grid, over the first of them: at most 2300 was seen on hard scenes
_MOST_POLISHES = 10  # passes on the finer grids
_CONSISTENT = 1e-3  # error of the volume constraint at the base up to which a coarse integration counts


class Settings(NamedTuple):
    """The numbers of `SingleShooting` that a program takes as data: another value is no recompile."""

    coarse_steps: Any
    grids: Any  # how many of `steps` there are
    steps: Any
    error: Any
    newton_tol: Any
    max_iterations: Any
    min_load_step: Any


class Found(NamedTuple):
    """An equilibrium, or how far the branch was followed.

    - `unknowns` at full load; `outcome` of the following; `load_fraction`, `iterations`.
    - `jacobian` of the clamp's equation, of lengths over their compliance. `residual` of that equation.
    - `error`: estimated, of the tip [rad, lengths]. `steps` of the last integration, in each segment.
    - `trajectory`: the last integration; where the branch was lost, of the attempt that failed. `rod` at that load.
    - `change`: how the correction after the last integration changes it.
    """

    unknowns: Float[Array, "unknowns batch"]
    outcome: Any
    load_fraction: Array
    iterations: Array
    jacobian: Array
    residual: Array
    error: Array
    steps: Array
    trajectory: Trajectory
    change: Trajectory
    rod: Rod


class _Loop(NamedTuple):
    """State of the loop. `column` 0 is a pass at the unknowns, j one with unknown j moved. `level` is the number of the
    finer grid, -1 while the branch is followed; `is_last` whether the pass is for the result."""

    branch: Branch
    column: Array
    level: Array
    passes: Array
    is_last: Array
    done: Array
    unknowns: Array
    value: Array  # of the error of the base, and its place [lengths] where that is no unknown
    base: RodState
    columns: Array  # of its Jacobian by finite differences
    jacobian: Array
    taut: Array
    prediction: Array  # of the equilibrium, by the last grid
    estimate: Array
    correction: Array
    contraction: Array  # of the next one over it
    is_same_grid: Array  # as in the pass before
    trajectory: Trajectory
    coarse: Trajectory  # the passes of a round on the coarse grid, one for each column, and room for the others


def find(scene: Scene, settings: Settings, tableau: Tableau, most: int, coarse_room: int, batch: int) -> Found:
    """The equilibria of the scenes, [batch], without derivatives. The program has room for `most` steps, and for
    `coarse_room` on the coarse grid."""
    rod = Rod.of(scene)
    unknowns = Unknowns.of(rod)
    shape, n = (batch,), unknowns.size
    outputs = n + (0 if unknowns.pose == 3 else 2)
    compliance = unknowns.compliance_at_rest(rod, shape)
    stepping = Stepping(
        _PROBE, 1.0, _REACH, settings.newton_tol, settings.max_iterations, settings.min_load_step
    )  # fmt: skip
    levels = jnp.asarray(settings.steps)

    def evaluate(load: Array, u: Array, count: Array, before: Trajectory) -> tuple[Array, Array, Trajectory]:
        """The error of the base with its place, which tendons are taut, and the integration."""
        loaded = unknowns.applied(rod.at_load(load), u)
        trajectory = shoot(loaded, unknowns.tip(loaded, u), tableau, count, before)
        base = trajectory.base
        place = [] if unknowns.pose == 3 else [base.x / rod.length, base.y / rod.length]
        error = unknowns.error(loaded, base)
        value = jnp.concatenate([error, *(jnp.broadcast_to(p, (1, *shape)) for p in place)])
        return value, unknowns.taut(loaded, base.shortenings, shape), trajectory

    def consistent(u: Array, load: Array, base: RodState) -> Array:
        """Whether the integration came through, and kept the volume, short of a fold."""
        finite = jnp.isfinite(base.theta + base.x + base.y)
        if rod.is_rigid:
            return finite
        loaded = unknowns.applied(rod.at_load(load), u)
        active = tuple(jnp.asarray(True) for _ in rod.tendons)
        _, section, margin = derivative(loaded, jnp.zeros(shape), base, active)
        defect = volume_defect(section.nu, section.mu, section.beta, section.surface)
        return finite & (jnp.abs(defect) < _CONSISTENT) & (margin > 0)

    def follow(loop: _Loop, value: Array, base: RodState, taut: Array) -> _Loop:
        """After a pass on the coarse grid; at the end of a round of them the branch advances."""
        is_value = loop.column == 0
        value0 = jnp.where(is_value, value, loop.value)
        slope = (value - value0) / _DIFFERENCE
        columns = jnp.where((jnp.arange(n + 1) == loop.column)[None, :, None], slope[:, None], loop.columns)
        base0 = jax.tree.map(lambda a, b: jnp.where(is_value, a, b), base, loop.base)
        taut0 = jnp.where(is_value, taut, loop.taut)
        branch = loop.branch
        is_probe = (branch.iterations.max() == 0) & knows_rest
        jacobian = jnp.where(is_probe, at_rest, columns[:, 1:])
        matrix = jacobian[:n]
        step = linear_systems.solve(matrix, -value0[:n])
        correction = Correction(
            unknowns=branch.trial + step,
            step=_size(step),
            error=_size(value0[:n]),
            rate=None,
            jacobian=unknowns.over_compliance(matrix, compliance, taut0),
            usable=consistent(branch.trial, branch.trial_load, base0) & jnp.isfinite(jacobian).all((0, 1)),
        )
        advanced = continuation.advance(branch, correction, stepping, _predict, _size, _reason)
        is_round = is_probe | (loop.column == n)
        branch = jax.tree.map(lambda a, b: jnp.where(is_round, a, b), advanced, branch)
        finished = is_round & ~branch.running.any()
        alive = branch.outcome == code_of(Outcome.converged)
        return loop._replace(
            branch=branch,
            column=jnp.where(is_round, 0, loop.column + 1),
            level=jnp.where(finished, 0, loop.level),
            unknowns=jnp.where(alive & finished, branch.unknowns, branch.trial),
            value=value0, base=base0, columns=columns, taut=taut0,
            jacobian=jnp.where(is_round & loop.branch.running, jacobian, loop.jacobian),
        )  # fmt: skip

    def polish(loop: _Loop, value: Array, taut: Array) -> _Loop:
        """After a pass on a finer grid."""
        alive = loop.branch.outcome == code_of(Outcome.converged)
        step = linear_systems.solve(loop.jacobian[:n], -value[:n])
        place = value[n:] + linear_systems.product(loop.jacobian[n:], step)
        root = jnp.concatenate([loop.unknowns + step, place])
        size = jnp.where(alive, _size(step), 0.0)
        is_settled = ~(size > _SETTLED).any() | (loop.passes >= _MOST_POLISHES - 2)
        is_first = loop.level == 0
        counts = is_settled & ~loop.is_last
        finer = levels[loop.level] / levels[jnp.maximum(loop.level - 1, 0)]
        estimate = _size(root - loop.prediction) / (finer**_SURE_ORDER - 1)
        estimate = jnp.where(counts & ~is_first, estimate, loop.estimate)
        accurate = ~is_first & ~(alive & ~(estimate <= settings.error)).any()
        is_final_grid = accurate | (loop.level >= settings.grids - 1)
        # of the next correction over this one, and of what a linear change of the arm leaves: measured on one grid,
        # before that bounded by how far the coarse grid was off
        guessed = jnp.where(loop.passes == 0, jnp.minimum(_CONTRACTION * size, 1.0), loop.contraction)
        measured = jnp.minimum(size / jnp.maximum(_size(loop.correction), _TINY), 1.0)
        contraction = jnp.where(loop.is_same_grid, measured, guessed)
        polished = ~(size * contraction > jnp.clip(1e-2 * settings.error, *_POLISHED)).any() | (
            loop.passes >= _MOST_POLISHES
        )
        is_last = loop.is_last | (is_settled & is_final_grid)
        done = is_last & polished
        return loop._replace(
            level=jnp.where(is_settled & ~loop.is_last & ~is_final_grid, loop.level + 1, loop.level),
            is_last=is_last,
            passes=loop.passes + 1,
            done=done,
            unknowns=jnp.where(alive, loop.unknowns + step, loop.unknowns),
            prediction=jnp.where(counts, root, loop.prediction),
            estimate=estimate,
            correction=jnp.where(alive, step, 0.0),
            contraction=contraction,
            is_same_grid=~is_settled | is_last,
            value=value,
            taut=taut,
        )

    def one_pass(loop: _Loop) -> _Loop:
        is_polish = loop.level >= 0
        alive = loop.branch.outcome == code_of(Outcome.converged)
        load = jnp.where(is_polish & alive, 1.0, loop.branch.trial_load)
        moved = (jnp.arange(1, n + 1) == loop.column)[:, None] * _DIFFERENCE
        at = jnp.where(is_polish, loop.unknowns, loop.branch.trial + moved)
        is_probe = loop.branch.iterations.max() == 0
        coarse = jnp.where(is_probe, _PROBE_STEPS, settings.coarse_steps)
        count = jnp.where(is_polish, levels[loop.level], coarse).astype(int)
        value, taut, trajectory = evaluate(load, at, count, loop.trajectory)
        followed = follow(loop, value, trajectory.base, taut)
        polished = polish(loop, value, taut)
        kept = jax.tree.map(
            lambda all, one: all.at[jnp.where(is_polish, n + 1, loop.column)].set(one),
            loop.coarse, _beginning(trajectory, coarse_room),
        )  # fmt: skip
        followed, polished = (part._replace(trajectory=None, coarse=None) for part in (followed, polished))
        new = jax.tree.map(lambda a, b: jnp.where(is_polish, a, b), polished, followed)
        return new._replace(trajectory=trajectory, coarse=kept)

    rest = unknowns.at_rest(rod, shape)
    zero = jnp.zeros(shape)
    eye = jnp.broadcast_to(jnp.eye(n)[..., None], (n, n, *shape))
    allowed = jnp.broadcast_to(is_allowed(scene), shape)
    branch = continuation.begin(rest, eye, allowed, stepping)
    at_tip = unknowns.tip(rod, rest)
    nothing = jnp.zeros((outputs, *shape))
    knows_rest = not unknowns.tendons
    at_rest = unknowns.jacobian_at_rest(rod, shape) if knows_rest else jnp.zeros((outputs, n, *shape))
    loop = _Loop(
        branch=branch, column=jnp.asarray(0), level=jnp.where(allowed.any(), -1, 0), passes=jnp.asarray(0),
        is_last=jnp.asarray(False), done=jnp.asarray(False), unknowns=rest, value=nothing, base=at_tip,
        columns=jnp.zeros((outputs, n + 1, *shape)), jacobian=jnp.zeros((outputs, n, *shape)),
        taut=jnp.zeros((len(unknowns.tendons), *shape), bool), prediction=nothing, estimate=zero + jnp.inf,
        correction=jnp.zeros((n, *shape)), contraction=zero + 1, is_same_grid=jnp.asarray(False),
        trajectory=_no_trajectory(rod, at_tip, most), coarse=_rooms(_no_trajectory(rod, at_tip, coarse_room), n + 2),
    )  # fmt: skip
    loop = lax.while_loop(lambda loop: ~loop.done, one_pass, loop)
    branch = loop.branch
    alive = branch.outcome == code_of(Outcome.converged)
    outcome = jnp.where(
        unknowns.redundant(loop.unknowns, alive, compliance) & (branch.outcome != code_of(Outcome.bad_input)),
        code_of(Outcome.muscles_redundant),
        branch.outcome,
    )
    final = unknowns.applied(rod.at_load(jnp.where(alive, 1.0, branch.trial_load)), loop.unknowns)
    return Found(
        unknowns=loop.unknowns, outcome=outcome, load_fraction=branch.load, iterations=branch.iterations,
        jacobian=branch.jacobian, residual=loop.contraction * _size(loop.value[:n]),
        error=jnp.maximum(loop.estimate, _size(loop.correction) * loop.contraction), steps=levels[loop.level],
        trajectory=loop.trajectory, change=_change(loop.coarse, loop.correction), rod=final,
    )  # fmt: skip


def _size(change: Float[Array, "unknowns ..."]) -> Float[Array, "..."]:
    return jnp.max(jnp.abs(change), axis=0)


def _predict(unknowns: Array, rate: Array, load: Array, ahead: Array) -> Array:
    return unknowns + (ahead - load) * rate


def _reason(usable: Array, jacobian: Array) -> Any:
    determinant = linear_systems.determinant(jacobian)
    reason = jnp.where(determinant < _NEARLY_SINGULAR, code_of(Outcome.limit_point), code_of(Outcome.ill_conditioned))
    return jnp.where(usable, reason, code_of(Outcome.integration_failed))


def _change(coarse: Trajectory, correction: Float[Array, "unknowns batch"]) -> Trajectory:
    """How a correction of the unknowns changes the integration, from those of a round on the coarse grid."""
    steps = coarse.nodes.steps[0]
    coarse = coarse._replace(nodes=coarse.nodes._replace(steps=None))
    factors = correction / _DIFFERENCE

    def combined(all: Array) -> Array:
        return sum(((all[1 + j] - all[0]) * factor for j, factor in enumerate(factors)), jnp.zeros_like(all[0]))

    change = jax.tree.map(combined, coarse)
    return change._replace(nodes=change.nodes._replace(steps=steps))


def _beginning(trajectory: Trajectory, steps: int) -> Trajectory:
    """With room for so many steps."""
    nodes = trajectory.nodes
    states, slopes = jax.tree.map(lambda leaf: leaf[:, : steps + 1], (nodes.states, nodes.slopes))
    return trajectory._replace(nodes=nodes._replace(states=states, slopes=slopes))


def _rooms(like: Trajectory, count: int) -> Trajectory:
    return jax.tree.map(lambda leaf: jnp.zeros((count, *leaf.shape), leaf.dtype), like)


def _no_trajectory(rod: Rod, at_tip: RodState, most: int) -> Trajectory:
    """Zeros in the shape of a trajectory."""
    count = len([tendon for tendon in rod.tendons if tendon.end is not None]) + 1

    def room(rows: int) -> RodState:
        return jax.tree.map(lambda u: jnp.zeros((count, *(rows,) * (rows > 0), *u.shape)), at_tip)

    nodes = Nodes(room(most + 1), room(most + 1), room(0), jnp.zeros(count, int))
    return Trajectory(nodes, at_tip)
