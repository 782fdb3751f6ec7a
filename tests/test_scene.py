"""What a user writes: files, paths, units and values, and what is said to one who errs. The command line's errors are
tested in `test_cli`."""

import dataclasses
import math
import time

import equinox as eqx
import jax
import numpy as np
import pytest
from command import ARM_FILE

from cosserat_jax import (
    Arm,
    InputError,
    Muscle,
    Outcome,
    Scene,
    dumps,
    load_scene,
    parameters,
    presets,
    replace,
    solve,
    sweep,
)
from cosserat_jax.scene import bounds_to_si, range_to_si, read, sweep_values, to_si
from cosserat_jax.scene.parts import Notes
from cosserat_jax.scene.plausible import unit_hints
from cosserat_jax.solver.solution import Pose, SectionStrains
from cosserat_jax.solver.solve import empty_solution


@pytest.mark.parametrize("name", presets())
def test_a_scene_written_down_reads_back_the_same(name, tmp_path):
    scene = load_scene(name)
    path = tmp_path / "scene.toml"
    path.write_text(dumps(scene))
    assert load_scene(path) == scene
    assert read(name).title


def test_title_and_sweep_are_kept_and_make_no_other_program():
    scene, plain = load_scene("octopus"), dataclasses.replace(load_scene("octopus"), notes=Notes())
    written = dumps(replace(scene, {"muscles.0.tension": 7.0}))
    assert f'title = "{read("octopus").title}"' in written
    assert '"muscles.0.tension" = "0:20:0.5 N"' in written
    assert jax.tree.structure(scene) == jax.tree.structure(plain)
    assert "title" not in dumps(plain)


def test_water_and_gravity_have_the_defaults_of_fresh_water_on_earth(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(ARM_FILE + 'tension = "1 N"\n[gravity]\n[water]\nvelocity = 0.1\n')
    scene = load_scene(path)
    assert scene.gravity.acceleration == 9.81
    assert (scene.water.density, scene.water.viscosity, scene.water.boundary_layer) == (998.2, 1.002e-3, 0.02)


def test_a_sweep_in_python_speaks_the_language_of_the_command_line():
    scene = load_scene("octopus")
    np.testing.assert_allclose(sweep_values(scene, "muscles.0.tension", "0:2:0.5 N"), [0, 0.5, 1, 1.5, 2])
    np.testing.assert_allclose(sweep_values(scene, "arm.length", ["40 cm", 0.5]), [0.4, 0.5])
    for bad in (["fast"], [], 1.0, [[1.0]], {"a": 1}):
        with pytest.raises(InputError, match=r"^water\.velocity must be"):
            sweep_values(scene, "water.velocity", bad)


def test_octopus_is_the_papers_table():
    values = parameters(load_scene("octopus"))
    table = {"arm.length": 0.418, "arm.base_radius": 0.015, "arm.tip_radius": 0.004, "arm.youngs_modulus": 1e7,
             "arm.poisson_ratio": 0.5, "arm.density": 1100, "muscles.0.base_offset": 0.012,
             "muscles.0.end_offset": 0.001, "water.density": 998,
             "water.viscosity": 1.002e-3, "gravity.acceleration": 9.81}  # fmt: skip
    assert {path: values[path] for path in table} == pytest.approx(table, rel=1e-14)
    grid = read("octopus").sweep
    np.testing.assert_allclose(grid["muscles.0.tension"], np.arange(0, 20.5, 0.5))
    np.testing.assert_allclose(grid["water.velocity"], [0.2, 0.4])


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [("418 mm", "m", 0.418), ("10 MPa", "Pa", 1e7), ("1.1 kg/dm^3", "kg/m^3", 1100), ("1.002 mPa*s", "Pa*s", 1.002e-3),
     ("1070 kg/m3", "kg/m^3", 1070),
     ("1.07 g/cm3", "kg/m^3", 1070), ("10 N/mm2", "Pa", 1e7), ("1 kg/(m*s)", "Pa*s", 1), ("98 degC", "K", 371.15),
     ("90 deg", "rad", math.pi / 2), ("0 1/s", "1/s", 0), ("-2e-1", "m/s", -0.2), (3, "N", 3.0), ("0.5", "1", 0.5)],
)  # fmt: skip
def test_quantities_are_read_in_si(text, unit, value):
    assert to_si(text, unit, "here") == pytest.approx(value, rel=1e-15)


@pytest.mark.parametrize(
    ("text", "unit", "values"),
    [("0:20:5 N", "N", [0, 5, 10, 15, 20]), ("0.2, 0.4 m/s", "m/s", [0.2, 0.4]), ("1:0:-0.5 mm", "m", [1e-3, 5e-4, 0]),
     ("0:1:0.3", "N", [0, 0.3, 0.6, 0.9]), ("7 cm", "m", [0.07])],
)  # fmt: skip
def test_ranges_hold_their_end(text, unit, values):
    np.testing.assert_allclose(range_to_si(text, unit, "here"), values, rtol=1e-15, atol=1e-18)


@pytest.mark.parametrize(
    "text",
    ["1 m**9**9**9", "10**(10**9)*m", "1 m^999999999", "1 " + "m" * 1_000_000, "1" * 50_000 + " N", "3 m!", "3 m #x",
     "0-20 N", "0,5 m", "35 5 cm", "0:1e300:1e-300", "0:" + "9" * 50_000 + " m", "0:1", "", "nan:1 m"],
)  # fmt: skip
@pytest.mark.parametrize("read", [to_si, range_to_si, bounds_to_si])
def test_hostile_quantities_are_refused_at_once_in_a_line_that_quotes_them(read, text):
    if (read, text) in [(range_to_si, "0,5 m"), (bounds_to_si, "0:1")]:
        return  # which is two numbers
    begin = time.perf_counter()
    with pytest.raises(InputError, match=r"^here must ") as caught:
        read(text, "m", "here")
    assert time.perf_counter() - begin < 1
    assert len(str(caught.value)) < 400
    assert text[:30] in str(caught.value)


@pytest.mark.parametrize(
    ("values", "said"),
    [({"arm.length": 41.8}, ["the arm is 41.8 m long and 15 mm thick"]), ({"arm.youngs_modulus": 0.3}, ["0.3 Pa"]),
     ({"arm.length": 418.0}, ["418 m long"]), ({"muscles.0.tension": 2e8}, ["tension is 2e+08 N, 9e+07 times"]),
     ({"arm.density": 1.1e6}, ["arm.density is 1.1e+06"]), ({"water.velocity": -200.0}, ["water.velocity"]), ({}, [])],
)  # fmt: skip
def test_slips_of_a_unit_are_hinted_at(values, said):
    hints = unit_hints(replace(load_scene("octopus"), values))
    assert all(any(part in hint for hint in hints) for part in said)
    assert all("a number without a unit is in SI" in hint for hint in hints)
    assert bool(hints) == bool(said)


@pytest.mark.parametrize("name", presets())
def test_no_preset_looks_like_a_slip(name):
    assert unit_hints(load_scene(name)) == ()


def test_replace_changes_only_what_is_named():
    scene = load_scene("two-segments")
    changed = replace(scene, {"muscles.1.tension": "5 N", "arm.cross_section": "rigid", "water.velocity_gradient": 0.2})
    assert changed.muscles[1].tension == 5.0
    assert changed.arm.cross_section == "rigid"
    assert changed.water.velocity_gradient == 0.2
    back = replace(changed, {"muscles.1.tension": 2.0, "arm.cross_section": "volume-preserving"})
    assert dataclasses.replace(back, water=scene.water) == scene


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"muscles.0.tensoin": 1}, "did you mean 'tension'"),
        ({"muscles.3.tension": 1}, "0 to 0"),
        ({"tip.moment": 1}, "this scene has none"),
        ({"arm": 1}, "names a part"),
        ({"arm.length": "3 N"}, "wrong unit"),
        ({"arm.length": "long"}, "a number and a unit"),
        ({"arm.tip_radius": 0.0}, "must be positive, but is 0 m"),
        ({"arm.poisson_ratio": 0.51}, "must be between 0 and 0.5, but is 0.51$"),
        ({"muscles.0.tension": -1.0}, "must be at least 0, but is -1 N"),
        ({"muscles.0.tension": math.nan}, "but is nan N"),
        ({"muscles.0.end": 0.42}, "the arm's length"),
        ({"muscles.0.end_offset": 0.0041}, "outside the arm"),
        ({"muscles.0.tangent": "unity"}, "'unnormalized' or 'unit'"),
        ({"muscles.0.tension": "a lot of N"}, "a number and a unit"),
    ],
)
def test_a_value_that_is_not_allowed_is_named_with_what_is(values, said):
    with pytest.raises(InputError, match=f"^{next(iter(values))}:? .*{said}") as caught:
        replace(load_scene("octopus"), values)
    assert "\n" not in str(caught.value)


def test_python_scenes_are_checked_too():
    arm = Arm(length=0.4, base_radius=0.01, tip_radius=0.005, density=1100.0, youngs_modulus=1e6, poisson_ratio=0.5)
    with pytest.raises(InputError, match=r"muscles\.0\.side"):
        Scene(arm, muscles=(Muscle(base_offset=0.005, end_offset=0.001, tension=1.0, side=2),))
    with pytest.raises(InputError, match=r"arm\.youngs_modulus must be given"):
        Scene(dataclasses.replace(arm, youngs_modulus=None))


def test_a_sweep_checks_every_rod_before_it_solves_one():
    with pytest.raises(InputError, match=r"arm\.tip_radius must be positive, but is -0\.001 m"):
        sweep(load_scene("octopus"), {"arm.tip_radius": [0.004, -0.001]})
    with pytest.raises(InputError, match="cannot be swept"):
        sweep(load_scene("octopus"), {"arm.cross_section": [1.0]})


def test_moduli_can_be_swept():
    """They may be absent, so their checks look at what is there."""
    scene = replace(
        load_scene("octopus"), {"arm.youngs_modulus": np.array([1e6, 1e7]), "arm.poisson_ratio": np.array([0.3, 0.5])}
    )
    assert scene.arm.youngs_modulus.shape == (2,)


def test_results_print_numbers_with_units():
    assert str(Pose(np.array(0.25), np.array(-0.1), np.array(1.0))) == "Pose(x=0.25 m, y=-0.1 m, theta=1 rad)"
    strains = SectionStrains(*np.array([0.98, 0.0, 7.5, 1.1]))
    assert str(strains) == "SectionStrains(nu=0.98, eta=0, mu=7.5 1/m, beta=1.1)"
    batch = Pose(np.linspace(0, 1, 6), np.array([np.nan, 1, 2, 3, 4, 5]), np.full(6, np.nan))
    assert str(batch) == "Pose(x=0 to 1 m, y=1 to 5 m, theta=nan rad)"
    solution = eqx.tree_at(lambda solution: solution.outcome, empty_solution(), Outcome.converged)
    assert str(solution).splitlines()[:2] == [
        "Solution: converged to the equilibrium that proportional loading reaches", "  tip: x=0 m, y=0 m, theta=0 rad",
    ]  # fmt: skip
    assert str(jax.eval_shape(lambda x: Pose(x, x, x), 1.0)).startswith("Pose{")


def test_single_precision_is_refused():
    jax.config.update("jax_enable_x64", False)
    try:
        with pytest.raises(RuntimeError, match="double precision"):
            solve(load_scene("octopus"))
    finally:
        jax.config.update("jax_enable_x64", True)


def test_importing_all_of_the_package_imports_no_tool_of_its_edges():
    import subprocess
    import sys

    tools = ("pint", "xarray", "click", "matplotlib", "tqdm")
    code = f"import sys; from cosserat_jax import *; print([tool for tool in {tools} if tool in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"
