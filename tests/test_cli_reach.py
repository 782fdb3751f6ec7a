"""`cosserat-jax reach`: what it prints and draws, and that every bad input is one line.

All that is solved here shares one compiled program: a stiff-sectioned arm in air with two muscles.
"""

import json
import os
import re
from pathlib import Path

import numpy as np
import pytest
from command import Run, assert_one_line_and_nothing_left

from cosserat_jax import Reach, ReachOutcome, load_scene, reach, replace, solve
from cosserat_jax.report.figures import reach_figure, workspace_figure

SCENE = """
[arm]
length = "418 mm"
base_radius = "15 mm"
tip_radius = "4 mm"
youngs_modulus = "10 MPa"
poisson_ratio = 0.5
density = "1.1 kg/dm^3"
cross_section = "rigid"

[[muscles]]
base_offset = "12 mm"
end_offset = "1 mm"
tension = "1 N"

[[muscles]]
side = -1
base_offset = "12 mm"
end_offset = "1 mm"
tension = "1 N"
"""
FREE = ["--free", "muscles.0.tension=0:30 N", "muscles.1.tension=0:30 N"]
OUT = "50, 10 cm"
KEYS = [
    "scene", "target", "at", "outcome", "reached", "message", "distance", "parameters", "tip", "effort", "iterations",
]  # fmt: skip


@pytest.fixture
def scene(tmp_path: Path) -> str:
    (tmp_path / "arm.toml").write_text(SCENE)
    return "arm.toml"


def tip_at(scene: str, first: float, second: float) -> tuple[float, float]:
    tip = solve(replace(load_scene(scene), {"muscles.0.tension": first, "muscles.1.tension": second})).tip
    return float(tip.x), float(tip.y)


def test_json_is_the_contract_s_line_for_each_target(run: Run, tmp_path: Path, scene: str) -> None:
    x, y = tip_at(str(tmp_path / scene), 12.0, 3.0)
    ran = run("reach", scene, "--target", f"{1e3 * x!r}, {1e3 * y!r} mm", "--target", OUT, *FREE, "--json")
    assert (ran.status, ran.err, ran.out.count("\n")) == (1, "", 2)
    there, out = (json.loads(line) for line in ran.out.splitlines())
    assert list(there) == list(out) == KEYS
    assert (there["scene"], there["outcome"], there["reached"]) == ("arm.toml", "reached", True)
    assert there["target"] == pytest.approx({"x": x, "y": y})
    assert there["distance"] < 1e-8
    assert there["tip"]["x"] == pytest.approx(x, abs=1e-8)
    assert there["parameters"]["muscles.0.tension"] == pytest.approx(
        {"value": 12.0, "unit": "N", "lower": 0.0, "upper": 30.0}, abs=1e-4
    )
    assert there["parameters"]["muscles.1.tension"]["value"] == pytest.approx(3.0, abs=1e-4)
    assert (out["outcome"], out["reached"], out["target"]) == ("out_of_reach", False, {"x": 0.5, "y": 0.1})
    assert out["message"].startswith(ReachOutcome[ReachOutcome.out_of_reach])
    nearest = np.array([out["tip"]["x"], out["tip"]["y"]])
    assert out["distance"] == pytest.approx(float(np.linalg.norm(nearest - [0.5, 0.1])))


@pytest.mark.slow
def test_text_gives_values_with_bounds_and_a_figure_is_drawn(run: Run, tmp_path: Path, scene: str) -> None:
    x, y = tip_at(str(tmp_path / scene), 12.0, 3.0)
    ran = run("reach", scene, "--target", f"{x}, {y}", *FREE, "--plot", "reach.png")
    assert (ran.status, ran.err) == (0, "")
    assert ran.out.startswith("arm.toml: reached\n")
    assert re.search(r"  muscles\.0\.tension = 12(\.0000\d)? N, of 0 to 30 N\n", ran.out)
    assert "written      " in ran.out
    assert sorted(os.listdir(tmp_path)) == ["arm.toml", "reach.png"]


@pytest.mark.slow
def test_at_is_the_point_that_is_brought_to_the_target(run: Run, scene: str) -> None:
    ran = run("reach", scene, "--target", "0.209, 0 m", "--at", "209 mm", *FREE, "--set", "arm.length=418 mm")
    assert ran.status == 0
    assert ", for the arm at s = 0.209 m\n" in ran.out
    assert "muscles.0.tension = 0 N" in ran.out


@pytest.mark.slow
@pytest.mark.parametrize("one", [True, False])
def test_figures_show_arms_targets_and_workspace(tmp_path: Path, scene: str, one: bool) -> None:
    (tmp_path / scene).write_text(SCENE)
    free = {f"muscles.{i}.tension": (0, 30) for i in range(2)}
    targets = [[0.4, 0.02], [0.5, 0.1], [0.38, -0.1]]
    found: Reach = reach(load_scene(str(tmp_path / scene)), targets[1] if one else targets, free)
    axes, values = reach_figure(found).axes
    assert len([line for line in axes.lines if line.get_gid() == "target"]) == (1 if one else 3)
    assert len([line for line in axes.lines if line.get_gid() == "missed"]) == int(np.sum(~found.reached)) > 0
    assert len([patch for patch in axes.patches if patch.get_gid() == "outline"]) == (1 if one else 3)
    (mesh,) = (collection for collection in axes.collections if collection.get_gid() == "workspace")
    assert len(mesh.get_segments()) == 32
    assert len(values.patches) == (2 if one else 6)
    assert len(workspace_figure({"here": found.workspace, "there": found.workspace}).axes) == 2


@pytest.mark.slow
def test_a_voltage_is_read_in_volts(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def stopped(*arguments: object) -> None:
        asked.append(arguments[1:])
        raise KeyboardInterrupt

    monkeypatch.setattr("cosserat_jax.study.inverse.reach", stopped)
    words = ["reach", "octopus-tcam", "--target", "35, 8 cm", "--free", "muscles.0.tcam.voltage=500:9000 mV"]
    assert run(*words, "water.velocity=0:0.3 m/s", "--at", "30 cm").status == 130
    ((target, free, at),) = asked
    np.testing.assert_allclose(target, [[0.35, 0.08]])
    assert free == {"muscles.0.tcam.voltage": (0.5, 9.0), "water.velocity": (0.0, 0.3)}
    assert at == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["--target", "0.3 m", *FREE], ['--target must be "X, Y UNIT"', "but is '0.3 m'"]),
        (["--target", "0.3, 0.1, 0.2 m", *FREE], ["X, Y UNIT"]),
        (["--target", "0:1:1 m", *FREE], ["X, Y UNIT"]),
        (["--target", "0.3, 0.1 kg", *FREE], ["--target", "'0.3, 0.1 kg' has the wrong unit", "m"]),
        (["--target", "nan, 0.1 m", *FREE], ["--target", "'nan, 0.1 m'"]),
        (["--target", "there", *FREE], ["--target", "'there'"]),
        (["--target", "35 5 cm", *FREE], ["--target must be", "'35 5 cm'"]),
        (["--target", "0:0.1 m", *FREE], ["--target must be", "'0:0.1 m'"]),
        (FREE, ["Missing option '--target'"]),
        (["--target", "0.3, 0.1 m"], ["Missing option '--free'"]),
        (["--target", "0.3, 0.1 m", "--free", "muscles.0.tensoin"], ["arm.toml", "did you mean 'tension'?"]),
        (["--target", "0.3, 0.1 m", "--free", "muscles.7.tension"], ["'7' is not an index", "0 to 1"]),
        (["--target", "0.3, 0.1 m", "--free", "arm.length"], ["arm.length: has no upper bound", "LOWER:UPPER m"]),
        (
            ["--target", "0.3, 0.1 m", "--free", "muscles.0.tension=5:2 N"],
            ["muscles.0.tension must have a lower bound below", "5 to 2"],
        ),
        (["--target", "0.3, 0.1 m", "--free", "muscles.0.tension=0:2 V"], ["wrong unit"]),
        (["--target", "0.3, 0.1 m", "--free", "muscles.0.tcam.voltage"], ["muscles.0.tcam: this scene has none"]),
        (["--target", "0.3, 0.1 m", *FREE, "--at", "50 cm"], ["--at must be", "'50 cm'", "0.418 m"]),
        (["--target", "0.3, 0.1 m", *FREE, "--at", "nan"], ["--at must be", "'nan'"]),
        (["--target", "0.3, 0.1 m", *FREE, "--plot", "no/such.png"], ["--plot 'no/such.png'", "no folder"]),
        (["--target", "0.3, 0.1 m", *FREE, "--plot", "reach.txt"], ["--plot 'reach.txt'", ".png"]),
        (["--target", "0.3, 0.1 m", *FREE, "--set", "arm.length"], ["--set must be PATH=VALUE", "'arm.length'"]),
    ],
)
def test_bad_input_is_one_line_and_nothing_left(
    run: Run, tmp_path: Path, scene: str, words: list[str], named: list[str]
) -> None:
    assert_one_line_and_nothing_left(run, tmp_path, ["reach", scene, *words], named)
