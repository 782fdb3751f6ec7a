"""Results print themselves, with numbers and units; draw themselves in a notebook; and become datasets."""

from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray

from cosserat_jax import (
    Actuation,
    Reach,
    ReachOutcome,
    Response,
    ResponseOutcome,
    Solution,
    Sweep,
    Workspace,
    load_scene,
    replace,
    solve,
)
from cosserat_jax.solver import Automatic, Outcome, Peak, Pose
from cosserat_jax.solver.display import data_against_model
from cosserat_jax.solver.outcome import from_codes
from cosserat_jax.study.free_parameters import free_parameters

SCENE = load_scene("octopus")
TENSION = "muscles.0.tension"
TENSIONS = np.array([0.0, 5.0, 10.0, 15.0, np.nan])


@pytest.fixture(scope="module")
def rods() -> Solution:
    """Five rods, the last without a solution."""
    solved = eqx.filter_jit(
        jax.vmap(lambda tension: solve(replace(SCENE, {TENSION: tension}), points=5, throw=False))
    )(TENSIONS)  # fmt: skip
    return jax.tree.map(np.asarray, solved)


@pytest.fixture(scope="module")
def one(rods: Solution) -> Solution:
    return jax.tree.map(lambda leaf: leaf[3], rods)


@pytest.fixture(scope="module")
def response() -> Response:
    times = np.linspace(0.0, 4.0, 5)
    numbers = {name: times + i for i, name in enumerate(Response.__dataclass_fields__) if name not in
               ("times", "peak", "outcome", "steps")}  # fmt: skip
    peak = Peak(np.array(310.5), np.array(3.5))
    return Response(times=times, peak=peak, outcome=ResponseOutcome.followed, steps=np.array(40), **numbers)


@pytest.fixture(scope="module")
def results(rods: Solution, one: Solution, response: Response) -> dict[str, Any]:
    free, at = free_parameters(SCENE, [TENSION]), np.array([0.418])
    points = np.stack([rods.tip.x, rods.tip.y], axis=-1)
    grid = Workspace(SCENE, free, at, {TENSION: TENSIONS}, (5,), points[:, None])
    codes = np.array([0, 0, 0, 0, int(ReachOutcome.no_equilibrium._value)])
    searched = np.full(5, 3)
    reached = Reach(
        SCENE, free, at, points, {TENSION: TENSIONS}, {TENSION: TENSIONS}, points, rods,
        from_codes(ReachOutcome, codes), 0 * rods.tip.x, 0 * rods.tip.x, searched, searched, grid,
    )  # fmt: skip
    return {
        "pose": one.tip,
        "strain": one.tip_strain,
        "one": one,
        "rods": rods,
        "sweep": Sweep(SCENE, {TENSION: TENSIONS}, Automatic(), rods),
        "response": response,
        "actuation": Actuation(SCENE, response.times, {0: response}, rods),
        "workspace": grid,
        "reach": reached,
        "reach one": reached.first,
    }


def test_a_pose_is_one_line_with_units() -> None:
    pose = Pose(jnp.array(0.35), np.array(0.1170004), 1.2)
    assert repr(pose) == "Pose(x=0.35 m, y=0.117 m, theta=1.2 rad)"


@pytest.mark.parametrize(
    ("name", "holds"),
    [
        ("strain", ["SectionStrains(nu=", " 1/m"]),
        ("one", ["Solution: converged", "tensions: 15 N", "tip: x=0.", "1/m"]),
        ("rods", ["Solution of 5 rods: 4 converged, 1 bad_input", " to ", "rad"]),
        ("sweep", ["Sweep of 5 rods: 4 converged, 1 bad_input", f"{TENSION}: 5 values, 0 to 15 N", "Pose(x="]),
        ("response", ["Response: followed", "times: 5, 0 to 4 s", "peak: 310.5 K at 3.5 s"]),
        ("actuation", ["Actuation at 5 instants, 0 to 4 s: 4 converged", "muscles.0: followed, peak 310.5 K"]),
        ("workspace", ["Workspace of 5 rods: 4 converged, 1 without", f"{TENSION}: 0 to 15 N", "s=0.418 m: x=0."]),
        ("reach", ["Reach of 5 targets: 4 reached, 1 no_equilibrium", "distance: 0 to 0 m"]),
        ("reach one", ["Reach: reached", f"{TENSION}: 0 N"]),
    ],
)
def test_text_holds_numbers_and_units(results: dict[str, Any], name: str, holds: list[str]) -> None:
    text = repr(results[name])
    assert all(part in text for part in holds), text
    assert len(text.splitlines()) < 10
    assert max(map(len, text.splitlines())) < 160


@pytest.mark.parametrize("name", ["one", "rods", "sweep", "reach", "reach one"])
def test_a_notebook_draws_it(results: dict[str, Any], name: str) -> None:
    shown = results[name]._repr_html_()
    assert "<pre>" in shown
    assert "<polyline" in shown
    assert "nan" not in shown.partition("<svg")[2]
    assert ("<path" in shown) == name.startswith("reach")


def test_a_drawing_has_equal_aspect(one: Solution) -> None:
    (line,) = [part.partition('"')[0] for part in one._repr_html_().split('<polyline points="')[1:]]
    pixels = np.array([pair.split(",") for pair in line.split()], float)
    drawn, real = np.ptp(pixels, axis=0), np.array([np.ptp(one.fields.x), np.ptp(one.fields.y)])
    np.testing.assert_allclose(drawn[0] / drawn[1], real[0] / real[1], rtol=0.01)


def test_data_are_drawn_against_the_model_without_missing_rows() -> None:
    drawn = data_against_model([("tip.y <[m]>", [0.1, np.nan, 0.3], [0.1, 0.2, 0.29]), ("none", [np.nan], [1.0])])
    assert drawn.count("<svg") == 1
    assert drawn.count("<circle") == 2
    assert "tip.y &lt;[m]&gt;" in drawn


@pytest.mark.parametrize("name", ["pose", "strain", "one", "rods", "response"])
def test_what_holds_no_numbers_prints_too(results: dict[str, Any], name: str) -> None:
    result, said = results[name], []
    jax.jit(lambda traced: said.append(repr(traced)))(result)
    for other in (
        jax.eval_shape(lambda: result),
        jax.tree.map(lambda _: None, result),
        jax.tree.map(lambda _: True, result),
        jax.tree.map(lambda leaf: np.zeros(np.shape(leaf), jax.dtypes.float0), result),
    ):
        said.append(repr(other))
        if hasattr(other, "_repr_html_"):
            assert "<svg" not in other._repr_html_()
    assert all(text.startswith(type(result).__name__) for text in said), said


def test_a_rod_without_a_solution_prints_and_draws_nothing(rods: Solution) -> None:
    lost = jax.tree.map(lambda leaf: leaf[4], rods)
    assert repr(lost).startswith(f"Solution: {Outcome[Outcome.bad_input]}")
    assert "<svg" not in lost._repr_html_()


@pytest.mark.parametrize("name", ["one", "rods", "response"])
def test_datasets_are_written_as_netcdf(results: dict[str, Any], name: str, tmp_path: Path) -> None:
    data = results[name].to_xarray()
    data.to_netcdf(tmp_path / "result.nc")
    with xarray.open_dataset(tmp_path / "result.nc") as read:
        assert all("units" in read[variable].attrs for variable in read.data_vars if variable != "time_of_peak")
        if name == "response":
            assert read.temperature.dims == ("time",)
        else:
            assert read.tip_x.dims == (("batch",) if name == "rods" else ())
            assert read.s.values[-1] == pytest.approx(0.418)
            np.testing.assert_array_equal(read.x.values, results[name].fields.x)


def test_a_batch_of_responses_keeps_times_of_their_own(response: Response) -> None:
    batch = jax.tree.map(lambda leaf: np.stack([leaf, leaf]), response)
    assert repr(batch).startswith("Response of 2 muscles: 2 followed")
    assert batch.to_xarray().temperature.dims == ("batch", "time")
    own = eqx.tree_at(lambda batch: batch.times, batch, batch.times * np.array([[1.0], [2.0]]))
    assert own.to_xarray().times.dims == ("batch", "time")
