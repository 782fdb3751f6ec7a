"""The package against the independent SciPy formulation, over scenes of every kind."""

import numpy as np
import pytest
import reference
from conversion import scene_of

from cosserat_jax import Outcome, SingleShooting, solve

DRAWS = 24


@pytest.mark.parametrize(
    "seed", [seed if seed % 2 else pytest.param(seed, marks=pytest.mark.slow) for seed in range(DRAWS)]
)
def test_agrees_with_collocation_on_random_scenes(seed: int):
    """Tip to 1e-8 of the length, fields over s to what the spacing of the collocation mesh allows."""
    plain = reference.random_scene(np.random.default_rng([2024, seed]))
    expected = reference.solve(plain)
    assert expected.converged, expected.message
    scene = scene_of(plain)
    solution = solve(scene, throw=False)
    assert Outcome[solution.outcome] == Outcome[Outcome.converged]
    length = plain["arm"]["length"]
    np.testing.assert_allclose(
        [solution.tip.x / length, solution.tip.y / length, solution.tip.theta],
        [expected.x / length, expected.y / length, expected.theta],
        rtol=0, atol=1e-8,
    )  # fmt: skip
    fields = solve(scene, SingleShooting(steps=(20, 28))).fields  # ten steps are far apart for what is between
    along = expected.fields(np.asarray(fields.s))
    for name, scale in {"x": length, "y": length, "theta": 1, "nu": 1, "eta": 1, "mu": 1 / length, "beta": 1}.items():
        np.testing.assert_allclose(getattr(fields, name), along[name], rtol=0, atol=1e-6 * scale, err_msg=name)


def test_unit_tangents_on_a_volume_preserving_section():
    """There beta_s acts on beta through |t_c|. What is left out, the slope of that beta_s, is 1e-9 of the length."""
    plain = reference.random_scene(np.random.default_rng(0)) | {"muscles": [
        {"side": 1, "base_offset": 0.012, "end_offset": 0.001, "tension": 20.0, "tangent": "unit"}]}  # fmt: skip
    plain["arm"] = plain["arm"] | {"cross_section": "volume-preserving"}
    expected, solution = reference.solve(plain), solve(scene_of(plain))
    np.testing.assert_allclose([solution.tip.x, solution.tip.y], [expected.x, expected.y], rtol=0, atol=2e-9)
