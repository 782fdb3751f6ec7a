"""What one would write without the package: plain single shooting from the base."""

import time
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from collocation import Tip

from cosserat_jax import Scene
from cosserat_jax.physics.rod import Rod, RodState, derivative, restarted
from cosserat_jax.physics.section_laws import ReferenceSection
from cosserat_jax.physics.segments import segments_of

BATCH = 64


def stacked(scenes: list[Scene]) -> Scene:
    """Scenes of one structure as one, with an axis in front of every number."""
    return jax.tree.map(lambda *leaves: jnp.asarray(leaves, float), *scenes)


def by_structure(scenes: list[Scene]) -> list[list[int]]:
    """The numbers of the scenes, those that one program serves together."""
    groups: dict[Any, list[int]] = {}
    for number, scene in enumerate(scenes):
        groups.setdefault(jax.tree.structure(scene), []).append(number)
    return list(groups.values())


@eqx.filter_jit
def shoot_from_base(scenes: Scene) -> tuple[jax.Array, ...]:
    """(found, x, y) of each rod by Newton on force and moment at the base, cold at full load, 20 times at most."""

    def one(scene: Scene) -> tuple[jax.Array, ...]:
        rod = Rod.of(scene)
        length, bending = rod.length, rod.law.stiffness(ReferenceSection(0.0, rod.base_radius)).bending
        units = jnp.stack([bending / length**2, bending / length**2, bending / length])
        ends, active = jax.tree.map(lambda part: part[::-1], segments_of(rod.tendons, length))

        def at_tip(clamp: jax.Array) -> tuple[RodState, jax.Array]:
            def segment(state: RodState, span: tuple) -> tuple[RodState, jax.Array]:
                begin, end, active = span
                state = restarted(rod, begin, state, active)

                def slope(tau: Any, state: Any, _: Any) -> RodState:
                    d_ds = derivative(rod, begin + (end - begin) * tau, state, active)[0]
                    return jax.tree.map(lambda d: d * (end - begin), d_ds)

                run = diffrax.diffeqsolve(
                    diffrax.ODETerm(slope), diffrax.Dopri8(), 0.0, 1.0, 0.1, state, max_steps=200, throw=False,
                    stepsize_controller=diffrax.PIDController(1e-9, 1e-9, dtmin=1e-6, force_dtmin=False),
                    adjoint=diffrax.ForwardMode(),
                )  # fmt: skip
                return jax.tree.map(lambda y: y[-1], run.ys), run.result == diffrax.RESULTS.successful

            zero, angle, beta = jnp.zeros(()), rod.base_angle, None if rod.is_rigid else jnp.ones(())
            start = RodState(zero, zero, angle + zero, jnp.cos(angle), jnp.sin(angle), *(clamp * units), beta)
            state, finished = jax.lax.scan(segment, start, (ends[:-1], ends[1:], active))
            return state, finished.all()

        def unbalanced(clamp: jax.Array, _: Any) -> jax.Array:
            state, _ = at_tip(clamp)
            return jnp.stack([state.force_x, state.force_y, state.moment]) / units

        newton = optx.Newton(rtol=1e-9, atol=1e-9)
        root = optx.root_find(unbalanced, newton, jnp.zeros(3), options={"jac": "fwd"}, max_steps=20, throw=False)
        state, finished = at_tip(root.value)
        small = jnp.max(jnp.abs(unbalanced(root.value, None))) < 1e-6
        return finished & small, state.x, state.y

    return jax.vmap(one)(scenes)


def from_base(scenes: list[Scene]) -> tuple[list[Tip], float]:
    """The tips that plain shooting from the base finds, and the seconds, compiling apart."""
    tips: dict[int, Tip] = {}
    spent = 0.0
    for numbers in by_structure(scenes):
        shoot_from_base(stacked([scenes[numbers[0]]] * BATCH))
        for start in range(0, len(numbers), BATCH):
            some = numbers[start : start + BATCH]
            begin = time.perf_counter()
            found, x, y = map(np.asarray, shoot_from_base(stacked([scenes[i] for i in np.resize(some, BATCH)])))
            seconds = time.perf_counter() - begin
            spent += seconds * len(some) / BATCH
            tips |= {i: Tip(bool(found[j]), x[j], y[j], "", seconds / BATCH) for j, i in enumerate(some)}
    return [tips[i] for i in range(len(scenes))], spent
