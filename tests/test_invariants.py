"""What must hold of any right solution: symmetries, balance, energy, order of convergence, independence in a batch."""

import dataclasses
import math

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cosserat_jax import Muscle, Outcome, Scene, SingleShooting, Tip, load_scene, replace, solve, sweep

OCTOPUS = load_scene("octopus")
WEIGHTLESS = dataclasses.replace(OCTOPUS, water=None, gravity=None)
OVER = {"muscles.0.tension": np.linspace(0.0, 20.0, 7), "water.velocity": np.array([-0.3, 0.2, 0.4])}


def mirrored(scene: Scene) -> Scene:
    """The scene seen in the mirror e2 -> -e2."""
    arm = dataclasses.replace(scene.arm, ventral=-scene.arm.ventral, base_angle=-scene.arm.base_angle)
    muscles = tuple(dataclasses.replace(muscle, side=-muscle.side) for muscle in scene.muscles)
    gravity = dataclasses.replace(scene.gravity, acceleration=-scene.gravity.acceleration)
    return dataclasses.replace(scene, arm=arm, muscles=muscles, gravity=gravity)


def test_mirror_image_of_a_scene_has_the_mirror_image_of_its_equilibrium():
    scene = replace(OCTOPUS, {"arm.base_angle": 0.2, "water.velocity": 0.4})
    tip, image = solve(scene).tip, solve(mirrored(scene)).tip
    np.testing.assert_allclose([image.x, image.y, image.theta], [tip.x, -tip.y, -tip.theta], atol=1e-12)


@pytest.mark.parametrize("angle", [0.7, -2.0, 3.0])
def test_equilibrium_turns_with_the_whole_scene(angle: float):
    """Where no water and no weight point a direction out, turning clamp and dead load turns the arm."""
    cos, sin = math.cos(angle), math.sin(angle)
    loaded = dataclasses.replace(WEIGHTLESS, tip=Tip(force=(0.1, -0.2), moment=0.01))
    force = (0.1 * cos + 0.2 * sin, 0.1 * sin - 0.2 * cos)
    turned = replace(loaded, {"arm.base_angle": angle, "tip.force.0": force[0], "tip.force.1": force[1]})
    tip, moved = solve(loaded).tip, solve(turned).tip
    expected = [cos * tip.x - sin * tip.y, sin * tip.x + cos * tip.y, tip.theta + angle]
    np.testing.assert_allclose([moved.x, moved.y, moved.theta], expected, atol=2e-9)


def test_two_muscles_on_one_path_pull_as_one_and_a_slack_one_not_at_all():
    muscle = OCTOPUS.muscles[0]
    half = dataclasses.replace(muscle, tension=10.0)
    slack = Muscle(base_offset=0.01, end_offset=0.002, tension=0.0, side=-1)
    tip = solve(OCTOPUS).tip
    for muscles in ((half, half), (muscle, slack)):
        same = solve(dataclasses.replace(OCTOPUS, muscles=muscles)).tip
        np.testing.assert_allclose([same.x, same.y, same.theta], [tip.x, tip.y, tip.theta], atol=1e-11)


def test_a_muscle_given_the_arms_length_as_its_end_is_one_without_an_end():
    ended = replace(OCTOPUS, {"muscles.0.end": OCTOPUS.arm.length})
    tip, same = solve(OCTOPUS).tip, solve(ended).tip
    np.testing.assert_allclose([same.x, same.y, same.theta], [tip.x, tip.y, tip.theta], atol=1e-12)


def test_fields_satisfy_the_papers_local_balance():
    """Its printed equations, with the internal force n alone and all else a load, differentiated from the fields:

        n_s + T t_c,s + f_water + f_weight = 0        m_s + r_s x n + (y beta b) x T t_c,s + X beta b x f_water = 0

    A spline through 401 points is differentiated, so the balance is seen to about 1e-5 of its terms."""
    from scipy.interpolate import CubicSpline

    fields = solve(OCTOPUS, SingleShooting(steps=(14, 20)), points=401).fields
    s, beta, nu, eta, mu = (np.asarray(getattr(fields, name)) for name in ("s", "beta", "nu", "eta", "mu"))
    arm, water, muscle = OCTOPUS.arm, OCTOPUS.water, OCTOPUS.muscles[0]

    def d(values: np.ndarray) -> np.ndarray:
        return CubicSpline(s, values, axis=0)(s, 1)

    theta = np.asarray(fields.theta)
    a, b = np.stack([np.cos(theta), np.sin(theta)], 1), np.stack([-np.sin(theta), np.cos(theta)], 1)
    radius = arm.base_radius + (arm.tip_radius - arm.base_radius) * s / arm.length
    area = np.pi * (beta * radius) ** 2
    n = (np.asarray(fields.N)[:, None] * a + np.asarray(fields.H)[:, None] * b) * area[:, None]
    m = np.asarray(fields.M) * np.pi * (beta * radius) ** 4 / 4
    r = np.stack([fields.x, fields.y], 1)
    y = muscle.base_offset + (muscle.end_offset - muscle.base_offset) * s / arm.length
    surface, path = r + (radius * beta)[:, None] * b, r + (y * beta)[:, None] * b
    pull = muscle.tension * d(d(path))

    tangent = d(surface) / np.linalg.norm(d(surface), axis=1)[:, None]
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], 1)
    v_t, v_n = water.velocity * tangent[:, 0], water.velocity * normal[:, 0]
    q = np.pi * water.density * beta * radius
    along = q * (v_n**2 + 2 * v_t * v_n) - 2 * np.pi * radius * beta * water.viscosity * v_t / water.boundary_layer
    flow = (q * np.abs(v_n) * v_n)[:, None] * normal + along[:, None] * tangent
    weight = np.stack([0 * s, -(arm.density - water.density) * OCTOPUS.gravity.acceleration * area * nu], 1)

    def cross(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        return u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]

    inner = slice(8, -8)  # the spline's ends are its worst
    force = (d(n) + pull + flow + weight)[inner]
    moment = (d(m) + cross(d(r), n) + cross(path - r, pull) + cross(surface - r, flow))[inner]
    assert np.abs(force).max() < 1e-5 * np.abs(d(n)).max()
    assert np.abs(moment).max() < 1e-5 * np.abs(d(m)).max()
    np.testing.assert_allclose(d(r), nu[:, None] * a + eta[:, None] * b, atol=1e-6)
    np.testing.assert_allclose(beta * (nu - beta * radius * mu), 1, atol=1e-12)


def test_work_of_the_muscle_is_the_energy_it_stores():
    """Without water and weight on a rigid section the arm is elastic: the section's energy
    1/2 int c (E A (nu - 1)^2 + G A eta^2 + E J mu^2) ds equals the integral over the pull of what the muscle gives,
    minus d(int |t_c|^2 / 2 ds)/dT times T, for unnormalized tangents."""
    scene = replace(WEIGHTLESS, {"arm.cross_section": "rigid"})
    arm, muscle = scene.arm, scene.muscles[0]
    s = np.linspace(0, arm.length, 201)
    radius = arm.base_radius + (arm.tip_radius - arm.base_radius) * s / arm.length
    area, shear_modulus = np.pi * radius**2, arm.youngs_modulus / (2 * (1 + arm.poisson_ratio))
    slope = (muscle.end_offset - muscle.base_offset) / arm.length
    y = muscle.base_offset + slope * s

    from scipy.integrate import simpson

    tension = np.linspace(0, 20, 41)
    fields = sweep(scene, {"muscles.0.tension": tension}, points=201).solution.fields
    stretch = ((fields.nu - y * fields.mu) ** 2 + (fields.eta + slope) ** 2) / 2
    muscle_energy = simpson(stretch, x=s, axis=1)
    stored = arm.youngs_modulus * (area * (fields.nu - 1) ** 2 + area * radius**2 / 4 * fields.mu**2)
    stored = simpson(stored + shear_modulus * area * fields.eta**2, x=s, axis=1) / 2
    given = tension[-1] * (muscle_energy[0] - muscle_energy[-1]) - simpson(muscle_energy[0] - muscle_energy, x=tension)
    assert stored[-1] == pytest.approx(given, rel=1e-6)


@pytest.mark.parametrize(
    ("solver", "order", "steps"),
    [
        (diffrax.Heun(), 2, (16, 64)),
        (diffrax.Bosh3(), 3, (16, 64)),
        (diffrax.Tsit5(), 5, (8, 18)),
        (diffrax.Dopri8(), 8, (10, 16)),
    ],
)
def test_equal_steps_converge_with_the_order_of_the_solver(
    solver: diffrax.AbstractERK, order: int, steps: tuple[int, int]
):
    """On a smooth scene, where the load turns with the tip. Of two grids the result is that of the second."""
    scene = load_scene("follower")
    exact = solve(scene, SingleShooting(steps=(28, 40))).tip.x
    method = SingleShooting(error=1.0, solver=solver, coarse_steps=12)
    errors = []
    for n in steps:
        found = solve(scene, dataclasses.replace(method, steps=(6, n)), points=3)
        assert found.steps == n
        errors.append(abs(float(found.tip.x - exact)))
    measured = -np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert measured == pytest.approx(order, abs=0.5)


def test_a_rod_is_the_same_alone_in_a_batch_and_in_chunks():
    whole = sweep(OCTOPUS, OVER).solution
    chunked = sweep(OCTOPUS, OVER, batch=8).solution
    for name in ("tip", "tip_strain", "fields", "tensions", "outcome", "iterations", "steps", "load_fraction"):
        for a, b in zip(*(jax.tree.leaves(getattr(one, name)) for one in (whole, chunked)), strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12 * np.abs(a).max())
    # of differences, so that digits are lost
    np.testing.assert_allclose(chunked.condition, whole.condition, rtol=1e-7)
    np.testing.assert_allclose(chunked.error, whole.error, rtol=1e-3, atol=1e-14)
    for i, j in ((0, 0), (3, 1), (6, 2)):
        alone = solve(
            replace(OCTOPUS, {path: values[k] for (path, values), k in zip(OVER.items(), (i, j), strict=True)})
        )
        np.testing.assert_allclose(whole.tip.x[i, j], alone.tip.x, rtol=0, atol=1e-12)
        np.testing.assert_allclose(whole.tip.y[i, j], alone.tip.y, rtol=0, atol=1e-12)


def test_a_rod_that_fails_leaves_its_neighbours_untouched():
    """A tip moment against the ventral side folds the volume constraint; a NaN is told apart from it."""
    moments = jnp.asarray([0.02, -0.6, jnp.nan, 0.01])
    bent = dataclasses.replace(WEIGHTLESS, tip=Tip(moment=0.0))
    solution = jax.jit(jax.vmap(lambda moment: solve(replace(bent, {"tip.moment": moment}), throw=False)))(moments)
    names = [Outcome[jax.tree.map(lambda code, i=i: code[i], solution.outcome)] for i in range(4)]
    assert names == [Outcome[x] for x in (
        Outcome.converged, Outcome.volume_constraint_folded, Outcome.bad_input, Outcome.converged)]  # fmt: skip
    for i in (0, 3):
        alone = solve(replace(bent, {"tip.moment": float(moments[i])})).tip
        np.testing.assert_allclose([solution.tip.x[i], solution.tip.y[i]], [alone.x, alone.y], rtol=0, atol=1e-12)
    assert np.isnan(solution.tip.x[1:3]).all()
    assert solution.iterations[2] == 0, "the batch waited for what was never to come"
    assert 0 < solution.load_fraction[1] < 1


def test_volume_constraint_folds_where_theory_says():
    """With a moment alone beta^3 - beta^2 = 4 M X / (E pi R^4), whose least value is -4/27 at beta = 2/3: the
    section at the tip, the thinnest, folds at M = -E pi R^3 / 27."""
    arm = WEIGHTLESS.arm
    folds_at = arm.youngs_modulus * np.pi * arm.tip_radius**3 / 27
    bare = dataclasses.replace(WEIGHTLESS, muscles=(), tip=Tip(moment=-1.001 * folds_at))
    solution = solve(bare, throw=False)
    assert Outcome[solution.outcome] == Outcome[Outcome.volume_constraint_folded]
    assert float(solution.load_fraction) == pytest.approx(1 / 1.001, abs=3e-3)
    assert float(solution.failed_at) == pytest.approx(arm.length, rel=1e-3)
    assert bool(solve(replace(bare, {"tip.moment": -0.995 * folds_at}), throw=False).converged)
    # a hair before it the derivative of beta is beyond all bounds, and the outcome says so
    brink = solve(replace(bare, {"tip.moment": -(1 - 1e-8) * folds_at}), throw=False)
    assert Outcome[brink.outcome] == Outcome[Outcome.volume_constraint_folded]
