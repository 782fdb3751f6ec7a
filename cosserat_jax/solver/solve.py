"""`solve`: the one entry point from a scene to its equilibrium."""

from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from ..physics.implicit import condition_number
from ..physics.muscles import active_at
from ..physics.rod import Rod, derivative
from ..physics.section import stiffness_at, stretched
from ..scene import Scene, SceneError
from ..scene.quantity import Scalar, as_floats, is_traced
from . import equilibrium, multiple
from .equilibrium import at_root
from .integrate import Shot, shoot
from .method import Shooting
from .multiple import find_nodes, shoot_between
from .outcome import Outcome
from .shooting import base_error, find_tip_pose, split
from .solution import Fields, Pose, SectionStrains, Solution
from .tensions import pulled, tensions_of

_ACCEPTED_RESIDUAL = 1e-7
_SINGULAR = 1e5  # norm of the inverse of the clamp's Jacobian from which the arm counts as standing at a limit point
_FOLDING = 1e-3  # d(volume)/d(beta), 1 at rest and 0 at a fold, below which the constraint counts as folded


class SolveError(RuntimeError):
    """A rod has no solution; the message says why and what to do."""


def solve(scene: Scene, method: Shooting | None = None, *, throw: bool = True) -> Solution:
    """The static equilibrium of `scene` that raising all its loads in proportion from zero leads to.

    Works under `jax.jit`, `vmap`, `grad`, `jacfwd` and any nesting of them; derivatives with respect to every float of
    the scene are those of the implicit function theorem. `method` is a `Shooting`, by default `Shooting()`: single
    shooting, and where that loses the equilibrium multiple shooting, but under `jit` and `vmap` only what the method
    says.

    Raises `SolveError` with the outcome's sentence if the rod has no solution, unless `throw` is False. While JAX is
    tracing nothing can raise: look at `Solution.outcome`, and expect NaN in a rod that has no solution and in its
    derivatives.
    Raises `RuntimeError` if double precision is off, and `SceneError` for a scene with a muscle that a TCAM drives: its
    tension changes with time, which is what `actuate` is for.
    """
    if not jax.config.read("jax_enable_x64"):
        raise RuntimeError('cosserat_jax needs double precision: undo jax.config.update("jax_enable_x64", False)')
    check_steady(scene)
    scene, method = as_floats(scene), Shooting() if method is None else method
    if is_traced(scene):
        return _solve(scene, method)
    solution = _solve(scene, method.single)
    if needs_multiple_shooting(solution, method):
        solution = _solve(scene, method.multiple)
    if throw and lax.stop_gradient(solution.outcome._value) != Outcome.converged._value:
        raise SolveError(solution.message)
    return solution


def check_steady(scene: Scene) -> None:
    """Raises `SceneError` for a scene whose equilibrium changes with time."""
    for i, muscle in enumerate(scene.muscles):
        if muscle.tcam is not None:
            raise SceneError(f"muscles.{i}.tcam: makes a tension that changes with time; allowed: actuate")


def needs_multiple_shooting(solution: Solution, method: Shooting) -> Bool[Array, "..."]:
    """Which rods single shooting did not solve, where `method` leaves it to us what to do about them."""
    lost = ~solution.converged & (solution.outcome != Outcome.bad_input)
    return lax.stop_gradient(lost & (method.intervals is None))


@eqx.filter_jit
def _solve(scene: Scene, method: Shooting) -> Solution:
    params, tree = jax.tree.flatten(scene)

    def rod_of(params: list) -> Rod:
        return Rod.of(jax.tree.unflatten(tree, params))

    def at_pose(pose: Any, params: list) -> tuple[Array, tuple]:
        rod = rod_of(params)
        points = jnp.asarray(method.places) * rod.arm.length
        if method.is_multiple:
            rod = pulled(rod, pose.tensions)
            shot, error = shoot_between(rod, pose, method, points)
        else:
            rod, tip_pose = split(rod, pose)
            shot = shoot(rod, tip_pose, method, points)
            error = base_error(rod, shot)
        fields, margin = _fields(rod, shot, points)
        steps, finished = shot.progress.steps.astype(float), shot.progress.finished.astype(float)
        return error, (fields, tensions_of(rod, shot.base.shortenings), margin, error, steps, finished)

    if method.is_multiple:
        found, total = find_nodes(scene, method), partial(multiple.total_rates, rod_of, method)
    else:
        found, total = find_tip_pose(scene, method), equilibrium.total_rates
    fields, tensions, margin, error, steps, finished = at_root(at_pose, total, found.pose, params)
    residual = jnp.max(jnp.abs(error))
    condition, inverse = condition_number(found.jacobian)
    outcome = Outcome.where(residual < _ACCEPTED_RESIDUAL, Outcome.converged, Outcome.ill_conditioned)
    outcome = Outcome.where(inverse > _SINGULAR, Outcome.limit_point, outcome)
    outcome = Outcome.where(jnp.min(margin) < _FOLDING, Outcome.volume_constraint_folded, outcome)
    outcome = Outcome.where(finished == 1, outcome, Outcome.integration_failed)
    outcome = Outcome.where(found.outcome == Outcome.converged, outcome, found.outcome)
    failed_at = jnp.where(found.outcome == Outcome.converged, fields.s[jnp.argmin(margin)], found.stopped_at)
    stopped = (outcome == Outcome.volume_constraint_folded) | (outcome == Outcome.integration_failed)
    failed_at = lax.stop_gradient(jnp.where(stopped, failed_at, jnp.nan))
    # a factor, for what is lost to have no derivative either: a choice between it and NaN would have that of zero
    # (but not of what is empty, whose value JAX leaves unbatched where its derivative is batched)
    known = jnp.where(outcome == Outcome.converged, 1.0, jnp.nan)
    fields, tensions = jax.tree.map(lambda value: value * known if value.size else value, (fields, tensions))
    tip = jax.tree.map(lambda field: field[-1], fields)
    return Solution(
        tip=Pose(tip.x, tip.y, tip.theta),
        tip_strain=SectionStrains(tip.nu, tip.eta, tip.mu, tip.beta),
        fields=fields,
        outcome=outcome,
        residual=residual,
        condition=condition,
        iterations=found.iterations,
        steps=steps.astype(int),
        load_fraction=found.load_fraction,
        failed_at=failed_at,
        tensions=tensions,
    )


def _fields(rod: Rod, shot: Shot, points: Float[Array, " points"]) -> tuple[Fields, Scalar]:
    """The fields at the points, and how far the volume constraint is from folding there."""
    saved: Any = shot.saved
    section: Any
    section, margin = jax.vmap(lambda s, at: derivative(rod, s, at, active_at(rod.muscles, s))[1:])(points, saved)
    beta = jnp.broadcast_to(section.beta, points.shape)
    stiffness = stretched(stiffness_at(rod.arm, points), beta)
    area = jnp.pi * (beta * section.radius) ** 2
    fields = Fields(
        s=points,
        x=saved.x - shot.base.x,
        y=saved.y - shot.base.y,
        theta=saved.theta,
        nu=section.nu,
        eta=section.eta,
        mu=section.mu,
        beta=beta,
        N=stiffness.axial / area * (section.nu - 1),
        H=stiffness.shear / area * section.eta,
        M=stiffness.bending / (area * area / (4 * jnp.pi)) * section.mu,
        force_x=saved.force_x,
        force_y=saved.force_y,
        moment=saved.moment,
    )
    return fields, margin
