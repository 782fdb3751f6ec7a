"""`Solution.error` beside the truth: it is held against much finer steps, and against the SciPy reference."""

import hard
import numpy as np
import pytest
import reference

from cosserat_jax import Outcome, SingleShooting, Solution, load_scene, replace, solve

SEED = 2026
# to 28 like the default, whose program they share
COARSE, COARSER = (SingleShooting(error=1e-4, steps=(6, second, 28)) for second in (8, 7))
FINE = SingleShooting(steps=(28, 40))
NUMBERS = range(1, 47)


def pose(solution: Solution, length: float) -> np.ndarray:
    return np.array([solution.tip.theta, solution.tip.x / length, solution.tip.y / length])


def test_error_is_not_underestimated_on_hard_scenes_and_never_far_above_what_was_asked():
    """Of arms that have an equilibrium, those too along which the water changes sides and its force has a kink."""
    compared = 0
    for number in NUMBERS:
        scene = hard.alike(hard.drawn(SEED, number))
        for method in (SingleShooting(), COARSE, COARSER):
            found = solve(scene, method, points=2, throw=False)
            if not found.converged:
                continue
            exact = solve(scene, FINE, points=2)
            true = np.abs(pose(found, scene.arm.length) - pose(exact, scene.arm.length)).max()
            assert true < 3 * method.error, (number, method)
            if true > 1e-9:
                compared += 1
                assert float(found.error) > true / 3, (number, method)
    assert compared >= 5


@pytest.mark.parametrize("number", [pytest.param(5, marks=pytest.mark.slow), 6])
def test_error_is_not_underestimated_beside_collocation(number: int):
    plain = hard.drawn(SEED, number)
    expected = reference.solve(plain, tol=1e-9)
    found = solve(hard.alike(plain), COARSE, points=2)
    length = plain["arm"]["length"]
    true = np.abs(pose(found, length) - [expected.theta, expected.x / length, expected.y / length]).max()
    assert true > 1e-9
    assert true / 3 < float(found.error) < 1000 * true


def test_a_rod_whose_error_is_larger_than_asked_for_says_so():
    rigid = replace(load_scene("octopus"), {"arm.cross_section": "rigid"})
    found = solve(rigid, SingleShooting(error=1e-13, steps=(6, 8)), points=2, throw=False)
    assert Outcome[found.outcome] == Outcome[Outcome.inaccurate]
    assert found.error > 1e-13
    assert np.isnan(found.tip.x)
    assert found.load_fraction == 1


def test_steps_are_as_many_as_the_error_asks_for():
    scene = load_scene("octopus")
    loose, tight = (solve(scene, SingleShooting(error=error), points=2) for error in (1e-5, 1e-10))
    assert loose.steps < tight.steps
    assert loose.error < 1e-5
    assert tight.error < 1e-10


@pytest.mark.parametrize(
    "wrong", [{"steps": (10,)}, {"steps": (5, 8)}, {"steps": (10, 6)}, {"steps": (8, 8)}, {"coarse_steps": 0}]
)
def test_steps_that_show_no_error_are_refused(wrong: dict):
    with pytest.raises(ValueError, match="steps must be"):
        SingleShooting(**wrong)
