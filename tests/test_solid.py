"""The solid and the rod of benchmarks/solid, which the package is held against, held against their own classics.

Cylinders and the paper's arm; reference values are closed forms, integrals, the package, and felupe where installed.
"""

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import fsolve

from cosserat_jax import load_scene, solve

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from solid import Arm, Bent, Loads, Mesh, Rubber, Solid, rod
from solid.rod import resultants

CYLINDER = Arm(length=0.2, base_radius=0.01, tip_radius=0.01, modulus=1e6, base_offset=0.0, end_offset=0.0)
SECTION = np.pi * CYLINDER.base_radius**2
BENDING = CYLINDER.modulus * SECTION * CYLINDER.base_radius**2 / 4


def bent(arm: Arm, loads: Loads, along: int = 4, mooney: float = 0.0, **more) -> Bent:
    return Solid(Mesh.of(arm, along), Rubber.of(arm, mooney), loads, **more).solve()


@pytest.mark.parametrize("unit", [True, False])
def test_incompressible_cylinder_is_shortened_by_a_central_tendon(unit):
    """Nominal stress (E / 3)(l - l^-2) against -T, or -T l: l = (1 + 3 T / E A)^(-1/3)."""
    tension = 0.3 * CYLINDER.modulus * SECTION
    found = bent(CYLINDER, Loads(tension, unit=unit))
    if unit:
        stretch = np.roots([1.0, 3 * tension / (CYLINDER.modulus * SECTION), 0.0, -1.0]).real.max()
    else:
        stretch = (1 + 3 * tension / (CYLINDER.modulus * SECTION)) ** (-1 / 3)
    np.testing.assert_allclose(found.tip, [stretch * CYLINDER.length, 0, 0], atol=1e-9)
    np.testing.assert_allclose([found.beta, found.scale_3], stretch**-0.5, atol=1e-9)


@pytest.mark.parametrize(("poisson_ratio", "mooney"), [(0.3, 0.0), (0.45, 0.5), (0.5, 0.5)])
def test_cylinder_of_other_rubbers_under_axial_stress(poisson_ratio, mooney):
    """The principal stresses of W, the lateral one zero; the axial one -T / A."""
    arm = CYLINDER._replace(poisson_ratio=poisson_ratio)
    rubber, stress = Rubber.of(arm, mooney), -0.2 * arm.modulus
    found = bent(arm, Loads(-stress * SECTION, unit=True), mooney=mooney)

    def slopes(stretches):
        """dW / dl_i of the principal stretches with p = lambda (J - 1), axial and lateral, and its own equation."""
        axial, lateral, p = stretches
        l1, l2, volume = axial, lateral, axial * lateral**2
        log = 2 * rubber.c1 + 4 * rubber.c2
        along = 2 * rubber.c1 * l1 + 4 * rubber.c2 * l1 * l2**2 + (p * volume - log) / l1
        across = 2 * rubber.c1 * l2 + 2 * rubber.c2 * l2 * (l1**2 + l2**2) + (p * volume - log) / l2
        return [(along - stress) / 1e6, across / 1e6, volume - 1 - rubber.compliance * p]

    axial, lateral, _ = fsolve(slopes, [0.9, 1.05, 0.0], xtol=1e-13)
    assert found.tip[0] == pytest.approx(axial * arm.length, rel=1e-9)
    np.testing.assert_allclose([found.beta, found.scale_3], lateral, rtol=1e-9)


@pytest.mark.parametrize("poisson_ratio", [0.3, 0.5])
def test_pure_bending_of_a_cylinder_in_the_limit_of_a_small_moment(poisson_ratio):
    """theta = M L / EI and y = M L^2 / 2 EI; what is left is the circle, here of parabolas, 1e-4 of EI."""
    moment = 1e-6 * BENDING / CYLINDER.length
    tip = bent(CYLINDER._replace(poisson_ratio=poisson_ratio), Loads(tip_moment=moment)).tip
    assert tip[2] == pytest.approx(1e-6, rel=2e-4)
    assert tip[1] == pytest.approx(1e-6 * CYLINDER.length / 2, rel=2e-4)


@pytest.mark.parametrize("poisson_ratio", [0.3, 0.5])
def test_cantilever_of_timoshenko_in_the_limit_of_a_small_force(poisson_ratio):
    """P L^3 / 3 EI + P L / (k G A), k = 6 (1 + nu_p) / (7 + 6 nu_p) of the circle (Cowper 1966)."""
    arm = CYLINDER._replace(length=0.1, poisson_ratio=poisson_ratio)
    force = 1e-6 * BENDING / arm.length**2
    shear_factor = 6 * (1 + poisson_ratio) / (7 + 6 * poisson_ratio)
    shear = arm.length * 2 * (1 + poisson_ratio) / (shear_factor * arm.modulus * SECTION)
    bending = arm.length**3 / (3 * BENDING)
    found = bent(arm, Loads(tip_force=force), along=10).tip[1] / force
    assert abs(found - bending - shear) < 0.08 * shear  # the base, kept plane, is stiffer; 0.2 % of the whole


def test_slope_of_the_solid_is_exact():
    """Beside a central difference: Mooney-Rivlin, compressible, tendon of unit tangents, water, weight, tip load."""
    arm = Arm(poisson_ratio=0.45)
    loads = Loads(8.0, unit=True, velocity=0.4, gravity=9.81, tip_force=0.3, tip_moment=0.01)
    solid = Solid(Mesh.of(arm, 3), Rubber.of(arm, 0.3), loads)
    at = solid.from_rod(rod(arm, Loads(8.0)))
    rng = np.random.default_rng(0)
    change = np.zeros_like(at)
    for part, size in zip(solid.split(change), (1e-4, 1e3, 1e-4, 1.0), strict=True):
        part[:] = size * rng.standard_normal(part.shape)
    slope, _ = solid.system(at)
    difference = (solid.system(at + 1e-3 * change)[1] - solid.system(at - 1e-3 * change)[1]) / 2e-3
    np.testing.assert_allclose(slope @ change, difference, atol=1e-5 * np.abs(difference).max())


def test_rod_with_the_papers_constraint_is_that_of_the_package():
    solution = solve(load_scene("octopus"))
    ours = rod(Arm(), Loads(20.0, velocity=0.2, gravity=9.81), "paper", points=40)
    ends = [ours.x[-1], ours.y[-1], ours.theta[-1], ours.beta[-1]]
    theirs = [solution.tip.x, solution.tip.y, solution.tip.theta, solution.fields.beta[-1]]
    np.testing.assert_allclose(ends, theirs, atol=1e-7)


def test_incompressible_section_sums_the_stresses_of_its_fibers():
    nu, mu, s = 0.9, 15.0, 0.1
    arm, beta = Arm(), 0.9**-0.5
    radius = arm.radius(s)

    def fiber(y):
        stretch = nu - y * beta * mu
        return 2 * np.sqrt(radius**2 - y**2) * arm.modulus / 3 * (stretch - stretch**-2)

    axial, _, moment, constraint = resultants(arm, "incompressible", 1.0, s, nu, 0.0, mu, beta)
    assert axial == pytest.approx(quad(fiber, -radius, radius, epsabs=1e-10)[0], rel=1e-8)
    assert moment == pytest.approx(quad(lambda y: -y * beta * fiber(y), -radius, radius, epsabs=1e-12)[0], rel=1e-8)
    assert constraint == 0.0


def test_arm_as_a_solid_is_as_an_incompressible_rod():
    """And not as the rods of the other two sections: tips at 10 N, over the length."""
    arm, loads = Arm(), Loads(10.0)
    tip = bent(arm, loads, along=16).tip
    gaps = {}
    for section in ("incompressible", "rigid", "paper"):
        line = rod(arm, loads, section)
        gaps[section] = np.hypot(line.x[-1] - tip[0], line.y[-1] - tip[1]) / arm.length
    assert gaps["incompressible"] < 1e-4
    assert gaps["rigid"] > 2e-3
    assert gaps["paper"] > 5e-3


def test_water_frozen_on_the_arm_as_bent_is_the_water_that_follows():
    arm, loads = Arm(), Loads(20.0, velocity=0.4, gravity=9.81)
    follows = bent(arm, loads, along=8)
    still = bent(arm, loads._replace(velocity=0.0), along=8)
    frozen = bent(arm, loads, along=8, frozen=np.hstack([follows.r, follows.d]))
    np.testing.assert_allclose(frozen.tip, follows.tip, atol=1e-9)
    assert np.abs(still.tip - follows.tip).max() > 1e-2


def test_felupe_bends_the_same_cylinder():
    """A clamped cantilever at large deflection, nearly incompressible; felupe's pressure is linear in each direction of
    a brick where ours is linear, so the two differ by their errors on this mesh."""
    felupe = pytest.importorskip("felupe")
    arm = CYLINDER._replace(poisson_ratio=0.45)
    mesh, rubber, force = Mesh.of(arm, 4, 2, 2), Rubber.of(arm), 2 * BENDING / arm.length**2
    ours = Solid(mesh, rubber, Loads(tip_force=force), clamped=True).solve()
    assert ours.tip[1] > 0.4 * arm.length

    corners = 1 + felupe.TriQuadraticHexahedron().points.astype(int)
    numbered, mirrored = (np.ravel_multi_index(corners[:, axes].T, (3, 3, 3)) for axes in ([0, 1, 2], [0, 2, 1]))
    edges = mesh.nodes[mesh.bricks[:, numbered[[1, 3, 4]]]] - mesh.nodes[mesh.bricks[:, numbered[[0]]]]
    cells = np.where(np.linalg.det(edges)[:, None] > 0, mesh.bricks[:, numbered], mesh.bricks[:, mirrored])
    region = felupe.RegionTriQuadraticHexahedron(felupe.Mesh(mesh.nodes, cells, "VTK_TRIQUADRATIC_HEXAHEDRON"))
    field = felupe.FieldsMixed(region, n=3)
    shear = arm.modulus / (2 * (1 + arm.poisson_ratio))
    material = felupe.NearlyIncompressible(felupe.NeoHookeCompressible(mu=shear), bulk=1 / rubber.compliance)
    held = {
        "base": felupe.Boundary(field[0], fx=0.0),
        "middle": felupe.Boundary(field[0], fz=0.0, skip=(True, True, False)),
    }
    tip = np.arange(len(mesh.nodes) - len(mesh.disk), len(mesh.nodes))
    body = felupe.SolidBody(material, field)
    dof0, dof1 = felupe.dof.partition(field, held)
    for share in (0.25, 0.5, 0.75, 1.0):
        pulled = np.zeros((len(tip), 3))
        pulled[:, 1] = share * force / 2 * mesh.moments[0]
        load = felupe.PointLoad(field, tip, values=pulled)
        felupe.newtonraphson(items=[body, load], dof0=dof0, dof1=dof1, verbose=0, tol=1e-8)
    moved = mesh.moments[0] @ field[0].values[tip] + [arm.length, 0, 0]
    np.testing.assert_allclose(moved[:2], ours.tip[:2], atol=1.5e-4 * arm.length)
