"""`actuate`: from the voltage on the muscles to the motion of the arm."""

import dataclasses
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from ..scene import TCAM, InputError, Scene
from ..scene.quantity import as_floats
from ..solver import Method, Outcome, Response, ResponseOutcome, Solution, TimeStepping, tcam_response
from ..solver.display import counted, described, values_text
from ..solver.solve import places_of
from .batch import solve_rods

if TYPE_CHECKING:
    import xarray


class Actuation(eqx.Module):
    """An arm driven by TCAMs at `times` [s]: what each muscle did, and the arm's equilibrium at each instant.

    - `responses`: by the number of the muscle in the scene, the `Response` of each that a TCAM drives.
    - `solution`: every array with a leading axis over the times, each instant with its own outcome; one that has no
      equilibrium is NaN and leaves no trace in the others.
    """

    scene: Scene
    times: Float[Array, " times"]
    responses: dict[int, Response]
    solution: Solution

    def _text(self) -> str:
        times = f"{np.shape(self.times)[-1]} instants, {values_text(self.times, 's')}"
        lines = [f"Actuation at {times}: {counted(self.solution.outcome, Outcome)}"]
        for i, response in self.responses.items():
            hottest = f"peak {values_text(response.peak.temperature, 'K')} at {values_text(response.peak.time, 's')}"
            came = counted(response.outcome, ResponseOutcome).removeprefix("1 ")
            lines.append(f"  muscles.{i}: {came}, {hottest}, tension {values_text(response.tension, 'N')}")
        return "\n".join([*lines, f"  tip: {self.solution.tip}"])

    __repr__ = described(_text, ("times", "responses", "solution"))

    def tcam(self, i: int) -> TCAM:
        """The TCAM of the driven muscle `i`."""
        tcam = self.scene.muscles[i].tcam
        assert tcam is not None, "a muscle with a response has the TCAM that gave it"
        return tcam

    def to_xarray(self) -> "xarray.Dataset":
        """A dataset over `time` and `s`, the muscles' variables also over `muscle`, with units and long names."""
        from .datasets import actuation_dataset

        return actuation_dataset(self.scene, self.times, self.responses, self.solution)


def actuate(
    scene: Scene, times: ArrayLike, method: Method | None = None, *, stepping: TimeStepping | None = None
) -> Actuation:
    """Voltage to temperature, tension and contraction of every TCAM, and the arm's equilibrium at each of `times` [s].

    The muscles start at t = 0 at ambient temperature; `times` ascend from there. A TCAM pulls with C_T T (paper, Eq.
    CableTensionTCAMs), other muscles as the scene says; the arm follows quasi-statically, all instants in one
    compiled batch. The temperature does not depend on the arm. The contraction is that of the muscle on its own, under
    its hanging mass. `method` is that of `solve`; `stepping` is by default chosen by `TimeStepping.suited_to` for each
    muscle.

    Works under `jit`, `grad`, `jacfwd` and `vmap`, with respect to every float of the scene. Does not raise for what
    comes of it: see `Response.outcome` and `Solution.outcome`. Raises `InputError` for a scene without a TCAM, and for
    times that are not allowed.
    """
    driven: dict[int, TCAM] = {i: muscle.tcam for i, muscle in enumerate(scene.muscles) if muscle.tcam is not None}
    if not driven:
        raise InputError("muscles: none has a tcam; allowed: at least one muscle that a TCAM drives")
    responses = {i: tcam_response(tcam, times, stepping) for i, tcam in driven.items()}
    tensions = {i: response.tension for i, response in responses.items()}
    scene = as_floats(scene)
    # in the place of none, unchecked: a muscle that makes no tension is marked, and does not raise
    steady = with_tensions(scene, dict.fromkeys(tensions, 0.0))
    rods = eqx.tree_at(lambda scene: [scene.muscles[i].tension for i in tensions], steady, list(tensions.values()))
    solution = solve_rods(rods, method, places_of(101), np.size(times))
    return Actuation(scene, jnp.asarray(times, float), responses, solution)


def with_tensions(scene: Scene, tensions: dict[int, Any]) -> Scene:
    """`scene` with these tensions [N], by the number of the muscle, in place of what makes them."""
    muscles = [
        dataclasses.replace(muscle, tension=tensions[i], tcam=None, displacement=None) if i in tensions else muscle
        for i, muscle in enumerate(scene.muscles)
    ]
    return dataclasses.replace(scene, muscles=tuple(muscles))
