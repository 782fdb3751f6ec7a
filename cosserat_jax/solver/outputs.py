"""What is computed from an integration: the fields along the arm and the numbers of the tip, as arrays."""

import functools as ft
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..numerics import linear_systems
from ..numerics.runge_kutta import Tableau
from ..physics.loads import DeformedSection
from ..physics.rod import Rod, RodState, derivative, place_at, restarted, section_load
from ..physics.section_laws import ReferenceSection
from ..physics.segments import active_at
from ..physics.tendon import is_wound_in_whole, pull_at, tangent
from ..physics.volume import is_tendon_lost, volume_defect
from ..scene import Scene
from .integrate import Trajectory, states_at
from .outcome import Outcome, code_of
from .unknowns import Unknowns

FIELDS = ("s", "x", "y", "theta", "nu", "eta", "mu", "beta", "N", "H", "M", "force_x", "force_y", "moment")
_ACCEPTED_RESIDUAL = 1e-7
_SINGULAR = 1e5  # norm of the inverse of the clamp's Jacobian from which the arm counts as standing at a limit point
_FOLDING = 1e-3  # d(volume)/d(beta), 1 at rest and 0 at a fold, below which the constraint counts as folded
_DEFECT = 1e-6  # of the volume constraint along the arm, from which it is not kept: beyond a fold, or on too few steps
COARSE_AROUND = 4  # nodes that the dense output of a coarse grid takes
TIP = ("x", "y", "theta", "nu", "eta", "mu", "beta")


class Structure(NamedTuple):
    """What decides which program is compiled: the kind of scene, with the shapes of its floats, the Runge-Kutta method,
    and the most steps in a segment, on the fine and on the coarse grid."""

    tree: Any
    ranks: tuple[int, ...]
    tableau: Tableau
    most: int
    coarse_most: int

    def scene(self, leaves: Any) -> Scene:
        """The scene with these floats, [batch] or shared."""
        return jax.tree.unflatten(self.tree, leaves)


class Report(NamedTuple):
    """What an equilibrium is and how it was found, every array with the batch last; see `Solution`."""

    tip: Float[Array, "tip ..."]
    tensions: Float[Array, "muscles ..."]
    fields: Float[Array, "fields points ..."]
    root: Float[Array, "unknowns+1 ..."]  # the unknowns and the number of steps, for the derivatives
    residual: Array
    error: Array
    condition: Array
    load_fraction: Array
    failed_at: Array
    outcome: Array
    iterations: Array
    steps: Array


def active_at_tip(rod: Rod) -> tuple[Any, ...]:
    """The tendons that run to the tip."""
    return tuple(jnp.asarray(True) if tendon.end is None else tendon.end >= rod.length for tendon in rod.tendons)


def tip_values(rod: Rod, unknowns: Unknowns, u: Array, base: Any, known: Any = None) -> Float[Array, "values batch"]:
    """The numbers of the tip, in the order of `TIP`, the tension of every muscle, and the unknowns. For `known` see
    `physics.volume.strained`."""
    shape, active = u.shape[1:], active_at_tip(rod)
    state = restarted(rod, rod.length, unknowns.tip(rod, u), active)
    _, section, _ = derivative(rod, rod.length, state, active, known)
    values = [state.x - base.x, state.y - base.y, u[0], section.nu, section.eta, section.mu, section.beta]
    return jnp.concatenate([stacked(values, shape), unknowns.tensions(rod, base.shortenings, shape), u])


def along(
    rod: Rod, trajectory: Trajectory, change: Trajectory, s: Array, batch: int
) -> tuple[Array, Array, Array, Array | None, RodState]:
    """The fields, [fields, points, batch], the margin and the defect of the volume constraint at arc lengths `s`; where
    a tendon is lost, see `lost_tendon`; and the state at the base.

    The integration is corrected by a small `change` of it, made on the coarse grid.
    """
    state, _ = states_at(rod, trajectory, s)
    more, _ = states_at(rod, change, s, around=COARSE_AROUND)
    state, base = jax.tree.map(jnp.add, (state, trajectory.base), (more, change.base))
    s = s if s.ndim == 2 else s[:, None]
    active = active_at(rod.tendons, s)
    _, section, margin = derivative(rod, s, state, active)
    values = field_values(rod, base, s, state, section)
    shape = (len(s), batch)
    lost = lost_tendon(rod, s, state, section, active)
    lost = None if lost is None else jnp.broadcast_to(lost, shape[1:])
    if rod.is_rigid:
        return stacked(values, shape), jnp.ones(shape), jnp.zeros(shape), lost, base
    defect = jnp.abs(volume_defect(section.nu, section.mu, section.beta, section.surface))
    return stacked(values, shape), jnp.broadcast_to(margin, shape), jnp.broadcast_to(defect, shape), lost, base


def lost_tendon(rod: Rod, s: Array, state: RodState, section: DeformedSection, active: Any) -> Array | None:
    """The first of the arc lengths `s`, [points, ...], at which a tendon has zero length, infinite if there is none;
    None of a rod whose tendons all pull along t_c itself, so that it may vanish."""
    if not any(tendon.unit for tendon in rod.tendons):
        return None
    place, load = place_at(rod, s, active), section_load(state)
    lost = [is_tendon_lost(rod.law, place, load, section, pull) for pull in place.pulls if pull.unit]
    return jnp.where(ft.reduce(jnp.logical_or, lost), s, jnp.inf).min(axis=0)


def arc_lengths(places: Float[Array, "points ..."], length: Any, batch: int) -> Array:
    """[points], or [points, batch] where the arms are not of one length."""
    if places.ndim == 1 and jnp.ndim(length) == 1:
        return places[:, None] * length
    return places * length


def stacked(values: list[Any], shape: tuple[int, ...]) -> Array:
    """The values, each of this shape."""
    return jnp.stack([jnp.broadcast_to(jnp.asarray(value, float), shape) for value in values])


def field_values(rod: Rod, base: Any, s: Any, state: Any, section: Any) -> list[Any]:
    """The fields, in the order of `FIELDS`, of sections with these states; the base is put to the origin.

    N, H and M follow from the balance of the section, so that they are right for an inextensible arm too.
    """
    axial = state.force_x * state.cos + state.force_y * state.sin
    shear = state.force_y * state.cos - state.force_x * state.sin
    moment = state.moment
    for tendon, active in zip(rod.tendons, active_at(rod.tendons, s), strict=True):
        pull = pull_at(tendon, s, active)
        along, across = tangent(pull, section.nu, section.eta, section.mu, section.beta, section.beta_s)
        tension = pull.tension / jnp.sqrt(along**2 + across**2) if pull.unit else pull.tension
        axial, shear = axial - tension * along, shear - tension * across
        moment = moment + tension * pull.offset * section.beta * along
    here = ReferenceSection(s, section.radius, section.beta)
    area = rod.law.area(here)
    return [
        s, state.x - base.x, state.y - base.y, state.theta, section.nu, section.eta, section.mu, section.beta,
        axial / area, shear / area, moment / rod.law.second_moment(here),
        state.force_x, state.force_y, state.moment,
    ]  # fmt: skip


def outcome_of(
    rod: Rod, followed: Array, s: Array, margin: Array, defect: Array, lost_at: Array | None, residual: Array,
    error: Array, asked: Any, jacobian: Array,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """The outcome's code, where the arm failed [m], and the condition number.

    From the outcome of following the branch, and at points `s` along the last integration the margin and the defect of
    the volume constraint, `lost_tendon`, the residual, the estimated error and the one asked for, the
    Jacobian of the clamp.
    """
    condition, inverse = linear_systems.condition_number(jacobian)
    kept = jnp.max(defect, axis=0) <= _DEFECT
    is_folded = ~(jnp.min(margin, axis=0) >= _FOLDING)
    if rod.is_rigid:
        is_folded = jnp.zeros_like(is_folded)
    folded, failed = code_of(Outcome.volume_constraint_folded), code_of(Outcome.integration_failed)
    outcome = jnp.where(residual < _ACCEPTED_RESIDUAL, 0, code_of(Outcome.ill_conditioned))
    outcome = jnp.where((outcome == 0) & ~((error <= asked) & kept), code_of(Outcome.inaccurate), outcome)
    outcome = jnp.where(inverse > _SINGULAR, code_of(Outcome.limit_point), outcome)
    outcome = jnp.where(is_folded, folded, outcome)
    outcome = jnp.where(jnp.isfinite(residual), outcome, failed)
    kinds = (Outcome.bad_input, Outcome.muscles_redundant, Outcome.iterations_exhausted)
    keeps = ft.reduce(jnp.logical_or, [followed == code_of(kind) for kind in kinds])
    lost = jnp.where((is_folded | ~kept) & ~keeps, folded, followed)
    outcome = jnp.where(followed == 0, outcome, lost)
    worst = jnp.argmin(jnp.where(defect <= _DEFECT, margin, -defect), axis=0)
    place = jnp.take_along_axis(jnp.broadcast_to(s, margin.shape), worst[None], axis=0)[0]
    place = jnp.where((outcome == folded) | (outcome == failed), place, jnp.nan)
    no_length = code_of(Outcome.tendon_length_zero)
    if lost_at is not None:
        is_lost = (lost_at < jnp.inf) & ~keeps
        outcome, place = jnp.where(is_lost, no_length, outcome), jnp.where(is_lost, lost_at, place)
    if rod.displaced:
        whole = ft.reduce(jnp.logical_or, [is_wound_in_whole(rod.tendons[i], rod.length) for i in rod.displaced])
        outcome = jnp.where(whole & ~keeps & (outcome != 0), no_length, outcome)
    return outcome, place, condition
