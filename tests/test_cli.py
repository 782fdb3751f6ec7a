"""The command line: what it prints and writes, and that every bad input is one line.

All solves and all sweeps here share two compiled programs: the preset `octopus`, alone and swept over `water.velocity`
in batches of two.
"""

import errno
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import xarray
from command import ARM_FILE, Ran, Run, assert_one_line_and_nothing_left, contents

import cosserat_jax
from cosserat_jax.cli import common
from cosserat_jax.scene import presets, read
from cosserat_jax.study.checkpoint import Checkpoint

SWEEP = ["sweep", "octopus", "--over", "water.velocity=0.2:0.6:0.1 m/s", "--batch", "2"]
STUCK = ["--set", "water.velocity=-5 m/s"]  # a strong current from the tip: the arm would snap
KEYS = ["scene", "outcome", "converged", "message", "residual", "iterations", "steps", "tip", "tip_strain", "tilt_deg"]
KEYS += ["condition", "load_fraction", "failed_at", "tensions_N"]


def stop_at_save(monkeypatch: pytest.MonkeyPatch, number: int) -> None:
    """Ctrl-C when batch `number` has been solved and before it is kept."""
    save = Checkpoint.save

    def stopping(self: Checkpoint, index: int, arrays: list[np.ndarray]) -> None:
        if index == number:
            raise KeyboardInterrupt
        save(self, index, arrays)

    monkeypatch.setattr(Checkpoint, "save", stopping)


# --- scenes, help


def test_scenes_lists_every_preset_with_its_title(run: Run) -> None:
    ran = run("scenes")
    assert (ran.status, ran.err) == (0, "")
    assert [line.split()[0] for line in ran.out.splitlines()] == list(presets())
    assert all(read(name).title in line for name, line in zip(presets(), ran.out.splitlines(), strict=True))


@pytest.mark.parametrize(
    "words", [["--help"], *([name, "--help"] for name in ("scenes", "solve", "sweep", "actuate", "reach"))]
)
def test_help_shows_examples_at_every_level(run: Run, words: list[str]) -> None:
    ran = run(*words)
    assert (ran.status, ran.err) == (0, "")
    assert re.search(r"Examples?:\n +cosserat-jax ", ran.out)


def test_version_is_the_package_s(run: Run) -> None:
    assert cosserat_jax.__version__ in run("--version").out


def test_answers_without_a_solve_do_not_pay_for_plots_and_datasets() -> None:
    script = (
        "import sys; from cosserat_jax.cli import main; main(['scenes', '--no-cache']); main(['solve', 'octopuss']);"
        "sys.exit({'matplotlib', 'xarray', 'h5netcdf', 'pandas'} & set(sys.modules) or 0)"
    )
    ran = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr


# --- solve


def test_solve_json_is_the_contract_s_line(run: Run) -> None:
    ran = run("solve", "octopus", "--set", "muscles.0.tension=20 N", "--set", "water.velocity=0.4 m/s", "--json")
    assert (ran.status, ran.err, ran.out.count("\n")) == (0, "", 1)
    line = json.loads(ran.out)
    assert list(line) == KEYS
    assert (line["scene"], line["outcome"], line["converged"]) == ("octopus", "converged", True)
    assert list(line["tip"]) == ["x", "y", "theta"]
    assert list(line["tip_strain"]) == ["nu", "eta", "mu", "beta"]
    assert line["tip"]["y"] == pytest.approx(0.1044592402, abs=1e-8)
    assert line["residual"] < 1e-7
    assert np.tan(np.radians(line["tilt_deg"])) == pytest.approx(line["tip_strain"]["eta"] / line["tip_strain"]["nu"])


def test_solve_prints_a_line_for_a_scene_that_has_no_solution_and_goes_on(run: Run, tmp_path: Path) -> None:
    stuck = cosserat_jax.replace(cosserat_jax.load_scene("octopus"), {"water.velocity": -5.0})
    (tmp_path / "stuck.toml").write_text(cosserat_jax.dumps(stuck))
    ran = run("solve", "octopus", "stuck.toml", "octopus", "--json")
    assert (ran.status, ran.err) == (1, "")
    assert "NaN" not in ran.out
    first, second, third = (json.loads(line) for line in ran.out.splitlines())
    assert (first["scene"], second["scene"], third["scene"]) == ("octopus", "stuck.toml", "octopus")
    assert first == third
    assert list(second) == KEYS
    assert (second["outcome"], second["converged"], second["tilt_deg"]) == ("limit_point", False, None)
    assert second["tip"] == {"x": None, "y": None, "theta": None}
    assert "limit point" in second["message"]


def test_solve_text_gives_the_tip_with_units(run: Run) -> None:
    ran = run("solve", "octopus", "--set", "water.velocity=0.4 m/s")
    assert ran.status == 0
    assert "y 0.104459 m" in ran.out
    assert "rad" in ran.out
    assert "deg" in ran.out


def test_solve_text_says_why_there_is_no_solution(run: Run) -> None:
    ran = run("solve", "octopus", *STUCK)
    assert (ran.status, ran.err) == (1, "")
    assert "lower the load" in ran.out
    assert "nan" not in ran.out


def test_solve_reads_every_scene_before_it_solves_one(run: Run) -> None:
    ran = run("solve", "octopus", "octopuss", "--json")
    assert (ran.status, ran.out) == (2, "")


def test_solve_draws_the_figure(run: Run, tmp_path: Path) -> None:
    assert run("solve", "octopus", "--plot", "arm.png").status == 0
    assert (tmp_path / "arm.png").read_bytes().startswith(b"\x89PNG")
    assert os.listdir(tmp_path) == ["arm.png"]


@pytest.mark.parametrize("terminal", [True, False])
def test_what_takes_long_says_so_on_a_terminal(
    terminal: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.stderr.isatty", lambda: terminal, raising=False)
    monkeypatch.setattr(common, "_SLOW", 0.05)
    with common.word_if_slow():
        time.sleep(0.3)
    with common.word_if_slow():
        pass
    assert capsys.readouterr().err.count("compiling") == terminal


def test_ctrl_c_is_one_line(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def stopped(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("cosserat_jax.solver.solve", stopped)
    assert run("solve", "octopus") == Ran(130, "", "cosserat-jax: stopped\n")


# --- sweep


def test_ctrl_c_on_a_running_sweep_ends_the_process_with_130(tmp_path: Path) -> None:
    heard = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"  # a job of `cmd &` ignores it
    script = f"{heard}; from cosserat_jax.cli import main; raise SystemExit(main())"
    words = [sys.executable, "-c", script, *SWEEP, "--out", "a.nc", "--no-cache"]
    process = subprocess.Popen(words, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 120
    while not (tmp_path / "a.nc.partial/identity").exists() and time.monotonic() < deadline:
        time.sleep(0.05)
    begin = time.monotonic()
    process.send_signal(signal.SIGINT)  # while XLA compiles
    out, err = process.communicate(timeout=120)
    assert (process.returncode, out, err.count("\n")) == (130, "", 1)
    assert time.monotonic() - begin < 6
    assert "--resume" in err
    assert os.listdir(tmp_path) == ["a.nc.partial"]


def test_sweep_writes_netcdf_that_reads_back_complete(run: Run, tmp_path: Path) -> None:
    ran = run(*SWEEP, "--out", "a.nc", "--plot", "a.svg")
    assert (ran.status, ran.err) == (0, "")  # and no progress bar in a pipe
    assert "5 of 5 rods converged" in ran.out
    assert sorted(os.listdir(tmp_path)) == ["a.nc", "a.svg"]
    assert b"<svg" in (tmp_path / "a.svg").read_bytes()
    with xarray.open_dataset(tmp_path / "a.nc", engine="h5netcdf") as data:
        assert dict(data.sizes) == {"water.velocity": 5, "s": 101, "muscle": 1}
        np.testing.assert_allclose(data["water.velocity"], [0.2, 0.3, 0.4, 0.5, 0.6])
        for name in ("x", "y", "theta", "nu", "eta", "mu", "beta", "N", "H", "M"):
            assert data[name].dims == ("water.velocity", "s")
        for name, variable in data.variables.items():
            assert {"units", "long_name"} <= set(variable.attrs), name
        assert {"scene", "versions", "method"} <= set(data.attrs)
        (tmp_path / "scene.toml").write_text(data.attrs["scene"])
        scene = cosserat_jax.load_scene(tmp_path / "scene.toml")
        for i, velocity in enumerate(data["water.velocity"].values):
            alone = cosserat_jax.solve(cosserat_jax.replace(scene, {"water.velocity": velocity}))
            assert float(data["tip_y"][i]) == pytest.approx(float(alone.tip.y), abs=1e-8)
            np.testing.assert_allclose(data["theta"][i], alone.fields.theta, atol=1e-7)


def test_sweep_without_files_prints_a_table_and_writes_nothing(run: Run, tmp_path: Path) -> None:
    ran = run(*SWEEP)
    assert (ran.status, ran.err) == (0, "")
    assert "water.velocity [m/s]" in ran.out
    assert len(re.findall(r"^0\.\d .* converged$", ran.out, re.MULTILINE)) == 5
    assert "tip height" in ran.out
    assert os.listdir(tmp_path) == []


def test_sweep_runs_the_file_s_own_ranges_when_told_nothing(run: Run, tmp_path: Path) -> None:
    text = cosserat_jax.dumps(cosserat_jax.load_scene("octopus")).partition("[sweep]")[0]
    (tmp_path / "arm.toml").write_text(text + '\n[sweep]\n"water.velocity" = "0.2, 0.4 m/s"\n')
    ran = run("sweep", "arm.toml")
    assert (ran.status, ran.err) == (0, "")
    assert "water.velocity: 2 values, 0.2 to 0.4 m/s" in ran.out


@pytest.mark.slow
def test_sweep_with_a_rod_that_has_no_solution_writes_its_file_and_names_the_rod(run: Run, tmp_path: Path) -> None:
    ran = run("sweep", "octopus", "--over", "water.velocity=0.2, -5 m/s", "--out", "a.nc")
    assert (ran.status, ran.err) == (1, "")
    assert "1 of 2 rods converged" in ran.out
    assert "1 rods: limit_point" in ran.out
    assert re.search(r"water.velocity = -5 m/s: equilibrium is lost .*lower the load", ran.out)
    with xarray.open_dataset(tmp_path / "a.nc", engine="h5netcdf") as data:
        np.testing.assert_array_equal(data["converged"], [1, 0])
        np.testing.assert_array_equal(np.isnan(data["tip_y"]), [False, True])


def test_a_stopped_sweep_resumes_to_the_same_bits(run: Run, tmp_path: Path) -> None:
    assert run(*SWEEP, "--out", "whole.nc").status == 0
    (tmp_path / "a.nc").write_bytes(b"the old file")
    with pytest.MonkeyPatch.context() as patch:
        stop_at_save(patch, 1)
        ran = run(*SWEEP, "--out", "a.nc")
    assert (ran.status, ran.out, ran.err.count("\n")) == (130, "", 1)
    assert "--resume" in ran.err
    assert (tmp_path / "a.nc").read_bytes() == b"the old file"
    assert sorted(os.listdir(tmp_path)) == ["a.nc", "a.nc.partial", "whole.nc"]

    with pytest.MonkeyPatch.context() as patch:
        stop_at_save(patch, 0)  # the first batch is not solved again
        ran = run(*SWEEP, "--out", "a.nc", "--resume")
    assert (ran.status, ran.err) == (0, "")
    assert sorted(os.listdir(tmp_path)) == ["a.nc", "whole.nc"]
    with (
        xarray.open_dataset(tmp_path / "a.nc", engine="h5netcdf") as resumed,
        xarray.open_dataset(tmp_path / "whole.nc", engine="h5netcdf") as whole,
    ):
        assert list(resumed.variables) == list(whole.variables)
        for name in whole.variables:
            assert resumed[name].values.tobytes() == whole[name].values.tobytes(), name


def test_a_sweep_of_one_batch_keeps_nothing_when_it_is_stopped(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stopped(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("cosserat_jax.study.sweep", stopped)
    ran = run("sweep", "octopus", "--out", "a.nc")
    assert ran == Ran(130, "", "cosserat-jax: stopped; nothing was written\n")
    assert os.listdir(tmp_path) == []


def test_a_stopped_sweep_is_not_thrown_away_without_restart(run: Run, tmp_path: Path) -> None:
    with pytest.MonkeyPatch.context() as patch:
        stop_at_save(patch, 1)
        run(*SWEEP, "--out", "a.nc")
    before = contents(tmp_path)
    (tmp_path / "a.nc.partial/thesis.txt").write_text("the only copy")
    ran = run(*SWEEP, "--out", "a.nc")
    assert (ran.status, ran.out, ran.err.count("\n")) == (2, "", 1)
    assert "--resume" in ran.err
    assert "--restart" in ran.err
    assert before.items() <= contents(tmp_path).items()
    with pytest.MonkeyPatch.context() as patch:
        stop_at_save(patch, 0)
        assert run(*SWEEP, "--out", "a.nc", "--restart").status == 2  # that file is in the way
    assert (tmp_path / "a.nc.partial/thesis.txt").read_text() == "the only copy"


def test_bad_input_leaves_a_stopped_sweep_as_it_is(run: Run, tmp_path: Path) -> None:
    with pytest.MonkeyPatch.context() as patch:
        stop_at_save(patch, 1)
        run(*SWEEP, "--out", "a.nc")
    before = contents(tmp_path)
    assert run(*SWEEP, "--out", "a.nc", "--set", "arm.length=-1 m").status == 2
    assert run(*SWEEP, "--out", "a.nc", "--plot", "a.doc").status == 2
    assert contents(tmp_path) == before


def test_a_folder_that_only_looks_like_a_stopped_sweep_is_not_emptied(run: Run, tmp_path: Path) -> None:
    (tmp_path / "a.nc.partial").mkdir()
    (tmp_path / "a.nc.partial/thesis.txt").write_text("the only copy")
    for more in ([], ["--resume"]):
        ran = run(*SWEEP, "--out", "a.nc", *more)
        assert (ran.status, ran.out, ran.err.count("\n")) == (2, "", 1)
        assert "a.nc.partial" in ran.err
    assert (tmp_path / "a.nc.partial/thesis.txt").read_text() == "the only copy"


def test_a_write_that_fails_leaves_the_old_file(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(self: xarray.Dataset, path: Path, **_: object) -> None:
        path.write_bytes(b"half")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    (tmp_path / "a.nc").write_bytes(b"the old file")
    monkeypatch.setattr(xarray.Dataset, "to_netcdf", full)
    ran = run("sweep", "octopus", "--over", "water.velocity=0.2, 0.4 m/s", "--out", "a.nc")
    assert (ran.status, ran.out, ran.err.count("\n")) == (2, "", 1)
    assert "No space left" in ran.err
    assert os.listdir(tmp_path) == ["a.nc"]
    assert (tmp_path / "a.nc").read_bytes() == b"the old file"


# --- bad input: words of the command, and what the line must name

GOOD = ARM_FILE + 'tension = "20 N"\n'

BAD_FILES = {  # what is changed in a good file, to what, and what the line must name
    "typo in a key": ('length = "418 mm"', 'lenght = "418 mm"', ["arm.lenght", "'length'"]),
    "unknown table": ("[[muscles]]", "[[tendons]]", ["tendons", "muscles"]),
    "key at the top": ("\n[arm]", "colour = 1\n[arm]", ["colour"]),
    "missing key": ('density = "1.1 kg/dm^3"', "", ["arm.density", "missing"]),
    "five missing keys": (
        GOOD[GOOD.index("youngs") :],
        '[[muscles]]\nend_offset = "1 mm"\n',
        ["arm.density, arm.youngs_modulus, arm.poisson_ratio, muscles.0.base_offset, muscles.0.tension must be given"],
    ),
    "offset below zero": ('"12 mm"', '"-12 mm"', ["muscles.0.base_offset", "'-12 mm'", "side = -1"]),
    "missing modulus": ('youngs_modulus = "10 MPa"', "", ["arm.youngs_modulus", "missing"]),
    "unknown unit": ('"418 mm"', '"418 furlings"', ["arm.length", "418 furlings", " m"]),
    "wrong dimension": ('"418 mm"', '"418 kg"', ["arm.length", "418 kg", " m"]),
    "text for a number": ('"418 mm"', '"long"', ["arm.length", "long"]),
    "boolean for a number": ('"418 mm"', "true", ["arm.length", "True"]),
    "radius of zero": ('"15 mm"', '"0 mm"', ["arm.base_radius must be positive, but is '0 mm'"]),
    "negative tension": ('"20 N"', '"-20 N"', ["muscles.0.tension", "-20", "at least 0"]),
    "ratio above a half": (
        "poisson_ratio = 0.5",
        "poisson_ratio = 0.6",
        ["arm.poisson_ratio", "0.6", "between 0 and 0.5"],
    ),
    "NaN": ('"418 mm"', "nan", ["arm.length", "nan"]),
    "infinite": ('"418 mm"', "inf", ["arm.length", "inf"]),
    "end after the tip": ('tension = "20 N"', 'tension = "20 N"\nend = "500 mm"', ["muscles.0.end", "0.5", "0.418"]),
    "muscle outside the arm": ('"12 mm"', '"16 mm"', ["muscles.0.base_offset", "0.016", "0.015"]),
    "bad choice": ("[arm]", '[arm]\ncross_section = "soft"', ["arm.cross_section", "'soft'", "'rigid'"]),
    "a list for a table": ("[[muscles]]", "[muscles]", ["muscles", "[[muscles]]"]),
    "not TOML": ('"418 mm"', '"418 mm', ["not a TOML file", "line 3"]),
    "empty": (GOOD, "", ["arm", "missing"]),
    "sweep of nothing known": ("\n[arm]", '\n[sweep]\n"water.velocity" = "0.2 m/s"\n[arm]', ["water.velocity", "none"]),
}

BAD_SCENES = {
    "no such file": (["missing.toml"], ["missing.toml"]),
    "no such preset": (["octopuss"], ["octopuss", "'octopus'"]),
    "folder": (["folder"], ["folder", "directory"]),
    "binary file": (["binary.toml"], ["binary.toml", "not a text file"]),
    "endless name": (["a" * 300], ["a" * 300, "too long"]),
    "second of two": (["octopus", "missing.toml"], ["missing.toml"]),
}

BAD_SETTINGS = {
    "typo": ("water.velocty=1 m/s", ["water.velocty", "'velocity'"]),
    "no such part": ("tip.moment=1 N*m", ["tip.moment", "none"]),
    "a part": ("water=1", ["water", "part"]),
    "empty path": ("=1", ["--set", "arm"]),
    "no equals sign": ("water.velocity", ["'water.velocity'", "PATH=VALUE"]),
    "no value": ("water.velocity=", ["water.velocity", "m/s"]),
    "wrong unit": ("water.velocity=1 kg", ["water.velocity", "1 kg", "m/s"]),
    "out of range": ("muscles.0.tension=-5 N", ["muscles.0.tension", "-5", "at least 0"]),
    "NaN": ("muscles.0.tension=nan", ["muscles.0.tension", "nan"]),
    "overflow": ("muscles.0.tension=1e999 N", ["muscles.0.tension", "must be finite", "1e999 N"]),
    "index past the end": ("muscles.3.tension=5 N", ["muscles.3.tension", "'3'", "0 to 0"]),
    "index that is none": ("muscles.first.tension=5 N", ["muscles.first.tension", "'first'"]),
    "choice": ("arm.cross_section=soft", ["arm.cross_section", "'soft'", "'rigid'"]),
    "two lines": ("water.velocity=1\nm/s/s", ["water.velocity", "m/s"]),
}

BAD_RANGES = {
    "never reaches": ("water.velocity=0:1:-0.1 m/s", ["water.velocity", "0:1:-0.1 m/s", "never"]),
    "step of zero": ("water.velocity=0:1:0 m/s", ["water.velocity", "0:1:0 m/s"]),
    "no step": ("water.velocity=0:1 m/s", ["water.velocity", "0:1 m/s", "START:STOP:STEP"]),
    "text": ("water.velocity=fast", ["water.velocity", "fast", "START:STOP:STEP"]),
    "empty": ("water.velocity=", ["water.velocity", "START:STOP:STEP"]),
    "wrong unit": ("water.velocity=0:1:0.1 N", ["water.velocity", "N", "m/s"]),
    "value out of range": ("muscles.0.tension=-1:1:0.5 N", ["muscles.0.tension", "-1", "at least 0"]),
    "typo": ("muscles.0.tensoin=0:1:0.5 N", ["muscles.0.tensoin", "'tension'"]),
    "choice": ("arm.cross_section=rigid", ["arm.cross_section", "one number"]),
    "no equals sign": ("water.velocity", ["'water.velocity'", "PATH=VALUE"]),
    "too long": ("water.velocity=0:1:1e-9 m/s", ["water.velocity", "1000000"]),
}

BAD_COMMANDS = {
    "nothing": ([], ["command"]),
    "unknown command": (["swep"], ["'swep'", "'sweep'"]),
    "unlike any command": (["xyz"], ["'xyz'", "scenes, solve, sweep"]),
    "unknown option": (["solve", "octopus", "--jsn"], ["--jsn", "--json"]),
    "unknown global option": (["--fast"], ["--fast"]),
    "no scene": (["solve", "--json"], ["SCENE"]),
    "two scenes to sweep": ([*SWEEP, "elastica"], ["elastica"]),
    "word after scenes": (["scenes", "octopus"], ["octopus"]),
    "option without its value": (["solve", "octopus", "--set"], ["--set"]),
    "batch of zero": ([*SWEEP, "--batch", "0"], ["--batch", "0", "1"]),
    "batch of words": ([*SWEEP, "--batch", "many"], ["--batch", "many"]),
    "nothing to sweep": (["sweep", "timoshenko"], ["timoshenko", "--over"]),
    "path set twice": (["solve", "octopus", *STUCK, *STUCK], ["water.velocity", "twice"]),
    "path swept twice": ([*SWEEP, "--over", "water.velocity=1 m/s"], ["water.velocity", "twice"]),
    "path set and swept": ([*SWEEP, *STUCK], ["water.velocity", "'-5 m/s'", "--set"]),
    "too many rods": ([*SWEEP, "--over", "muscles.0.tension=0:21:1e-4 N"], ["1050005 rods", "1000000"]),
    "resume without out": ([*SWEEP, "--resume"], ["--resume", "--out"]),
    "no folder for out": ([*SWEEP, "--out", "none/a.nc"], ["--out", "none/a.nc", "folder"]),
    "out below a file": ([*SWEEP, "--out", "binary.toml/a.nc"], ["--out", "binary.toml/a.nc"]),
    "out is a folder": ([*SWEEP, "--out", "folder.nc"], ["--out", "folder.nc", "folder"]),
    "name of out too long": ([*SWEEP, "--out", "a" * 250 + ".nc"], ["--out", "aaa.nc", "too long"]),
    "out with a wrong ending": ([*SWEEP, "--out", "a.csv"], ["--out", "a.csv", ".nc"]),
    "no folder for a plot": (["solve", "octopus", "--plot", "none/a.png"], ["--plot", "none/a.png", "folder"]),
    "plot with a wrong ending": (["solve", "octopus", "--plot", "a.doc"], ["--plot", "a.doc", ".png"]),
    "one file for both": ([*SWEEP, "--out", "a.nc", "--plot", "./a.nc"], ["--out", "--plot", "a.nc"]),
}


def bad_inputs() -> Iterator:
    """Words of a command, what the line must name, and the text of arm.toml."""
    for name, (words, named) in BAD_COMMANDS.items():
        yield pytest.param(words, named, GOOD, id=f"command: {name}")
    for name, (words, named) in BAD_SCENES.items():
        yield pytest.param(["solve", *words], named, GOOD, id=f"scene: {name}")
    for name, (text, named) in BAD_SETTINGS.items():
        yield pytest.param(["solve", "octopus", "--set", text], named, GOOD, id=f"set: {name}")
    for name, (text, named) in BAD_RANGES.items():
        yield pytest.param(["sweep", "octopus", "--out", "a.nc", "--over", text], named, GOOD, id=f"over: {name}")
    for name, (old, new, named) in BAD_FILES.items():
        yield pytest.param(["solve", "arm.toml"], ["arm.toml", *named], GOOD.replace(old, new), id=f"file: {name}")


@pytest.mark.parametrize(("words", "named", "text"), list(bad_inputs()))
def test_bad_input_is_one_line_and_leaves_nothing(
    run: Run, tmp_path: Path, words: list[str], named: list[str], text: str
) -> None:
    (tmp_path / "arm.toml").write_text(text)
    (tmp_path / "binary.toml").write_bytes(bytes(range(256)))
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder.nc").mkdir()
    assert_one_line_and_nothing_left(run, tmp_path, words, named)


def test_a_good_file_is_what_the_bad_ones_were_made_from(run: Run, tmp_path: Path) -> None:
    (tmp_path / "arm.toml").write_text(GOOD)
    assert all(old in GOOD for old, _, _ in BAD_FILES.values())
    assert cosserat_jax.load_scene("arm.toml").muscles
