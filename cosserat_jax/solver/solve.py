"""`solve`: the one entry point from a scene to its equilibrium."""

from typing import Any

import equinox as eqx
import jax
import jax.core
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..physics.rod import Rod, derivative
from ..physics.section import stiffness_at
from ..scene import Scene, SceneError
from ..scene.quantity import as_floats
from .equilibrium import at_root
from .integrate import Shot, shoot
from .method import Shooting
from .outcome import Outcome
from .shooting import base_error, find_tip_pose
from .solution import Fields, Pose, SectionStrains, Solution

_ACCEPTED_RESIDUAL = 1e-7


class SolveError(RuntimeError):
    """A rod has no solution; the message says why and what to do."""


def solve(scene: Scene, method: Shooting | None = None, *, throw: bool = True) -> Solution:
    """The static equilibrium of `scene` that raising all its loads in proportion from zero leads to.

    Works under `jax.jit`, `vmap`, `grad`, `jacfwd` and any nesting of them; derivatives with respect to every float of
    the scene are those of the implicit function theorem. `method` is a `Shooting`, by default `Shooting()`.

    Raises `SolveError` with the outcome's sentence if the rod has no solution, unless `throw` is False. While JAX is
    tracing nothing can raise: look at `Solution.outcome`, and expect NaN in a rod that has no solution.
    Raises `RuntimeError` if double precision is off, and `SceneError` for a scene with a muscle that a TCAM drives: its
    tension changes with time, which is what `actuate` is for.
    """
    if not jax.config.read("jax_enable_x64"):
        raise RuntimeError('cosserat_jax needs double precision: undo jax.config.update("jax_enable_x64", False)')
    check_steady(scene)
    solution = _solve(as_floats(scene), Shooting() if method is None else method)
    outcome = solution.outcome._value
    if throw and not isinstance(outcome, jax.core.Tracer) and not solution.converged.all():
        raise SolveError(f"{Outcome[solution.outcome]} (reached {float(solution.load_fraction):.3g} of the load)")
    return solution


def check_steady(scene: Scene) -> None:
    """Raises `SceneError` for a scene whose equilibrium changes with time."""
    for i, muscle in enumerate(scene.muscles):
        if muscle.tcam is not None:
            raise SceneError(f"muscles.{i}.tcam: makes a tension that changes with time; allowed: actuate")


@eqx.filter_jit
def _solve(scene: Scene, method: Shooting) -> Solution:
    found = find_tip_pose(scene, method)
    params, tree = jax.tree.flatten(scene)

    def at_pose(tip_pose: Array, params: list) -> tuple[Array, tuple]:
        scene = jax.tree.unflatten(tree, params)
        rod = Rod.of(scene)
        points = jnp.linspace(0.0, scene.arm.length, method.points)
        shot = shoot(rod, tip_pose, method, points)
        error = base_error(rod, shot)
        return error, (_fields(rod, shot, points), error, shot.steps.astype(float), shot.finished.astype(float))

    fields, error, steps, finished = at_root(at_pose, found.tip_pose, params)
    residual = jnp.max(jnp.abs(error))
    came_through = Outcome.where(residual < _ACCEPTED_RESIDUAL, Outcome.converged, Outcome.ill_conditioned)
    came_through = Outcome.where(finished == 1, came_through, Outcome.integration_failed)
    outcome = Outcome.where(found.outcome == Outcome.converged, came_through, found.outcome)
    fields = jax.tree.map(lambda field: jnp.where(outcome == Outcome.converged, field, jnp.nan), fields)
    tip = jax.tree.map(lambda field: field[-1], fields)
    return Solution(
        tip=Pose(tip.x, tip.y, tip.theta),
        tip_strain=SectionStrains(tip.nu, tip.eta, tip.mu, tip.beta),
        fields=fields,
        outcome=outcome,
        residual=residual,
        iterations=found.iterations,
        steps=steps.astype(int),
        load_fraction=found.load_fraction,
    )


def _fields(rod: Rod, shot: Shot, points: Float[Array, " points"]) -> Fields:
    saved: Any = shot.saved
    section: Any = jax.vmap(lambda s, state: derivative(rod, s, state, s)[1])(points, saved)
    beta = jnp.broadcast_to(section.beta, points.shape)
    stiffness = stiffness_at(rod.arm, points, beta)
    area = jnp.pi * (beta * section.radius) ** 2
    return Fields(
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
