"""Figures show what was solved: arms as wide as their sections, muscles where they run, and every failure counted."""

import dataclasses
import re

import equinox as eqx
import jax
import matplotlib
import numpy as np
import pytest
from drawn import by_gid, overlapping_words, words
from matplotlib.figure import Figure

from cosserat_jax import Outcome, Scene, Solution, Sweep, load_scene, replace, sweep
from cosserat_jax.report import figures
from cosserat_jax.report.figures.arm import draw_arm, draw_directors, draw_surroundings, surfaces
from cosserat_jax.report.figures.layout import Layout, prefixed, spread

END = 0.3  # m, of the muscle; between two of the points at which the fields are held
OF_SWEEPS = [
    figures.sweep_figure,
    figures.arms_over_tension,
    figures.velocities_compared,
    figures.tip_angles,
    figures.tilt_and_stretch_along,
    figures.tractions_along,
]
named = pytest.mark.parametrize("draw", OF_SWEEPS, ids=lambda draw: draw.__name__)


@pytest.fixture(scope="module")
def swept() -> Sweep:
    over = {"muscles.0.tension": [0.0, 10.0, 20.0], "water.velocity": [0.2, 0.4]}
    return sweep(load_scene("octopus"), over, points=15)


def one_rod(swept: Sweep, *index: int) -> tuple[Scene, Solution]:
    """Solved with a muscle to the tip, whose program is quick to compile; drawn with one that ends before it."""
    scene = replace(swept.scene, {"muscles.0.end": END, "muscles.0.end_offset": 0.004})
    return scene, jax.tree.map(lambda leaf: leaf[index], swept.solution)


def with_failures(swept: Sweep, failed: np.ndarray) -> Sweep:
    def blank(tree):
        return jax.tree.map(
            lambda leaf: np.where(failed.reshape(failed.shape + (1,) * (leaf.ndim - 2)), np.nan, leaf), tree
        )

    solution = swept.solution
    parts = {name: blank(getattr(solution, name)) for name in ("tip", "tip_strain", "fields")}
    codes = np.where(failed, np.asarray(Outcome.limit_point._value), solution.outcome._value)
    solution = eqx.tree_at(lambda s: s.outcome._value, dataclasses.replace(solution, **parts), codes)
    return dataclasses.replace(swept, solution=solution)


def drawn_arm(swept: Sweep):
    """Axes with the arm at 20 N and 0.2 m/s in mm, its scene and its fields."""
    scene, solution = one_rod(swept, -1, 0)
    axes = Figure().add_subplot()
    draw_arm(axes, scene, solution.fields, 1e3, color="black")
    return axes, scene, solution.fields


def test_the_outline_is_as_wide_as_the_deformed_sections(swept):
    axes, scene, fields = drawn_arm(swept)
    (outline,) = by_gid(axes, "outline")
    upper, lower = np.split(outline.get_xy()[:-1], 2)
    lower = lower[::-1]
    radius = scene.arm.base_radius + (scene.arm.tip_radius - scene.arm.base_radius) * fields.s / scene.arm.length
    np.testing.assert_allclose(np.hypot(*(upper - lower).T), 2e3 * fields.beta * radius, rtol=1e-12)
    np.testing.assert_allclose((upper + lower) / 2, 1e3 * np.stack([fields.x, fields.y], -1), atol=1e-9)
    assert fields.beta[-5] > 1.005  # else a test with rigid sections


def test_a_muscle_lies_at_y_beta_from_the_centerline_and_stops_at_its_end(swept):
    axes, scene, fields = drawn_arm(swept)
    (line,) = by_gid(axes, "muscle")
    s = np.append(fields.s[fields.s < END], END)
    x, y, theta, beta = (np.interp(s, fields.s, part) for part in (fields.x, fields.y, fields.theta, fields.beta))
    away = line.get_xydata() / 1e3 - np.stack([x, y], -1)
    muscle = scene.muscles[0]
    offset = muscle.base_offset + (muscle.end_offset - muscle.base_offset) * s / END
    np.testing.assert_allclose(-np.sin(theta) * away[:, 0] + np.cos(theta) * away[:, 1], offset * beta, atol=1e-12)
    np.testing.assert_allclose(np.cos(theta) * away[:, 0] + np.sin(theta) * away[:, 1], 0, atol=1e-12)
    (dot,) = by_gid(axes, "muscle end")
    np.testing.assert_array_equal(dot.get_xydata()[0], line.get_xydata()[-1])


def test_a_slack_muscle_is_drawn_otherwise_than_a_tense_one(swept):
    axes, scene, fields = drawn_arm(swept)
    draw_arm(axes, replace(scene, {"muscles.0.tension": 0.0}), fields, 1e3, color="black")
    tense, slack = by_gid(axes, "muscle")
    assert tense.get_linestyle() != slack.get_linestyle()


def test_the_arrows_at_the_tip_differ_by_the_tilt(swept):
    axes, scene, fields = drawn_arm(swept)
    fields = eqx.tree_at(lambda f: f.eta, fields, fields.eta + 0.1)  # the true tilt is too small to be seen
    draw_directors(axes, scene.arm, fields, 1e3)
    (director,), (tangent,) = by_gid(axes, "director"), by_gid(axes, "tangent")
    directions = [arrow._posA_posB[1] - arrow._posA_posB[0] for arrow in (director, tangent)]
    a, t = (np.arctan2(direction[1], direction[0]) for direction in directions)
    assert a == pytest.approx(fields.theta[-1])
    assert t - a == pytest.approx(np.arctan2(fields.eta[-1], fields.nu[-1]))


@pytest.mark.parametrize("velocity", [-0.4, 0.4])
def test_the_arrow_of_the_current_goes_with_the_current(swept, velocity):
    axes = Figure().add_subplot()
    draw_surroundings(axes, [replace(swept.scene, {"water.velocity": velocity})])
    (arrow,) = by_gid(axes, "current")
    assert np.sign(arrow._posA_posB[1][0] - arrow._posA_posB[0][0]) == np.sign(velocity)
    (down,) = by_gid(axes, "gravity")
    assert down._posA_posB[1][1] < down._posA_posB[0][1]


@named
def test_a_figure_has_units_equal_aspect_and_one_colour_bar_at_most(swept, draw):
    figure = draw(swept)
    bars = [axes for axes in figure.axes if axes.get_label() == "<colorbar>"]
    assert len(bars) == (draw not in (figures.velocities_compared, figures.tip_angles))
    for axes in figure.axes:
        labels = [axes.get_ylabel()] if axes in bars else [axes.get_xlabel(), axes.get_ylabel()]
        assert all(re.search(r"\[\S+.*\]$", label) for label in labels), labels
        assert axes.get_aspect() == 1 or not by_gid(axes, "outline") or axes in bars


@named
def test_labels_do_not_overlap(swept, draw):
    figure = draw(swept)
    assert not overlapping_words(figure)


@named
@pytest.mark.parametrize("suffix", ["png", "pdf"])
@pytest.mark.filterwarnings("error")
def test_a_figure_saves_and_leaves_no_style_behind(swept, draw, suffix, tmp_path):
    before = dict(matplotlib.rcParams)
    path = tmp_path / f"figure.{suffix}"
    draw(swept).savefig(path, dpi=60)
    assert path.stat().st_size > 2000
    assert dict(matplotlib.rcParams) == before


def test_the_tension_is_the_colour_and_each_velocity_a_panel(swept):
    layout = Layout.of(swept)
    assert layout.colour == "muscles.0.tension"
    assert [case.name for case in layout.cases] == ["water.velocity = 0.2 m/s", "water.velocity = 0.4 m/s"]
    panels = [axes for axes in figures.arms_over_tension(swept).axes if by_gid(axes, "outline")]
    assert [len(by_gid(axes, "outline")) for axes in panels] == [3, 3]
    scene, fields = layout.rod(layout.cases[1], 2)
    assert (scene.water.velocity, scene.muscles[0].tension) == (0.4, 20.0)
    np.testing.assert_array_equal(fields.y, swept.solution.fields.y[2, 1])


def test_without_a_tension_the_longest_axis_is_the_colour_in_rising_order(swept):
    turned = {"arm.density": np.array([1.0, 3.0, 2.0]) * 1e3, "water.velocity": swept.over["water.velocity"]}
    layout = Layout.of(dataclasses.replace(swept, over=turned))
    assert layout.colour == "arm.density"
    np.testing.assert_array_equal(layout.values, [1e3, 2e3, 3e3])
    np.testing.assert_array_equal(layout.cases[0].solution.tip.y, swept.solution.tip.y[[0, 2, 1], 0])


def test_more_cases_than_panels_are_cut_and_the_note_says_so(swept):
    solution = jax.tree.map(lambda leaf: np.repeat(leaf, 4, axis=1), swept.solution)
    over = swept.over | {"water.velocity": np.linspace(0.1, 0.8, 8)}
    figure = figures.sweep_figure(dataclasses.replace(swept, over=over, solution=solution))
    assert "4 of 8 cases of water.velocity are drawn" in words(figure)


def test_rods_without_a_solution_are_left_out_and_counted(swept):
    failed = np.array([[False, False], [True, False], [True, False]])
    figure = figures.sweep_figure(with_failures(swept, failed))
    assert "2 of 6 rods have no solution and are left out" in words(figure)
    assert [len(by_gid(axes, "outline")) for axes in figure.axes[:3]] == [1, 3, 1]


@named
def test_a_sweep_without_any_solution_is_still_a_figure(swept, draw):
    figure = draw(with_failures(swept, np.ones((3, 2), bool)))
    assert "6 of 6 rods have no solution and are left out" in words(figure)
    assert not by_gid(figure, "outline")


def test_single_solves_get_a_panel_each_and_failures_are_named(swept):
    scene, solution = one_rod(swept, -1, 0)
    _, failure = one_rod(with_failures(swept, np.ones((3, 2), bool)), 0, 0)
    figure = figures.solve_figure(
        {"first": scene, "second": scene, "third": scene}, {"first": solution, "second": solution, "third": failure}
    )
    assert [axes.get_title(loc="left") for axes in figure.axes[:2]] == ["first", "second"]
    assert "no solution, left out: third (1 of 3)" in words(figure)
    expected = (r"traction $N$ [kPa]", r"traction $H$ [kPa]", r"moment $M$ [MPa/m]", r"scale $\beta$ [-]")
    for axes, label in zip(figure.axes[2:], expected, strict=True):
        assert axes.get_ylabel().endswith(label)
        assert len(axes.lines) == 2


def test_surfaces_of_a_straight_arm_are_its_taper(swept):
    scene, solution = one_rod(swept, 0, 0)
    fields = solution.fields
    zero, one = np.zeros_like(fields.s), np.ones_like(fields.s)
    straight = dataclasses.replace(fields, x=fields.s, y=zero, theta=zero, beta=one)
    upper, lower = surfaces(scene.arm, straight)
    np.testing.assert_allclose(upper[[0, -1]], [[0, 0.015], [0.418, 0.004]], atol=1e-15)
    np.testing.assert_allclose(lower, upper * [1, -1])


def test_a_readable_subset_keeps_both_ends():
    np.testing.assert_array_equal(spread(np.arange(41), 9), np.arange(0, 41, 5))
    np.testing.assert_array_equal(spread(np.arange(3), 9), [0, 1, 2])


@pytest.mark.parametrize(
    ("unit", "largest", "expected"),
    [
        ("Pa", 2e7, (1e-6, "MPa")),
        ("m", 0.012, (1e3, "mm")),
        ("N", 20.0, (1.0, "N")),
        ("N", 0.0, (1.0, "N")),
        ("kg/m^3", 1100.0, (1.0, "kg/m^3")),
        ("1/s", 1e-3, (1.0, "1/s")),
        ("N", np.inf, (1.0, "N")),
    ],
)
def test_units_take_the_prefix_that_keeps_numbers_short(unit, largest, expected):
    factor, name = prefixed(unit, largest)
    assert (factor, name) == (pytest.approx(expected[0]), expected[1])
