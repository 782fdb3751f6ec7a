"""Loads and section laws of the user's own beside closed forms and beside what the package has built in."""

import dataclasses
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cosserat_jax import (
    AbstractLoad,
    Arm,
    Scene,
    SectionStiffness,
    SingleShooting,
    StrainEnergy,
    Tip,
    load_scene,
    parameters,
    replace,
    solve,
    sweep,
)

METHOD = SingleShooting(steps=(14, 20))
LENGTH, BENDING, STIFFNESS, FORCE = 1.0, 2.0, 300.0, 1e-4


class Foundation(AbstractLoad):
    stiffness: float  # [N/m^2]

    def per_length(self, section: Any) -> tuple:
        return 0.0, -self.stiffness * section.y, 0.0


class LinearEnergy(StrainEnergy):
    modulus: float
    ratio: float

    def energy(self, section: Any, nu: Any, eta: Any, mu: Any) -> Any:
        area = self.area(section)
        shear = self.modulus / (2 * (1 + self.ratio))
        of_axis = self.modulus * area * (nu - 1) ** 2 + shear * area * eta**2
        return (of_axis + self.modulus * self.second_moment(section) * mu**2) / 2


BEDDED = Scene(
    Arm(LENGTH, 0.01, 0.01, 1000.0, cross_section="rigid", stiffness=SectionStiffness(math.inf, math.inf, BENDING)),
    tip=Tip(force=(0.0, FORCE)),
    loads=(Foundation(STIFFNESS),),
)


def hetenyi(stiffness: float) -> float:
    """Deflection under a force on the free end of a clamped beam on an elastic foundation, by its four constants."""
    root = (stiffness / (4 * BENDING)) ** 0.25
    x = root * LENGTH
    numerator = math.sinh(x) * math.cosh(x) - math.sin(x) * math.cos(x)
    return 2 * FORCE * root / stiffness * numerator / (math.cosh(x) ** 2 + math.cos(x) ** 2)


def deflection(stiffness: Any) -> jax.Array:
    return solve(replace(BEDDED, {"loads.0.stiffness": stiffness}), METHOD, points=2, throw=False).tip.y


def test_a_beam_on_a_users_elastic_foundation_is_the_closed_form():
    assert float(deflection(STIFFNESS)) == pytest.approx(hetenyi(STIFFNESS), rel=1e-7)


def test_a_float_of_a_users_load_is_a_parameter_that_is_swept_and_differentiated():
    assert "loads.0.stiffness" in parameters(BEDDED)
    values = np.array([50.0, STIFFNESS])
    swept = sweep(BEDDED, {"loads.0.stiffness": values}, METHOD, points=2).solution.tip.y
    np.testing.assert_allclose(swept, [hetenyi(value) for value in values], rtol=1e-7)
    numerical = (hetenyi(STIFFNESS + 0.1) - hetenyi(STIFFNESS - 0.1)) / 0.2
    assert float(jax.grad(deflection)(STIFFNESS)) == pytest.approx(numerical, rel=1e-6)


@pytest.mark.parametrize("section", ["rigid", pytest.param("volume-preserving", marks=pytest.mark.slow)])
def test_a_users_strain_energy_of_linear_elasticity_is_the_built_in_law(section: str):
    """Tip, fields, and derivatives by its floats."""
    octopus = replace(load_scene("octopus"), {"arm.cross_section": section})
    modulus, ratio = octopus.arm.youngs_modulus, octopus.arm.poisson_ratio

    def with_energy(modulus: Any, ratio: Any) -> Scene:
        law = LinearEnergy(modulus, ratio)
        arm = dataclasses.replace(octopus.arm, youngs_modulus=None, poisson_ratio=None, section_law=law)
        return dataclasses.replace(octopus, arm=arm)

    def built_in(modulus: Any, ratio: Any) -> Scene:
        return replace(octopus, {"arm.youngs_modulus": modulus, "arm.poisson_ratio": ratio})

    def result(scene: Scene) -> jax.Array:
        solution = solve(scene, METHOD, points=(0.0, 0.4, 1.0), throw=False)
        fields = solution.fields
        of_fields = [fields.y, fields.theta, fields.nu, fields.eta, fields.beta, fields.mu, fields.N / modulus]
        return jnp.concatenate([jnp.stack([solution.tip.x, solution.tip.y, solution.tip.theta]), *of_fields])

    def both(make: Any) -> tuple:
        jacobian = jax.jit(jax.jacrev(lambda *at: result(make(*at)), argnums=(0, 1)))(modulus, ratio)
        return result(make(modulus, ratio)), jacobian

    (mine, my_slopes), (theirs, their_slopes) = both(with_energy), both(built_in)
    assert np.isfinite(theirs).all()
    np.testing.assert_allclose(mine, theirs, rtol=0, atol=1e-9)
    for a, b in zip(my_slopes, their_slopes, strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-7 * np.abs(b).max())
