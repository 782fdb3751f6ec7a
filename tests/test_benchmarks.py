"""Classic benchmarks of large deflection, each from its own source, to the digits given there."""

import math

import jax
import numpy as np
import pytest

from cosserat_jax import load_scene, replace, solve, sweep

PLAIN = load_scene("elastica")  # one compiled program serves every rod under a dead force and moment


@pytest.mark.parametrize(
    ("load_parameter", "deflection", "shortening", "angle"),
    [
        (1.0, 0.3017207738, 0.0564332363, 0.4613519497),
        (5.0, 0.7137915236, 0.3876283607, 1.2153681176),
        (10.0, 0.8106090249, 0.5549955978, 1.4302855388),
    ],
)
def test_elastica_under_a_dead_tip_load(load_parameter, deflection, shortening, angle):
    """Bisshopp & Drucker 1945, Mattiasson 1981: w/L, u/L and theta over P L^2 / EI."""
    tip = solve(replace(PLAIN, {"tip.force.1": load_parameter})).tip
    np.testing.assert_allclose([tip.y, 1 - tip.x, tip.theta], [deflection, shortening, angle], atol=1e-9)


def test_rod_rolls_up_to_a_full_circle_under_a_tip_moment():
    """theta = M L / EI, an arc of a circle of radius L / theta."""
    turns = np.linspace(0.1, 1.0, 10)
    solution = sweep(replace(PLAIN, {"tip.force.1": 0.0}), {"tip.moment": 2 * math.pi * turns}).solution
    theta = 2 * math.pi * turns
    assert solution.converged.all()
    np.testing.assert_allclose(solution.tip.theta, theta, atol=1e-9)
    np.testing.assert_allclose(solution.tip.x, np.sin(theta) / theta, atol=1e-9)
    np.testing.assert_allclose(solution.tip.y, (1 - np.cos(theta)) / theta, atol=1e-9)


@pytest.mark.parametrize(
    ("load_parameter", "x", "y"), [(2.0, 0.7673621915, 0.5738390626), (10.0, -0.0921231812, 0.5469832646)]
)
def test_follower_tip_force(load_parameter, x, y):
    """P L^2 / EI on an inextensible rod, the force turning with the tip (Argyris & Symeonidis 1981)."""
    tip = solve(replace(load_scene("follower"), {"tip.force.1": load_parameter})).tip
    np.testing.assert_allclose([tip.x, tip.y], [x, y], atol=1e-9)


def test_large_stretch_and_shear():
    """Harsch, Capobianco & Eugster 2021: the linear Cosserat law far outside the elastica."""
    tip = solve(load_scene("stretch-shear")).tip
    np.testing.assert_allclose([tip.x, tip.y, tip.theta], [4.60759500, -5.24233299, 0.22104592], atol=1e-8)


def test_timoshenko_cantilever_in_its_small_load_limit():
    """F L^3 / 3 EI + F L / k G A for the load on a millionth part, deflection scaled back."""
    scene = load_scene("timoshenko")
    slope = jax.grad(lambda force: solve(replace(scene, {"tip.force.1": force})).tip.y)(0.0)
    assert -15.0 * -slope == pytest.approx(0.0677702968, abs=1e-10)
    stiffness = scene.arm.stiffness
    shear = 15.0 * scene.arm.length / stiffness.shear
    assert shear == pytest.approx(0.0237671382, abs=1e-10)
    assert 15.0 * slope == pytest.approx(15.0 * scene.arm.length**3 / (3 * stiffness.bending) + shear, rel=1e-9)


def test_parallel_tendon_bends_an_unloaded_rod_to_an_arc():
    """Exact for a unit tangent: kappa = r T / EI, nu = 1 - T / EA."""
    scene = replace(load_scene("tendon-robot"), {"gravity.acceleration": 0.0, "muscles.0.tension": 15.0})
    fields = solve(scene).fields
    stiffness, muscle = scene.arm.stiffness, scene.muscles[0]
    curvature = -muscle.base_offset * muscle.tension / stiffness.bending
    stretch = 1 - muscle.tension / stiffness.axial
    np.testing.assert_allclose(fields.mu, curvature, rtol=1e-10)
    np.testing.assert_allclose(fields.nu, stretch, rtol=1e-12)
    np.testing.assert_allclose(fields.y, stretch / curvature * (1 - np.cos(curvature * fields.s)), atol=1e-9)


@pytest.mark.parametrize(
    ("tension", "bend", "axial"),
    [
        (15.0, 0.1822116945, 0.4532292709),
        (45.0, 0.3616317047, 0.1884158503),
        (150.0, 0.0268858201, 0.0544845738),
        (200.0, 0.1038252958, -0.0084675938),
    ],
)
def test_tendon_robot_under_its_weight(tension, bend, axial):
    """The robot of Till, Aloi & Rucker 2019 hanging sideways, where their solver stops converging too."""
    tip = solve(replace(load_scene("tendon-robot"), {"muscles.0.tension": tension})).tip
    np.testing.assert_allclose([-tip.y, tip.x], [bend, axial], atol=2e-9)


def test_branch_trap_returns_the_equilibrium_of_proportional_loading():
    """At 0.5 N the lateral load is 7.9 EI / L^2; the deflection goes first, the axial place second."""
    tip = solve(load_scene("branch-trap")).tip
    np.testing.assert_allclose([tip.y, tip.x], [0.31308252, 0.19976997], atol=1e-8)


@pytest.mark.parametrize("load_parameter", [15.0, 25.0, 40.0, 60.0])
def test_stays_on_the_first_branch_where_there_are_others(load_parameter):
    """Beyond P L^2 / EI = 10.3 the elastica has further equilibria. On the first the tip's angle grows with the load
    towards a right angle and the rod has no inflection; the load follows from theta by an elliptic integral."""
    from scipy.special import ellipk, ellipkinc

    solution = solve(replace(PLAIN, {"tip.force.1": load_parameter}))
    theta = float(solution.tip.theta)
    k = math.sqrt((1 + math.sin(theta)) / 2)
    first = math.asin(1 / (k * math.sqrt(2)))
    assert (ellipk(k**2) - ellipkinc(first, k**2)) ** 2 == pytest.approx(load_parameter, rel=1e-7)
    assert (np.asarray(solution.fields.mu)[:-1] > 0).all()
