"""`fit`: twin experiments on data of the independent formulation, standard errors, outcomes, bad input, the command.

Most tests share one compiled program: ten tips of the octopus arm, two free parameters.
"""

import dataclasses
import json

import equinox as eqx
import jax
import numpy as np
import optax
import pytest
import reference
from command import Run
from conversion import plain
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from cosserat_jax import (
    InputError,
    Pulses,
    bootstrap,
    fit,
    load_scene,
    log_density,
    read_measurements,
    replace,
    solve,
    tcam_response,
)
from cosserat_jax.solver import SingleShooting
from cosserat_jax.study.calibration.diagnostics import doubts
from cosserat_jax.study.calibration.forward_model import Model
from cosserat_jax.study.calibration.residuals import LOSSES
from cosserat_jax.study.calibration.uncertainty import not_told_apart, uncertainty
from cosserat_jax.study.free_parameters import free_parameters

HIDDEN = {"arm.youngs_modulus": 8.3e6, "water.inlet_fraction": 0.62}
FREE = list(HIDDEN)
TENSIONS = np.array([5.0, 20.0, 5.0, 20.0, 12.0])
CURRENTS = np.array([0.2, 0.2, 0.4, 0.4, 0.6])
SIGMA = 5e-5  # m


@pytest.fixture(scope="module")
def tips() -> dict[str, np.ndarray]:
    """Tips of the hidden arm by SciPy collocation."""
    hidden = replace(load_scene("octopus"), HIDDEN)
    found = []
    for tension, current in zip(TENSIONS, CURRENTS, strict=True):
        scene = replace(hidden, {"muscles.0.tension": tension, "water.velocity": current})
        found.append(reference.solve(plain(scene), tol=1e-9))
    assert all(tip.converged for tip in found)
    x, y = np.array([(tip.x, tip.y) for tip in found]).T
    return {"muscles.0.tension [N]": TENSIONS, "water.velocity [m/s]": CURRENTS, "tip.x [m]": x, "tip.y [m]": y}


@pytest.fixture(scope="module")
def exact(tips):
    return fit(load_scene("octopus"), tips, FREE, sigma=SIGMA)


def test_a_twin_gives_its_hidden_parameters_back(exact):
    assert exact.converged, exact.message
    for path, hidden in HIDDEN.items():
        assert exact.values[path] == pytest.approx(hidden, rel=1e-5)
    assert exact.values["arm.youngs_modulus"] == exact.fitted.arm.youngs_modulus
    assert exact.warnings == ()
    assert "arm.youngs_modulus: 8.3e+06 +- " in repr(exact) and "<svg" in exact._repr_html_()  # noqa: PT018


def test_standard_errors_are_those_of_scipy(exact, tips):
    """Covariance (J^T J)^-1 with a Jacobian of finite differences around single solves."""
    scene = exact.fitted

    def misfits(scaled: np.ndarray) -> np.ndarray:
        values = dict(zip(FREE, scaled * list(HIDDEN.values()), strict=True))
        rows = zip(TENSIONS, CURRENTS, strict=True)
        tips = [solve(replace(scene, values | {"muscles.0.tension": t, "water.velocity": v})).tip for t, v in rows]
        return (np.array([(tip.x, tip.y) for tip in tips]).ravel() - exact.problem.observed) / SIGMA

    jacobian = least_squares(misfits, np.ones(2), diff_step=1e-4, jac="3-point", max_nfev=1).jac
    errors = np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian))) * list(HIDDEN.values())
    np.testing.assert_allclose(list(exact.stderr.values()), errors, rtol=1e-3)


def test_the_density_is_the_loss_and_the_slopes_of_the_transformation(exact):
    density = log_density(exact)
    start, other = exact.minimum.u, exact.minimum.u + 1e-3
    loss = 0.5 * float(jax.numpy.sum(exact.problem.misfits(other, exact.problem.observed)[0] ** 2))
    slopes = [np.sum(np.log(np.abs(exact.problem.unbounded.slopes(u)))) for u in (start, other)]
    assert density(other) == pytest.approx(slopes[1] - loss, rel=1e-6)
    assert density(start) == pytest.approx(slopes[0] - float(exact.minimum.loss), rel=1e-6)


@pytest.mark.slow
def test_the_spread_of_a_bootstrap_is_the_standard_error(exact):
    values, errors = bootstrap(exact, 60, seed=1)
    for path in FREE:
        assert values[path].shape == errors[path].shape == (60,)
        assert np.std(values[path]) == pytest.approx(exact.stderr[path], rel=0.35)
        assert np.mean(errors[path]) == pytest.approx(exact.stderr[path], rel=0.05)


def test_outliers_are_told_by_chi_squared_and_a_robust_loss_finds_the_minimum_beside_them(tips):
    y = tips["tip.y [m]"].copy()
    y[[1, 3]] += [0.1, -0.1]
    spoilt = tips | {"tip.y [m]": y}
    linear, robust = (fit(load_scene("octopus"), spoilt, FREE, sigma=SIGMA, loss=loss) for loss in ("linear", "cauchy"))
    assert linear.converged
    assert linear.chi2_per_dof > 1e4
    assert any("chi squared" in line for line in linear.warnings)
    assert abs(linear.values[FREE[0]] - HIDDEN[FREE[0]]) > 20 * linear.stderr[FREE[0]]
    for path, hidden in HIDDEN.items():
        assert robust.values[path] == pytest.approx(hidden, rel=0.01)


def test_data_that_the_scene_can_hardly_explain_are_doubted_at_once(tips):
    scene, free = load_scene("octopus"), free_parameters(load_scene("octopus"), FREE)
    assert doubts(scene, (read_measurements(scene, tips, SIGMA),), free) == ()
    centimeters = read_measurements(scene, {"tip.y": [1.4, 6.0]})
    with pytest.raises(InputError, match=r"tip\.y must be within reach, but is 1\.4 m .* a head without a unit"):
        doubts(scene, (centimeters,), free)
    (line,) = doubts(scene, (read_measurements(scene, {"tip.y": [0.1, 0.2, 6.0]}),), free)
    assert "tip.y is 6 m from the base in row 2" in line
    (line,) = doubts(scene, (read_measurements(scene, {"tip.theta": [20.0, 60.0]}),), free)
    assert "tip.theta is 60 rad" in line
    assert doubts(scene, (centimeters,), free_parameters(scene, ["arm.length"])) == ()


def test_a_record_that_starts_warm_is_doubted(driven):
    scene, record = driven
    free = free_parameters(scene, MUSCLE_PATHS)
    data = {head: values for head, values in record.items() if "tension" not in head}
    data["muscles.0.tcam.voltage [V]"] = np.where(data["time [s]"] % 10 < 4, 9.0, 0.0)
    cold, warm = ({head: values[i:] for head, values in data.items()} for i in (0, 15))
    sigma = {"muscles.0.tcam.temperature": "1.5 degC"}
    assert doubts(scene, (read_measurements(scene, cold, sigma),), free) == ()
    (line,) = doubts(scene, (read_measurements(scene, warm, sigma),), free)
    assert "muscles.0.tcam.temperature starts at" in line


def test_a_record_with_a_voltage_starts_at_its_first_row_whatever_its_clock_shows(driven):
    scene, times = driven[0], np.array([0.0, 3.0, 4.0, 9.0])
    heads = ("time [s]", "muscles.0.tcam.voltage [V]", "muscles.0.tcam.temperature [degC]")

    def said(clock: np.ndarray) -> np.ndarray:
        table = dict(zip(heads, (clock, [6.0, 6.0, 0.0, 0.0], np.full(4, 23.0)), strict=True))
        return Model.of(scene, read_measurements(scene, table), SingleShooting())(scene).values

    for start in (100.0, -7.0):
        np.testing.assert_allclose(said(times + start), said(times), rtol=1e-12)
    second = dataclasses.replace(scene, muscles=scene.muscles * 2)
    table = dict(zip(heads, (times + 100, times, times + 23), strict=True))
    with pytest.raises(InputError, match=r"time must start at 0 s, when the voltage of muscles\.1 in the scene starts"):
        read_measurements(second, table)


def test_no_parameter_inside_its_bounds_leaves_nothing_to_tell_apart():
    nothing = uncertainty(jax.numpy.zeros((4, 0)), jax.numpy.ones(4), 4, True)
    assert not_told_apart(nothing) == []
    assert nothing.stderr.shape == (0,)


@pytest.mark.slow
def test_without_sigma_the_error_comes_from_the_residuals(tips):
    rng = np.random.default_rng(3)
    noisy = tips | {name: tips[name] + rng.normal(scale=SIGMA, size=5) for name in ("tip.x [m]", "tip.y [m]")}
    known, unknown = fit(load_scene("octopus"), noisy, FREE, sigma=SIGMA), fit(load_scene("octopus"), noisy, FREE)
    assert unknown.values["arm.youngs_modulus"] == pytest.approx(known.values["arm.youngs_modulus"], rel=1e-6)
    estimated = np.sqrt(known.chi_squared / known.dof)
    for path in FREE:
        assert unknown.stderr[path] == pytest.approx(known.stderr[path] * estimated, rel=1e-4)


@pytest.mark.slow
def test_a_missing_measurement_does_not_count(tips, exact):
    y = tips["tip.y [m]"].copy()
    y[1] = np.nan
    found = fit(load_scene("octopus"), tips | {"tip.y [m]": y}, FREE, sigma=SIGMA)
    assert found.dof == exact.dof - 1
    assert found.values["arm.youngs_modulus"] == pytest.approx(HIDDEN["arm.youngs_modulus"], rel=1e-5)
    assert np.isnan(found.residuals[0][1, 1])


HIDDEN_MUSCLE = {"thermal_mass": 0.21, "conductance": 0.0123, "tension_gain": 0.29}
MUSCLE_PATHS = [f"muscles.0.tcam.{name}" for name in HIDDEN_MUSCLE]
MUSCLE_SIGMA = {"muscles.0.tcam.temperature": "0.5 degC", "muscles.0.tcam.tension": 0.1}


@pytest.fixture(scope="module")
def driven():
    """A muscle under two pulses of 9 V, and its noisy record of 20 s by SciPy."""
    pulses = Pulses(amplitude=9.0, width=4.0, period=10.0, number=2)
    scene = eqx.tree_at(lambda scene: scene.muscles[0].tcam.voltage, load_scene("octopus-tcam"), pulses)
    tcam, times = scene.muscles[0].tcam, np.linspace(0.2, 20.0, 100)

    def rate(t, rise):
        power = 81.0 / float(tcam.resistance) if t % 10.0 < 4.0 else 0.0
        return (power - HIDDEN_MUSCLE["conductance"] * rise) / HIDDEN_MUSCLE["thermal_mass"]

    rise = solve_ivp(rate, (0, 20), [0.0], t_eval=times, max_step=0.01, rtol=1e-9, atol=1e-9).y[0]
    rng = np.random.default_rng(4)
    celsius = float(tcam.ambient_temperature) - 273.15 + rise + rng.normal(scale=0.5, size=100)
    force = HIDDEN_MUSCLE["tension_gain"] * rise + rng.normal(scale=0.1, size=100)
    heads = ("time [s]", "muscles.0.tcam.temperature [degC]", "muscles.0.tcam.tension [N]")
    return scene, dict(zip(heads, (times, celsius, force), strict=True))


def test_constants_of_a_muscle_come_from_a_noisy_record(driven):
    scene, record = driven
    found = fit(scene, record, MUSCLE_PATHS, sigma=MUSCLE_SIGMA)
    assert found.converged, found.message
    for path, hidden in zip(MUSCLE_PATHS, HIDDEN_MUSCLE.values(), strict=True):
        assert abs(found.values[path] - hidden) < 3 * found.stderr[path]
        assert found.stderr[path] < 0.02 * hidden
    assert 0.7 < found.chi_squared / found.dof < 1.3


@pytest.mark.slow
def test_a_robust_loss_shrugs_off_outliers(driven):
    scene, record = driven
    known = replace(scene, dict(zip(MUSCLE_PATHS[:2], list(HIDDEN_MUSCLE.values())[:2], strict=True)))
    force = record["muscles.0.tcam.tension [N]"].copy()
    force[::10] += 5.0
    spoilt = record | {"muscles.0.tcam.tension [N]": force}
    square, robust = (
        fit(known, spoilt, MUSCLE_PATHS[2:], sigma=MUSCLE_SIGMA, loss=loss) for loss in ("linear", "cauchy")
    )
    off = [abs(found.values[MUSCLE_PATHS[2]] / HIDDEN_MUSCLE["tension_gain"] - 1) for found in (square, robust)]
    assert off[1] < 0.005 < 0.015 < off[0]


def test_robust_losses_are_those_of_scipy():
    """scipy.optimize.least_squares: soft_l1 2 (1 + z)^1/2 - 2, huber z or 2 z^1/2 - 1 beyond 1, cauchy log(1 + z)."""
    r = np.array([-7.0, -0.3, 0.0, 1e-5, 0.8, 1.0, 1.3, 40.0])
    z = r**2
    rho = {"linear": z, "soft_l1": 2 * z / (np.sqrt(1 + z) + 1), "cauchy": np.log1p(z)}
    rho["huber"] = np.where(z <= 1, z, 2 * np.sqrt(z) - 1)
    for name, expected in rho.items():
        bent = LOSSES[name](jax.numpy.asarray(r))
        np.testing.assert_allclose(bent**2, expected, rtol=1e-9)
        assert (np.sign(bent) == np.sign(r)).all()


@pytest.mark.slow
def test_an_optax_optimiser_finds_the_same_minimum(driven):
    scene, record = driven
    best = fit(scene, record, MUSCLE_PATHS, sigma=MUSCLE_SIGMA)
    slow = fit(scene, record, MUSCLE_PATHS, sigma=MUSCLE_SIGMA, optimiser=optax.adam(0.05), max_steps=600)
    assert list(slow.values.values()) == pytest.approx(list(best.values.values()), rel=1e-3)


@pytest.mark.slow
def test_resistance_and_heat_cannot_be_told_apart_by_temperature(driven):
    """v^2 / (R C_t) and lambda / C_t are all that a temperature tells: two numbers, not three."""
    scene, record = driven
    names = ["resistance", "thermal_mass", "conductance"]
    data = {head: values for head, values in record.items() if "tension" not in head}
    found = fit(scene, data, [f"muscles.0.tcam.{name}" for name in names], sigma="0.5 degC")
    assert len(found.indistinguishable) == 1
    assert set(found.indistinguishable[0]) == {f"muscles.0.tcam.{name}" for name in names}
    assert np.isinf(list(found.stderr.values())).all()
    assert "cannot tell apart" in found.warnings[0]


@pytest.mark.slow
def test_markers_under_a_voltage_give_the_modulus_but_not_with_the_gain_as_well():
    """The marker is seen on an arm pulled by the tension of that instant, with a point every millimetre."""
    scene = replace(load_scene("octopus-tcam"), {"arm.cross_section": "rigid"})
    times, hidden = np.array([1.0, 3.0, 5.0]), replace(scene, {"arm.youngs_modulus": 9e6})
    pulls = tcam_response(scene.muscles[0].tcam, times).tension
    fields = [
        solve(
            dataclasses.replace(hidden, muscles=(dataclasses.replace(scene.muscles[0], tcam=None, tension=pull),)),
            points=419,
        ).fields
        for pull in pulls
    ]
    assert fields[0].s[200] == pytest.approx(0.2, abs=1e-12)
    data = {"time [s]": times, "y@200 mm [mm]": [1e3 * float(field.y[200]) for field in fields]}
    found = fit(scene, data, ["arm.youngs_modulus"], sigma="0.1 mm")
    assert found.values["arm.youngs_modulus"] == pytest.approx(9e6, rel=1e-6)
    pair = ["arm.youngs_modulus", "muscles.0.tcam.tension_gain"]
    both = fit(scene, data, pair, sigma="0.1 mm")
    assert [set(names) for names in both.indistinguishable] == [set(pair)]
    assert all(path in both.warnings[0] for path in pair)


def test_parameters_that_do_the_same_are_named():
    rng = np.random.default_rng(0)
    one, other, noise = rng.normal(size=(3, 20))
    jacobian = np.stack([one, other, 3 * one + 1e-12 * noise], axis=1)
    found = uncertainty(jax.numpy.asarray(jacobian), jax.numpy.asarray(rng.normal(size=20)), 20, True)
    assert not_told_apart(found) == [(0, 2)]
    assert np.isinf(found.stderr[0])
    assert found.stderr[1] == pytest.approx(np.linalg.norm(other - one * (one @ other) / (one @ one)) ** -1, rel=1e-3)


BAD = [
    ({"tip.y [kg]": [1.0]}, FREE, "tip.y [kg] must be a quantity in m, but 'kg' has the wrong unit"),
    ({"water.velocity": [0.2]}, FREE, "something must be measured"),
    ({"water.velocty": [0.2], "tip.y": [0.1]}, FREE, "did you mean 'velocity'"),
    ({"tip.y": [0.1, 0.2], "water.velocity": [0.2]}, FREE, "columns must have one value a row"),
    ({"tip.y": [0.1], "tip.theta": [0.1]}, FREE, "different units, as tip.y and tip.theta have"),
    ({"z@0.2": [0.1]}, FREE, "'z' is not measured at a marker"),
    ({"y@0.5": [0.1]}, FREE, "y@0.5 must be on the arm, 0 to 0.418 m, but is at 0.5 m"),
    ({"tip.y": [0.1], "muscles.0.tension": [-1.0]}, FREE, "muscles.0.tension must be at least 0, but is -1 N"),
    ({"tip.y": [0.1], "time": [1.0]}, FREE, "time must be a column only where a TCAM drives"),
    ({"tip.y": [0.1], "water.inlet_fraction": [0.5]}, FREE, "water.inlet_fraction must be free or given by the data"),
    ({"tip.y": [0.1]}, [], "free must name parameters"),
    ({"tip.y": [0.1]}, ["arm.ventral"], "arm.ventral must be a parameter that is one number"),
    ({"tip.y": [0.1]}, {"arm.youngs_modulus": (1e6, 2e6)}, "but starts at 1e+07"),
    (
        {"tip.y": [0.1]},
        {"water.inlet_fraction": (0.5, 2.0)},
        "must be between 0 and 1 within its bounds, but they are 0.5 to 2",
    ),
    ({"tip.y": [0.1, np.inf]}, FREE, "tip.y must be finite, or nan where nothing was measured, but is inf in row 1"),
    ({"tip.y": [np.nan, np.nan]}, FREE, "tip.y must have a value in some row"),
    ({"tip.y": [0.1, 0.1], "water.velocity": [0.2, np.nan]}, FREE, "water.velocity must be given in every row"),
    ({"tip.y": [0.1], "sigma(tip.y)": [-1.0]}, FREE, "sigma(tip.y) must be positive, but is -1 m"),
    ({"tip.y [": [0.1]}, FREE, "the head 'tip.y [' must be a path and a unit"),
]


@pytest.mark.parametrize(("data", "free", "line"), BAD)
def test_bad_input_is_one_line(data, free, line):
    with pytest.raises(InputError) as error:
        fit(load_scene("octopus"), data, free)
    assert line in str(error.value)
    assert "\n" not in str(error.value)


def write_csv(path, tips: dict[str, np.ndarray]) -> None:
    rows = zip(*tips.values(), strict=True)
    path.write_text("\n".join([", ".join(tips), *(", ".join(f"{value:.12g}" for value in row) for row in rows)]) + "\n")


def test_a_table_reads_alike_from_csv_pandas_and_xarray(tips, tmp_path):
    import pandas
    import xarray

    write_csv(tmp_path / "tips.csv", tips)
    frame = pandas.DataFrame(tips)
    columns = {"muscles.0.tension": "N", "water.velocity": "m/s", "tip.x": "m", "tip.y": "m"}
    units = {path: ("row", tips[f"{path} [{unit}]"] * 100, {"units": f"c{unit}"}) for path, unit in columns.items()}
    for data in (tmp_path / "tips.csv", frame, xarray.Dataset(units)):
        read = read_measurements(load_scene("octopus"), data)
        np.testing.assert_allclose(read.values[:, 1], tips["tip.y [m]"], rtol=1e-11)
        np.testing.assert_allclose(read.inputs["muscles.0.tension"], TENSIONS, rtol=1e-11)


@pytest.mark.parametrize(
    "text",
    ["tip.y [cm];muscles.0.tension [N]\n1,4;5\n# a remark\n6,0;12\n",
     "tip.y [cm]\tmuscles.0.tension [N]\n1,4\t5\n\n6\t12\n",
     'tip.y [cm],muscles.0.tension [N]\n1.4,"5\n"\n6,12\n',
     "\ufefftip.y [cm], muscles.0.tension [N]\r\n1.4, 5\r\n6, 12\r\n"],
    ids=["semicolons", "tabs", "a line break in quotes", "a spreadsheet's"],
)  # fmt: skip
def test_tables_of_other_countries_and_programs_are_read(text, tmp_path):
    (tmp_path / "tips.csv").write_bytes(text.encode())
    read = read_measurements(load_scene("octopus"), tmp_path / "tips.csv")
    np.testing.assert_allclose(read.values[:, 0], [0.014, 0.06])
    np.testing.assert_allclose(read.inputs["muscles.0.tension"], [5, 12])


def test_the_command_fits_and_writes_a_scene_that_runs(tips, run: Run, tmp_path):
    write_csv(tmp_path / "tips.csv", tips)
    words = ["fit", "octopus", "tips.csv", "--free", *FREE, "--sigma", "tip.x=0.05 mm", "--sigma", "tip.y=0.005 cm"]
    ran = run(*words, "--json", "--out", "fitted.toml", "--plot", "fit.png")
    assert ran.status == 0, ran.err
    line = json.loads(ran.out)
    assert line["converged"]
    fitted = line["parameters"]["arm.youngs_modulus"]
    assert fitted["value"] == pytest.approx(8.3e6, rel=1e-5)
    assert fitted["unit"] == "Pa"
    assert 0 < fitted["stderr"] < 1e5
    assert line["rms_residual"] < 1e-8
    assert load_scene(tmp_path / "fitted.toml").arm.youngs_modulus == fitted["value"]
    assert (tmp_path / "fit.png").stat().st_size > 20_000
    text = run(*words).out
    assert "arm.youngs_modulus" in text
    assert "95 % in" in text


BAD_FILES = {
    "": "tips.csv: empty; give a line of heads and rows of numbers",
    "tip.y [cm]\n": "tips.csv: no rows",
    "tip.y [cm], water.velocity [m/s]\n1, 0.2\n2\n": "tips.csv: line 3 must have 2 cells, one for each head, but has 1",
    "tip.y [cm]\n1\nwet\n": "tips.csv: line 3, tip.y [cm] must be a number, but is 'wet'",
    "tip.y [cm], tip.y [cm]\n1, 2\n": "tips.csv: every column must have a head of its own, but 'tip.y [cm]'",
    "tip.y [cm], muscles.0.tension [kPa]\n1, 2\n": "tips.csv: muscles.0.tension [kPa] must be a quantity in N",
    "tip.y [cm]\n1\ninf\n": "tips.csv: line 3, tip.y [cm] must be a finite number, or blank",
    "tip.y [cm], water.velocity [m/s]\n, 0.2\n": "tips.csv: tip.y must have a value in some row",
    "tip.y [cm]\n" + "1" * 140_000: "tips.csv: line 2: field larger than field limit",
}


@pytest.mark.parametrize(("text", "line"), BAD_FILES.items())
def test_a_bad_file_is_one_line_and_status_2(text, line, run: Run, tmp_path):
    (tmp_path / "tips.csv").write_text(text)
    ran = run("fit", "octopus", "tips.csv", "--free", "arm.youngs_modulus", "--out", "fitted.toml")
    assert ran.status == 2
    assert line in ran.err
    assert ran.err.count("\n") == 1
    assert list(tmp_path.iterdir()) == [tmp_path / "tips.csv"]
