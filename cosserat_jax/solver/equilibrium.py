"""The equilibria of a batch of scenes as one differentiable operation, and what is computed there."""

import dataclasses
import functools as ft
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import ShapedArray
from jaxtyping import Array

from ..numerics import batching
from ..physics.rod import Rod
from ..scene import Scene
from . import sensitivities
from .outputs import FIELDS, TIP, Report, Structure, along, arc_lengths, outcome_of
from .single_shooting import Settings, find
from .unknowns import Unknowns


@dataclasses.dataclass(frozen=True)
class Equilibrium(batching.BatchFunction):
    """From the numbers of the method, the places s / L of the fields, and the floats of a scene to a `Report`."""

    structure: Structure
    chunk: int = 256

    @property
    def ranks(self) -> tuple[int, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        return (1, 1, *self.structure.ranks)

    def results(self, *shapes: tuple[int, ...]) -> list[ShapedArray]:
        scene = self.structure.scene([jax.ShapeDtypeStruct(shape, float) for shape in shapes[2:]])
        points, muscles = shapes[1][0], len(scene.muscles)
        n = unknowns_of(scene) + 1
        floats = [(len(TIP),), (muscles,), (len(FIELDS), points), (n,), (), (), (), (), ()]
        real, whole = jnp.dtype(float), jnp.dtype(int)
        return [ShapedArray(shape, real) for shape in floats] + [ShapedArray((), whole)] * 3

    def compute(self, *arguments: Array) -> list[Array]:
        settings, places, *leaves = arguments
        batch = next(a.shape[-1] for a, r in zip(arguments, self.ranks, strict=True) if a.ndim > r)
        scene = self.structure.scene(leaves)
        coarse, error, newton_tol, max_iterations, min_load_step, grids = (settings[i] for i in range(6))
        given = Settings(coarse, grids, settings[6:], error, newton_tol, max_iterations, min_load_step)
        found = find(
            scene, given, self.structure.tableau, self.structure.most, self.structure.coarse_most, batch
        )  # fmt: skip
        rod, trajectory = found.rod, found.trajectory
        s = arc_lengths(places, rod.length, batch)
        # the tip is looked at beside the points
        tip_s = jnp.broadcast_to(jnp.asarray(rod.length, float), s.shape[1:])[None]
        values, margin, defect, lost, base = along(rod, trajectory, found.change, jnp.concatenate([s, tip_s]), batch)
        fields, at_tip = values[:, :-1], values[:, -1]
        tip = at_tip[jnp.array([FIELDS.index(name) for name in TIP])]
        tensions = Unknowns.of(rod).tensions(rod, base.shortenings, (batch,))

        outcome, failed_at, condition = outcome_of(
            rod, found.outcome, values[0], margin, defect, lost, found.residual, found.error, error, found.jacobian
        )
        known = jnp.where(outcome == 0, 1.0, jnp.nan)
        root = jnp.concatenate([found.unknowns, jnp.broadcast_to(found.steps, (1, batch))])
        whole = [jnp.broadcast_to(a, (batch,)).astype(int) for a in (outcome, found.iterations, found.steps)]
        return [
            tip * known, tensions * known, fields * known, root * known, found.residual, found.error, condition,
            found.load_fraction, failed_at, *whole,
        ]  # fmt: skip


def unknowns_of(scene: Scene) -> int:
    """How many unknowns shooting has."""
    rod = eqx.filter_eval_shape(Rod.of, scene)
    return (3 if rod.depends_on_position else 1) + len(rod.displaced)


@ft.partial(jax.custom_jvp, nondiff_argnums=(0,))
def equilibrium(structure: Structure, settings: Array, places: Array, leaves: list[Array]) -> Report:
    """The `Report` of the scene with these floats; derivatives are those of the implicit function theorem."""
    return Report(*batching.apply(Equilibrium(structure), settings, places, *leaves))


@equilibrium.defjvp
def _derivative(structure: Structure, primals: tuple, tangents: tuple) -> tuple:
    settings, places, leaves = primals
    report = equilibrium(structure, settings, places, leaves)
    changes = [jnp.asarray(change) for change in tangents[2]]
    vector = jnp.concatenate([jnp.reshape(change, -1) for change in changes])[None]

    def along(part: str) -> Array:
        function = sensitivities.Tangent(structure, part)
        (change,) = batching.apply(function, places, report.root, *leaves, vector)
        return change[0]

    tip, tensions, unknowns = jnp.split(along("tip"), [len(TIP), len(TIP) + len(report.tensions)])
    return report, jax.tree.map(_no_change, report)._replace(
        tip=tip,
        tensions=tensions,
        fields=along("fields").reshape(report.fields.shape),
        root=jnp.concatenate([unknowns, jnp.zeros(1)]),
    )


def _no_change(leaf: Array) -> Any:
    is_float = jnp.issubdtype(leaf.dtype, jnp.floating)
    return jnp.zeros_like(leaf) if is_float else np.zeros(leaf.shape, jax.dtypes.float0)
