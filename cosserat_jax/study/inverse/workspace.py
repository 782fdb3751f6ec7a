"""`workspace`: where a point of the arm can be brought, from a grid of what may change; and the arms behind `reach`."""

import dataclasses
from collections.abc import Iterable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float

from ...scene import InputError, Scene, replace
from ...scene.quantity import as_floats
from ...solver import Method, Solution, solve
from ...solver.display import described, values_text
from ...solver.method import methods_of
from ...solver.solve import places_of
from ..free_parameters import Free
from .box_least_squares import Images
from .controls import Control, check_driven, controls_of, steady_with
from .multistart import grid

_BATCH = 32  # rods at a time: one compiled program serves a single target and thousands of rods


@dataclasses.dataclass(frozen=True)
class Workspace:
    """The points of the arm over a grid of the box that the bounds of the free parameters make.

    - `values`: {path: (rods,)} [SI]. `shape`: that of the grid, the first path outermost; None for scattered points,
      which the box of more than five parameters is filled with.
    - `at`: the arc lengths s [m] of the points; `points` [m], NaN for a rod that has no equilibrium.
    """

    scene: Scene
    free: tuple[Free, ...]
    at: Float[np.ndarray, " at"]
    values: dict[str, Float[np.ndarray, " rods"]]
    shape: tuple[int, ...] | None
    points: Float[np.ndarray, "rods at 2"]

    def _text(self) -> str:
        lost = f", {np.sum(~self.converged)} without equilibrium" if not self.converged.all() else ""
        lines = [f"Workspace of {self.converged.size} rods: {np.sum(self.converged)} converged{lost}"]
        for one in self.free:
            lines.append(f"  {one.path}: {values_text(self.values[one.path], one.unit)}")
        x, y = (values_text(self.points[..., i], "m") for i in range(2))
        return "\n".join([*lines, f"  points at s={values_text(self.at, 'm')}: x={x}, y={y}"])

    __repr__ = described(_text, ("at", "values", "points"))

    @property
    def converged(self) -> Bool[np.ndarray, " rods"]:
        """Which rods have an equilibrium."""
        return np.isfinite(self.points[:, 0, 0])


def workspace(
    scene: Scene,
    free: Iterable[str] | Mapping[str, Any],
    at: ArrayLike | None = None,
    method: Method | None = None,
    *,
    count: int = 256,
) -> Workspace:
    """Where the tip, or the points `at` arc lengths s [m], can be brought: at most `count` rods over the box.

    `free` and what is raised are those of `reach`. All rods are solved by the program that `reach` runs, so that one of
    the two compiles for both.
    """
    arms = Arms.of(scene, free, at, method)
    box, shape = grid(len(arms.controls), count)
    return arms.workspace(box, shape, arms.images(box))


@dataclasses.dataclass(frozen=True)
class Arms:
    """The arms of a scene over the box [0, 1]^n of its controls: their points, exact rates, and equilibria."""

    scene: Scene
    controls: tuple[Control, ...]
    at: Float[np.ndarray, " at"]
    method: Method
    points: tuple[float, ...]
    places: tuple[int, ...]

    @classmethod
    def of(
        cls, scene: Scene, free: Iterable[str] | Mapping[str, Any], at: ArrayLike | None, method: Method | None
    ) -> "Arms":
        """Raises `InputError` for controls and arc lengths that are not allowed, and for a scene that is not steady."""
        controls = controls_of(scene, free)
        check_driven(scene, controls)
        arc_lengths = _arc_lengths(scene, at)
        points, places = _with_places(arc_lengths / float(scene.arm.length))
        return cls(scene, controls, arc_lengths, methods_of(method, traced=True)[0], points, places)

    @property
    def length(self) -> float:
        """L [m], the unit in which images are."""
        return float(self.scene.arm.length)

    @property
    def low(self) -> Float[np.ndarray, " n"]:
        """The unknowns [SI] at u = 0."""
        return np.array([control.low for control in self.controls])

    @property
    def width(self) -> Float[np.ndarray, " n"]:
        """The unknowns [SI] at u = 1 less those at u = 0."""
        return np.array([control.high - control.low for control in self.controls])

    @property
    def free(self) -> tuple[Free, ...]:
        """The free parameters with their bounds."""
        return tuple(control.free for control in self.controls)

    def unknowns(self, u: Float[np.ndarray, "rods n"]) -> Float[np.ndarray, "rods n"]:
        """The unknowns [SI] at u, at the bounds to the bit."""
        high = np.array([control.high for control in self.controls])
        return np.where(u == 1, high, self.low + self.width * u)

    def values(self, u: Float[np.ndarray, "... n"]) -> dict[str, Float[np.ndarray, "..."]]:
        """The parameters [SI] by their paths."""
        unknowns = self.unknowns(u)
        return {one.free.path: one.values(unknowns[..., i]) for i, one in enumerate(self.controls)}

    def images(self, u: Float[np.ndarray, "rods n"]) -> Images:
        """The points in lengths of the arm, one after the other, and their rates by u."""
        if len(u) == 0:
            m = 2 * self.at.size
            return Images(np.zeros((0, m)), np.zeros((0, m, len(self.controls))), np.zeros(0, bool))
        points, rates, solution = self._solved(u)
        r = points[:, self.places].reshape(len(u), -1) / self.length
        jacobian = rates[:, self.places].reshape(*r.shape, -1) * self.width / self.length
        return Images(r, jacobian, np.asarray(solution.converged))

    def solutions(self, u: Float[np.ndarray, "rods n"]) -> Solution:
        """The equilibria, as NumPy arrays."""
        return self._solved(u)[-1]

    def workspace(self, u: Float[np.ndarray, "rods n"], shape: tuple[int, ...] | None, images: Images) -> Workspace:
        """The points over these places of the box, which have these images."""
        points = images.r.reshape(len(u), -1, 2) * self.length
        return Workspace(self.scene, self.free, self.at, self.values(u), shape, points)

    def _solved(self, u: np.ndarray) -> Any:
        scene = as_floats(steady_with(self.scene, {}))
        paths = tuple(control.path for control in self.controls)
        unknowns, count = self.unknowns(u), len(u)
        parts = []
        for start in range(0, count, _BATCH):
            rows = np.minimum(np.arange(start, start + _BATCH), count - 1)  # a short batch is filled with its last rod
            parts.append(_solve_batch(scene, paths, jnp.asarray(unknowns[rows]), self.method, self.points))
        return jax.tree.map(lambda *some: np.concatenate([np.asarray(one) for one in some])[:count], *parts)


@eqx.filter_jit
def _solve_batch(
    scene: Scene, paths: tuple[str, ...], values: Float[Array, "rods n"], method: Method, places: tuple[float, ...]
) -> tuple[Float[Array, "rods points 2"], Float[Array, "rods points 2 n"], Solution]:
    """All points [m] of the arms, their rates by the values at `paths`, and the equilibria."""

    def points(values: Array) -> tuple[Array, tuple[Array, Solution]]:
        solution = solve(
            replace(scene, dict(zip(paths, list(values), strict=True))), method, points=places, throw=False
        )
        found = jnp.stack([solution.fields.x, solution.fields.y], axis=-1)
        return found, (found, solution)

    rates, (found, solution) = jax.vmap(jax.jacfwd(points, has_aux=True))(values)
    return found, rates, solution


def _arc_lengths(scene: Scene, at: ArrayLike | None) -> np.ndarray:
    length = float(scene.arm.length)
    places = np.array([length]) if at is None else np.atleast_1d(np.asarray(at, dtype=float))
    if places.ndim != 1 or places.size == 0:
        raise InputError(f"at: of shape {places.shape}; allowed: one arc length, or a list of them")
    bad = ~((places > 0) & (places <= length * (1 + 1e-12)))
    if bad.any():
        raise InputError(f"at: {places[bad][0]:g} [m] is not on the arm; allowed: more than 0 to {length:g} [m]")
    return np.minimum(places, length)


def _with_places(fractions: np.ndarray) -> tuple[tuple[float, ...], tuple[int, ...]]:
    """The points s / L of the solutions, these places among them, and which points they are."""
    points = places_of(101)
    missing = [x for x in dict.fromkeys(fractions.tolist()) if np.abs(points - x).min() > 1e-12]
    points = np.sort(np.append(points, missing))
    return tuple(points.tolist()), tuple(int(np.abs(points - x).argmin()) for x in fractions)
