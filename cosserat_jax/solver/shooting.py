"""Single shooting: the pose of the tip for which the base comes out clamped.

The unknown is u = (theta,) or (theta, x / L, y / L) of the tip, the residual the error of the base's pose. At no load
the arm is straight and u is known; a probe at a small load gives its linear response, and the pose at the next load is
predicted along the last secant.

A muscle whose contraction is given adds its tension to the unknown, and the error of its length to the residual, both
in the units of `physics.lengths`.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float

from ..physics.implicit import solve_columns, solve_linear, value_and_jacobian
from ..physics.lengths import length_error, units_of
from ..physics.muscles import active_stretches
from ..physics.rod import Rod, derivative, tip_state
from ..scene import Scene
from ..scene.quantity import Scalar
from ..scene.validate import is_allowed
from .continuation import Attempt, Formulation, Found, follow
from .integrate import Shot, shoot
from .method import Shooting
from .outcome import Outcome

_NEARLY_SINGULAR = 0.3  # determinant of the clamp's equation, 1 for the unloaded arm, 0 at a limit point
_REDUNDANT = 1e-8  # singular value of the muscles' compliance below which lengths do not tell tensions apart
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)  # of a quadrature along a stretch of the unloaded arm


class SingleShooting(Formulation):
    """The pose is that of the tip, and the tensions that are unknown.

    `compliance` is d(contraction)/d(tension) of those muscles on the unloaded arm, in their units; None without them.
    """

    scene: Scene
    method: Shooting
    compliance: Float[Array, "found found"] | None

    @property
    def unknowns(self) -> int:
        rod = Rod.of(self.scene)
        return rod.unknowns + len(rod.length_controlled)

    @property
    def first_load(self) -> float:
        return 1e-4

    @property
    def first_step(self) -> float:
        return 1.0

    @property
    def reach(self) -> float:
        return 2.0

    def rest(self) -> Float[Array, " unknowns"]:
        rod, angle = Rod.of(self.scene), jnp.asarray(self.scene.arm.base_angle, float)
        pose = [angle, jnp.cos(angle), jnp.sin(angle)]
        return jnp.stack([*pose[: rod.unknowns], *(jnp.zeros(()) for _ in rod.length_controlled)])

    def attempt(self, load: Float[Array, ""], pose: Float[Array, " unknowns"]) -> Attempt:
        def error_of(unknowns: Array) -> tuple[Array, tuple[Rod, Shot]]:
            rod, tip_pose = pulled(Rod.of(self.scene, load), unknowns)
            shot = shoot(rod, tip_pose, self.method)
            return base_error(rod, shot), (rod, shot)

        (error, (rod, shot)), jacobian = value_and_jacobian(error_of, pose, has_aux=True)
        jacobian = jacobian.reshape(pose.size, pose.size)
        newton, _ = solve_linear(jacobian, -error)
        return Attempt(
            pose=pose + newton,
            step=self.size(newton),
            error=self.size(error),
            rate=None,
            jacobian=jacobian if self.compliance is None else over_that_at_rest(jacobian, self.compliance, rod, shot),
            progress=shot.progress,
        )

    def predict(self, pose: Array, rate: Array, load: Array, ahead: Array) -> Array:
        return pose + (ahead - load) * rate

    def size(self, change: Array) -> Array:
        return jnp.max(jnp.abs(change))

    def reason(self, attempt: Attempt, at: Array) -> Any:
        _, determinant = solve_linear(at, jnp.zeros(len(at)))
        reason = Outcome.where(determinant < _NEARLY_SINGULAR, Outcome.limit_point, Outcome.ill_conditioned)
        reason = Outcome.where(attempt.progress.finished, reason, Outcome.integration_failed)
        return Outcome.where(attempt.progress.folded, Outcome.volume_constraint_folded, reason)


def find_tip_pose(scene: Scene, method: Shooting) -> Found:
    """The tip's pose and the unknown tensions at equilibrium, without derivatives."""
    scene = lax.stop_gradient(scene)
    rod = Rod.of(scene)
    if not rod.length_controlled:
        return follow(SingleShooting(scene, method, None), is_allowed(scene), method)
    compliance = compliance_at_rest(rod)
    found = follow(SingleShooting(scene, method, compliance), is_allowed(scene), method)
    pulling = (found.pose[rod.unknowns :] > 0) | (found.outcome != Outcome.converged)
    redundant = is_redundant(among(pulling, compliance)) & (found.outcome != Outcome.bad_input)
    return found._replace(outcome=Outcome.where(redundant, Outcome.muscles_redundant, found.outcome))


def pulled(rod: Rod, unknowns: Float[Array, " unknowns"]) -> tuple[Rod, Float[Array, " pose"]]:
    """The rod with the tensions among the unknowns, and the tip's pose."""
    controlled = rod.length_controlled
    if not controlled:
        return rod, unknowns
    scaled = list(unknowns[rod.unknowns :])
    found = tuple(units_of(rod.muscles[i], rod.arm).tension * t for i, t in zip(controlled, scaled, strict=True))
    return dataclasses.replace(rod, found=found), unknowns[: rod.unknowns]


def base_error(rod: Rod, shot: Shot) -> Float[Array, " unknowns"]:
    """Error of the base's pose: its angle [rad] and, with three unknowns, its place in lengths of the arm.

    Behind it the error of each given contraction, over the lever of the muscle.
    """
    error = [shot.base.theta - rod.arm.base_angle]
    if rod.depends_on_position:
        error += [shot.base.x / rod.arm.length, shot.base.y / rod.arm.length]
    return jnp.stack([*error, *(length for length, _ in length_errors(rod, shot))])


def length_errors(rod: Rod, shot: Shot) -> list[tuple[Scalar, Bool[Array, ""]]]:
    """`length_error` of every muscle whose contraction is given."""
    muscles: list[Any] = [rod.muscles[i] for i in rod.length_controlled]
    shortenings = shot.base.shortenings or ()
    return [
        length_error(shortening, rod.load_fraction * muscle.contraction, tension, units_of(muscle, rod.arm))
        for muscle, shortening, tension in zip(muscles, shortenings, rod.found, strict=True)
    ]


def tensions_of(rod: Rod, shot: Shot) -> Float[Array, " muscles"]:
    """The tension [N] of every muscle, zero without round-off for a slack one."""
    tensions = [rod.tension(i) for i in range(len(rod.muscles))]
    for i, (_, is_taut) in zip(rod.length_controlled, length_errors(rod, shot), strict=True):
        tensions[i] = jnp.where(is_taut, tensions[i], 0.0)
    return jnp.stack(tensions) if tensions else jnp.zeros(0)


def over_that_at_rest(jacobian: Float[Array, "n n"], compliance: Array, rod: Rod, shot: Shot) -> Float[Array, "n n"]:
    """The Jacobian with the rows of the lengths over their compliance at rest, so that at rest its determinant is 1.

    There lengths do not depend on the pose, and their block alone makes the determinant.
    """
    taut = jnp.stack([is_taut for _, is_taut in length_errors(rod, shot)])
    rows = solve_columns(among(taut, compliance), jacobian[rod.unknowns :])
    return jnp.concatenate([jacobian[: rod.unknowns], rows])


def among(taut: Bool[Array, " found"], compliance: Float[Array, "found found"]) -> Float[Array, "found found"]:
    """The compliance of the taut muscles; a slack one has the equation T = 0."""
    return jnp.where(taut[:, None], compliance, jnp.eye(len(compliance)))


def compliance_at_rest(rod: Rod) -> Float[Array, "found found"]:
    """d(contraction / lever)/d(tension), in units of each muscle, on the unloaded arm.

    There F and M stay zero whatever pulls, so that it is the integral of the sections' own compliance.
    """
    units = [units_of(rod.muscles[i], rod.arm) for i in rod.length_controlled]
    ends, active = active_stretches(rod.muscles, rod.arm)
    unloaded = dataclasses.replace(rod, load_fraction=0.0)
    state = tip_state(unloaded, jnp.zeros(()), jnp.zeros(()), jnp.zeros(()))

    def rates(scaled: Array, s: Array, active: Bool[Array, " muscles"]) -> Array:
        found = tuple(unit.tension * t for unit, t in zip(units, scaled, strict=True))
        slope = derivative(dataclasses.replace(unloaded, found=found), s, state, active)[0]
        return jnp.stack([-rate / unit.lever for rate, unit in zip(slope.shortenings or (), units, strict=True)])

    def over_stretch(start: Array, end: Array, active: Array) -> Array:
        s = (start + end) / 2 + (start - end) / 2 * _NODES
        at = jax.vmap(lambda s: jax.jacfwd(rates)(jnp.zeros(len(units)), s, active))(s)
        return (start - end) / 2 * jnp.tensordot(jnp.asarray(_WEIGHTS), at, 1)

    return jax.vmap(over_stretch)(ends[:-1], ends[1:], active).sum(axis=0)


def is_redundant(compliance: Float[Array, "found found"]) -> Bool[Array, ""]:
    """Whether two sets of tensions shorten the muscles alike, as those of two muscles on one path do."""
    return ~(jnp.linalg.svd(compliance, compute_uv=False)[-1] > _REDUNDANT)
