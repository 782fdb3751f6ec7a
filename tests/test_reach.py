"""`reach`: there and back again, least effort and nearest points as SciPy finds them, shapes, voltages, bad input.

All arms with three muscles share one compiled program, those with a TCAM another.
"""

import dataclasses
import importlib
import json
from typing import Any

import equinox as eqx
import jax
import numpy as np
import pytest
from scipy.optimize import least_squares, minimize

from cosserat_jax import (
    TCAM,
    Arm,
    InputError,
    LinearConductance,
    Muscle,
    Outcome,
    Reach,
    ReachOutcome,
    Scene,
    load_scene,
    reach,
    solve,
    sweep,
    tcam_response,
    workspace,
)
from cosserat_jax.report.figures import reach_figure
from cosserat_jax.report.inverse_text import reach_json
from cosserat_jax.study.inverse.controls import controls_of, default_limit, holding_voltage
from cosserat_jax.study.inverse.multistart import grid
from cosserat_jax.study.inverse.workspace import Arms

UPPER = Muscle(base_offset=0.012, end_offset=0.001, tension=1.0)
LOWER = dataclasses.replace(UPPER, side=-1)
INNER = Muscle(base_offset=0.009, end_offset=0.003, tension=1.0)
ARM = Arm(
    length=0.418, base_radius=0.015, tip_radius=0.004, youngs_modulus=1e7, poisson_ratio=0.5, density=1100.0,
    cross_section="rigid",
)  # fmt: skip
THREE = Scene(ARM, (UPPER, LOWER, INNER))
FREE = {f"muscles.{i}.tension": (0.0, 30.0) for i in range(3)}
VOLTAGE = "muscles.0.tcam.voltage"
LENGTH = 0.418


@pytest.fixture(scope="module")
def arms() -> Arms:
    return Arms.of(THREE, FREE, None, None)


@pytest.fixture(scope="module")
def drawn(arms: Arms) -> tuple[np.ndarray, np.ndarray]:
    """Places of the box and the tips [m] there."""
    u = np.random.default_rng(3).uniform(size=(20, 3))
    return u, arms.images(u).r * LENGTH


@pytest.fixture(scope="module")
def found(drawn: tuple[np.ndarray, np.ndarray]) -> Reach:
    """Tips that can be reached, then points twice as far away, which cannot."""
    return reach(THREE, np.concatenate([drawn[1], 2 * drawn[1][:6]]), FREE)


# --- there and back again


@pytest.mark.slow
def test_reachable_targets_are_reached_and_no_other(found: Reach) -> None:
    assert found.reached.tolist() == [True] * 20 + [False] * 6
    assert found.distance[:20].max() < 1e-8
    assert (found.outcome == ReachOutcome.out_of_reach).tolist() == [False] * 20 + [True] * 6
    assert found.distance[20:].min() > 0.2 * LENGTH
    assert found.message_of(0) == "reached"
    assert found.message_of(20).startswith("out of reach")
    assert f"nearest {found.distance[20]:.4g} m away" in found.message_of(20)


@pytest.mark.slow
def test_tips_are_those_that_solve_finds(found: Reach) -> None:
    tip = solve(found.scene_at(4)).tip
    np.testing.assert_allclose([tip.x, tip.y], found.target[4], atol=1e-8)
    np.testing.assert_allclose(found.points[4], found.target[4], atol=1e-8)
    assert [muscle.tension for muscle in found.scene_at(4).muscles] == [v[4] for v in found.values.values()]


@pytest.mark.slow
def test_values_keep_their_bounds(found: Reach) -> None:
    values = np.stack(list(found.values.values()))
    assert list(found.values) == list(FREE)
    assert ((values >= 0) & (values <= 30)).all()
    assert (values == 0).any()  # slack antagonists are slack to the bit
    assert [(one.lower, one.upper) for one in found.free] == [(0.0, 30.0)] * 3


# --- against SciPy


@pytest.mark.slow
def test_least_effort_is_that_of_slsqp(arms: Arms, found: Reach, drawn: tuple[np.ndarray, np.ndarray]) -> None:
    assert (found.effort[:20] <= np.sum(drawn[0] ** 2, axis=1) * (1 + 1e-9)).all()
    for i in (0, 7):
        target = found.target[i] / LENGTH

        def at(u: np.ndarray) -> Any:
            return arms.images(np.clip(u, 0, 1)[None])

        constraint = {
            "type": "eq",
            "fun": lambda u, target=target, at=at: at(u).r[0] - target,
            "jac": lambda u, at=at: at(u).jacobian[0],
        }
        slsqp = minimize(
            lambda u: u @ u, drawn[0][i], jac=lambda u: 2 * u, method="SLSQP", bounds=[(0, 1)] * 3,
            constraints=constraint, options={"ftol": 1e-14},
        )  # fmt: skip
        assert found.effort[i] == pytest.approx(slsqp.fun, rel=1e-6)


@pytest.mark.slow
def test_nearest_point_is_that_of_trust_region_least_squares(arms: Arms, found: Reach) -> None:
    for i in (20, 23):
        target = found.target[i] / LENGTH
        trf = least_squares(
            lambda u, target=target: arms.images(u[None]).r[0] - target, np.full(3, 0.5),
            lambda u: arms.images(u[None]).jacobian[0], bounds=(0, 1), xtol=1e-12, ftol=1e-12, gtol=1e-12,
        )  # fmt: skip
        assert found.distance[i] <= np.sqrt(2 * trf.cost) * LENGTH * (1 + 1e-9)
        assert found.distance[i] == pytest.approx(np.sqrt(2 * trf.cost) * LENGTH, rel=1e-6)


# --- points and shapes


@pytest.mark.slow
def test_a_shape_of_the_arm_is_met_at_all_its_points(drawn: tuple[np.ndarray, np.ndarray]) -> None:
    at = np.array([0.5, 0.75, 1.0]) * LENGTH
    shape = Arms.of(THREE, FREE, at, None).images(drawn[0][:1]).r.reshape(3, 2) * LENGTH
    found = reach(THREE, shape, FREE, at)
    assert bool(found.reached)
    assert found.points.shape == (3, 2)
    assert found.message == "reached"
    np.testing.assert_allclose(found.points, shape, atol=1e-8)
    np.testing.assert_allclose([30 * u for u in drawn[0][0]], list(found.values.values()), atol=1e-4)


@pytest.mark.slow
def test_of_a_shape_that_the_arm_cannot_take_the_distance_is_the_mean_square() -> None:
    at = np.array([0.5, 1.0]) * LENGTH
    found = reach(THREE, [[0.1, 0.1], [0.3, -0.1]], FREE, at)
    assert not found.reached
    apart = np.linalg.norm(found.points - found.target, axis=1)
    assert float(found.distance) == pytest.approx(np.sqrt(np.mean(apart**2)), rel=1e-12)
    tips = workspace(THREE, FREE, at).points
    assert float(found.distance) <= np.sqrt(np.mean(np.sum((tips - found.target) ** 2, axis=2), axis=1)).min()


@pytest.mark.slow
def test_fields_are_held_at_places_asked_for() -> None:
    places = (0.0, 0.123, 0.7, 1.0)
    few = solve(load_scene("elastica"), points=places).fields
    many = solve(load_scene("elastica"), points=1001).fields
    np.testing.assert_allclose(few.s, places)
    np.testing.assert_allclose(few.y[1:3], many.y[np.array([123, 700])], atol=1e-9)


@pytest.mark.slow
def test_datasets_hold_the_places_asked_for() -> None:
    places = (0.0, 0.123, 0.7, 1.0)
    swept = sweep(load_scene("elastica"), {"tip.force.1": [1.0, 2.0]}, points=places)
    np.testing.assert_allclose(swept.to_xarray()["s"], places)


@pytest.mark.slow
def test_where_no_arm_has_an_equilibrium_the_outcome_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    module = importlib.import_module("cosserat_jax.study.inverse.workspace")
    solve_batch = module._solve_batch

    def lost(*arguments: Any) -> Any:
        points, rates, solution = jax.tree.map(np.asarray, solve_batch(*arguments))
        codes = np.full(len(points), int(Outcome.limit_point._value))
        fields = jax.tree.map(lambda field: np.full_like(field, np.nan), solution.fields)
        solution = eqx.tree_at(lambda s: (s.outcome._value, s.fields), solution, (codes, fields))
        return np.full_like(points, np.nan), np.full_like(rates, np.nan), solution

    monkeypatch.setattr(module, "_solve_batch", lost)
    found = reach(THREE, [[0.3, 0.1], [0.2, 0.2]], FREE)
    assert (found.outcome == ReachOutcome.no_equilibrium).all()
    assert not found.reached.any()
    assert np.isnan(found.distance).all()
    assert np.isnan(found.values["muscles.0.tension"]).all()
    assert found.message_of(0).startswith("nowhere was an equilibrium found")
    first, second = (json.loads(line) for line in reach_json("arm", found))
    assert (first["distance"], second["effort"], second["parameters"]["muscles.0.tension"]["value"]) == (None,) * 3
    assert len(reach_figure(found).axes) == 2


# --- the workspace


@pytest.mark.slow
def test_the_workspace_is_a_grid_of_the_box(arms: Arms, found: Reach) -> None:
    space = workspace(THREE, FREE, count=30)
    assert space.shape == (3, 3, 3)
    assert space.converged.all()
    assert [np.unique(v).tolist() for v in space.values.values()] == [[0.0, 15.0, 30.0]] * 3
    np.testing.assert_allclose(space.points[0], [[LENGTH, 0.0]], atol=1e-9)  # nothing pulls
    assert found.workspace.shape == (6, 6, 6)


@pytest.mark.parametrize(("n", "count", "rods"), [(1, 256, 256), (2, 256, 256), (3, 256, 216), (7, 256, 256)])
def test_grids_fill_the_box(n: int, count: int, rods: int) -> None:
    box, shape = grid(n, count)
    assert box.shape == (rods, n)
    assert (shape is None) == (n == 7)
    assert ((box >= 0) & (box <= 1)).all()
    np.testing.assert_allclose(box.mean(axis=0), 0.5, atol=0.01)


# --- voltages


def wet(**changes: Any) -> TCAM:
    return TCAM(tension_gain=0.33, conductance=0.086, **changes)


def test_the_voltage_found_holds_the_muscle_at_its_tension() -> None:
    tcam = wet(conductance_law=LinearConductance(slope=2e-4))
    tensions = np.array([0.0, 3.0, 25.0])
    voltages = holding_voltage(tcam, tensions)
    assert voltages[0] == 0
    for tension, voltage in zip(tensions[1:], voltages[1:], strict=True):
        held = tcam_response(dataclasses.replace(tcam, voltage=lambda t, v=float(voltage): v), [60.0])
        assert float(held.tension[0]) == pytest.approx(tension, rel=1e-6)


@pytest.mark.slow
def test_voltages_are_bounded_by_the_limit_temperature_and_by_those_given() -> None:
    scene = Scene(ARM, (dataclasses.replace(UPPER, tension=None, tcam=wet()),))
    control = controls_of(scene, [VOLTAGE])[0]
    assert control.high == pytest.approx(0.33 * 127)  # 23 to 150 degC
    assert control.free.upper == pytest.approx(np.sqrt(18 * 0.086 * 127))
    narrow = controls_of(scene, {VOLTAGE: (1.0, "5 V")})[0]
    assert (narrow.free.lower, narrow.free.upper, narrow.free.unit) == (1.0, 5.0, "V")
    np.testing.assert_allclose([narrow.low, narrow.high], 0.33 * np.array([1.0, 25.0]) / (18 * 0.086))
    assert controls_of(scene, {VOLTAGE: (0, 100)})[0].high == control.high


@pytest.mark.slow
def test_a_voltage_brings_the_arm_where_its_tension_does() -> None:
    scene = Scene(ARM, (dataclasses.replace(UPPER, tension=None, tcam=wet()), dataclasses.replace(LOWER, tension=2.0)))
    pulled = dataclasses.replace(scene, muscles=(dataclasses.replace(UPPER, tension=9.0), scene.muscles[1]))
    tip = solve(pulled).tip
    found = reach(scene, [float(tip.x), float(tip.y)], VOLTAGE)
    assert bool(found.reached)
    assert found.unknowns["muscles.0.tension"] == pytest.approx(9.0, rel=1e-6)
    assert found.values[VOLTAGE] == pytest.approx(np.sqrt(18 * 0.086 * 9.0 / 0.33), rel=1e-6)
    assert found.scene_at().muscles[0].tcam is None


# --- limits and bad input


def test_the_default_limit_of_a_tension_is_a_half_turn() -> None:
    limit = default_limit(THREE, 0)
    bending = 1e7 * np.pi * 0.0095**4 / 4
    assert limit == pytest.approx(np.pi * bending / (0.0065 * LENGTH))
    assert controls_of(THREE, ["muscles.0.tension"])[0].high == limit
    strong = dataclasses.replace(THREE, muscles=(dataclasses.replace(UPPER, tension=1000.0),))
    assert default_limit(strong, 0) == 1000.0


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (([0.3], FREE), "target: of shape (1,); allowed: (2), or (targets, 2) for several"),
        (([np.nan, 0.1], FREE), "target: nan is not allowed; allowed: finite numbers in m"),
        (("here", FREE), "target: 'here' is not allowed"),
        (([0.3, 0.1], FREE, 0.5), "at: 0.5 [m] is not on the arm; allowed: more than 0 to 0.418 [m]"),
        (([0.3, 0.1], FREE, [0.2, 0.4]), "target: of shape (2,); allowed: (2, 2)"),
        (([0.3, 0.1], ["muscles.0.tensoin"]), "did you mean 'tension'?"),
        (([0.3, 0.1], ["arm.length"]), "arm.length: has no upper bound; allowed: finite bounds, LOWER:UPPER m"),
        (([0.3, 0.1], []), "free must name parameters"),
        (([0.3, 0.1], [VOLTAGE]), "muscles.0.tcam: this scene has none"),
        (
            ([0.3, 0.1], {"muscles.0.tension": (3, 2)}),
            "must have a lower bound below its upper bound, but is 3 to 2 [N]",
        ),
    ],
)
def test_bad_input_is_one_line(arguments: tuple, said: str) -> None:
    with pytest.raises(InputError) as error:
        reach(THREE, *arguments)
    assert said in str(error.value)
    assert "\n" not in str(error.value)


def test_tcams_must_be_free_or_cold() -> None:
    driven = dataclasses.replace(UPPER, tension=None, tcam=wet(voltage=lambda t: 3.0))
    scene = Scene(ARM, (driven, LOWER))
    with pytest.raises(InputError, match=r"muscles\.0\.tcam\.voltage: makes a tension that changes with time"):
        reach(scene, [0.3, 0.1], "muscles.1.tension")
    with pytest.raises(InputError, match=r"muscles\.0\.tension: a TCAM makes it; allowed: muscles\.0\.tcam\.voltage"):
        reach(scene, [0.3, 0.1], "muscles.0.tension")
