"""Derivatives of the equilibrium: every float of a scene, both modes, against differences and against each other."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cosserat_jax import (
    Gravity,
    MultipleShooting,
    Muscle,
    Scene,
    SingleShooting,
    Tip,
    load_scene,
    parameters,
    replace,
    solve,
)
from cosserat_jax.solver import Method

METHOD = SingleShooting(steps=(10, 20))  # of two grids the last is always the second: no jumps in differences
OCTOPUS = load_scene("octopus")
FULL = Scene(  # every kind of float leaf that a volume-preserving scene of unnormalized tangents can have
    arm=replace(OCTOPUS, {"arm.poisson_ratio": 0.45, "arm.base_angle": 0.1}).arm,
    muscles=(
        Muscle(base_offset=0.011, end_offset=0.006, tension=9.0, end=0.2),
        Muscle(base_offset=0.012, end_offset=0.002, tension=6.0, side=-1),
    ),
    water=dataclasses.replace(OCTOPUS.water, inlet_fraction=0.8, velocity_gradient=0.3),
    gravity=Gravity(9.81),
    tip=Tip(force=(0.05, -0.1), moment=0.002),
)


def tip_of(scene: Scene) -> jax.Array:
    tip = solve(scene, METHOD, points=3, throw=False).tip
    return jnp.stack([tip.x, tip.y, tip.theta])


FORWARD, REVERSE = jax.jit(jax.jacfwd(tip_of)), jax.jit(jax.jacrev(tip_of))


def as_arrays(scene: Scene) -> Scene:
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, float), scene)


def central_difference(scene: Scene, path: str, relative_step: float = 1e-4) -> np.ndarray:
    """Fourth order, so that the step can be large against the integrator's tolerance."""
    value = float(parameters(scene)[path])
    step = relative_step * max(abs(value), 1e-2)
    weights = {2: -1, 1: 8, -1: -8, -2: 1}
    return sum(w * np.asarray(tip_of(replace(scene, {path: value + k * step}))) for k, w in weights.items()) / (
        12 * step
    )


@pytest.fixture(scope="module")
def forward() -> dict[str, np.ndarray]:
    scene = as_arrays(FULL)
    columns = FORWARD(scene)
    return {path: np.asarray(column) for path, column in parameters(columns).items()}


def test_every_float_leaf_is_differentiated(forward):
    assert forward.keys() == parameters(FULL).keys()
    assert all(np.isfinite(column).all() for column in forward.values())


@pytest.mark.parametrize("path", parameters(FULL))
def test_forward_mode_equals_central_differences(forward, path):
    difference = central_difference(FULL, path)
    scale = np.abs(difference).max()
    np.testing.assert_allclose(forward[path], difference, rtol=0, atol=1e-6 * scale + 1e-11)


def test_reverse_mode_equals_forward_mode(forward):
    backward = parameters(REVERSE(as_arrays(FULL)))
    for path, column in forward.items():
        np.testing.assert_allclose(backward[path], column, rtol=1e-12, atol=0)


def test_derivatives_are_right_where_a_segment_has_no_length():
    """The end of a muscle at the tip leaves none between the two."""
    at_tip = replace(FULL, {"muscles.0.end": FULL.arm.length, "muscles.0.end_offset": 0.003})
    forward, reverse = (parameters(derivatives(as_arrays(at_tip))) for derivatives in (FORWARD, REVERSE))
    for path, column in forward.items():
        np.testing.assert_allclose(reverse[path], column, rtol=1e-7, atol=1e-9)
    for path in ("muscles.0.tension", "muscles.1.base_offset"):
        np.testing.assert_allclose(forward[path], central_difference(at_tip, path), rtol=1e-6, atol=1e-9)


def test_gradient_is_finite_at_the_straight_unloaded_arm():
    """No tension, no current, no weight: the arm is straight, and pulling it is the only thing that bends it."""
    still = replace(FULL, dict.fromkeys(("muscles.0.tension", "muscles.1.tension", "water.velocity"), 0.0))
    still = replace(still, {"gravity.acceleration": 0.0, "tip.force.0": 0.0, "tip.force.1": 0.0, "tip.moment": 0.0,
                            "water.velocity_gradient": 0.0})  # fmt: skip
    gradient = parameters(REVERSE(as_arrays(still)))
    assert all(np.isfinite(row).all() for row in gradient.values())
    assert gradient["muscles.0.tension"][1] > 0 > gradient["muscles.1.tension"][1]
    assert gradient["arm.youngs_modulus"] == pytest.approx(np.zeros(3), abs=1e-15)


COINCIDENCES = {  # values at which two things fall together, or one is absent, beside others
    "arm.tip_radius": [0.004, OCTOPUS.arm.base_radius],
    "arm.poisson_ratio": [0.45, 0.5, 0.0],
    "arm.base_angle": [0.1, 0.0, np.pi / 2, -np.pi],
    "muscles.0.tension": [9.0, 0.0],
    "muscles.0.base_offset": [0.004, 0.0],
    "muscles.0.end_offset": [0.004, 0.0],
    "muscles.0.end": [0.2, OCTOPUS.arm.length],
    "muscles.1.tension": [6.0, 0.0, 9.0],
    "muscles.1.base_offset": [0.004, 0.0],
    "muscles.1.end_offset": [0.004, 0.0],
    "water.velocity": [0.2, 0.0],
    "water.velocity_gradient": [0.3, 0.0],
    "water.viscosity": [0.001, 0.0],
    "water.inlet_fraction": [0.8, 0.0, 1.0],
    "water.density": [998.0, OCTOPUS.arm.density],
    "gravity.acceleration": [9.81, 0.0],
    "tip.force.0": [0.05, 0.0],
    "tip.force.1": [-0.1, 0.0],
    "tip.moment": [0.002, 0.0],
}
AT_MOST = {"arm.poisson_ratio": 0.5, "water.inlet_fraction": 1.0, "muscles.0.end": OCTOPUS.arm.length}
FORWARD_FIFTH = np.array([-25, 48, -36, 16, -3]) / 12  # first derivative from five values, at and ahead of a place


@settings(max_examples=40, derandomize=True, deadline=None)
@given(st.tuples(*(st.sampled_from(values) for values in COINCIDENCES.values())), st.integers(0, 2**32))
def test_derivatives_hold_where_ends_loads_and_radii_coincide_or_vanish(values: tuple, seed: int):
    """Along a direction that leaves the coincidence, into what is allowed."""
    at = dict(zip(COINCIDENCES, values, strict=True))
    scene = replace(FULL, at)
    rng = np.random.default_rng(seed)
    scales = {path: max(abs(value) for value in COINCIDENCES[path]) for path in at}
    direction = {
        path: scale * rng.uniform(0.1, 1) * (1 - 2 * (at[path] == AT_MOST.get(path))) for path, scale in scales.items()
    }
    gradient = parameters(REVERSE(as_arrays(scene)))
    assert all(np.isfinite(column).all() for column in gradient.values())
    slope = sum(gradient[path] * change for path, change in direction.items())
    step = 2e-4
    moved = [{path: at[path] + k * step * change for path, change in direction.items()} for k in range(5)]
    difference = FORWARD_FIFTH @ [tip_of(replace(FULL, ahead)) for ahead in moved] / step
    np.testing.assert_allclose(slope, difference, rtol=0, atol=1e-5 * np.abs(slope).max() + 1e-8)


def pull_to_height(tension: jax.Array, method: Method = METHOD) -> jax.Array:
    return solve(replace(load_scene("elastica"), {"tip.force.1": tension}), method, points=3, throw=False).tip.y


def test_a_unit_tendon_bends_an_inextensible_arm_as_a_stiff_one():
    """And there too no number that is not finite comes out of an infinite stiffness."""
    elastica = load_scene("elastica")
    rod = Scene(
        elastica.arm, (Muscle(base_offset=0.01, end_offset=0.0, tension=10.0, tangent="unit"),), tip=elastica.tip
    )
    stiff = replace(rod, {"arm.stiffness.axial": 1e12, "arm.stiffness.shear": 1e12})
    np.testing.assert_allclose(tip_of(rod), tip_of(stiff), rtol=0, atol=1e-9)
    by_rod, by_stiff = (parameters(jax.jit(jax.jacrev(tip_of))(as_arrays(scene))) for scene in (rod, stiff))
    for path, column in by_rod.items():
        np.testing.assert_allclose(column, by_stiff[path], rtol=1e-6, atol=1e-8, err_msg=path)


@pytest.mark.slow
def test_second_derivatives_in_every_nesting():
    """Of the elastica's deflection over its load, beside differences of first derivatives."""
    at, step = jnp.asarray(3.0), 1e-3
    slope = jax.jit(jax.grad(pull_to_height))
    second = float(slope(at + step) - slope(at - step)) / (2 * step)
    for outer in (jax.jacfwd, jax.jacrev):
        for inner in (jax.jacfwd, jax.jacrev):
            assert float(jax.jit(outer(inner(pull_to_height)))(at)) == pytest.approx(second, rel=1e-5)


@pytest.mark.parametrize(
    "method",
    [
        pytest.param(METHOD, id="single shooting"),
        pytest.param(MultipleShooting(intervals=4), id="multiple shooting", marks=pytest.mark.slow),
    ],
)
def test_vmap_and_grad_nest_either_way(method):
    """And a rod without an equilibrium has no gradient, not that of zero, while its neighbours keep theirs."""
    height = functools.partial(pull_to_height, method=method)
    pulls = jnp.asarray([0.5, 2.0, 5.0, 1e4])
    each = jnp.stack([*(jax.grad(height)(pull) for pull in pulls[:-1]), jnp.nan])
    np.testing.assert_allclose(jax.jit(jax.vmap(jax.grad(height)))(pulls), each, rtol=1e-11)
    total = jax.jit(jax.grad(lambda pulls: jax.vmap(height)(pulls).sum()))(pulls)
    np.testing.assert_allclose(total, each, rtol=1e-11)


def test_gradient_with_respect_to_the_initial_guess_is_zero():
    """The root that a guess leads to does not move with the guess."""
    from cosserat_jax.numerics.newton import root

    def at(guess: jax.Array, a: jax.Array) -> jax.Array:
        return root(lambda x, a: (x[0] ** 2 - a,), (guess,), a)[0]

    by_guess, by_a = jax.grad(at, argnums=(0, 1))(jnp.asarray(1.5), jnp.asarray(4.0))
    assert by_guess == 0
    assert by_a == pytest.approx(0.25)
