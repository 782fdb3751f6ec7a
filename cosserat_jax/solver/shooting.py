"""Single shooting: the pose of the tip for which the base comes out clamped.

The unknown is u = (theta,) or (theta, x / L, y / L) of the tip, the residual the error of the base's pose. At no load
the arm is straight and u is known; a probe at a small load gives its linear response, and the pose at the next load is
predicted along the last secant.

A muscle whose contraction is given adds its tension to the unknown, and the error of its length to the residual; see
`tensions`.
"""

from typing import Any

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from ..physics.implicit import solve_linear, value_and_jacobian
from ..physics.rod import Rod
from ..scene import Scene
from ..scene.validate import is_allowed
from .continuation import Attempt, Formulation, Found, follow
from .integrate import Shot, shoot
from .method import Shooting
from .outcome import Outcome
from .tensions import compliance_at_rest, length_errors, over_compliance, pulled, taut_at, without_redundant

_NEARLY_SINGULAR = 0.3  # determinant of the clamp's equation, 1 for the unloaded arm, 0 at a limit point


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
            rod, tip_pose = split(Rod.of(self.scene, load), unknowns)
            shot = shoot(rod, tip_pose, self.method)
            return base_error(rod, shot), (rod, shot)

        (error, (rod, shot)), jacobian = value_and_jacobian(error_of, pose, has_aux=True)
        jacobian = jacobian.reshape(pose.size, pose.size)
        newton, _ = solve_linear(jacobian, -error)
        if self.compliance is not None:
            taut = taut_at(rod, shot.base.shortenings)
            rows = over_compliance(jacobian[rod.unknowns :], self.compliance, taut)
            jacobian = jnp.concatenate([jacobian[: rod.unknowns], rows])
        return Attempt(
            pose=pose + newton,
            step=self.size(newton),
            error=self.size(error),
            rate=None,
            jacobian=jacobian,
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
    compliance = compliance_at_rest(rod)
    found = follow(SingleShooting(scene, method, compliance), is_allowed(scene), method)
    return without_redundant(found, compliance, None if compliance is None else found.pose[rod.unknowns :])


def split(rod: Rod, unknowns: Float[Array, " unknowns"]) -> tuple[Rod, Float[Array, " pose"]]:
    """The rod with the tensions that are among the unknowns, and the tip's pose."""
    if not rod.length_controlled:
        return rod, unknowns
    return pulled(rod, unknowns[rod.unknowns :]), unknowns[: rod.unknowns]


def base_error(rod: Rod, shot: Shot) -> Float[Array, " unknowns"]:
    """Error of the base's pose: its angle [rad] and, with three unknowns, its place in lengths of the arm.

    Behind it the error of each given contraction, over the lever of the muscle.
    """
    error = [shot.base.theta - rod.arm.base_angle]
    if rod.depends_on_position:
        error += [shot.base.x / rod.arm.length, shot.base.y / rod.arm.length]
    return jnp.stack([*error, *(length for length, _ in length_errors(rod, shot.base.shortenings))])
