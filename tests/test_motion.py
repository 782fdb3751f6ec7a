"""The page and the animation of an actuation show what was solved: arms at their times, peaks, limits, failures."""

import dataclasses
import stat

import equinox as eqx
import jax
import matplotlib
import numpy as np
import pytest
from drawn import by_gid, overlapping_words, words
from PIL import Image, ImageSequence

from cosserat_jax import Outcome, load_scene, replace
from cosserat_jax.errors import OutputError
from cosserat_jax.report.figures import actuation_figure, animation_suffixes, save_animation
from cosserat_jax.report.figures.animation import Playback, write_movie
from cosserat_jax.report.figures.layout import COLOURS
from cosserat_jax.scene import Pulses
from cosserat_jax.solver import ResponseOutcome
from cosserat_jax.study import Actuation, actuate

TIMES = np.linspace(0.0, 6.28, 9)
CURVES = ("voltage", "temperature", "tension")


@pytest.fixture(scope="module")
def actuation() -> Actuation:
    return actuate(load_scene("octopus-tcam"), TIMES)


@pytest.fixture(scope="module")
def figure(actuation):
    return actuation_figure(actuation)


def panels(figure) -> dict:
    """The panels of curves, by what they show."""
    return {what: axes for axes in figure.axes for what in CURVES if by_gid(axes, what)}


def with_failures(actuation: Actuation, failed: np.ndarray) -> Actuation:
    solution = actuation.solution
    fields = jax.tree.map(lambda leaf: np.where(failed[:, None], np.nan, leaf), solution.fields)
    codes = np.where(failed, np.asarray(Outcome.limit_point._value), solution.outcome._value)
    solution = eqx.tree_at(lambda s: s.outcome._value, dataclasses.replace(solution, fields=fields), codes)
    return dataclasses.replace(actuation, solution=solution)


def with_limit(actuation: Actuation, limit: str) -> Actuation:
    scene = replace(actuation.scene, {"muscles.0.tcam.limit_temperature": limit})
    return dataclasses.replace(actuation, scene=scene)


def with_outcome(actuation: Actuation, outcome) -> Actuation:
    return eqx.tree_at(lambda a: a.responses[0].outcome, actuation, outcome)


def with_antagonist(actuation: Actuation) -> Actuation:
    """A second muscle, driven by pulses, which grows half as warm and is so one second earlier."""
    muscle = actuation.scene.muscles[0]
    tcam = dataclasses.replace(muscle.tcam, voltage=Pulses(amplitude=5.0, width=0.5, period=2.0, number=2, start=1.0))
    both = (muscle, dataclasses.replace(muscle, side=-1, tcam=tcam))
    response = actuation.responses[0]
    ambient = tcam.ambient_temperature
    peak = response.peak._replace(
        temperature=(response.peak.temperature + ambient) / 2, time=np.asarray(response.peak.time - 1.0)
    )
    cooler = dataclasses.replace(
        response, temperature=(response.temperature + ambient) / 2, tension=response.tension / 2, peak=peak
    )
    scene = dataclasses.replace(actuation.scene, muscles=both)
    return dataclasses.replace(actuation, scene=scene, responses={0: response, 1: cooler})


def test_every_panel_has_its_quantity_with_a_unit_and_arms_are_at_equal_aspect(figure):
    assert {what: axes.get_ylabel() for what, axes in panels(figure).items()} == {
        "voltage": "voltage [V]",
        "temperature": "temperature [°C]",
        "tension": "tension [N]",
    }
    assert {axes.get_xlabel() for axes in panels(figure).values()} == {"time [s]"}
    (arms,) = (axes for axes in figure.axes if by_gid(axes, "outline"))
    assert (arms.get_xlabel(), arms.get_ylabel(), arms.get_aspect()) == ("$x$ [cm]", "$y$ [cm]", 1)
    assert by_gid(arms, "current")
    assert by_gid(arms, "clamp")


def test_the_curves_are_those_of_the_response(figure, actuation):
    response = actuation.responses[0]
    expected = {
        "voltage": 9 * np.sin(TIMES),
        "temperature": response.temperature - 273.15,
        "tension": response.tension,
    }
    for what, axes in panels(figure).items():
        (line,) = by_gid(axes, what)
        np.testing.assert_allclose(np.interp(TIMES, *line.get_data()), expected[what], atol=1e-9)


def test_the_peak_is_marked_between_the_instants_with_its_value_and_time(figure, actuation):
    marker, label = by_gid(panels(figure)["temperature"], "peak")
    np.testing.assert_allclose(marker.get_xydata(), [[5.894, 98.17]], atol=5e-3)
    assert label.get_text() == "peak 98.17 °C at 5.894 s"
    (line,) = by_gid(panels(figure)["temperature"], "temperature")
    assert marker.get_xydata()[0].tolist() in line.get_xydata().tolist()
    (tension,) = by_gid(panels(figure)["tension"], "tension")
    assert tension.get_ydata().max() == pytest.approx(25.0, abs=1e-3)


@pytest.mark.parametrize("limit", [150.0, 90.0])
def test_the_limit_is_a_labelled_line_at_its_temperature(actuation, limit):
    axes = panels(actuation_figure(with_limit(actuation, f"{limit} degC")))["temperature"]
    line, label = by_gid(axes, "limit")
    np.testing.assert_allclose(line.get_ydata(), limit)
    assert line.get_linestyle() != "-"
    assert label.get_text() == f"limit {limit:.4g} °C"
    assert axes.get_ylim()[0] < limit < axes.get_ylim()[1]


def test_a_limit_far_above_is_a_note_and_does_not_squash_the_curve(actuation):
    axes = panels(actuation_figure(with_limit(actuation, "600 degC")))["temperature"]
    assert not by_gid(axes, "limit")
    assert axes.get_title(loc="left") == "limit 600 °C, above the axis"
    assert axes.get_ylim()[1] < 120


def test_arms_are_coloured_by_the_time_that_the_bar_shows(figure):
    (bar,) = by_gid(figure, "bar")
    assert bar.get_ylabel() == "time [s]"
    assert bar.get_ylim() == pytest.approx((0.0, 6.28))
    drawn = TIMES[[0, 2, 3, 5, 6, 8]]
    edges = [outline.get_edgecolor() for outline in by_gid(figure, "outline")]
    np.testing.assert_allclose(edges, [COLOURS(time / 6.28) for time in drawn], atol=1e-12)
    (dots,) = by_gid(panels(figure)["tension"], "instant")
    np.testing.assert_allclose(dots.get_offsets()[:, 0], drawn)
    np.testing.assert_allclose(dots.get_facecolors(), edges)


def test_arms_are_those_of_their_instants(figure, actuation):
    fields = actuation.solution.fields
    lines = by_gid(figure, "centerline")
    for line, i in zip(lines, [0, 2, 3, 5, 6, 8], strict=True):
        np.testing.assert_allclose(line.get_xydata(), 100 * np.stack([fields.x[i], fields.y[i]], -1), atol=1e-9)
    slack, *tense = [line.get_linestyle() for line in by_gid(figure, "muscle")]
    assert slack not in tense  # at t = 0 the muscle does not pull yet


def test_instants_without_equilibrium_are_left_out_and_counted(actuation):
    failed = np.isin(np.arange(9), [1, 2, 4, 8])
    drawn = actuation_figure(with_failures(actuation, failed))
    assert "4 of 9 instants have no equilibrium" in words(drawn)
    edges = [outline.get_edgecolor() for outline in by_gid(drawn, "outline")]
    np.testing.assert_allclose(edges, [COLOURS(time / 6.28) for time in TIMES[~failed]], atol=1e-12)


def test_an_actuation_without_any_equilibrium_still_shows_its_curves(actuation):
    drawn = actuation_figure(with_failures(actuation, np.ones(9, bool)))
    assert "no equilibrium" in words(drawn).splitlines()
    assert list(panels(drawn)) == list(CURVES)
    assert not by_gid(drawn, "outline")


def test_a_hot_and_a_failed_muscle_are_noted(actuation):
    assert "hotter" not in words(actuation_figure(actuation))
    hot = with_outcome(actuation, ResponseOutcome.overheated)
    assert "muscles.0: the muscle is hotter than its limit temperature" in words(actuation_figure(hot))
    nothing = jax.tree.map(lambda leaf: np.full(leaf.shape, np.nan), dataclasses.replace(actuation.responses[0]))
    nothing = dataclasses.replace(nothing, outcome=ResponseOutcome.integration_failed)
    failed = with_failures(dataclasses.replace(actuation, responses={0: nothing}), np.ones(9, bool))
    drawn = words(actuation_figure(failed))
    assert "muscles.0: the integration in time did not finish" in drawn
    assert "no response" in drawn


def test_several_muscles_are_told_apart_in_grey_and_each_has_its_peak(actuation):
    drawn = actuation_figure(with_antagonist(actuation))
    for what, axes in panels(drawn).items():
        assert len({line.get_linestyle() for line in by_gid(axes, what)}) == 2
    legend = [text.get_text() for text in drawn.legends[-1].get_texts()]
    assert [label.partition(",")[0] for label in legend] == [
        "muscles.0: peak 98.17 °C at 5.894 s",
        "muscles.1: peak 60.58 °C at 4.894 s",
    ]
    assert len(by_gid(panels(drawn)["temperature"], "limit")) == 2  # one line and its label: the limits are equal


def test_a_voltage_that_jumps_between_the_instants_is_drawn_so(actuation):
    _, pulses = by_gid(panels(actuation_figure(with_antagonist(actuation)))["voltage"], "voltage")
    times, volts = pulses.get_data()
    assert set(volts) == {0.0, 5.0}
    np.testing.assert_allclose(times[1:][np.diff(volts) != 0], [1.0, 1.5, 3.0, 3.5], rtol=1e-12)
    assert np.diff(times)[np.diff(volts) != 0].max() < 1e-12


@pytest.mark.parametrize("change", [lambda a: a, with_antagonist, lambda a: with_limit(a, "600 degC")])
def test_labels_do_not_overlap(actuation, change):
    assert not overlapping_words(actuation_figure(change(actuation)))


@pytest.mark.parametrize("suffix", ["png", "pdf"])
@pytest.mark.filterwarnings("error")
def test_a_page_saves_and_leaves_no_style_behind(actuation, suffix, tmp_path):
    before = dict(matplotlib.rcParams)
    path = tmp_path / f"page.{suffix}"
    actuation_figure(actuation).savefig(path, dpi=60)
    assert path.stat().st_size > 2000
    assert dict(matplotlib.rcParams) == before


@pytest.mark.parametrize(
    ("times", "frames", "playing", "speed"),
    [
        (np.linspace(0, 6, 13), 13, 6.0, 1.0),
        (np.linspace(0, 60, 61), 61, 15.0, 4.0),
        (np.linspace(0, 0.1, 11), 11, 2.0, 0.05),
        (np.linspace(0, 15, 2000), 150, 15.0, 1.0),
        (np.linspace(0, 2, 2000), 51, 2.0, 1.0),
    ],
)
def test_a_motion_plays_in_real_time_unless_that_is_too_short_or_too_long(times, frames, playing, speed):
    playback = Playback.of(times)
    assert playback.instants.size == frames
    assert playback.interval * (frames - 1) == pytest.approx(playing)
    assert playback.speed == pytest.approx(speed)
    assert (playback.words == "") == (speed == 1)
    assert (playback.instants[0], playback.instants[-1]) == (0, times.size - 1)


def test_frames_at_equal_intervals_show_the_nearest_of_unequal_instants():
    playback = Playback.of(np.array([0.0, 1.0, 1.0, 1.5, 4.0]))
    np.testing.assert_array_equal(playback.instants, [0, 0, 1, 3, 3, 3, 4, 4, 4])
    assert Playback.of(np.array([3.0])).instants.tolist() == [0]


def frames_of(place) -> tuple[list[np.ndarray], float]:
    """Every frame and the seconds that they play together."""
    with Image.open(place) as image:
        pairs = [(np.asarray(frame.convert("RGB")), frame.info["duration"]) for frame in ImageSequence.Iterator(image)]
    return [frame for frame, _ in pairs], sum(duration for _, duration in pairs) / 1000


def test_a_gif_shows_the_arm_move_in_real_time_and_none_where_there_is_no_equilibrium(actuation, tmp_path):
    before = dict(matplotlib.rcParams)
    failed = np.isin(np.arange(9), [0, 5])
    save_animation(with_failures(actuation, failed), tmp_path / "arm.GIF")
    frames, duration = frames_of(tmp_path / "arm.GIF")
    assert len(frames) == 9
    assert duration == pytest.approx(6.28 * 9 / 8, abs=0.011)
    ground = 0.9 * (0.65 + 0.35 * np.array(COLOURS(0.55)[:3])) + 0.1  # of the arm, which is all but opaque
    places = [np.argwhere(np.abs(frame / 255 - ground).max(axis=-1) < 0.05) for frame in frames]
    assert [len(place) > 2000 for place in places] == (~failed).tolist()
    heights = [place[:, 0].min() for place in places if len(place)]
    assert heights[0] > heights[-1] + 50  # from the top: the arm rises
    assert (frames[0][0] == 255).all()
    assert [path.name for path in tmp_path.iterdir()] == ["arm.GIF"]
    assert dict(matplotlib.rcParams) == before


def test_an_animation_that_is_stopped_leaves_the_old_file_whole(actuation, tmp_path, monkeypatch):
    place = tmp_path / "arm.gif"
    place.write_text("old")

    def stop(image, beside, *_, **__):
        beside.write_text("half")
        raise KeyboardInterrupt

    monkeypatch.setattr(Image.Image, "save", stop)
    with pytest.raises(KeyboardInterrupt):
        save_animation(actuation, place)
    assert [path.read_text() for path in tmp_path.iterdir()] == ["old"]


def stand_in_for_ffmpeg(folder, script: str) -> str:
    program = folder / "ffmpeg"
    program.write_text(f"#!/bin/sh\nfor last; do :; done\n{script}\n")
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    return str(program)


def test_mp4_is_offered_where_ffmpeg_is_which_gets_every_frame_with_even_sides(tmp_path, monkeypatch):
    monkeypatch.setitem(matplotlib.rcParams, "animation.ffmpeg_path", str(tmp_path / "nowhere"))
    assert animation_suffixes() == [".gif"]
    program = stand_in_for_ffmpeg(tmp_path, 'echo "$@" > "$last"; wc -c >> "$last"')
    monkeypatch.setitem(matplotlib.rcParams, "animation.ffmpeg_path", program)
    assert animation_suffixes() == [".gif", ".mp4"]
    picture = np.zeros((301, 401, 3), np.uint8)
    write_movie(picture, [picture] * 9, 0.785, ".mp4", tmp_path / "arm.mp4")
    options, size = (tmp_path / "arm.mp4").read_text().splitlines()
    options = options.split()
    assert options[options.index("-s") + 1] == "400x300"
    assert int(size) == 9 * 4 * 400 * 300
    assert float(options[options.index("-framerate") + 1]) == pytest.approx(1 / 0.785)
    assert "-f mp4" in " ".join(options)


def test_ffmpeg_that_fails_is_one_line_and_leaves_no_file(actuation, tmp_path, monkeypatch):
    program = stand_in_for_ffmpeg(tmp_path, "cat > /dev/null; echo first >&2; echo no such encoder >&2; exit 1")
    monkeypatch.setitem(matplotlib.rcParams, "animation.ffmpeg_path", program)
    with pytest.raises(OutputError, match=r"arm.mp4: cannot be written: ffmpeg: no such encoder$"):
        save_animation(actuation, tmp_path / "arm.mp4")
    assert [path.name for path in tmp_path.iterdir()] == ["ffmpeg"]
