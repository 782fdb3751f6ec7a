"""From voltage to motion: the chain as one function, its numbers and its derivatives."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cosserat_jax import (
    InputError,
    ResponseOutcome,
    SingleShooting,
    TimeStepping,
    actuate,
    gain_from_measurement,
    load_scene,
    parameters,
    replace,
    solve,
)
from cosserat_jax.study import with_tensions

OCTOPUS = load_scene("octopus-tcam")
TIMES = np.linspace(0, 6.28, 5)
METHOD = SingleShooting(steps=(10, 20))  # of two grids the last is always the second: no jumps in differences
STEPPING = TimeStepping.suited_to(OCTOPUS.muscles[0].tcam)
TIGHT = dataclasses.replace(STEPPING, rtol=1e-12, atol=1e-12, watch=1)


@pytest.fixture(scope="module")
def actuation():
    return actuate(OCTOPUS, TIMES)


def test_the_preset_pulls_with_25_newton_at_the_paper_s_temperature(actuation):
    gain = parameters(OCTOPUS)["muscles.0.tcam.tension_gain"]
    assert gain == pytest.approx(gain_from_measurement(25.0, 98.17 + 273.15, 23 + 273.15), rel=1e-14)
    response = actuation.responses[0]
    assert response.peak.temperature - 273.15 == pytest.approx(98.1677, abs=1e-4)
    assert response.peak.time == pytest.approx(5.8944, abs=1e-4)
    assert gain * (response.peak.temperature - 296.15) == pytest.approx(25.0, abs=2e-3)
    np.testing.assert_allclose(response.tension, 25 / 75.17 * (response.temperature - 296.15), rtol=1e-13)


def test_each_instant_is_the_equilibrium_under_that_instant_s_tension(actuation):
    octopus = load_scene("octopus")
    assert actuation.solution.converged.all()
    for i in (0, 2, 4):
        tension = float(actuation.responses[0].tension[i])
        alone = solve(replace(octopus, {"muscles.0.tension": tension}))
        assert actuation.solution.tip.y[i] == pytest.approx(float(alone.tip.y), abs=1e-12)
    assert actuation.solution.tip.y[0] == pytest.approx(-0.0036152319, abs=1e-9)  # no tension


def test_only_the_muscles_with_a_tcam_get_another_tension():
    passive = dataclasses.replace(load_scene("octopus").muscles[0], tension=6.0, side=-1)
    scene = dataclasses.replace(OCTOPUS, muscles=(passive, *OCTOPUS.muscles))
    pulled = with_tensions(scene, {1: 9.0}).muscles
    assert pulled == (passive, dataclasses.replace(load_scene("octopus").muscles[0], tension=9.0))


def test_an_instant_without_equilibrium_and_a_muscle_too_hot_are_marked_and_nothing_stops():
    """A scene at which the arm folds from some tension on: the instants before it are untouched."""
    strong = replace(OCTOPUS, {"muscles.0.tcam.tension_gain": 40.0, "muscles.0.tcam.limit_temperature": 340.0})
    acted = actuate(strong, TIMES)
    converged = np.asarray(acted.solution.converged)
    assert converged[:2].all()
    assert not converged[-1]
    assert np.isnan(acted.solution.tip.y[~converged]).all()
    assert np.isfinite(acted.solution.tip.y[converged]).all()
    assert acted.responses[0].outcome == ResponseOutcome.overheated
    assert np.isfinite(acted.responses[0].temperature).all()


def test_a_scene_that_cannot_be_actuated_or_solved_says_what_to_use():
    with pytest.raises(InputError, match="at least one muscle that a TCAM drives"):
        actuate(load_scene("octopus"), TIMES)
    with pytest.raises(InputError, match=r"muscles\.0\.tcam: .*allowed: actuate"):
        solve(OCTOPUS)
    with pytest.raises(InputError, match=r"times: not in order"):
        actuate(OCTOPUS, TIMES[::-1])
    with pytest.raises(
        InputError, match=r"muscles\.0\.tension must be given alone, but is given beside muscles\.0\.tcam"
    ):
        replace(OCTOPUS, {"muscles.0.tension": 3.0})
    with pytest.raises(InputError, match=r"muscles\.0\.tension must be given"):
        dataclasses.replace(OCTOPUS, muscles=(dataclasses.replace(OCTOPUS.muscles[0], tcam=None),))
    with pytest.raises(InputError, match=r"muscles\.0\.tcam\.resistance must be positive, but is -1"):
        replace(OCTOPUS, {"muscles.0.tcam.resistance": -1.0})


# --- derivatives through the whole chain

PATHS = [
    "muscles.0.tcam.voltage.amplitude", "muscles.0.tcam.voltage.frequency", "muscles.0.tcam.resistance",
    "muscles.0.tcam.conductance", "muscles.0.tcam.thermal_mass", "muscles.0.tcam.tension_gain", "arm.youngs_modulus",
    "arm.length", "arm.density", "muscles.0.base_offset", "water.velocity", "water.density",
]  # fmt: skip


def tip_at_end(values: jax.Array) -> jax.Array:
    scene = replace(OCTOPUS, {"arm.cross_section": "rigid"} | dict(zip(PATHS, values, strict=True)))
    tip = actuate(scene, jnp.asarray([3.0, 5.0]), METHOD, stepping=TIGHT).solution.tip
    return jnp.stack([tip.x[-1], tip.y[-1], tip.theta[-1]])


def test_derivatives_of_the_tip_by_voltage_heat_and_arm_are_those_of_differences_in_both_modes():
    at = jnp.asarray([parameters(OCTOPUS)[path] for path in PATHS])
    forward = np.asarray(jax.jit(jax.jacfwd(tip_at_end))(at))
    backward = np.asarray(jax.jit(jax.jacrev(tip_at_end))(at))
    np.testing.assert_allclose(backward, forward, rtol=1e-11, atol=1e-14)
    tip, step = jax.jit(jax.vmap(tip_at_end)), 1e-4 * np.diag(at)
    shifted = {k: np.asarray(tip(at[None] + k * step)) for k in (-2, -1, 1, 2)}
    difference = (8 * (shifted[1] - shifted[-1]) - (shifted[2] - shifted[-2])) / (12 * 1e-4 * np.asarray(at)[:, None])
    for path, column, wanted in zip(PATHS, forward.T, difference, strict=True):
        scale = np.abs(wanted).max()
        assert scale > 0, path
        np.testing.assert_allclose(column, wanted, rtol=0, atol=1e-6 * scale, err_msg=path)
