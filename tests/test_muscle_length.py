"""Muscles whose displacement is given: the tension found is the one that gives it, a slack muscle does not push."""

import dataclasses
import json
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference
from command import Run
from conversion import scene_of

from cosserat_jax import (
    Arm,
    InputError,
    MultipleShooting,
    Muscle,
    Outcome,
    Scene,
    SectionStiffness,
    SingleShooting,
    Tip,
    dumps,
    load_scene,
    parameters,
    replace,
    solve,
    sweep,
)  # fmt: skip

METHOD = SingleShooting(steps=(10, 20))  # of two grids the last is always the second: no jumps in differences
OCTOPUS = load_scene("octopus")
WOUND = replace(OCTOPUS, {"muscles.0.displacement": "8 mm"})
PLAIN = {  # antagonists, one of which ends before the tip, in a current that changes with height: three unknowns
    "arm": {"length": 0.418, "base_radius": 0.015, "tip_radius": 0.004, "density": 1100.0, "youngs_modulus": 1e7,
            "poisson_ratio": 0.5},
    "water": {"density": 998.0, "viscosity": 1.002e-3, "velocity": 0.2, "boundary_layer": 0.02,
              "velocity_gradient": 0.5},
    "gravity": {"acceleration": 9.81},
    "muscles": [
        {"side": 1, "base_offset": 0.012, "end_offset": 0.001, "tension": 20.0},
        {"side": -1, "base_offset": 0.012, "end_offset": 0.006, "end": 0.21, "tension": 6.0},
    ],
}  # fmt: skip
PULLED = scene_of(PLAIN)
BOTH_WOUND = replace(PULLED, {"muscles.0.displacement": "9 mm", "muscles.1.displacement": "-0.4 mm"})


@pytest.mark.slow
def test_tensions_are_those_of_collocation_whose_muscles_have_that_length():
    """Solved with tensions by the independent formulation, the lengths of its muscles by quadrature."""
    expected = reference.solve(PLAIN)
    assert expected.converged
    given = {f"muscles.{i}.displacement": float(d) for i, d in enumerate(expected.displacements)}
    solution = solve(replace(PULLED, given), METHOD, points=3)
    np.testing.assert_allclose(solution.tensions, [20.0, 6.0], rtol=1e-7)
    np.testing.assert_allclose([solution.tip.x, solution.tip.y], [expected.x, expected.y], rtol=0, atol=4e-9)


@pytest.mark.parametrize("displacement", [0.001, 0.01, 0.05])
def test_parallel_tendon_in_closed_form(displacement: float):
    """With a unit tangent, a rigid section and no load the arm is an arc: kappa = r T / (E I), nu = 1 - T / (E A), so
    the displacement is L (1 - nu + r kappa) = L T (1 / (E A) + r^2 / (E I))."""
    scene = dataclasses.replace(load_scene("tendon-robot"), gravity=None)
    stiffness, length, offset = scene.arm.stiffness, scene.arm.length, scene.muscles[0].base_offset
    tension = displacement / length / (1 / stiffness.axial + offset**2 / stiffness.bending)
    solution = solve(replace(scene, {"muscles.0.displacement": displacement}), METHOD, points=3)
    assert float(solution.tensions[0]) == pytest.approx(tension, rel=1e-11)
    bend = float(solution.tip.theta) - scene.arm.base_angle
    assert abs(bend) == pytest.approx(length * offset * tension / stiffness.bending, rel=1e-10)


@pytest.mark.parametrize("part", [0.3, 1.001, 1.5, 10.0])
def test_a_tendon_shortened_to_nothing_has_an_outcome_of_its_own(part: float):
    """The same arm: no length is left of the tendon at T (1 / (E A) + r^2 / (E I)) = 1."""
    scene = dataclasses.replace(load_scene("tendon-robot"), gravity=None)
    stiffness, length, offset = scene.arm.stiffness, scene.arm.length, scene.muscles[0].base_offset
    tension = 1 / (1 / stiffness.axial + offset**2 / stiffness.bending)
    for path, most in (("muscles.0.tension", tension), ("muscles.0.displacement", length)):
        solution = solve(replace(scene, {path: part * most}), METHOD, points=3, throw=False)
        expected = Outcome.converged if part < 1 else Outcome.tendon_length_zero
        assert Outcome[solution.outcome] == Outcome[expected]
        assert float(solution.load_fraction) == pytest.approx(min(1, 1 / part), rel=1e-3)


@pytest.mark.slow
def test_sweep_over_displacement_is_each_solve_and_tensions_are_in_its_dataset():
    """Paid out, the muscle is slack, and the arm that of no tension; at its length at rest it holds the arm up; the
    third displacement is that at 20 N, by a spline through the fields."""
    displacements = [-0.01, 0.0, 0.008573833041, 0.02]
    swept = sweep(OCTOPUS, {"muscles.0.displacement": displacements}, METHOD, points=3)
    tensions = swept.solution.tensions
    assert swept.solution.converged.all()
    assert tensions[0, 0] == 0
    assert tensions[2, 0] == pytest.approx(20.0, rel=1e-9)
    np.testing.assert_allclose(swept.solution.tip.y[[0, 2]], [-0.0036152319, 0.1171941337], rtol=0, atol=2e-10)
    assert (np.diff(tensions[:, 0]) > 0).all()
    alone = solve(replace(WOUND, {"muscles.0.displacement": displacements[3]}), METHOD, points=3)
    np.testing.assert_allclose(tensions[3], alone.tensions, rtol=1e-11)
    in_dataset = swept.to_xarray().tension
    assert in_dataset.dims == ("muscles.0.displacement", "muscle")
    assert in_dataset.attrs["units"] == "N"


@pytest.mark.slow
def test_multiple_shooting_finds_the_same_tension():
    """Wound in and paid out; at the latter the muscle, taut in the linear response, goes slack."""
    methods = (METHOD, MultipleShooting(intervals=8))
    for displacement in (0.008573833041, -0.01):
        wound = replace(WOUND, {"muscles.0.displacement": displacement})
        single, multiple = (solve(wound, method, points=3) for method in methods)
        np.testing.assert_allclose(multiple.tensions, single.tensions, rtol=1e-8)
        np.testing.assert_allclose(multiple.tip.y, single.tip.y, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_length_control_holds_where_tension_control_snaps():
    """A steel column that leans to the left under 1.5 times its buckling load, a tendon on its right. Wound in, the
    tendon first pulls harder, up to a limit point, and then, as it brings the column upright, less: there the column
    would fall over to the right if the tension were given, and does."""
    bending, length = 0.157, 0.5
    load = 1.5 * math.pi**2 * bending / (4 * length**2)
    column = Scene(
        Arm(length, 1e-3, 1e-3, 1.0, cross_section="rigid", base_angle=math.pi / 2 + 0.05,
            stiffness=SectionStiffness(6e5, 2.5e5, bending)),
        (Muscle(0.015, 0.015, 1.0, side=-1, tangent="unit"),),
        tip=Tip(force=(0.0, -load)),
    )  # fmt: skip
    held = sweep(column, {"muscles.0.displacement": np.array([-0.02, -0.012, -0.004, 0.0])}, METHOD, points=3).solution
    assert held.converged.all()
    tensions = held.tensions[:, 0]
    assert tensions[0] < tensions[1] > tensions[2] > tensions[3] > 0
    assert (np.diff(held.tip.y) > 0).all()
    assert held.tip.x[2] < -0.1
    fallen = solve(replace(column, {"muscles.0.tension": tensions[2]}), METHOD, points=3)
    assert fallen.tip.x > 0.3


def found(scene: Scene) -> jax.Array:
    solution = solve(scene, METHOD, points=3, throw=False)
    return jnp.stack([*solution.tensions / 20, solution.tip.x, solution.tip.y, solution.tip.theta])


REVERSE = jax.jit(jax.jacrev(found))


def as_arrays(scene: Scene) -> Scene:
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, float), scene)


@pytest.mark.slow
def test_derivatives_by_every_float_are_central_differences():
    columns = parameters(REVERSE(as_arrays(BOTH_WOUND)))
    assert columns.keys() == parameters(BOTH_WOUND).keys()
    for path, value in parameters(BOTH_WOUND).items():
        step = 1e-4 * max(abs(value), 1e-2)
        weights = {2: -1, 1: 8, -1: -8, -2: 1}
        moved = {k: found(replace(BOTH_WOUND, {path: value + k * step})) for k in weights if not _leaves(path, k)}
        if len(moved) < 4:
            continue
        difference = sum(w * np.asarray(moved[k]) for k, w in weights.items()) / (12 * step)
        scale = np.abs(difference).max()
        np.testing.assert_allclose(columns[path], difference, rtol=0, atol=1e-6 * scale + 1e-9, err_msg=path)


def _leaves(path: str, step: int) -> bool:
    """Whether a step goes where the parameter may not."""
    return step > 0 and path in ("arm.poisson_ratio", "water.inlet_fraction")


@pytest.mark.slow
def test_derivatives_of_a_slack_muscle_are_those_of_none():
    columns = parameters(REVERSE(as_arrays(replace(BOTH_WOUND, {"muscles.1.displacement": "-20 mm"}))))
    assert np.isfinite(np.stack(list(columns.values()))).all()
    for name in ("displacement", "base_offset", "end_offset", "end"):
        np.testing.assert_allclose(columns[f"muscles.1.{name}"], 0, atol=1e-8)  # its end is where steps begin
    assert columns["muscles.0.displacement"][0] > 0


@pytest.mark.slow
def test_muscles_on_one_path_cannot_be_told_apart():
    offsets = [f"muscles.{i}.{name}" for i in range(2) for name in ("base_offset", "end_offset")]
    same = replace(BOTH_WOUND, dict.fromkeys(offsets, 0.0) | {"muscles.1.end": PULLED.arm.length})
    same = replace(same, {"muscles.0.displacement": 0.001, "muscles.1.displacement": 0.001})
    solution = solve(same, METHOD, points=3, throw=False)
    assert Outcome[solution.outcome] == Outcome[Outcome.muscles_redundant]
    assert np.isnan(solution.tensions).all()


def test_a_displacement_beside_a_tension_or_a_coil_is_refused():
    coil = load_scene("octopus-tcam").muscles[0].tcam
    where = {"base_offset": 0.012, "end_offset": 0.001}
    for given, named in (
        ({}, r"muscles\.0\.tension must be given, .* muscles\.0\.displacement, or a table muscles\.0\.tcam"),
        (
            {"tension": 1.0, "displacement": 0.01},
            r"muscles\.0\.tension must be given alone, but is given beside muscles\.0\.displacement",
        ),
        (
            {"displacement": 0.01, "tcam": coil},
            r"muscles\.0\.displacement must be given alone, but is given beside muscles\.0\.tcam",
        ),
        ({"displacement": math.nan}, r"muscles\.0\.displacement must be a finite number, but is nan"),
    ):
        with pytest.raises(InputError, match=named):
            Scene(OCTOPUS.arm, (Muscle(**where, **given),))


def test_displacement_takes_the_place_of_tension_and_reads_back(tmp_path):
    assert WOUND.muscles[0].tension is None
    assert replace(WOUND, {"muscles.0.tension": "20 N"}) == OCTOPUS
    with pytest.raises(InputError, match="given beside"):
        replace(OCTOPUS, {"muscles.0.tension": "20 N", "muscles.0.displacement": "5 mm"})
    path = tmp_path / "wound.toml"
    path.write_text(dumps(WOUND))
    assert load_scene(path) == WOUND


@pytest.mark.slow
def test_command_line_takes_a_displacement_and_prints_the_tension(run: Run):
    words = ("solve", "octopus", "--set", "muscles.0.displacement=8 mm")
    line, text = run(*words, "--json"), run(*words)
    (tension,) = json.loads(line.out)["tensions_N"]
    assert tension == pytest.approx(18.6, abs=0.3)
    assert f"tensions     {tension:.6g} N" in text.out
    assert "0 N (slack)" in run(*words[:3], "muscles.0.displacement=-8 mm").out
