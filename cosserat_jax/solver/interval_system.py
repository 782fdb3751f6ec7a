"""The system of equations of multiple shooting: the arm cut into intervals, the state at every cut unknown.

With u_i the state at cut i, from the tip, and phi_i the integration onward,

    phi_i(u_i) = u_i+1        u_0 = tip(pose)        pose(u_n) = clamp

is solved by Newton for all u_i at once. Its linear system is solved by a stabilized march (Godunov, "On the numerical
solution of boundary value problems for systems of linear ordinary differential equations", 1961; Conte, "The numerical
solution of linear boundary value problems", 1966): du_i = P_i w_i + c_i, P_i an orthonormal basis of what the tip's
pose can do at cut i, carried to the base, where the clamp gives w_n, and w back to the tip. Unknown tensions border
that system: it is solved for a change of each as well, and the equations of the lengths say how much of each there is.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from ..numerics.linear_systems import solve_columns
from ..numerics.runge_kutta import Nodes as DenseNodes
from ..numerics.runge_kutta import Tableau
from ..physics.rod import Rod, RodState, derivative, restarted
from ..physics.section_laws import ReferenceSection
from ..physics.segments import segments_of
from ..physics.volume import volume_defect
from ..scene.quantity import Scalar
from .integrate import Segment, graded, integrate
from .unknowns import Unknowns

_CONSISTENT = 1e-5  # error of the volume constraint up to which an integration counts


class Nodes(NamedTuple):
    """Where the arm is cut, s / L from the tip to the base without the ends of the arm and of muscles, and the states
    at all of them: (theta, F1, F2, M) or (theta, x, y, F1, F2, M), in the units of the bending stiffness there. And the
    unknown tensions, None without; see `tensions`."""

    cuts: Float[Array, " cuts"]
    states: Float[Array, "nodes size"]
    tensions: Float[Array, " found"] | None = None


def pulled(rod: Rod, nodes: Nodes) -> Rod:
    """The rod with the tensions of the nodes."""
    if nodes.tensions is None:
        return rod
    units = Unknowns.of(rod).tendons
    return rod.with_tensions([unit.tension * t for unit, t in zip(units, list(nodes.tensions), strict=True)])


class Linearized(NamedTuple):
    """The system of multiple shooting at `states`, and its derivatives by the states and by some parameters.

    - `states`: those given, the first one put on the tip's condition. `ends`: phi(u).
    - `growth` d phi / d u, `rates` d phi / d parameters. `tip`, `tip_rates`: d u_0 by the tip's pose, by parameters.
    - `clamp_error`, `clamp_rates`: of the pose at the base.
    - `lengths`: the equations of given displacements, None without; the last parameters are then the unknown tensions.
    """

    states: Float[Array, "nodes size"]
    ends: Float[Array, "intervals size"]
    growth: Float[Array, "intervals size size"]
    rates: Float[Array, "intervals size params"]
    tip: Float[Array, "size unknowns"]
    tip_rates: Float[Array, "size params"]
    clamp_error: Float[Array, " unknowns"]
    clamp_rates: Float[Array, "unknowns params"]
    lengths: "_LinearLengths | None"
    error: Float[Array, ""]
    keeps_volume: Bool[Array, ""]

    def solve(
        self, layout: Unknowns, compliance: Float[Array, "tendons tendons"] | None = None
    ) -> tuple[Float[Array, "nodes size params+1"], Float[Array, "tendons params+1"] | None, Float[Array, "n n"]]:
        """Newton's step and, beside it, d(states)/d(parameters); the same of the tensions, None without; and the
        Jacobian of the clamp's equation, with a block for the lengths, over their `compliance`, where that is given."""
        jumps = jnp.concatenate([(self.ends - self.states[1:])[..., None], self.rates], axis=-1)
        start = jnp.pad(self.tip_rates, ((0, 0), (1, 0)))
        clamp = jnp.concatenate([-self.clamp_error[:, None], self.clamp_rates], axis=-1)
        change, jacobian = _march(self.growth, jumps, self.tip, start, clamp)
        if self.lengths is None:
            return change, None, jacobian
        change, tensions, block = self.lengths.close(change)
        whole = jax.scipy.linalg.block_diag(jacobian, block)
        if compliance is not None:
            whole = layout.over_compliance(whole, compliance, self.lengths.taut)
        return change, tensions, whole


class _LinearLengths(NamedTuple):
    """The equations of the given displacements: error, derivatives by every state and by parameters; which are taut.

    The last of the parameters are the unknown tensions.
    """

    error: Float[Array, " tendons"]
    growth: Float[Array, "intervals tendons size"]
    rates: Float[Array, "tendons params"]
    taut: Bool[Array, " tendons"]

    def close(self, change: Float[Array, "nodes size columns"]) -> tuple[Array, Array, Float[Array, "tendons tendons"]]:
        """From the change of states, Newton's step and one a parameter, those with the tensions following; the changes
        of the tensions, and the Jacobian of lengths by tensions."""
        count = self.error.size
        of_states = jnp.einsum("iks,isc->kc", self.growth, change[:-1])
        columns = of_states + jnp.concatenate([self.error[:, None], self.rates], axis=1)
        jacobian = columns[:, -count:]
        tensions = -solve_columns(jacobian, columns[:, :-count])
        return change[..., :-count] + change[..., -count:] @ tensions, tensions, jacobian


def linearized(
    given: Callable[[Array], Rod], params: Float[Array, " params"], nodes: Nodes, tableau: Tableau, steps: int
) -> Linearized:
    """The system at `nodes` of the rod `given(params)`; see `Linearized`. Unknown tensions join the parameters.

    phi_i depends on u_i alone, so the same change of every state at once shows all blocks of the Jacobian.
    """
    count = params.size
    if nodes.tensions is not None:
        params = jnp.concatenate([params, nodes.tensions])

    def rod_of(params: Array) -> Rod:
        return pulled(
            given(params[:count]), nodes if nodes.tensions is None else nodes._replace(tensions=params[count:])
        )

    size, rod = nodes.states.shape[1], rod_of(params)
    layout = Unknowns.of(rod)
    pose = nodes.states[0, : layout.pose]

    def at_tip(pose: Array, params: Array) -> Array:
        rod = rod_of(params)
        return vector_of(rod, Unknowns.of(rod).tip(rod, pose), rod.length)

    states = nodes.states.at[0].set(at_tip(pose, params))
    tip, tip_rates = jax.jacfwd(at_tip, argnums=(0, 1))(pose, params)

    def along(states_step: Array, params_step: Array) -> tuple:
        def integrated(states: Array, params: Array) -> tuple[tuple, tuple]:
            kept, ends, span = integrate_all(rod_of(params), Nodes(nodes.cuts, states), tableau, steps)
            return (ends, kept.end.shortenings), (kept.end, span)

        steps_along = (jnp.broadcast_to(states_step, states.shape), params_step)
        return jax.jvp(integrated, (states, params), steps_along, has_aux=True)

    both = jnp.eye(size + params.size)
    (ends, shorter), (rates, shorter_rates), (at_end, span) = jax.vmap(along, out_axes=(None, -1, None))(
        both[:, :size], both[:, size:]
    )
    clamp_rates = jax.jacfwd(lambda params: clamp(rod_of(params), layout.pose))(params)
    clamp_error = states[-1, : layout.pose] - clamp(rod, layout.pose)
    shortenings = jax.tree.map(jnp.sum, shorter)
    lengths = None
    if shorter:
        lengths = _linear_lengths(rod_of, params, shortenings, jnp.stack(shorter_rates, axis=1))
    error = largest_error(rod, layout, states, ends, shortenings)
    return Linearized(
        states, ends, rates[..., :size], rates[..., size:], tip, tip_rates, clamp_error, clamp_rates, lengths, error,
        _keeps_volume(rod, at_end, span),
    )  # fmt: skip


def _keeps_volume(rod: Rod, state: RodState, span: Segment) -> Bool[Array, ""]:
    """Whether the sections at the ends of all intervals keep their volume, short of a fold."""
    if rod.is_rigid:
        return jnp.asarray(True)
    _, section, margin = derivative(rod, span.end, state, span.active)
    defect = volume_defect(section.nu, section.mu, section.beta, section.surface)
    return ((jnp.abs(defect) < _CONSISTENT) & (margin > 0)).all()


def _linear_lengths(
    rod_of: Callable[[Array], Rod],
    params: Array,
    shortenings: Any,
    rates: Float[Array, "intervals tendons size+params"],
) -> _LinearLengths:
    """The equations of the lengths, from how much shorter every interval's part of the tendons is, by state and by
    parameters."""

    def errors(shortenings: Any, params: Array) -> Array:
        rod = rod_of(params)
        return jnp.stack([error for error, _ in Unknowns.of(rod).length_errors(rod, shortenings)])

    by_shortening, by_params = jax.jacfwd(errors, argnums=(0, 1))(shortenings, params)
    rates = jnp.einsum("kj,ijp->ikp", jnp.stack(by_shortening, axis=1), rates)
    rod = rod_of(params)
    return _LinearLengths(
        error=errors(shortenings, params),
        growth=rates[..., : -params.size],
        rates=by_params + rates[..., -params.size :].sum(axis=0),
        taut=Unknowns.of(rod).taut(rod, shortenings, ()),
    )


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


def integrate_all(
    rod: Rod, nodes: Nodes, tableau: Tableau, steps: int
) -> tuple[DenseNodes, Float[Array, "intervals size"], Segment]:
    """Every interval, side by side as a batch; the states at the ends of all as the next node has them; where they
    are."""
    s, active = mesh(rod, nodes.cuts)
    span = Segment(s[:-1], s[1:], active, graded(rod, s[:-1], s[1:]))
    start = restarted(rod, span.start, state_of(rod, nodes.states[:-1], span.start), active)
    room = jax.tree.map(lambda leaf: jnp.zeros((steps + 1, *leaf.shape)), start)
    kept = integrate(rod, start, span, tableau, jnp.asarray(steps), (room, room), steps)
    return kept, vector_of(rod, kept.end, span.end), span


def cut_anew(rod: Rod, nodes: Nodes) -> Nodes:
    """Cuts that share out evenly the lengths over which the state changes, and the states there by cubics through the
    nodes and their slopes."""
    (s, active), length = mesh(rod, nodes.cuts), rod.length
    step = s[1:] - s[:-1]
    physical = nodes.states * units_at(rod, s, nodes.states.shape[1] - 3)

    def slopes(s: Array, u: Array) -> Array:
        state = restarted(rod, s, state_of(rod, u / units_at(rod, s, u.shape[1] - 3), s), active)
        rates = derivative(rod, s, state, active)[0]
        return _components(jax.tree.map(lambda d: jnp.broadcast_to(d, s.shape), rates), u.shape[1] - 3)

    # where the prediction lies beyond a fold there is no slope; the integration will say so
    first = jnp.nan_to_num(slopes(s[:-1], physical[:-1]))
    last = jnp.nan_to_num(slopes(s[1:], physical[1:]))

    force = jnp.sqrt(physical[:, -3] ** 2 + physical[:, -2] ** 2)
    pull = jnp.sqrt(force / _bending(rod, s))
    density = 2 / length + (pull[1:] + pull[:-1]) / 2 + (jnp.abs(first[:, 0]) + jnp.abs(last[:, 0])) / 4
    total = jnp.concatenate([jnp.zeros(1), jnp.cumsum(-step * density)])
    cuts = jnp.interp(jnp.linspace(0.0, 1.0, nodes.cuts.size + 2)[1:-1] * total[-1], total, s) / length

    target, _ = mesh(rod, cuts)
    i = jnp.clip(jnp.searchsorted(-s, -target) - 1, 0, step.size - 1)
    h = jnp.where(step[i] < 0, step[i], -1.0)[:, None]  # an interval between equal ends has no length
    t = jnp.clip((target - s[i])[:, None] / h, 0.0, 1.0)
    begin, end = physical[i], physical[i + 1]
    cubic = begin * (1 + 2 * t) * (1 - t) ** 2 + end * t**2 * (3 - 2 * t)
    cubic += h * t * (1 - t) * (first[i] * (1 - t) - last[i] * t)
    return Nodes(cuts, cubic / units_at(rod, target, nodes.states.shape[1] - 3), nodes.tensions)


def mesh(rod: Rod, cuts: Float[Array, " cuts"]) -> tuple[Float[Array, " nodes"], tuple[Bool[Array, " intervals"], ...]]:
    """Arc lengths [m] of all nodes, from the tip to the base, and the tendons that are active between them."""
    s, active = segments_of(rod.tendons, rod.length, cuts * rod.length)
    return s, tuple(jnp.broadcast_to(a, (s.size - 1,)) for a in active)


def largest_error(rod: Rod, layout: Unknowns, states: Array, ends: Array, shortenings: Any) -> Float[Array, ""]:
    """The largest error of the clamp, of lengths, and of a state that meets the next, in parts of it if it is large."""
    met = jnp.max(jnp.abs(ends - states[1:]) / (1 + jnp.abs(states[1:])))
    clamped = jnp.max(jnp.abs(states[-1, : layout.pose] - clamp(rod, layout.pose)))
    lengths = [jnp.abs(error) for error, _ in layout.length_errors(rod, shortenings)]
    return jnp.max(jnp.stack([met, clamped, *lengths]))


def clamp(rod: Rod, pose: int) -> Float[Array, " pose"]:
    """The pose of the base."""
    return jnp.stack([jnp.asarray(rod.base_angle, float), jnp.zeros(()), jnp.zeros(())])[:pose]


def _bending(rod: Rod, s: Any) -> Array:
    bending = rod.law.stiffness(ReferenceSection(s, rod.radius_at(s))).bending
    return jnp.broadcast_to(bending, jnp.shape(s))


def units_at(rod: Rod, s: Any, pose: int) -> Float[Array, "nodes size"]:
    """Of the states: radians and lengths of the arm, E J / L^2, E J / L."""
    length, bending = jnp.broadcast_to(rod.length, jnp.shape(s)), _bending(rod, s)
    force, one = bending / length**2, jnp.ones_like(bending)
    return lax.stop_gradient(jnp.stack([*[one, length, length][:pose], force, force, bending / length], axis=-1))


def _components(state: RodState, pose: int) -> Float[Array, "nodes size"]:
    return jnp.stack([*[state.theta, state.x, state.y][:pose], state.force_x, state.force_y, state.moment], axis=-1)


def vector_of(rod: Rod, state: RodState, s: Any) -> Float[Array, "nodes size"]:
    """States at `s` in their units."""
    pose = 3 if rod.depends_on_position else 1
    return _components(state, pose) / units_at(rod, s, pose)


def state_of(rod: Rod, vector: Float[Array, "nodes size"], s: Scalar) -> RodState:
    """The states that vectors at `s` stand for, with the beta of the unloaded section; see `restarted`."""
    theta, *place, force_x, force_y, moment = jnp.moveaxis(vector * units_at(rod, s, vector.shape[-1] - 3), -1, 0)
    zero = jnp.zeros_like(theta)
    x, y = place if place else (zero, zero)
    beta = None if rod.is_rigid else zero + 1
    shortenings = tuple(zero for _ in rod.displaced)
    return RodState(x, y, theta, jnp.cos(theta), jnp.sin(theta), force_x, force_y, moment, beta, shortenings)
