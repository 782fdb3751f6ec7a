"""A batch is its rods one by one, those that fail among them; derivatives agree in all modes, alone and in a batch."""

import dataclasses

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cosserat_jax import (
    MultipleShooting,
    Muscle,
    Outcome,
    Scene,
    SingleShooting,
    TimeStepping,
    Tip,
    load_scene,
    replace,
    solve,
    tcam_response,
)

METHOD = SingleShooting(steps=(10, 20))  # of two grids the last is always the second: no jumps in differences
OCTOPUS = load_scene("octopus")
TWO = dataclasses.replace(  # two segments, a given displacement, a current that changes with height, a load on the tip
    OCTOPUS,
    muscles=(
        dataclasses.replace(OCTOPUS.muscles[0], tension=None, displacement=0.006),
        Muscle(base_offset=0.012, end_offset=0.006, tension=4.0, end=0.21, side=-1),
    ),
    water=dataclasses.replace(OCTOPUS.water, velocity_gradient=0.5),
    tip=Tip(force=(0.02, -0.03)),
)
UNIT = replace(OCTOPUS, {"muscles.0.tangent": "unit"})
PATHS = {
    "two segments": (TWO, ["muscles.0.displacement", "muscles.1.end", "arm.youngs_modulus"]),
    "unit tangent": (UNIT, ["muscles.0.tension", "muscles.0.base_offset", "arm.tip_radius"]),
}


# --- a batch is its rods


GRID = {  # each rod with an arm of its own, so that the segments and the grading of the steps are its own too
    "arm.length": [0.418, 0.30, 0.418, 0.5, 0.418],
    "arm.tip_radius": [0.004, 0.006, 0.004, 0.004, 0.004],
    "muscles.1.end": [0.2, 0.25, 0.418, 0.2, 0.21],
    "muscles.0.displacement": [0.006, 0.004, 0.006, 0.4, jnp.nan],
}


def test_a_batch_is_its_rods_one_by_one_whatever_becomes_of_them():
    """The fourth asks for more than the arm gives, the fifth for nothing that is a number."""

    def one(*values: jax.Array):
        return solve(replace(TWO, dict(zip(GRID, values, strict=True))), points=(0.0, 1.0), throw=False)

    columns = [jnp.asarray(column) for column in GRID.values()]
    batch, alone = jax.jit(jax.vmap(one))(*columns), jax.jit(one)
    assert batch.outcome._value[:3].tolist() == [0, 0, 0]
    assert batch.outcome._value[3] != 0
    assert batch.outcome._value[4] == int(Outcome.bad_input._value)
    for i in range(5):
        single = alone(*(column[i] for column in columns))
        rod = jax.tree.map(lambda leaf, i=i: leaf[i], batch)
        assert rod.outcome._value == single.outcome._value
        for name in ("tip", "tip_strain", "fields", "tensions"):
            for a, b in zip(*(jax.tree.leaves(getattr(of, name)) for of in (rod, single)), strict=True):
                np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12 * max(1.0, np.nanmax(np.abs(b), initial=0.0)))


# --- derivatives


def height(values: jax.Array, name: str) -> jax.Array:
    """Of the tip, and of a field half-way."""
    scene, paths = PATHS[name]
    solution = solve(replace(scene, dict(zip(paths, values, strict=True))), METHOD, points=(0.5, 1.0), throw=False)
    return jnp.stack([solution.tip.y, solution.tip.theta, solution.fields.y[0], 1e-2 * solution.fields.mu[0]])


@pytest.mark.slow
@pytest.mark.parametrize("name", PATHS)
def test_derivatives_agree_in_all_modes_alone_and_in_a_batch(name: str):
    scene, paths = PATHS[name]
    at = jnp.asarray([_value(scene, path) for path in paths])

    def of(values: jax.Array) -> jax.Array:
        return height(values, name)

    forward, backward = jax.jit(jax.jacfwd(of))(at), jax.jit(jax.jacrev(of))(at)
    assert np.isfinite(forward).all()
    np.testing.assert_allclose(backward, forward, rtol=1e-9, atol=1e-12 * np.abs(forward).max())
    _, along = jax.jvp(of, (at,), (at,))
    np.testing.assert_allclose(along, forward @ at, rtol=1e-9)
    batch = jax.jit(jax.vmap(jax.jacrev(of)))(jnp.stack([at, 1.01 * at]))
    np.testing.assert_allclose(batch[0], forward, rtol=1e-9, atol=1e-12 * np.abs(forward).max())
    steps = 1e-3 * np.diag(at)
    moved = {k: np.asarray(jax.jit(jax.vmap(of))(at[None] + k * steps)) for k in (-2, -1, 1, 2)}
    difference = (8 * (moved[1] - moved[-1]) - (moved[2] - moved[-2])) / 12 / (1e-3 * np.asarray(at)[:, None])
    for column, wanted in zip(np.asarray(forward).T, difference, strict=True):
        np.testing.assert_allclose(column, wanted, rtol=0, atol=1e-6 * np.abs(wanted).max() + 1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("name", PATHS)
def test_second_derivatives_are_those_of_differences_of_the_first(name: str):
    scene, paths = PATHS[name]
    value = _value(scene, paths[0])

    def of(x: jax.Array) -> jax.Array:
        return height(jnp.asarray([x, *(_value(scene, path) for path in paths[1:])]), name)[0]

    slope, step = jax.jit(jax.grad(of)), 1e-3 * value
    difference = float(slope(value + step) - slope(value - step)) / (2 * step)
    for outer in (jax.jacfwd, jax.grad):
        assert float(jax.jit(outer(jax.grad(of)))(value)) == pytest.approx(difference, rel=1e-4)


def _value(scene: Scene, path: str) -> float:
    part = scene
    for key in path.split("."):
        part = part[int(key)] if key.isdecimal() else getattr(part, key)
    return float(part)


# --- programs


def tip_height(tension: jax.Array, method: SingleShooting | MultipleShooting) -> jax.Array:
    return solve(replace(OCTOPUS, {"muscles.0.tension": tension}), method, points=2, throw=False).tip.y


@pytest.mark.parametrize("method", [SingleShooting(), MultipleShooting(intervals=4)], ids=["single", "multiple"])
def test_no_program_calls_back_to_python(method: SingleShooting | MultipleShooting):
    def text(function) -> str:
        return jax.jit(function).lower(3.0).as_text()

    assert "stablehlo" in text(lambda tension: tip_height(tension, method))
    assert "callback" not in text(lambda tension: tip_height(tension, method))
    assert "callback" not in text(jax.grad(lambda tension: tip_height(tension, method)))


@pytest.mark.parametrize("solver", [diffrax.Tsit5(), diffrax.Kvaerno5()], ids=["explicit", "implicit"])
def test_no_program_of_a_muscle_over_time_calls_back_to_python(solver: diffrax.AbstractSolver):
    tcam, method = load_scene("octopus-tcam").muscles[0].tcam, TimeStepping(solver)

    def tension(times: jax.Array) -> jax.Array:
        return tcam_response(tcam, times, method).tension

    assert "callback" not in jax.jit(tension).lower(jnp.linspace(0.0, 10.0, 3)).as_text()
