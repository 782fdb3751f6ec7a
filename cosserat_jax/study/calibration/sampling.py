"""What takes more runs of the model after a fit: fits to data drawn anew, and the density that a sampler draws from."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .optimizer import loss_at, minimise
from .result import Calibration
from .uncertainty import uncertainty


def bootstrap(
    calibration: Calibration, repeats: int = 200, seed: int = 0
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Values and standard errors of `repeats` fits, in one batch, to data drawn anew: what the fitted scene says, and
    Gaussian noise. Arrays of shape (repeats,), by path.

    The spread of the values holds what the standard errors of a Jacobian leave out (parametric bootstrap, Efron).
    """
    problem, start = calibration.problem, calibration.minimum
    noise = np.random.default_rng(seed).normal(size=(repeats, problem.observed.size)) * calibration.noise
    values = np.asarray(start.predicted) + noise * np.asarray(problem.sigma)
    values = np.where(np.isnan(problem.observed), np.nan, values)
    starts = jnp.tile(start.u, (repeats, 1))
    found = minimise(problem, jnp.asarray(values), starts, calibration.solver, calibration.max_steps)
    jacobians = found.jacobian / jax.vmap(problem.unbounded.slopes)(found.u)[:, None]
    taken, known = calibration.taken, calibration.sigma_known
    errors = jax.vmap(lambda j, r: uncertainty(j, r, taken, known).stderr)(jacobians, found.misfits)
    drawn = jax.vmap(problem.unbounded.array)(found.u)
    by_path = [dict(zip(calibration.paths, np.asarray(part).T, strict=True)) for part in (drawn, errors)]
    return by_path[0], by_path[1]


def log_density(calibration: Calibration) -> Callable[[Float[Array, " params"]], Float[Array, ""]]:
    """The logarithm of the posterior density, up to a constant, as a function of the unbounded parameters u,

        -loss / noise^2 + sum log |d value / d u|

    for a sampler, with a prior that is flat in the values, between their bounds. Start it at `calibration.minimum.u`; a
    sample's values are `calibration.problem.unbounded.array(u)`.
    """
    problem, noise = calibration.problem, calibration.noise

    def density(u: Float[Array, " params"]) -> Float[Array, ""]:
        loss = loss_at(problem, u, problem.observed)
        return -loss / noise**2 + jnp.sum(jnp.log(jnp.abs(problem.unbounded.slopes(u))))

    return density
