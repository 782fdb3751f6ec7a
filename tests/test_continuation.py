"""Following a branch in the load, on one equation for one unknown: what is said where it ends."""

from collections.abc import Callable

import jax.numpy as jnp
import pytest

from cosserat_jax import Outcome
from cosserat_jax.solver import continuation, outcome_codes
from cosserat_jax.solver.continuation import Correction, Stepping
from cosserat_jax.solver.outcome import code_of

STEPPING = Stepping(1e-4, 1.0, 2.0, 1e-8, 400, 1e-4)
ONE = jnp.ones(())


def fold(u: float, load: float) -> tuple[float, float, float]:
    """u - u^2 / 2 = load / 1.2: a limit point at u = 1, 0.6 of the load. Error, slope, and the least step."""
    return u - u**2 / 2 - load / 1.2, 1 - u, 0.0


def noise(u: float, load: float) -> tuple[float, float, float]:
    """u = load, with an error that Newton cannot lower from half of the load on."""
    return u - load, 1.0, 1e-3 if load > 0.5 else 0.0


def plain(u: float, load: float) -> tuple[float, float, float]:
    return u - load, 1.0, 0.0


@pytest.mark.parametrize(
    ("equation", "outcome", "load"),
    [(fold, "limit_point", 0.6), (noise, "not_followed", 0.5), (plain, "converged", 1.0)],
)
def test_a_limit_point_is_claimed_only_where_the_determinant_vanishes(
    equation: Callable, outcome: str, load: float
) -> None:
    branch = continuation.begin(jnp.zeros(()), ONE[None, None], jnp.asarray(True), STEPPING)
    while bool(branch.running):
        error, slope, least = equation(float(branch.trial), float(branch.trial_load))
        step = -error / slope
        correction = Correction(
            branch.trial + step, jnp.maximum(abs(step), least), jnp.asarray(abs(error)), None,
            jnp.full((1, 1), slope), jnp.asarray(True),
        )  # fmt: skip
        branch = continuation.advance(
            branch, correction, STEPPING, lambda u, rate, at, ahead: u + (ahead - at) * rate, jnp.abs,
            lambda usable, jacobian: code_of(Outcome.limit_point),
        )  # fmt: skip
    assert int(branch.outcome) == outcome_codes()[outcome]
    assert float(branch.load) == pytest.approx(load, rel=1e-3)
