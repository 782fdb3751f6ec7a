"""The least-squares problem of a fit: misfits of all tables as a function of unbounded parameters."""

from collections.abc import Callable
from typing import Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from ...scene import Scene, replace
from ...scene.quantity import as_floats
from ...solver import Method
from ..free_parameters import Unbounded
from .forward_model import Model
from .measurements import Measurements
from .optimizer import AbstractProblem

Loss = Literal["linear", "soft_l1", "huber", "cauchy"] | Callable[[Float[Array, " values"]], Float[Array, ""]]


class Problem(AbstractProblem):
    """The misfits of a scene's models, all tables one after the other, row by row.

    - `observed`: what was measured, NaN where nothing was. `sigma`: the unit of its misfit, its standard error or,
      where that is not known, the spread of all that was measured. `lost`: the misfit where there is no equilibrium.
    - `bend`: the number of the robust loss among `LOSSES`, data to the compiled program; `rho`: a loss of the user's.
    """

    scene: Scene
    models: tuple[Model, ...]
    observed: Float[Array, " values"]
    sigma: Float[Array, " values"]
    lost: Float[Array, " values"]
    bend: Float[Array, ""]
    unbounded: Unbounded = eqx.field(static=True)
    rho: Callable | None = eqx.field(static=True)

    def predict(self, u: Float[Array, " params"]) -> Float[Array, " values"]:
        """What the models say, in SI; NaN in a row that has no equilibrium."""
        scene = replace(self.scene, self.unbounded.values(u))
        return jnp.concatenate([model(scene).values.ravel() for model in self.models])

    def misfits(
        self, u: Float[Array, " params"], values: Float[Array, " values"]
    ) -> tuple[Float[Array, " values"], Float[Array, " values"]]:
        predicted = self.predict(u)
        taken, found = ~jnp.isnan(values), ~jnp.isnan(predicted)
        misfit = (jnp.where(found, predicted, 0.0) - jnp.where(taken, values, 0.0)) / self.sigma
        misfit = jnp.where(taken, jnp.where(found, misfit, self.lost), 0.0)
        return lax.switch(self.bend.astype(int), list(LOSSES.values()), misfit), predicted

    def loss(self, misfits: Float[Array, " values"]) -> Float[Array, ""]:
        return jnp.sum(misfits**2) / 2 if self.rho is None else self.rho(misfits)


def problem_of(
    scene: Scene, measured: tuple[Measurements, ...], unbounded: Unbounded, method: Method, loss: Loss
) -> Problem:
    """The problem that a fit minimises."""
    sigma, lost = [], []
    values = np.concatenate([table.values.ravel() for table in measured])
    spread = float(np.nanstd(values)) or float(np.nanmax(np.abs(values))) or 1.0
    for table in measured:
        errors = np.full(table.values.shape, spread) if table.sigma is None else table.sigma
        largest = np.nanmax(np.abs(table.values), axis=0, initial=1.0)
        reach = {"m": float(scene.arm.length), "rad": 2 * np.pi}
        reaches = [reach.get(o.unit, high) for o, high in zip(table.observables, largest, strict=True)]
        sigma.append(errors.ravel())
        lost.append((10 * np.array(reaches) / errors).ravel())
    return Problem(
        scene=as_floats(scene),
        observed=jnp.asarray(values),
        models=tuple(Model.of(scene, table, method) for table in measured),
        sigma=jnp.asarray(np.concatenate(sigma)),
        lost=jnp.asarray(np.concatenate(lost)),
        unbounded=unbounded,
        bend=bend_of(loss),
        rho=None if isinstance(loss, str) else loss,
    )


def _soft_l1(r: Array) -> Array:
    return r * jnp.sqrt(2 / (1 + jnp.sqrt(1 + r**2)))


def _huber(r: Array) -> Array:
    far = jnp.abs(r) > 1
    return jnp.where(far, jnp.sign(r) * jnp.sqrt(2 * jnp.where(far, jnp.abs(r), 1.0) - 1), r)


def _cauchy(r: Array) -> Array:
    small = r**2 < 1e-8
    z = jnp.where(small, 1.0, r**2)
    return r * jnp.where(small, 1 - r**2 / 4, jnp.sqrt(jnp.log1p(z) / z))


LOSSES: dict[str, Callable[[Array], Array]] = {  # sign(r) sqrt(rho(r^2)): its square is rho
    "linear": lambda r: r,
    "soft_l1": _soft_l1,
    "huber": _huber,
    "cauchy": _cauchy,
}


def bend_of(loss: Loss) -> Float[Array, ""]:
    """The number of a loss among `LOSSES`; a loss of the user's takes misfits as they are."""
    return jnp.asarray(list(LOSSES).index(loss if isinstance(loss, str) else "linear"), float)
