"""`solve`: the one entry point from a scene to its equilibrium."""

import functools as ft
import itertools
import logging
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from ..numerics import batching
from ..scene import InputError, Scene
from ..scene.quantity import as_floats, is_traced
from .equilibrium import Equilibrium, equilibrium
from .method import Method, MultipleShooting, SingleShooting, methods_of, tableau_of
from .multiple_shooting import multiple_shooting
from .outcome import Outcome, code_of, from_codes
from .outputs import FIELDS, TIP, Report, Structure
from .solution import Fields, Pose, SectionStrains, Solution

LOG = logging.getLogger("cosserat_jax")
_FINAL = (code_of(Outcome.converged), code_of(Outcome.bad_input), code_of(Outcome.muscles_redundant))
_ENDS = (  # of a branch, and of what is worth trying
    code_of(Outcome.limit_point),
    code_of(Outcome.volume_constraint_folded),
    code_of(Outcome.tendon_length_zero),
    code_of(Outcome.iterations_exhausted),
)


class SolveError(RuntimeError):
    """A rod has no solution; the message says why and what to do."""


def solve(
    scene: Scene, method: Method | None = None, *, points: int | tuple[float, ...] = 101, throw: bool = True
) -> Solution:
    """The static equilibrium of `scene` that raising all its loads in proportion from zero leads to.

    Under `jit` and `vmap` only single shooting is used, the `traced` method of `Automatic`, for it takes values to know
    which rods that has lost. Otherwise `solve` does the same under `jax.jit`, `vmap`, `grad`, `jacfwd` and any nesting
    of them; derivatives with respect to every float of the scene are those of the implicit function theorem, forward
    for a few directions and backward, by the discrete adjoint, at a cost that the number of parameters does not change.

    **Arguments:**

    - `scene`: the arm, its muscles and loads.
    - `method`: a `SingleShooting`, a `MultipleShooting`, or by default `Automatic()`.
    - `points`: where the solution holds its fields: a number of equally spaced points from s = 0 to L, or a tuple of
      places s / L, ascending from 0 to 1.
    - `throw`: whether to raise if the rod has no solution. While JAX is tracing nothing can raise: look at
      `Solution.outcome`, and expect NaN in a rod that has no solution and in its derivatives.

    **Returns:** a `Solution`.

    **Raises:** `SolveError` with the outcome's sentence if the rod has no solution; `RuntimeError` if double precision
    is off; `InputError` for a scene with a muscle that a TCAM drives: its tension changes with time, which is what
    `actuate` is for.
    """
    if not jax.config.read("jax_enable_x64"):
        raise RuntimeError('cosserat_jax needs double precision: undo jax.config.update("jax_enable_x64", False)')
    check_steady(scene)
    traced = is_traced(scene)
    methods = methods_of(method, traced=traced)
    places = places_of(points)
    if traced:
        return solve_once(as_floats(scene), methods[0], places)
    solution = solve_once(scene, methods[0], places)
    for before, harder in itertools.pairwise(methods):
        if not is_lost(solution, before):
            break
        LOG.info("trying %s ...", harder)
        solution = solve_once(scene, harder, places)
    if throw and int(lax.stop_gradient(solution.outcome._value)) != 0:
        raise SolveError(solution.message)
    return solution


def check_steady(scene: Scene) -> None:
    """Raises `InputError` for a scene whose equilibrium changes with time."""
    for i, muscle in enumerate(scene.muscles):
        if muscle.tcam is not None:
            raise InputError(f"muscles.{i}.tcam: makes a tension that changes with time; allowed: actuate")


def places_of(points: int | tuple[float, ...]) -> Float[np.ndarray, " points"]:
    """The places s / L at which a solution holds its fields."""
    places = np.linspace(0.0, 1.0, points) if isinstance(points, int) else np.array(points, float)
    if places.ndim != 1 or places.size == 0 or not ((places >= 0) & (places <= 1)).all() or (np.diff(places) < 0).any():
        raise ValueError(f"points must be a positive number or ascending places s / L from 0 to 1, but are {points}")
    return places


def is_lost(solution: Solution, method: SingleShooting | MultipleShooting) -> Any:
    """Which rods the method did not solve that a harder one might. Multiple shooting is believed where it finds that
    the branch ends, and not tried again where it has used up its iterations."""
    codes = lax.stop_gradient(solution.outcome._value)
    return ~np.isin(np.asarray(codes), _FINAL + _ENDS * isinstance(method, MultipleShooting))


def solve_once(scene: Scene, method: SingleShooting | MultipleShooting, places: Any) -> Solution:
    """The solution by one method, whatever its outcome."""
    if isinstance(method, MultipleShooting):
        return solution_of(multiple_shooting(as_floats(scene), jnp.asarray(places), method))
    leaves, tree = jax.tree.flatten(scene)
    leaves = [leaf if isinstance(leaf, jax.Array) else np.asarray(leaf, float) for leaf in leaves]
    structure = Structure(tree, tuple(np.ndim(leaf) for leaf in leaves), tableau_of(method.solver), *method.rooms)
    return _jitted(structure, method.settings, places, leaves)


@ft.partial(jax.jit, static_argnums=0)
def _jitted(structure: Structure, settings: Array, places: Array, leaves: list[Array]) -> Solution:
    return solution_of(equilibrium(structure, settings, places, leaves))


def solve_batch(scene: Scene, method: SingleShooting | MultipleShooting, places: Any) -> Solution:
    """The solutions, rods first, of a scene of which some floats are arrays [rods]; those of the others all share.

    The same program as that of `jax.vmap(solve)`.
    """
    leaves, tree = jax.tree.flatten(scene)
    if isinstance(method, MultipleShooting):
        axes = [0 if np.ndim(leaf) else None for leaf in leaves]
        one = ft.partial(solve_once, method=method, places=places)
        return jax.vmap(lambda leaves: one(jax.tree.unflatten(tree, leaves)), in_axes=(axes,))(leaves)
    structure = Structure(tree, (0,) * len(leaves), tableau_of(method.solver), *method.rooms)
    if is_traced(scene):
        axes = [0 if np.ndim(leaf) else None for leaf in leaves]
        one = ft.partial(equilibrium, structure, method.settings, places)
        return jax.vmap(lambda leaves: solution_of(one(leaves)), in_axes=(axes,))(leaves)
    report = _jitted_batch(structure, method.settings, places, [np.asarray(leaf, float) for leaf in leaves])
    # to NumPy as a whole, for JAX copies every row that it takes from an array
    return solution_of(jax.tree.map(np.asarray, report), batch_first=lambda values: np.moveaxis(values, -1, 0))


@ft.partial(jax.jit, static_argnums=0)
def _jitted_batch(structure: Structure, settings: Array, places: Array, leaves: list[Array]) -> Report:
    return Report(*batching.apply(Equilibrium(structure), settings, places, *leaves))


def solution_of(report: Report, batch_first: Callable[[Any], Any] = lambda values: values) -> Solution:
    """The `Solution` that a report makes, of one rod, or of many with a function that puts the rods first."""
    at = jax.tree.map(batch_first, report._replace(tip=list(report.tip), fields=list(report.fields)))
    tip = dict(zip(TIP, at.tip, strict=True))
    return Solution(
        tip=Pose(tip["x"], tip["y"], tip["theta"]),
        tip_strain=SectionStrains(tip["nu"], tip["eta"], tip["mu"], tip["beta"]),
        fields=Fields(**dict(zip(FIELDS, at.fields, strict=True))),
        outcome=from_codes(Outcome, at.outcome),
        residual=at.residual,
        error=at.error,
        condition=at.condition,
        iterations=at.iterations,
        steps=at.steps,
        load_fraction=at.load_fraction,
        failed_at=at.failed_at,
        tensions=at.tensions,
    )


def empty_solution() -> Solution:
    """A solution of zeros, for its structure."""
    return solution_of(Report(np.zeros(len(TIP)), np.zeros(0), np.zeros((len(FIELDS), 0)), *[np.zeros(())] * 9))  # pyright: ignore[reportArgumentType]
