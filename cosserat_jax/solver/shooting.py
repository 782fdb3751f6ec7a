"""Single shooting: the pose of the tip for which the base comes out clamped.

The unknown is u = (theta,) or (theta, x / L, y / L) of the tip, the residual the error of the base's pose. At no load
the arm is straight and u is known; a probe at a small load gives its linear response, and the pose at the next load is
predicted along the last secant.
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

_NEARLY_SINGULAR = 0.3  # determinant of the clamp's equation, 1 for the unloaded arm, 0 at a limit point


class SingleShooting(Formulation):
    """The pose is that of the tip."""

    scene: Scene
    method: Shooting

    @property
    def unknowns(self) -> int:
        return Rod.of(self.scene).unknowns

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
        angle = jnp.asarray(self.scene.arm.base_angle, float)
        pose = [angle, jnp.cos(angle), jnp.sin(angle)]
        return jnp.stack(pose[: self.unknowns])

    def attempt(self, load: Float[Array, ""], pose: Float[Array, " unknowns"]) -> Attempt:
        def error_of(pose: Array) -> tuple[Array, Shot]:
            rod = Rod.of(self.scene, load)
            shot = shoot(rod, pose, self.method)
            return base_error(rod, shot), shot

        (error, shot), jacobian = value_and_jacobian(error_of, pose, has_aux=True)
        jacobian = jacobian.reshape(pose.size, pose.size)
        newton, _ = solve_linear(jacobian, -error)
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
    """The tip's pose at equilibrium, without derivatives."""
    scene = lax.stop_gradient(scene)
    return follow(SingleShooting(scene, method), is_allowed(scene), method)


def base_error(rod: Rod, shot: Shot) -> Float[Array, " unknowns"]:
    """Error of the base's pose: its angle [rad] and, with three unknowns, its place in lengths of the arm."""
    error = [shot.base.theta - rod.arm.base_angle]
    if rod.depends_on_position:
        error += [shot.base.x / rod.arm.length, shot.base.y / rod.arm.length]
    return jnp.stack(error)
