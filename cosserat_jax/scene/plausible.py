"""Hints at numbers that are probably meant in another unit: allowed, but unlike any arm."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from .parts import Arm, Scene
from .quantity import concrete

_SLENDERNESS = 1.0, 1500.0  # length over the radius at the base
_MODULUS = 1e2, 2e12  # Pa
_DENSITY = 0.5, 3e4  # kg/m^3
_SPEED = 50.0  # m/s of a current
_LOAD = 1e7  # forces over E J / L^2
_SI = "a number without a unit is in SI"


def unit_hints(scene: Scene) -> tuple[str, ...]:
    """A sentence for each number of `scene` that looks like a slip of its unit. It is solved all the same."""
    return tuple(_hints(scene))


def _hints(scene: Scene) -> Iterator[str]:
    arm = scene.arm
    length, radius, modulus, density = (
        _largest(value) for value in (arm.length, arm.base_radius, arm.youngs_modulus, arm.density)
    )
    if length < _SLENDERNESS[0] * radius or length > _SLENDERNESS[1] * radius:
        yield f"the arm is {length:g} m long and {1e3 * radius:g} mm thick at its base; {_SI}"
    if modulus < _MODULUS[0] or modulus > _MODULUS[1]:
        yield f"arm.youngs_modulus is {modulus:g} Pa; {_SI}"
    if density < _DENSITY[0] or density > _DENSITY[1]:
        yield f"arm.density is {density:g} kg/m^3; {_SI}"
    if scene.water is not None and _largest(scene.water.velocity) > _SPEED:
        yield f"water.velocity is {_largest(scene.water.velocity):g} m/s; {_SI}"
    unit = _bending_stiffness(arm) / length**2
    loads = {f"muscles.{i}.tension": muscle.tension for i, muscle in enumerate(scene.muscles)}
    if scene.tip is not None:
        loads |= {f"tip.force.{i}": force for i, force in enumerate(scene.tip.force)}
    for path, force in loads.items():
        if force is not None and _largest(force) > _LOAD * unit:
            yield f"{path} is {_largest(force):g} N, {_largest(force) / unit:.0g} times E J / L^2 of the arm; {_SI}"


def _bending_stiffness(arm: Arm) -> float:
    """E J [N m^2] at the base; infinite for a section law of the user's own."""
    if arm.stiffness is not None:
        return _largest(arm.stiffness.bending)
    if arm.youngs_modulus is None:
        return math.inf
    return _largest(arm.youngs_modulus) * math.pi / 4 * _largest(arm.base_radius) ** 4


def _largest(value: Any) -> float:
    """In magnitude; NaN, of which nothing is said, for what is absent or JAX traces."""
    number = None if value is None else concrete(value)
    return math.nan if number is None else float(np.max(np.abs(number)))
