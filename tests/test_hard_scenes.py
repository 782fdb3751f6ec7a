"""Stiff, slender, soft and strongly loaded arms: the equilibrium of proportional loading, or why there is none."""

import functools

import hard
import jax
import numpy as np
import pytest
import reference
from hypothesis import given, settings
from hypothesis import strategies as st

from cosserat_jax import (
    MultipleShooting,
    Outcome,
    Scene,
    SingleShooting,
    Solution,
    load_scene,
    parameters,
    replace,
    solve,
    sweep,
)
from cosserat_jax.scene.quantity import as_floats
from cosserat_jax.solver import Method

POINTS = 5
SEED = 2026
TAUT, TAUT_SOFT, HANGING = 55, 78, 65  # single shooting loses the branch at 0.55, 0.41 and 0.30 of the load


def scene(number: int) -> Scene:
    return hard.alike(hard.drawn(SEED, number))


@functools.cache
def solution(number: int, method: Method | None = None) -> Solution:
    return solve(scene(number), method, points=POINTS, throw=False)


@pytest.mark.parametrize("number", [TAUT, pytest.param(TAUT_SOFT, marks=pytest.mark.slow), HANGING])
def test_agrees_with_collocation_where_single_shooting_does_not_reach(number: int):
    assert not solution(number, SingleShooting()).converged
    plain, found = hard.drawn(SEED, number), solution(number)
    expected = reference.solve(plain, tol=1e-8)
    assert expected.converged
    apart = np.hypot(found.tip.x - expected.x, found.tip.y - expected.y)
    assert apart < 1e-8 * plain["arm"]["length"]
    assert found.residual < 1e-9


@pytest.mark.parametrize("number", [68, 37])
def test_both_formulations_stop_at_the_same_limit_point(number: int):
    """Before the full load, where other equilibria exist that a bold step would land on."""
    both = [solution(number, method) for method in (SingleShooting(), MultipleShooting())]
    assert [Outcome[one.outcome] for one in both] == [Outcome[Outcome.limit_point]] * 2
    assert 0 < both[0].load_fraction < 1
    assert float(both[0].load_fraction) == pytest.approx(float(both[1].load_fraction), rel=1e-3)
    assert all(np.isnan(leaf).all() for one in both for leaf in jax.tree.leaves((one.tip, one.tip_strain)))


@pytest.mark.slow
def test_sweep_solves_rods_that_need_it_by_multiple_shooting():
    """And leaves their neighbours as they are: each is the same as alone."""
    tension = float(scene(TAUT).muscles[0].tension)
    over = {"muscles.0.tension": [0.0, tension], "water.velocity": [0.05, float(scene(TAUT).water.velocity)]}
    swept = sweep(scene(TAUT), over, points=POINTS).solution
    assert swept.converged.all()
    for i, pull in enumerate(over["muscles.0.tension"]):
        for j, speed in enumerate(over["water.velocity"]):
            alone = solve(replace(scene(TAUT), {"muscles.0.tension": pull, "water.velocity": speed}), points=POINTS)
            np.testing.assert_allclose(swept.tip.x[i, j], alone.tip.x, rtol=0, atol=1e-12)
            np.testing.assert_allclose(swept.tip.y[i, j], alone.tip.y, rtol=0, atol=1e-12)


@pytest.mark.slow
def test_gradient_through_multiple_shooting_equals_central_differences():
    """Of a plain `jax.grad`, which chooses multiple shooting by itself, along a random direction in all parameters."""
    at = as_floats(scene(TAUT))
    gradient = jax.grad(lambda scene: solve(scene, points=POINTS, throw=False).tip.y)(at)
    rng = np.random.default_rng(1)
    direction = {path: float(value) * rng.uniform(-1, 1) for path, value in parameters(at).items()}
    direction["water.inlet_fraction"] = 0.0  # it is at its largest, 1
    slope = sum(float(parameters(gradient)[path]) * change for path, change in direction.items())

    def height(step: float) -> float:
        moved = {path: float(parameters(at)[path]) + step * change for path, change in direction.items()}
        return float(solve(replace(at, moved), points=POINTS).tip.y)

    step = 1e-4
    numerical = (8 * (height(step) - height(-step)) - (height(2 * step) - height(-2 * step))) / (12 * step)
    assert slope == pytest.approx(numerical, rel=1e-7)


def decades(bounds: tuple[float, float]) -> st.SearchStrategy[float]:
    return st.floats(*np.log(bounds)).map(lambda x: float(np.clip(np.exp(x), *bounds)))


muscle = st.tuples(st.floats(*hard.MUSCLE_END), st.floats(*hard.PULL))
hard_scenes = st.builds(
    lambda modulus, length, base, tip, poisson, density, first, second, third, gravity, current: hard.alike(
        hard.scene(modulus, length, (base, tip), poisson, density, [(1, *first), (1, *second), (-1, *third)])
        | {"gravity": {"acceleration": gravity}, "water": hard.WATER | {"velocity": current}}
    ),
    decades(hard.MODULUS), decades(hard.LENGTH), decades(hard.BASE_RADIUS), decades(hard.TIP_RADIUS),
    st.floats(*hard.POISSON), st.floats(*hard.DENSITY), muscle, muscle, muscle,
    st.sampled_from([0.0, 9.81]), st.floats(*hard.CURRENT),
)  # fmt: skip


@settings(max_examples=12, deadline=None, derandomize=True)
@given(hard_scenes)
def test_either_an_equilibrium_or_an_outcome(scene: Scene):
    """Clamped, free of load at the tip, the volume kept; or no number at all, and a reason."""
    found = solve(scene, points=POINTS, throw=False)
    fields = found.fields
    if not found.converged:
        assert np.isnan(fields.x).all()
        assert np.isnan(found.tip.theta)
        assert Outcome[found.outcome] in {Outcome[Outcome.limit_point], Outcome[Outcome.volume_constraint_folded]}
        assert 0 <= found.load_fraction < 1
        return
    arm = scene.arm
    radius = arm.base_radius + (arm.tip_radius - arm.base_radius) * fields.s / arm.length
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(fields))
    np.testing.assert_allclose([fields.x[0], fields.y[0]], 0, atol=1e-7 * arm.length)
    assert abs(float(fields.theta[0])) < 1e-7
    np.testing.assert_allclose([fields.force_x[-1], fields.force_y[-1], fields.moment[-1]], 0, atol=1e-12)
    np.testing.assert_allclose(fields.beta * (fields.nu - fields.beta * radius * fields.mu), 1, atol=1e-7)
    assert found.condition >= 1


@pytest.mark.slow
def test_a_very_strong_pull_at_the_tip_turns_the_arm_within_a_thousandth_of_its_length():
    """With k = sqrt(P / EI) the elastica's tip stands at x = sqrt(2) / k and y = L - (2 - sqrt(2)) / k but for terms of
    exp(-k L). Only many intervals hold it: over one of 64 an error grows by exp(16)."""
    found = solve(replace(load_scene("elastica"), {"tip.force.1": 1e6}), points=2)
    assert float(found.tip.x) == pytest.approx(np.sqrt(2) * 1e-3, abs=1e-9)
    assert float(found.tip.y) == pytest.approx(1 - (2 - np.sqrt(2)) * 1e-3, abs=1e-9)
