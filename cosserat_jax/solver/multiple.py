"""Multiple shooting: the arm cut into intervals, the state at every cut unknown.

An arm pulled taut makes two neighbouring solutions part like exp of the integral of sqrt(F.a / (c E J)) along it,
whichever end one starts from, and past exp(30) no pose of the tip decides anything at the base in double precision.
Over a short interval they hardly part. With u_i the state at cut i, from the tip, and phi_i the integration onward,

    phi_i(u_i) = u_i+1        u_0 = tip(pose)        pose(u_n) = clamp

is solved by Newton for all u_i at once. Its linear system is solved by a stabilised march (Godunov 1961; Conte 1966):
du_i = P_i w_i + c_i, P_i an orthonormal basis of what the tip's pose can do at cut i, carried to the base, where the
clamp gives w_n, and w back to the tip. The intervals are short where force or curvature is large, and are cut anew
before every load. Unknown tensions border that system: it is solved for a change of each as well, and the equations of
the lengths say how much of each there is.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from ..physics.implicit import in_places, solve_columns
from ..physics.muscles import active_stretches
from ..physics.rod import Rod, RodState, derivative
from ..physics.section import stiffness_at
from ..scene import Scene
from ..scene.quantity import Scalar
from ..scene.validate import is_allowed
from .continuation import Attempt, Formulation, Found, follow
from .equilibrium import Scalars
from .integrate import Progress, Shot, Stretch, gather, integrate, state_at_tip
from .method import Shooting
from .outcome import Outcome
from .tensions import (
    LinearLengths,
    compliance_at_rest,
    length_errors,
    linear_lengths,
    over_compliance,
    pulled,
    without_redundant,
)


class Nodes(NamedTuple):
    """Where the arm is cut, s / L from the tip to the base without the ends of the arm and of muscles, and the states
    at all of them: (theta, F1, F2, M) or (theta, x, y, F1, F2, M), in the units of the bending stiffness there. And the
    unknown tensions, None without; see `tensions`."""

    cuts: Float[Array, " cuts"]
    states: Float[Array, "nodes size"]
    tensions: Float[Array, " found"] | None = None


class MultipleShooting(Formulation):
    """The pose is the `Nodes`. `compliance` is that of `tensions.compliance_at_rest`."""

    scene: Scene
    method: Shooting
    compliance: Float[Array, "found found"] | None

    @property
    def unknowns(self) -> int:
        rod = Rod.of(self.scene)
        return rod.unknowns + len(rod.length_controlled)

    @property
    def first_load(self) -> float:
        return 0.0

    @property
    def first_step(self) -> float:
        return 0.05

    @property
    def reach(self) -> float:
        return 1.0

    def rest(self) -> Nodes:
        rod = Rod.of(self.scene, 0.0)
        cuts = jnp.linspace(1.0, 0.0, _intervals(self.method) + 1)[1:-1]
        s, _ = _mesh(rod, cuts)
        angle = jnp.full(s.shape, self.scene.arm.base_angle)
        pose = [angle, s / s[0] * jnp.cos(angle), s / s[0] * jnp.sin(angle)][: rod.unknowns]
        tensions = jnp.zeros(len(rod.length_controlled)) if rod.length_controlled else None
        return Nodes(cuts, jnp.stack([*pose, *jnp.zeros((3, s.size))], axis=1), tensions)

    def attempt(self, load: Float[Array, ""], pose: Nodes) -> Attempt:
        def rod_of(load: Float[Array, " 1"]) -> Rod:
            return Rod.of(self.scene, load[0])

        linear = linearised(rod_of, load[None], pose, self.method)
        change, tensions, jacobian = linear.solve(self.compliance)
        newton, rate = (
            Nodes(jnp.zeros_like(pose.cuts), change[..., i], None if tensions is None else tensions[:, i])
            for i in range(2)
        )
        return Attempt(
            pose=jax.tree.map(jnp.add, pose._replace(states=linear.states), newton),
            step=self.size(newton),
            error=linear.error,
            rate=rate,
            jacobian=jacobian,
            progress=linear.progress,
        )

    def predict(self, pose: Nodes, rate: Nodes, load: Array, ahead: Array) -> Nodes:
        nodes = jax.tree.map(lambda at, rate: at + (ahead - load) * rate, pose, rate)  # cuts have no rate
        return _cut_anew(pulled(Rod.of(self.scene, ahead), nodes.tensions), nodes)

    def size(self, change: Nodes) -> Array:
        of_pose = jnp.max(jnp.abs(change.states[:, : change.states.shape[1] - 3]))
        return of_pose if change.tensions is None else jnp.maximum(of_pose, jnp.max(jnp.abs(change.tensions)))

    def reason(self, attempt: Attempt, at: Array) -> Outcome:
        reason = Outcome.where(attempt.progress.finished, Outcome.limit_point, Outcome.integration_failed)
        return Outcome.where(attempt.progress.folded, Outcome.volume_constraint_folded, reason)


def find_nodes(scene: Scene, method: Shooting) -> Found:
    """The nodes at equilibrium, without derivatives."""
    scene = lax.stop_gradient(scene)
    compliance = compliance_at_rest(Rod.of(scene))
    found = follow(MultipleShooting(scene, method, compliance), is_allowed(scene), method)
    return without_redundant(found, compliance, found.pose.tensions)


def shoot_between(
    rod: Rod, nodes: Nodes, method: Shooting, points: Float[Array, " points"]
) -> tuple[Shot, Float[Array, ""]]:
    """The integration from every node to the next as one `Shot` with the base at the origin, and the largest error.

    `rod` is that with the tensions of `nodes`.
    """
    s, _ = _mesh(rod, nodes.cuts)
    stretches, ends = _integrate_all(rod, nodes, method, points)
    start = jax.vmap(lambda s, u: _state(rod, u, s))(s[:-1], nodes.states[:-1])

    def placed(begin: Any, end: Any, saved: Array) -> Array:
        place = -jnp.cumsum((end - begin)[::-1])[::-1]
        return place[:, None] + saved - begin[:, None]

    at: Any = stretches.saved
    at = at._replace(x=placed(start.x, stretches.end.x, at.x), y=placed(start.y, stretches.end.y, at.y))
    base = jax.tree.map(lambda leaf: leaf[-1], stretches.end)
    shortenings = jax.tree.map(jnp.sum, stretches.end.shortenings)
    base = base._replace(x=jnp.zeros(()), y=jnp.zeros(()), shortenings=shortenings)
    error = _error(rod, nodes.states, ends, length_errors(rod, shortenings))
    return Shot(base, gather(at, s, points), stretches.progress.over_all()), error


def total_rates(
    rod_of: Callable[[Scalars], Rod], method: Shooting, function: Callable, nodes: Nodes, params: Scalars, moving: tuple
) -> tuple:
    """`function(nodes, params)` and its total derivative by the moving parameters, `nodes` following; see `at_root`."""

    def with_moving(values: Float[Array, " moving"]) -> Scalars:
        return in_places(params, moving, values)

    at = jnp.stack([params[i] for i in moving])
    change, tensions, _ = linearised(lambda values: rod_of(with_moving(values)), at, nodes, method).solve()
    change, tensions = jax.tree.map(lambda of: jnp.moveaxis(of[..., 1:], -1, 0), (change, tensions))

    def along(states_step: Array, tensions_step: Array | None, values_step: Array) -> tuple:
        def of(states: Array, tensions: Array | None, values: Array) -> Any:
            return function(Nodes(nodes.cuts, states, tensions), with_moving(values))

        return jax.jvp(of, (nodes.states, nodes.tensions, at), (states_step, tensions_step, values_step))

    return jax.vmap(along, out_axes=(None, -1))(change, tensions, jnp.eye(len(moving)))


class Linearised(NamedTuple):
    """The system of multiple shooting at `states`, and its derivatives by the states and by some parameters.

    - `states`: those given, the first one put on the tip's condition. `ends`: phi(u).
    - `growth` d phi / d u, `rates` d phi / d parameters. `tip`, `tip_rates`: d u_0 by the tip's pose, by parameters.
    - `clamp_error`, `clamp_rates`: of the pose at the base.
    - `lengths`: the equations of given contractions, None without; the last parameters are then the unknown tensions.
    """

    states: Float[Array, "nodes size"]
    ends: Float[Array, "intervals size"]
    growth: Float[Array, "intervals size size"]
    rates: Float[Array, "intervals size params"]
    tip: Float[Array, "size unknowns"]
    tip_rates: Float[Array, "size params"]
    clamp_error: Float[Array, " unknowns"]
    clamp_rates: Float[Array, "unknowns params"]
    lengths: LinearLengths | None
    error: Float[Array, ""]
    progress: Progress

    def solve(
        self, compliance: Float[Array, "found found"] | None = None
    ) -> tuple[Float[Array, "nodes size params+1"], Float[Array, "found params+1"] | None, Float[Array, "n n"]]:
        """Newton's step and, beside it, d(states)/d(parameters); the same of the tensions, None without; and the
        Jacobian of the clamp's equation, with a block for the lengths, over their `compliance`, where that is given."""
        jumps = jnp.concatenate([(self.ends - self.states[1:])[..., None], self.rates], axis=-1)
        start = jnp.pad(self.tip_rates, ((0, 0), (1, 0)))
        clamp = jnp.concatenate([-self.clamp_error[:, None], self.clamp_rates], axis=-1)
        change, jacobian = _march(self.growth, jumps, self.tip, start, clamp)
        if self.lengths is None:
            return change, None, jacobian
        change, tensions, block = self.lengths.close(change)
        if compliance is not None:
            block = over_compliance(block, compliance, self.lengths.taut)
        return change, tensions, jax.scipy.linalg.block_diag(jacobian, block)


def linearised(
    given: Callable[[Array], Rod], params: Float[Array, " params"], nodes: Nodes, method: Shooting
) -> Linearised:
    """The system at `nodes` of the rod `given(params)`; see `Linearised`. Unknown tensions join the parameters.

    phi_i depends on u_i alone, so the same change of every state at once shows all blocks of the Jacobian.
    """
    count = params.size
    if nodes.tensions is not None:
        params = jnp.concatenate([params, nodes.tensions])

    def rod_of(params: Array) -> Rod:
        return given(params) if nodes.tensions is None else pulled(given(params[:count]), params[count:])

    size, rod = nodes.states.shape[1], rod_of(params)
    unknowns = rod.unknowns
    pose = nodes.states[0, :unknowns]

    def at_tip(pose: Array, params: Array) -> Array:
        rod = rod_of(params)
        return _vector(rod, state_at_tip(rod, pose), rod.arm.length)

    states = nodes.states.at[0].set(at_tip(pose, params))
    tip, tip_rates = jax.jacfwd(at_tip, argnums=(0, 1))(pose, params)

    def along(states_step: Array, params_step: Array) -> tuple:
        def integrated(states: Array, params: Array) -> tuple[tuple[Array, Any], Progress]:
            stretches, ends = _integrate_all(rod_of(params), Nodes(nodes.cuts, states), method)
            return (ends, stretches.end.shortenings), stretches.progress

        steps = jnp.broadcast_to(states_step, states.shape), params_step
        return jax.jvp(integrated, (states, params), steps, has_aux=True)

    both = jnp.eye(size + params.size)
    (ends, shorter), (rates, shorter_rates), progress = jax.vmap(along, out_axes=(None, -1, None))(
        both[:, :size], both[:, size:]
    )
    clamp_rates = jax.jacfwd(lambda params: _clamp(rod_of(params)))(params)
    clamp_error = states[-1, :unknowns] - _clamp(rod)
    shortenings = jax.tree.map(jnp.sum, shorter)
    rows = None if shorter is None else jnp.stack(shorter_rates, axis=1)
    lengths = None if rows is None else linear_lengths(rod_of, params, shortenings, rows)
    return Linearised(
        states, ends, rates[..., :size], rates[..., size:], tip, tip_rates, clamp_error, clamp_rates, lengths,
        _error(rod, states, ends, length_errors(rod, shortenings)), progress.over_all(),
    )  # fmt: skip


def _march(
    growth: Array, jumps: Array, tip: Array, start: Array, clamp: Array
) -> tuple[Float[Array, "nodes size columns"], Float[Array, "unknowns unknowns"]]:
    """du with du_i+1 = growth_i du_i + jumps_i, du_0 = tip w + start and the pose of du_n = clamp."""
    unknowns = tip.shape[1]

    def split(basis: Array, rest: Array) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        basis, triangle = _orthonormal(basis)
        along = basis.T @ rest
        return (basis, rest - basis @ along), (triangle, along)

    def onward(carry: tuple, interval: tuple) -> tuple:
        basis, rest = carry
        matrix, jump = interval
        after, taken = split(matrix @ basis, matrix @ rest + jump)
        return after, (carry, taken)

    def back(w: Array, taken: tuple) -> tuple[Array, Array]:
        triangle, along = taken
        w = solve_columns(triangle, w - along)
        return w, w

    first, _ = split(tip, start)
    last, (bases, taken) = lax.scan(onward, first, (growth, jumps))
    jacobian = last[0][:unknowns]
    at_base = solve_columns(jacobian, clamp - last[1][:unknowns])
    _, w = lax.scan(back, at_base, taken, reverse=True)
    basis, rest = jax.tree.map(lambda before, end: jnp.concatenate([before, end[None]]), bases, last)
    return basis @ jnp.concatenate([w, at_base[None]]) + rest, jacobian


def _orthonormal(matrix: Float[Array, "size unknowns"]) -> tuple[Array, Array]:
    """Q and upper triangular R, its diagonal positive, with Q R = matrix: Gram-Schmidt, for one or three columns."""
    columns, triangle = [], jnp.zeros((matrix.shape[1], matrix.shape[1]))
    for j in range(matrix.shape[1]):
        column = matrix[:, j]
        for i, other in enumerate(columns):
            part = other @ column
            column, triangle = column - part * other, triangle.at[i, j].set(part)
        length = jnp.sqrt(column @ column)
        columns.append(column / length)
        triangle = triangle.at[j, j].set(length)
    return jnp.stack(columns, axis=1), triangle


def _integrate_all(
    rod: Rod, nodes: Nodes, method: Shooting, points: Float[Array, " points"] | None = None
) -> tuple[Stretch, Float[Array, "intervals size"]]:
    """Every interval, side by side, and the states at the ends of all as the next node has them."""
    s, active = _mesh(rod, nodes.cuts)
    start = jax.vmap(lambda s, u: _state(rod, u, s))(s[:-1], nodes.states[:-1])
    stretches = jax.vmap(lambda u, begin, end, active: integrate(rod, u, begin, end, active, method, points))(
        start, s[:-1], s[1:], active
    )
    return stretches, jax.vmap(lambda s, end: _vector(rod, end, s))(s[1:], stretches.end)


def _cut_anew(rod: Rod, nodes: Nodes) -> Nodes:
    """Cuts that share out evenly the lengths over which the state changes, and the states there by cubics through the
    nodes and their slopes."""
    (s, active), length = _mesh(rod, nodes.cuts), rod.arm.length
    step = s[1:] - s[:-1]
    physical = jax.vmap(lambda s, u: u * _units(rod, s))(s, nodes.states)

    def slope(s: Array, u: Array, active: Array) -> Array:
        return _components(rod, derivative(rod, s, _state(rod, u, s), active)[0])

    at = (
        jnp.concatenate([s[:-1], s[1:]]),
        jnp.concatenate([nodes.states[:-1], nodes.states[1:]]),
        jnp.tile(active, (2, 1)),
    )
    # where the prediction lies beyond a fold there is no slope; the integration will say so
    first, last = jnp.split(jnp.nan_to_num(jax.vmap(slope)(*at)), 2)

    force = jnp.sqrt(physical[:, -3] ** 2 + physical[:, -2] ** 2)
    bending = jax.vmap(lambda s: stiffness_at(rod.arm, s).bending)(s)
    pull = jnp.sqrt(force / bending)
    density = 2 / length + (pull[1:] + pull[:-1]) / 2 + (jnp.abs(first[:, 0]) + jnp.abs(last[:, 0])) / 4
    total = jnp.concatenate([jnp.zeros(1), jnp.cumsum(-step * density)])
    cuts = jnp.interp(jnp.linspace(0.0, 1.0, nodes.cuts.size + 2)[1:-1] * total[-1], total, s) / length

    target, _ = _mesh(rod, cuts)
    i = jnp.clip(jnp.searchsorted(-s, -target) - 1, 0, step.size - 1)
    h = jnp.where(step[i] < 0, step[i], -1.0)[:, None]  # an interval between equal ends has no length
    t = jnp.clip((target - s[i])[:, None] / h, 0.0, 1.0)
    begin, end = physical[i], physical[i + 1]
    cubic = begin * (1 + 2 * t) * (1 - t) ** 2 + end * t**2 * (3 - 2 * t)
    cubic += h * t * (1 - t) * (first[i] * (1 - t) - last[i] * t)
    return Nodes(cuts, cubic / jax.vmap(lambda s: _units(rod, s))(target), nodes.tensions)


def _mesh(rod: Rod, cuts: Float[Array, " cuts"]) -> tuple[Float[Array, " nodes"], Bool[Array, "intervals muscles"]]:
    """Arc lengths [m] of all nodes, from the tip to the base, and the muscles that are active between them."""
    return active_stretches(rod.muscles, rod.arm, cuts * rod.arm.length)


def _error(rod: Rod, states: Array, ends: Array, lengths: list) -> Float[Array, ""]:
    """The largest error of the clamp, of lengths, and of a state that meets the next, in parts of it if it is large."""
    met = jnp.max(jnp.abs(ends - states[1:]) / (1 + jnp.abs(states[1:])))
    largest = jnp.maximum(met, jnp.max(jnp.abs(states[-1, : rod.unknowns] - _clamp(rod))))
    return jnp.max(jnp.stack([largest, *(jnp.abs(error) for error, _ in lengths)])) if lengths else largest


def _clamp(rod: Rod) -> Float[Array, " unknowns"]:
    return jnp.stack([jnp.asarray(rod.arm.base_angle, float), jnp.zeros(()), jnp.zeros(())])[: rod.unknowns]


def _intervals(method: Shooting) -> int:
    assert method.intervals is not None
    return method.intervals


def _units(rod: Rod, s: Scalar) -> Float[Array, " size"]:
    length, bending = rod.arm.length, stiffness_at(rod.arm, s).bending
    force, one = bending / length**2, jnp.ones(())
    pose = [one, length, length][: rod.unknowns]
    return lax.stop_gradient(jnp.stack([*pose, force, force, bending / length]))


def _components(rod: Rod, state: RodState) -> Float[Array, " size"]:
    pose = [state.theta, state.x, state.y][: rod.unknowns]
    return jnp.stack([*pose, state.force_x, state.force_y, state.moment])


def _vector(rod: Rod, state: RodState, s: Scalar) -> Float[Array, " size"]:
    return _components(rod, state) / _units(rod, s)


def _state(rod: Rod, vector: Float[Array, " size"], s: Scalar) -> RodState:
    theta, *place, force_x, force_y, moment = list(vector * _units(rod, s))
    x, y = place if place else jnp.zeros(2)
    none = tuple(jnp.zeros_like(theta) for _ in rod.length_controlled) or None
    return RodState(x, y, theta, jnp.cos(theta), jnp.sin(theta), force_x, force_y, moment, none)
