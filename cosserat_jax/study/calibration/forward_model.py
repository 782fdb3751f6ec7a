"""What a scene says that was measured: one value for each measurement, as a function of the scene's numbers."""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ...scene import Sampled, Scene, replace
from ...solver import Method, Response, ResponseOutcome, Solution, TimeStepping, solve, tcam_response
from ..actuate import with_tensions
from .measurements import Measurements, Observable, markers_of


class Prediction(NamedTuple):
    """The value of every observable in every row, in SI, and which rows have one: the others are NaN."""

    values: Float[Array, "rows observables"]
    found: Bool[Array, " rows"]


class Model(eqx.Module):
    """The rows of some measurements as a function of the scene, `model(scene)`, and nothing that they do not ask for.

    Rows with the same inputs share one equilibrium, `rod_of_row`. Works under JAX's transformations, with respect to
    every float of the scene.
    """

    observables: tuple[Observable, ...] = eqx.field(static=True)
    rod_of_row: tuple[int, ...] = eqx.field(static=True)
    inputs: dict[str, Float[Array, " rods"]]
    times: Float[Array, " rows"] | None
    voltages: dict[int, Float[Array, " rows"]]
    method: Method
    places: tuple[float, ...] = eqx.field(static=True)
    stepping: dict[int, TimeStepping]

    @classmethod
    def of(cls, scene: Scene, measured: Measurements, method: Method) -> "Model":
        """The model of these measurements. How a TCAM is stepped through time is settled by its constants in `scene`,
        and is not seen to between the measurements."""
        driven = {i: muscle.tcam for i, muscle in enumerate(scene.muscles) if muscle.tcam is not None}
        inputs, rod_of_row = _distinct(measured)
        places = tuple(marker / float(scene.arm.length) for marker in measured.markers)
        return cls(
            observables=measured.observables,
            inputs={path: jnp.asarray(values) for path, values in inputs.items()},
            rod_of_row=tuple(rod_of_row.tolist()),
            times=None if measured.times is None else jnp.asarray(measured.times - measured.start),
            voltages={i: jnp.asarray(volts) for i, volts in measured.voltages.items()},
            method=method,
            places=(0.0, *places, 1.0),
            stepping={i: dataclasses.replace(TimeStepping.suited_to(tcam), watch=1) for i, tcam in driven.items()},
        )

    def __call__(self, scene: Scene) -> Prediction:
        responses = self._responses(scene)
        of_row = np.array(self.rod_of_row)
        found = jnp.full(of_row.size, True)
        for response in responses.values():
            followed = response.outcome == ResponseOutcome.followed
            found = found & (followed | (response.outcome == ResponseOutcome.overheated))
        solution = None
        if any(observable.muscle is None for observable in self.observables):
            solution = self._equilibria(scene, {i: response.tension for i, response in responses.items()})
            found = found & solution.converged[of_row]
        columns = [self._column(observable, solution, responses) for observable in self.observables]
        return Prediction(jnp.where(found[:, None], jnp.stack(columns, axis=1), jnp.nan), found)

    def _responses(self, scene: Scene) -> dict[int, Response]:
        if self.times is None:
            return {}
        responses = {}
        for i, stepping in self.stepping.items():
            tcam: Any = scene.muscles[i].tcam
            if i in self.voltages:
                tcam = dataclasses.replace(tcam, voltage=Sampled(self.times, self.voltages[i]))
            responses[i] = tcam_response(tcam, self.times, stepping)
        return responses

    def _equilibria(self, scene: Scene, tensions: dict[int, Float[Array, " rows"]]) -> Solution:
        """Of every rod; with TCAMs a rod is a row."""

        def one(inputs: dict, pulls: dict, _: Array) -> Solution:
            rod = replace(with_tensions(scene, pulls), inputs)
            return solve(rod, self.method, points=self.places, throw=False)

        return jax.vmap(one)(self.inputs, tensions, jnp.arange(max(self.rod_of_row) + 1))

    def _column(
        self, observable: Observable, solution: Solution | None, responses: dict[int, Response]
    ) -> Float[Array, " rows"]:
        if observable.muscle is not None:
            return getattr(responses[observable.muscle], observable.field)
        assert solution is not None, "an observable of the arm has its equilibria"
        of_row = np.array(self.rod_of_row)
        if observable.marker is None:
            return getattr(solution.tip, observable.field)[of_row]
        place = 1 + markers_of(self.observables).index(observable.marker)
        return getattr(solution.fields, observable.field)[of_row, place]


def _distinct(measured: Measurements) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """The inputs of the rods that differ, and the number of the rod of every row; over time every row is one."""
    rows = np.arange(len(measured.values))
    if measured.times is not None:
        return measured.inputs, rows
    if not measured.inputs:
        return {}, np.zeros_like(rows)
    table = np.stack(list(measured.inputs.values()), axis=1)
    distinct, rod_of_row = np.unique(table, axis=0, return_inverse=True)
    return dict(zip(measured.inputs, distinct.T, strict=True)), rod_of_row.ravel()
