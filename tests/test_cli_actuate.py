"""`cosserat-jax actuate`: what it prints and writes, and that every bad input is one line.

All that is solved here shares one compiled program: the preset `octopus-tcam` at five instants. Its muscle's motion is
compared with SciPy's integrator; the peak, 98.1677 degC at 5.89445 s, and its 25 N are those of the paper's figure.
"""

import dataclasses
import errno
import json
import os
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import xarray
from command import ARM_FILE, Ran, Run, assert_one_line_and_nothing_left, contents
from PIL import Image
from scipy.integrate import solve_ivp

import cosserat_jax
from cosserat_jax import Actuation, ResponseOutcome, VoltageFunction, parameters, replace
from cosserat_jax.physics.tcam import spring_coefficient
from cosserat_jax.report.text import actuation_json, actuation_text, overheated_lines
from cosserat_jax.solver import Peak

UNTIL = ["--until", "6.28 s", "--steps", "4"]
ACTUATE = ["actuate", "octopus-tcam", *UNTIL]
LOST = ["--set", "water.velocity=-5 m/s"]  # a strong current from the tip: at most instants the arm would snap
NO_COIL = ["--set", "muscles.0.tcam.turns=1"]  # a fiber that is hardly twisted does not coil
GAIN, AMBIENT = 0.332579486497273, 296.15  # N/K, K
FORMULAS_GAIN = 8.4506961401e-4  # N/K, which the muscle's own motion follows
KEYS = [
    "scene", "outcome", "converged", "message", "instants", "instants_converged", "peak_temperature_degC",
    "time_of_peak_s", "peak_force_N", "peak_contraction_m", "tip_at_end", "muscles",
]  # fmt: skip
MUSCLE_KEYS = ["outcome", "peak_temperature_degC", "time_of_peak_s", "peak_force_N"]
NOWHERE = {"x": None, "y": None, "theta": None}
VARIABLES = {
    ("muscle", "time"): "voltage temperature contraction contraction_rate force tension",
    ("muscle",): "peak_temperature time_of_peak limit_temperature muscle_outcome muscle_steps",
    ("time",): "tip_x tip_y tip_theta tip_nu tip_eta tip_mu tip_beta tilt outcome converged residual iterations steps "
    "load_fraction condition failed_at",
    ("time", "s"): "x y theta nu eta mu beta N H M force_x force_y moment",
}
UNITS = {
    "time": "s", "muscle": "1", "s": "m", "voltage": "V", "temperature": "K", "contraction": "m",
    "contraction_rate": "m/s", "force": "N", "tension": "N", "peak_temperature": "K", "time_of_peak": "s",
    "limit_temperature": "K", "muscle_outcome": "1", "muscle_steps": "1", "tip_y": "m", "M": "Pa/m",
}  # fmt: skip


@pytest.fixture(scope="module")
def actuation() -> Actuation:
    return cosserat_jax.actuate(cosserat_jax.load_scene("octopus-tcam"), np.linspace(0, 6.28, 5))


# --- what it prints


def test_json_is_the_contract_s_line(run: Run) -> None:
    ran = run(*ACTUATE, "--json")
    assert (ran.status, ran.err, ran.out.count("\n")) == (0, "", 1)
    line = json.loads(ran.out)
    assert list(line) == KEYS
    assert (line["scene"], line["outcome"], line["converged"]) == ("octopus-tcam", "followed", True)
    assert line["message"] == ResponseOutcome[ResponseOutcome.followed]
    assert (line["instants"], line["instants_converged"]) == (5, 5)
    assert list(line["muscles"]) == ["0"]
    assert list(line["muscles"]["0"]) == MUSCLE_KEYS
    for peaks in (line, line["muscles"]["0"]):
        assert peaks["peak_temperature_degC"] == pytest.approx(98.1677, abs=1e-4)
        assert peaks["time_of_peak_s"] == pytest.approx(5.89445, abs=1e-5)
        assert peaks["peak_force_N"] == pytest.approx(25.0, abs=1e-2)
    assert list(line["tip_at_end"]) == ["x", "y", "theta"]
    assert 0 < line["tip_at_end"]["y"] < 0.418


def test_text_gives_peak_and_tip_with_units(run: Run) -> None:
    ran = run(*ACTUATE)
    assert (ran.status, ran.err) == (0, "")
    assert "5 from 0 to 6.28 s, 5 converged" in ran.out
    assert "peak 98.1677 degC and 24.9992 N at 5.89445 s" in ran.out
    assert re.search(r"tip at end +x 0\.\d+ m, y 0\.\d+ m\n +theta +\S+ rad, \S+ deg\n$", ran.out)


@pytest.mark.parametrize(
    ("words", "last", "instants"), [([], 6.28, 500), (["--until", "1 min"], 60.0, 500), (["--steps", "1"], 6.28, 2)]
)
def test_instants_are_equally_spaced_from_zero(
    run: Run, monkeypatch: pytest.MonkeyPatch, words: list[str], last: float, instants: int
) -> None:
    asked = []

    def stopped(scene: object, times: np.ndarray) -> None:
        asked.append(times)
        raise KeyboardInterrupt

    monkeypatch.setattr("cosserat_jax.study.actuate", stopped)
    assert run("actuate", "octopus-tcam", "--until", "6.28 s", *words) == Ran(130, "", "cosserat-jax: stopped\n")
    np.testing.assert_allclose(asked[0], last * np.arange(instants) / (instants - 1), rtol=1e-14)


def test_an_overheated_muscle_is_a_warning_and_all_is_written(run: Run, tmp_path: Path) -> None:
    ran = run("actuate", "octopus-tcam", "--until", "60 s", "--steps", "4", "--json", "--out", "a.nc")
    assert (ran.status, ran.err.count("\n")) == (0, 1)
    assert ran.err.startswith(
        "cosserat-jax: warning: muscles.0.tcam: 553.3 K = 280.1 degC at 58.9 s, above its limit of 150 degC; lower"
    )
    line = json.loads(ran.out)
    assert (line["outcome"], line["converged"]) == ("overheated", True)
    assert line["muscles"]["0"]["outcome"] == "overheated"
    assert line["message"].startswith("muscles.0.tcam: the muscle is hotter than its limit")
    assert os.listdir(tmp_path) == ["a.nc"]


@pytest.mark.slow
def test_instants_without_equilibrium_are_null_and_all_is_written(run: Run, tmp_path: Path) -> None:
    ran = run(*ACTUATE, *LOST, "--json", "--out", "a.nc", "--plot", "a.png")
    assert (ran.status, ran.err) == (1, "")
    line = json.loads(ran.out)
    assert (line["outcome"], line["converged"], line["tip_at_end"]) == ("followed", False, NOWHERE)
    assert re.search(r"[45] of 5 instants have no equilibrium, first at 0 s: .*lower the load", line["message"])
    assert line["peak_temperature_degC"] == pytest.approx(98.1677, abs=1e-4)  # the water does not reach the muscle
    assert sorted(os.listdir(tmp_path)) == ["a.nc", "a.png"]
    with xarray.open_dataset("a.nc", engine="h5netcdf") as data:
        assert int(data["converged"].sum()) == line["instants_converged"] < 2
        np.testing.assert_array_equal(np.isnan(data["tip_y"]), data["converged"] == 0)
        assert np.isfinite(data["tension"]).all()


def test_a_muscle_that_makes_no_tension_is_named(run: Run, tmp_path: Path) -> None:
    ran = run(*ACTUATE, *NO_COIL, "--json", "--out", "a.nc", "--plot", "a.gif")
    assert (ran.status, ran.err) == (1, "")
    line = json.loads(ran.out)
    assert (line["outcome"], line["converged"], line["instants_converged"]) == ("no_coil", False, 0)
    assert line["message"] == f"muscles.0.tcam: {ResponseOutcome[ResponseOutcome.no_coil]}"
    assert (line["tip_at_end"], line["peak_contraction_m"]) == (NOWHERE, None)
    for peaks in (line, line["muscles"]["0"]):
        assert [peaks[key] for key in MUSCLE_KEYS] == ["no_coil", None, None, None]
    assert sorted(os.listdir(tmp_path)) == ["a.gif", "a.nc"]
    assert "nan" not in run(*ACTUATE, *NO_COIL).out


def test_peaks_at_the_top_are_those_of_the_hottest_and_of_the_strongest_muscle(actuation: Actuation) -> None:
    arm, made = actuation.scene, actuation.responses[0]
    weak = replace(arm, {"muscles.0.tcam.tension_gain": 0.1, "muscles.0.tcam.limit_temperature": 400.0}).muscles[0]
    given = dataclasses.replace(weak, tcam=None, tension=1.0)
    hot = dataclasses.replace(made, peak=Peak(np.array(420.0), np.array(3.0)), outcome=ResponseOutcome.overheated)
    two = dataclasses.replace(
        actuation,
        scene=dataclasses.replace(arm, muscles=(arm.muscles[0], given, weak)),
        responses={0: made, 2: hot},
    )
    line = json.loads(actuation_json("two", two))
    assert list(line["muscles"]) == ["0", "2"]
    assert [muscle["outcome"] for muscle in line["muscles"].values()] == ["followed", "overheated"]
    assert line["outcome"] == "overheated"
    assert line["peak_temperature_degC"] == pytest.approx(420 - 273.15)
    assert line["time_of_peak_s"] == 3.0
    assert line["muscles"]["2"]["peak_force_N"] == pytest.approx(0.1 * (420 - AMBIENT))
    assert line["peak_force_N"] == line["muscles"]["0"]["peak_force_N"] == pytest.approx(25.0, abs=1e-2)
    assert "muscles.2 " in actuation_text("two", two)
    (warning,) = overheated_lines(two)
    assert warning.startswith("muscles.2.tcam: 420.0 K = 146.9 degC at 3.0 s, above its limit of 126.85 degC; ")
    np.testing.assert_array_equal(two.to_xarray()["limit_temperature"], [423.15, 400.0])
    np.testing.assert_array_equal(two.to_xarray()["muscle"], [0, 2])


# --- what it writes


def test_netcdf_reads_back_complete(run: Run, tmp_path: Path) -> None:
    ran = run(*ACTUATE, "--json", "--out", "a.nc")
    assert (ran.status, ran.err) == (0, "")
    line = json.loads(ran.out)
    with xarray.open_dataset(tmp_path / "a.nc", engine="h5netcdf") as data:
        assert dict(data.sizes) == {"time": 5, "muscle": 1, "s": 101}
        found = {name: variable.dims for name, variable in data.data_vars.items()}
        assert found == {name: dims for dims, names in VARIABLES.items() for name in names.split()}
        for name, variable in data.variables.items():
            assert {"units", "long_name"} <= set(variable.attrs), name
            assert (np.isnan if name == "failed_at" else np.isfinite)(variable).all(), name
        assert {name: data[name].attrs["units"] for name in UNITS} == UNITS
        assert {"title", "scene", "versions", "date"} <= set(data.attrs)
        (tmp_path / "scene.toml").write_text(data.attrs["scene"])
        scene = cosserat_jax.load_scene(tmp_path / "scene.toml")
        assert parameters(scene) == parameters(cosserat_jax.load_scene("octopus-tcam"))

        t = data["time"].values
        np.testing.assert_allclose(t, [0, 1.57, 3.14, 4.71, 6.28], rtol=1e-14)
        np.testing.assert_allclose(data["s"], 0.418 * np.linspace(0, 1, 101), rtol=1e-14)
        np.testing.assert_array_equal(data["muscle"], [0])
        rise, contraction, rate = muscle_motion(t)
        np.testing.assert_allclose(data["voltage"][0], 9 * np.sin(t), atol=1e-12)
        np.testing.assert_allclose(data["temperature"][0], AMBIENT + rise, atol=1e-6)
        np.testing.assert_allclose(data["contraction"][0], contraction, atol=1e-9)
        np.testing.assert_allclose(data["contraction_rate"][0], rate, atol=1e-9)
        np.testing.assert_allclose(data["tension"][0], GAIN * rise, atol=1e-6)
        np.testing.assert_allclose(data["force"][0], FORMULAS_GAIN * rise, atol=1e-9)
        assert line["peak_contraction_m"] == pytest.approx(contraction.max(), abs=1e-9)

        assert float(data["peak_temperature"][0]) == pytest.approx(98.1677 + 273.15, abs=1e-4)
        assert float(data["time_of_peak"][0]) == pytest.approx(5.89445, abs=1e-5)
        assert float(data["limit_temperature"][0]) == 150 + 273.15
        names = data["muscle_outcome"].attrs["flag_meanings"].split()
        assert names == ["followed", "overheated", "no_coil", "voltage_not_resolved", "integration_failed"]
        codes = data["muscle_outcome"].attrs["flag_values"].tolist()
        assert names[codes.index(int(data["muscle_outcome"][0]))] == "followed"
        assert "limit_point" in data["outcome"].attrs["flag_meanings"]
        np.testing.assert_array_equal(data["converged"], 1)
        for name, tip in line["tip_at_end"].items():
            assert float(data[f"tip_{name}"][-1]) == float(data[name][-1, -1]) == tip


def muscle_motion(t: np.ndarray) -> np.ndarray:
    """Rise [K], contraction [m] and its rate [m/s] of the preset's muscle at `t`, by SciPy from the paper's equations:
    C_t T' = v^2 / R - lambda T,  m d'' + 2 sqrt(m k_o) d' + k_o d = C_T T, with C_T of the formulas."""
    stiffness = float(spring_coefficient(cosserat_jax.TCAM(), 0.0))

    def slope(t: float, state: np.ndarray) -> list[float]:
        rise, contraction, rate = state
        damping = 2 * np.sqrt(0.106 * stiffness)
        acceleration = (FORMULAS_GAIN * rise - damping * rate - stiffness * contraction) / 0.106
        return [(81 * np.sin(t) ** 2 / 18 - 0.0086 * rise) / 0.162, rate, acceleration]

    return solve_ivp(slope, (0, t[-1]), np.zeros(3), t_eval=t, rtol=1e-11, atol=1e-11, method="DOP853").y


def test_a_voltage_that_is_a_function_is_said_to_be_one(actuation: Actuation) -> None:
    muscle = actuation.scene.muscles[0]
    tcam = dataclasses.replace(muscle.tcam, voltage=VoltageFunction(np.sin))
    scene = dataclasses.replace(actuation.scene, muscles=(dataclasses.replace(muscle, tcam=tcam),))
    text = dataclasses.replace(actuation, scene=scene).to_xarray().attrs["scene"]
    assert text.startswith("not written: ")
    assert "voltage: a Python function has no text" in text


def test_figure_and_animation_are_written(run: Run, tmp_path: Path) -> None:
    ran = run(*ACTUATE, "--plot", "a.GIF")
    assert (ran.status, ran.err) == (0, "")
    assert f"written      {tmp_path / 'a.GIF'}" in ran.out
    with Image.open("a.GIF") as animation:
        assert animation.format == "GIF"
        assert animation.n_frames > 1
    assert run(*ACTUATE, "--plot", "a.png").status == 0
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    assert sorted(os.listdir(tmp_path)) == ["a.GIF", "a.png"]


def test_a_write_that_fails_leaves_the_old_file(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(self: xarray.Dataset, path: Path, **_: object) -> None:
        path.write_bytes(b"half")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    (tmp_path / "a.nc").write_bytes(b"the old file")
    monkeypatch.setattr(xarray.Dataset, "to_netcdf", full)
    ran = run(*ACTUATE, "--out", "a.nc")
    assert (ran.status, ran.out, ran.err.count("\n")) == (2, "", 1)
    assert "No space left" in ran.err
    assert contents(tmp_path) == {str(tmp_path / "a.nc"): b"the old file"}


@pytest.mark.parametrize("ffmpeg", [True, False])
def test_an_mp4_is_asked_for_only_where_there_is_ffmpeg(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ffmpeg: bool
) -> None:
    drawn = []
    monkeypatch.setattr("matplotlib.animation.writers.is_available", lambda name: ffmpeg)
    monkeypatch.setattr("cosserat_jax.report.figures.save_animation", lambda _, place: drawn.append(place))
    ran = run(*ACTUATE, "--plot", "a.mp4")
    if ffmpeg:
        assert (ran.status, ran.err, drawn) == (0, "", [tmp_path / "a.mp4"])
    else:
        assert (ran.status, ran.out, ran.err.count("\n"), drawn) == (2, "", 1, [])
        assert all(part in ran.err for part in ("--plot", "'a.mp4'", "ffmpeg", "allowed: .gif"))


# --- bad input: words of the command, and what the line must name

GOOD = (
    ARM_FILE
    + """
[muscles.tcam]
conductance = "0.0086 W/K"
limit_temperature = "150 degC"
voltage = { amplitude = "9 V", frequency = "1 rad/s" }
"""
)
SINE = '{ amplitude = "9 V", frequency = "1 rad/s" }'
TABLE = GOOD[GOOD.index("[muscles.tcam]") :]


def pulses(width: str = '"1 s"', number: str = "3") -> str:
    return f'{{ kind = "pulses", amplitude = "9 V", width = {width}, period = "2 s", number = {number} }}'


def sampled(times: str, values: str = '"0, 1, 2 V"') -> str:
    return f'{{ kind = "sampled", times = {times}, values = {values} }}'


VOLTAGE = "muscles.0.tcam.voltage"
BAD_FILES = {  # what is changed in a good file, to what, and what the line must name
    "typo in a key": ("conductance", "conductanse", ["muscles.0.tcam.conductanse", "'conductance'"]),
    "negative conductance": ('"0.0086 W/K"', '"-1 W/K"', ["muscles.0.tcam.conductance", "-1", "at least 0"]),
    "NaN": ('"0.0086 W/K"', "nan", ["muscles.0.tcam.conductance", "nan"]),
    "limit below ambient": ('"150 degC"', '"20 degC"', ["tcam.limit_temperature", "293.15", "296.15"]),
    "no table": (TABLE, 'tcam = "9 V"', ["muscles.0.tcam", "'9 V'", "[muscles.0.tcam]"]),
    "tension and tcam": ("[muscles.tcam]", 'tension = "20 N"\n[muscles.tcam]', ["muscles.0.tension", "muscles.0.tcam"]),
    "neither": (TABLE, "", ["muscles.0.tension", "missing"]),
    "voltage that is a string": (SINE, '"9 V"', [f"{VOLTAGE} must be a table", "'9 V'", f"[{VOLTAGE}]"]),
    "kind of voltage": ("{ amp", '{ kind = "square", amp', [f"{VOLTAGE}.kind", "'square'", "'sinusoid'", "'pulses'"]),
    "key of a voltage": ("{ amp", '{ start = "1 s", amp', [f"{VOLTAGE}.start", "allowed: amplitude"]),
    "frequency in seconds": ("1 rad/s", "1 s", [f"{VOLTAGE}.frequency", "'1 s'", "rad/s"]),
    "no amplitude": ('amplitude = "9 V", ', "", [f"{VOLTAGE}.amplitude", "missing"]),
    "pulses that overlap": (SINE, pulses(width='"3 s"'), [f"{VOLTAGE}.width", "3", "at most 2 s", "period"]),
    "no pulse": (SINE, pulses(number="0"), [f"{VOLTAGE}.number", "0", "1 to 100000"]),
    "half a pulse": (SINE, pulses(number="2.5"), [f"{VOLTAGE}.number", "2.5", "whole number"]),
    "samples in disorder": (SINE, sampled('"0, 2, 1 s"'), [f"{VOLTAGE}.times", "1 s", "after"]),
    "two samples at once": (SINE, sampled('["0 s", "1 s", 1]'), [f"{VOLTAGE}.times", "1 s", "after"]),
    "ragged samples": (SINE, sampled('"0, 1 s"'), [f"{VOLTAGE} must", "2", "3", "as many"]),
    "one sample": (SINE, sampled('"0 s"', '"1 V"'), [f"{VOLTAGE} must", "at least 2"]),
}

BAD_TIMES = {
    "wrong unit": ("6.5 m", ["--until", "'6.5 m'", "quantity in s"]),
    "negative": ("-1 s", ["--until", "'-1 s'", "more than 0"]),
    "zero": ("0 s", ["--until", "'0 s'", "more than 0"]),
    "NaN": ("nan s", ["--until", "'nan s'", "finite"]),
    "infinite": ("inf s", ["--until", "'inf s'", "finite"]),
    "overflow": ("1e400 s", ["--until", "'1e400 s'", "finite"]),
    "text": ("soon", ["--until", "'soon'", "a number and a unit"]),
    "empty": ("", ["--until", "''", "a number and a unit"]),
}

OUTPUTS = ["--out", "a.nc", "--plot", "a.gif"]
BAD_COMMANDS = {
    "no end": (["actuate", "arm.toml"], ["--until"]),
    "no scene": (["actuate", *UNTIL], ["SCENE"]),
    "no such scene": (["actuate", "octopus-tcm", *UNTIL], ["octopus-tcm", "'octopus-tcam'"]),
    "no steps": (["actuate", "arm.toml", *UNTIL, "--steps", "0"], ["--steps", "0", "1"]),
    "too many steps": (["actuate", "arm.toml", *UNTIL, "--steps", "100001"], ["--steps", "100001", "100000"]),
    "half a step": (["actuate", "arm.toml", *UNTIL, "--steps", "2.5"], ["--steps", "2.5"]),
    "no TCAM": (["actuate", "octopus", *UNTIL, *OUTPUTS], ["octopus: muscles", "tcam"]),
    "solve with a TCAM": (["solve", "octopus", "arm.toml"], ["arm.toml: muscles.0.tcam", "actuate"]),
    "sweep with a TCAM": (
        ["sweep", "arm.toml", "--over", "arm.length=0.4:0.5:0.1 m", *OUTPUTS],
        ["arm.toml: muscles.0.tcam", "actuate"],
    ),
    "set a typo": (["actuate", "arm.toml", *UNTIL, "--set", "muscles.0.tcam.turn=3"], ["tcam.turn", "'turns'"]),
    "set out of range": (
        ["actuate", "arm.toml", *UNTIL, "--set", f"{VOLTAGE}.frequency=-1 Hz"],
        ["arm.toml: --set", f"{VOLTAGE}.frequency", "at least 0"],
    ),
    "set a voltage": (["actuate", "arm.toml", *UNTIL, "--set", f"{VOLTAGE}=3 V"], [VOLTAGE, "part"]),
    "out with a wrong ending": (["actuate", "arm.toml", *UNTIL, "--out", "a.csv"], ["--out", "a.csv", ".nc"]),
    "plot with a wrong ending": (["actuate", "arm.toml", *UNTIL, "--plot", "a.avi"], ["--plot", "a.avi", ".gif"]),
    "no folder for a plot": (["actuate", "arm.toml", *UNTIL, "--plot", "none/a.gif"], ["--plot", "none/a.gif"]),
    "one file for both": (["actuate", "arm.toml", *UNTIL, "--out", "a.nc", "--plot", "./a.nc"], ["--out", "--plot"]),
}


def bad_inputs() -> Iterator:
    """Words of a command, what the line must name, and the text of arm.toml."""
    for name, (words, named) in BAD_COMMANDS.items():
        yield pytest.param(words, named, GOOD, id=f"command: {name}")
    for name, (text, named) in BAD_TIMES.items():
        yield pytest.param(["actuate", "arm.toml", "--until", text, *OUTPUTS], named, GOOD, id=f"until: {name}")
    for name, (old, new, named) in BAD_FILES.items():
        words = ["actuate", "arm.toml", *UNTIL, *OUTPUTS]
        yield pytest.param(words, ["arm.toml", *named], GOOD.replace(old, new), id=f"file: {name}")


@pytest.mark.parametrize(("words", "named", "text"), list(bad_inputs()))
def test_bad_input_is_one_line_and_leaves_nothing(
    run: Run, tmp_path: Path, words: list[str], named: list[str], text: str
) -> None:
    (tmp_path / "arm.toml").write_text(text)
    assert_one_line_and_nothing_left(run, tmp_path, words, named)


@pytest.mark.parametrize("voltage", [SINE, pulses(), sampled('"0, 1, 2 s"')])
def test_good_files_are_what_the_bad_ones_were_made_from(run: Run, tmp_path: Path, voltage: str) -> None:
    (tmp_path / "arm.toml").write_text(GOOD.replace(SINE, voltage))
    assert all(old in GOOD for old, _, _ in BAD_FILES.values())
    assert cosserat_jax.load_scene("arm.toml").muscles[0].tcam is not None
