"""What shooting looks for: the pose of the tip, and the tension of every tendon whose displacement is given.

The unknowns are u = (theta,) of the tip, or (theta, x / L, y / L) where a load depends on position, and behind them the
tensions, each in its unit T_1. The equations are the error of the base's pose, in radians and lengths, and of each
tendon's length, over its lever; see `physics.tendon`.

On the unloaded arm the lengths do not depend on the pose, so that there the determinant of the whole is that of the
tendons' compliance, by which the rows of the lengths are divided: it is 1 at rest, as it is without such tendons, and
falls to zero at a limit point.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float

from ..numerics import linear_systems
from ..physics.rod import Rod, RodState, derivative, tip_state
from ..physics.section_laws import ReferenceSection
from ..physics.segments import segments_of
from ..physics.tendon import length_error
from ..scene.quantity import Scalar

_REDUNDANT = 1e-8  # singular value of the tendons' compliance below which lengths do not tell tensions apart
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)  # of a quadrature along a segment of the unloaded arm


class TendonUnits(NamedTuple):
    """In which the equation of a tendon's length is solved: T_1 [N] and the lever h [m]."""

    tension: Scalar
    lever: Scalar


class Unknowns(NamedTuple):
    """The layout of u [unknowns, ...]: `pose` of them are the tip's pose, one for each of `tendons` follows."""

    pose: int
    tendons: tuple[TendonUnits, ...]

    @classmethod
    def of(cls, rod: Rod) -> "Unknowns":
        """The unknowns of a rod."""
        return cls(3 if rod.depends_on_position else 1, tuple(_units(rod, i) for i in rod.displaced))

    @property
    def size(self) -> int:
        """How many there are."""
        return self.pose + len(self.tendons)

    def at_rest(self, rod: Rod, shape: tuple[int, ...]) -> Float[Array, "unknowns ..."]:
        """u of the unloaded arm."""
        angle = jnp.asarray(rod.base_angle, float)
        pose = [angle, jnp.cos(angle), jnp.sin(angle)][: self.pose]
        return jnp.stack([jnp.broadcast_to(u, shape) for u in (*pose, *(jnp.zeros(()) for _ in self.tendons))])

    def jacobian_at_rest(self, rod: Rod, shape: tuple[int, ...]) -> Float[Array, "3 pose ..."]:
        """The derivative of the base's pose [rad, lengths] by that of the tip of the unloaded arm, a rigid body."""
        angle = jnp.broadcast_to(jnp.asarray(rod.base_angle, float), shape)
        one, zero = jnp.ones(shape), jnp.zeros(shape)
        rows = [[one, zero, zero], [jnp.sin(angle), one, zero], [-jnp.cos(angle), zero, one]]
        return jnp.stack([jnp.stack(row[: self.pose]) for row in rows])

    def applied(self, rod: Rod, u: Float[Array, "unknowns ..."]) -> Rod:
        """The rod with the tensions that are among the unknowns."""
        if not self.tendons:
            return rod
        return rod.with_tensions(unit.tension * t for unit, t in zip(self.tendons, u[self.pose :], strict=True))

    def tip(self, rod: Rod, u: Float[Array, "unknowns ..."]) -> RodState:
        """The state at the tip; where no load asks for its place, that is the origin."""
        x, y = u[1:3] * rod.length if self.pose == 3 else (jnp.zeros_like(u[0]), jnp.zeros_like(u[0]))
        return tip_state(rod, x, y, u[0])

    def error(self, rod: Rod, base: RodState) -> Float[Array, "unknowns ..."]:
        """The error of the base's pose, and of each given displacement."""
        pose = [base.theta - rod.base_angle, base.x / rod.length, base.y / rod.length][: self.pose]
        return jnp.stack(
            jnp.broadcast_arrays(*pose, *(error for error, _ in self.length_errors(rod, base.shortenings)))
        )

    def length_errors(self, rod: Rod, shortenings: Any) -> list[tuple[Array, Bool[Array, "..."]]]:
        """`length_error` of every tendon whose displacement is given."""
        found = []
        for i, unit, shortening in zip(rod.displaced, self.tendons, shortenings, strict=True):
            tendon: Any = rod.tendons[i]
            found.append(length_error(shortening, tendon.displacement, tendon.tension, *unit))
        return found

    def taut(self, rod: Rod, shortenings: Any, shape: tuple[int, ...]) -> Bool[Array, "tendons ..."]:
        """Which of those tendons are taut."""
        taut = [jnp.broadcast_to(is_taut, shape) for _, is_taut in self.length_errors(rod, shortenings)]
        return jnp.stack(taut) if taut else jnp.zeros((0, *shape), bool)

    def tensions(self, rod: Rod, shortenings: Any, shape: tuple[int, ...]) -> Float[Array, "all_tendons ..."]:
        """The tension [N] of every tendon, zero without round-off for a slack one."""
        tensions = [tendon.tension for tendon in rod.tendons]
        for i, (_, is_taut) in zip(rod.displaced, self.length_errors(rod, shortenings), strict=True):
            tensions[i] = jnp.where(is_taut, tensions[i], 0.0)
        return jnp.stack([jnp.broadcast_to(t, shape) for t in tensions]) if tensions else jnp.zeros((0, *shape))

    def over_compliance(
        self, jacobian: Float[Array, "unknowns columns ..."], compliance: Array, taut: Array
    ) -> Float[Array, "unknowns columns ..."]:
        """A Jacobian with the rows of the lengths over those of the unloaded arm."""
        if not self.tendons:
            return jacobian
        rows = linear_systems.solve_columns(_among(taut, compliance), jacobian[self.pose :])
        return jnp.concatenate([jacobian[: self.pose], rows])

    def compliance_at_rest(self, rod: Rod, shape: tuple[int, ...]) -> Float[Array, "tendons tendons ..."]:
        """d(displacement / lever)/d(tension), in units of each tendon, on the unloaded arm.

        There F and M stay zero whatever pulls, so that it is the integral of the sections' own compliance.
        """
        count = len(self.tendons)
        if count == 0:
            return jnp.zeros((0, 0, *shape))
        unloaded = rod.at_load(0.0)
        ends, active = segments_of(rod.tendons, rod.length)
        ends = jnp.broadcast_to(_trailing(ends, len(shape)), (len(ends), *shape))
        begin, end = ends[:-1, None], ends[1:, None]
        nodes = _NODES.reshape(1, -1, *(1,) * len(shape))
        s = (begin + end) / 2 + (begin - end) / 2 * nodes  # [segments, nodes, ...]
        active = tuple(jnp.broadcast_to(_trailing(a, len(shape))[:, None], s.shape) for a in active)
        zero = jnp.zeros_like(s)
        at_tip = tip_state(unloaded, zero, zero, zero)

        def rates(*scaled: Array) -> tuple[Array, ...]:
            pulled = unloaded.with_tensions(unit.tension * t for unit, t in zip(self.tendons, scaled, strict=True))
            slope = derivative(pulled, s, at_tip, active)[0]
            return tuple(-rate / unit.lever for rate, unit in zip(slope.shortenings, self.tendons, strict=True))

        weights = (begin - end) / 2 * _WEIGHTS.reshape(nodes.shape)
        columns = []
        for j in range(count):
            one = tuple(zero + (i == j) for i in range(count))
            _, column = jax.jvp(rates, (zero,) * count, one)
            columns.append(jnp.stack([(weights * rate).sum((0, 1)) for rate in column]))
        return jnp.stack(columns, axis=1)

    def redundant(self, u: Float[Array, "unknowns ..."], converged: Array, compliance: Array) -> Bool[Array, "..."]:
        """Whether two sets of tensions shorten the tendons alike, as those of two on one path do."""
        if not self.tendons:
            return jnp.zeros(u.shape[1:], bool)
        pulling = (u[self.pose :] > 0) | ~converged
        matrix = jnp.moveaxis(_among(pulling, compliance), (0, 1), (-2, -1))
        return ~(jnp.linalg.svd(matrix, compute_uv=False)[..., -1] > _REDUNDANT)


def _units(rod: Rod, i: int) -> TendonUnits:
    """Of one tendon; no derivative goes through them."""
    tendon = rod.tendons[i]
    end = rod.length if tendon.end is None else tendon.end
    stiffness = rod.law.stiffness(ReferenceSection(end / 2, rod.radius_at(end / 2)))
    lever = jnp.sqrt(stiffness.bending / stiffness.axial + tendon.offset_at(end / 2) ** 2)
    return lax.stop_gradient(TendonUnits(stiffness.bending / (lever * end), lever))


def _among(taut: Bool[Array, "tendons ..."], compliance: Float[Array, "tendons tendons ..."]) -> Array:
    """The compliance of the taut tendons; a slack one has the equation T = 0."""
    eye = jnp.eye(len(compliance)).reshape(*compliance.shape[:2], *(1,) * (compliance.ndim - 2))
    return jnp.where(taut[:, None], compliance, eye)


def _trailing(values: Array, axes: int) -> Array:
    """[segments] or [segments, batch] with as many axes behind the first."""
    return values.reshape(values.shape[0], *(1,) * (axes + 1 - values.ndim), *values.shape[1:])
