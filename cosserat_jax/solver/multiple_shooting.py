"""Multiple shooting: for an arm under high axial tension, ill-conditioned for single shooting.

Two neighboring solutions of such an arm part like exp of the integral of sqrt(F.a / (c E J)) along it, whichever end
one starts from, and past exp(30) no pose of the tip decides anything at the base in double precision. Over a short
interval they hardly part. The intervals are short where force or curvature is large, and are cut anew before every
load; see `interval_system` for the equations.
"""

import functools as ft
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from ..numerics.implicit_derivatives import Scalars, at_root, in_places
from ..numerics.newton import batched_with
from ..numerics.runge_kutta import dense_output
from ..physics.rod import Rod, derivative, restarted
from ..physics.segments import active_at
from ..physics.volume import volume_defect
from ..scene import Scene
from ..scene.validate import is_allowed
from . import continuation
from .continuation import Correction, Stepping
from .interval_system import Nodes, cut_anew, integrate_all, largest_error, linearized, mesh, pulled, state_of
from .method import MultipleShooting, tableau_of
from .outcome import Outcome, code_of
from .outputs import FIELDS, TIP, Report, field_values, lost_tendon, outcome_of, stacked
from .unknowns import Unknowns

_SURE_ORDER = 6  # at which errors fall with the number of steps for sure


@eqx.filter_jit
def multiple_shooting(scene: Scene, places: Float[Array, " points"], method: MultipleShooting) -> Report:
    """The `Report` of one scene, with the derivatives of the implicit function theorem in forward mode."""
    leaves, tree = jax.tree.flatten(scene)
    found, compliance = _find(lax.stop_gradient(scene), method)
    alive = found.outcome == code_of(Outcome.converged)
    nodes = jax.tree.map(lambda a, b: jnp.where(alive, a, b), found.unknowns, found.trial)
    load = jnp.where(alive, 1.0, found.trial_load)
    params = [*leaves, places, load]  # which are traced too, so that no function may close over them

    def rod_of(params: Scalars) -> Rod:
        return Rod.of(jax.tree.unflatten(tree, params[:-2])).at_load(params[-1])

    def at_nodes(nodes: Nodes, params: Scalars) -> tuple[Array, tuple]:
        return _results(rod_of(params), nodes, method, params[-2])

    total = ft.partial(total_rates, rod_of, method)
    fields, tip, tensions, margin, defect, error = at_root(at_nodes, total, nodes, params)
    held = lax.stop_gradient((rod_of(params), nodes))
    estimate = _estimate(*held, method)
    u = jnp.concatenate([jnp.zeros(0)] if nodes.tensions is None else [nodes.tensions])
    layout = Unknowns(0, Unknowns.of(held[0]).tendons)
    redundant = layout.redundant(u, alive, compliance) & (found.outcome != code_of(Outcome.bad_input))
    followed = jnp.where(redundant, code_of(Outcome.muscles_redundant), found.outcome)
    outcome, failed_at, condition = outcome_of(
        held[0], followed, fields[0][:, None], lax.stop_gradient(margin)[:, None], lax.stop_gradient(defect)[:, None],
        _lost_tendon(*held), error[None], estimate[None], method.error, found.jacobian[..., None],
    )  # fmt: skip
    known = jnp.where(outcome[0] == 0, 1.0, jnp.nan)
    steps = jnp.asarray(method.steps * (len(nodes.states) - 1))
    return Report(
        tip=tip * known, tensions=tensions * known if tensions.size else tensions, fields=fields * known,
        root=nodes.states[0] * known, residual=error, error=estimate, condition=condition[0],
        load_fraction=found.load, failed_at=failed_at[0], outcome=outcome[0], iterations=found.iterations, steps=steps,
    )  # fmt: skip


def _find(scene: Scene, method: MultipleShooting) -> tuple[continuation.Branch, Array]:
    """The branch followed to its end, and the compliance of tendons of given displacement, without derivatives."""
    rod = Rod.of(scene)
    layout = Unknowns.of(rod)
    compliance = layout.compliance_at_rest(rod, ())
    stepping = Stepping(0.0, 0.05, 1.0, method.newton_tol, method.max_iterations, method.min_load_step)

    def size(change: Nodes) -> Array:
        of_pose = jnp.max(jnp.abs(change.states[:, : layout.pose]))
        return of_pose if change.tensions is None else jnp.maximum(of_pose, jnp.max(jnp.abs(change.tensions)))

    def predict(nodes: Nodes, rate: Nodes, load: Array, ahead: Array) -> Nodes:
        nodes = jax.tree.map(lambda at, rate: at + (ahead - load) * rate, nodes, rate)  # cuts have no rate
        return cut_anew(pulled(rod.at_load(ahead), nodes), nodes)

    def reason(usable: Array, jacobian: Array) -> Array:
        failed = code_of(Outcome.integration_failed if rod.is_rigid else Outcome.volume_constraint_folded)
        return jnp.where(usable, code_of(Outcome.limit_point), failed)

    def correct(branch: continuation.Branch) -> continuation.Branch:
        nodes, load = branch.trial, branch.trial_load
        linear = linearized(
            lambda load: rod.at_load(load[0]), load[None], nodes, tableau_of(method.solver), method.steps
        )
        change, tensions, jacobian = linear.solve(layout, compliance)
        newton, rate = (
            Nodes(jnp.zeros_like(nodes.cuts), change[..., i], None if tensions is None else tensions[:, i])
            for i in range(2)
        )
        correction = Correction(
            unknowns=jax.tree.map(jnp.add, nodes._replace(states=linear.states), newton),
            step=size(newton), error=linear.error, rate=rate, jacobian=jacobian, 
            usable=jnp.isfinite(linear.error) & linear.keeps_volume,
        )  # fmt: skip
        return continuation.advance(branch, correction, stepping, predict, size, reason)

    rest = _at_rest(rod, layout, method.intervals)
    begin = continuation.begin(rest, jnp.eye(layout.size), is_allowed(scene), stepping)
    begin = batched_with(scene, begin)
    return lax.while_loop(lambda branch: branch.running, correct, begin), compliance


def _at_rest(rod: Rod, layout: Unknowns, intervals: int) -> Nodes:
    cuts = jnp.linspace(1.0, 0.0, intervals + 1)[1:-1]
    s, _ = mesh(rod, cuts)
    angle = jnp.broadcast_to(jnp.asarray(rod.base_angle, float), s.shape)
    pose = [angle, s / s[0] * jnp.cos(angle), s / s[0] * jnp.sin(angle)][: layout.pose]
    tensions = jnp.zeros(len(rod.displaced)) if rod.displaced else None
    return Nodes(cuts, jnp.stack([*pose, *jnp.zeros((3, s.size))], axis=1), tensions)


def _results(rod: Rod, nodes: Nodes, method: MultipleShooting, places: Array) -> tuple[Array, tuple]:
    """The largest error; and fields, numbers of the tip, tensions, margin and defect along the arm, and that error."""
    rod = pulled(rod, nodes)
    layout = Unknowns.of(rod)
    kept, ends, spans = integrate_all(rod, nodes, tableau_of(method.solver), method.steps)
    start = jax.tree.map(lambda leaf: leaf[0], kept.states)

    def placed(begin: Array, end: Array) -> Array:
        return -jnp.cumsum((end - begin)[::-1])[::-1] - begin  # of every interval, with the base at the origin

    s = jnp.concatenate([places, jnp.ones(1)]) * rod.length
    which = (s[None] <= spans.end[:-1, None]).sum(0)
    here = jax.tree.map(lambda leaf: leaf[which], spans)
    across = kept._replace(
        states=jax.tree.map(lambda leaf: jnp.swapaxes(leaf, 0, 1), kept.states),
        slopes=jax.tree.map(lambda leaf: jnp.swapaxes(leaf, 0, 1), kept.slopes),
    )
    state = dense_output(across, here.tau(s), which)
    state = state._replace(
        x=state.x + placed(start.x, kept.end.x)[which], y=state.y + placed(start.y, kept.end.y)[which]
    )
    _, section, margin = derivative(rod, s, state, active_at(rod.tendons, s))
    origin = state._replace(x=0.0, y=0.0)
    values = stacked(field_values(rod, origin, s, state, section), s.shape)
    tip = values[jnp.array([FIELDS.index(name) for name in TIP]), -1]
    defect = jnp.zeros(s.shape)
    if not rod.is_rigid:
        defect = volume_defect(section.nu, section.mu, section.beta, section.surface)
    shortenings = jax.tree.map(jnp.sum, kept.end.shortenings)
    error = largest_error(rod, layout, nodes.states, ends, shortenings)
    margin = jnp.broadcast_to(margin, s.shape)
    tensions = layout.tensions(rod, shortenings, ())
    return error, (values[:, :-1], tip, tensions, margin[:-1], jnp.abs(defect)[:-1], error)


def _lost_tendon(rod: Rod, nodes: Nodes) -> Array | None:
    """`lost_tendon` at the nodes."""
    rod = pulled(rod, nodes)
    s, _ = mesh(rod, nodes.cuts)
    active = active_at(rod.tendons, s)
    state = restarted(rod, s, state_of(rod, nodes.states, s), active)
    _, section, _ = derivative(rod, s, state, active)
    lost = lost_tendon(rod, s, state, section, active)
    return None if lost is None else lost[None]


def _estimate(rod: Rod, nodes: Nodes, method: MultipleShooting) -> Array:
    """The error of the tip's pose, from what half as many steps change in it."""
    linear = linearized(lambda _: rod, jnp.zeros(1), nodes, tableau_of(method.solver), method.steps)
    layout = Unknowns.of(rod)
    at = nodes._replace(states=linear.states)
    _, coarse, _ = integrate_all(pulled(rod, nodes), at, tableau_of(method.solver), method.steps // 2)
    apart = coarse - linear.ends
    moved = linear._replace(ends=linear.states[1:] + apart, clamp_error=jnp.zeros_like(linear.clamp_error))
    change, _, _ = moved.solve(layout)
    worst = jnp.max(jnp.abs(change[:, : layout.pose, 0]))
    return jnp.maximum(worst, jnp.max(jnp.abs(apart[:, : layout.pose]).sum(0))) / (2**_SURE_ORDER - 1)


def total_rates(
    rod_of: Callable[[Scalars], Rod],
    method: MultipleShooting,
    function: Callable,
    nodes: Nodes,
    params: Scalars,
    moving: tuple,
) -> tuple:
    """`function(nodes, params)` and its total derivative by the moving parameters, `nodes` following; see `at_root`."""

    def with_moving(values: Float[Array, " moving"]) -> Scalars:
        return in_places(params, moving, values)

    at = jnp.stack([params[i] for i in moving])
    system = linearized(lambda values: rod_of(with_moving(values)), at, nodes, tableau_of(method.solver), method.steps)
    change, tensions, _ = system.solve(Unknowns.of(rod_of(params)))
    change, tensions = jax.tree.map(lambda of: jnp.moveaxis(of[..., 1:], -1, 0), (change, tensions))

    def along(states_step: Array, tensions_step: Array | None, values_step: Array) -> tuple:
        def of(states: Array, tensions: Array | None, values: Array) -> Any:
            return function(Nodes(nodes.cuts, states, tensions), with_moving(values))

        return jax.jvp(of, (nodes.states, nodes.tensions, at), (states_step, tensions_step, values_step))

    return jax.vmap(along, out_axes=(None, -1))(change, tensions, jnp.eye(len(moving)))
