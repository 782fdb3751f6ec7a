"""Scenes drawn from the ranges that the solver promises to cope with: stiff, slender, soft, strongly pulled, in strong
currents. Plain dictionaries, as the reference formulation takes them."""

from typing import Any

import numpy as np
from conversion import scene_of

from cosserat_jax import Scene

MODULUS = 2e5, 1e9  # Pa
LENGTH = 0.1, 1.5  # m
BASE_RADIUS = 5e-3, 25e-3  # m
TIP_RADIUS = 0.5e-3, 10e-3  # m
POISSON = 0.2, 0.5
DENSITY = 900.0, 2000.0  # kg / m^3
PULL = 0.0, 6.0  # tension of a muscle in units of E pi R_tip^3 / (4 L)
MUSCLE_END = 0.3, 1.0  # in lengths of the arm
CURRENT = -2.0, 2.0  # m / s
WATER = {"density": 998.0, "viscosity": 1.002e-3, "boundary_layer": 0.02}


def draw(rng: np.random.Generator) -> dict[str, Any]:
    """A scene of a structure drawn by chance; decades are drawn evenly."""
    modulus, length = _decades(rng, MODULUS), _decades(rng, LENGTH)
    radii = _decades(rng, BASE_RADIUS), _decades(rng, TIP_RADIUS)
    count = rng.integers(1, 4)
    muscles = [(int(rng.choice([-1, 1])), rng.uniform(*MUSCLE_END), rng.uniform(*PULL)) for _ in range(count)]
    if count == 3 and abs(sum(side for side, _, _ in muscles)) == 3:
        muscles[0] = (-muscles[0][0], *muscles[0][1:])  # three have both sides
    plain = scene(modulus, length, radii, rng.uniform(*POISSON), rng.uniform(*DENSITY), muscles)
    if rng.random() < 0.5:
        plain["arm"]["cross_section"] = "rigid"
    if rng.random() < 0.5:
        plain["gravity"] = {"acceleration": 9.81}
    if rng.random() < 0.7:
        plain["water"] = WATER | {"velocity": rng.uniform(*CURRENT)}
    return plain


def drawn(seed: int, number: int) -> dict[str, Any]:
    """The scene that this seed and number stand for."""
    return draw(np.random.default_rng([seed, number]))


def scene(
    modulus: float, length: float, radii: tuple[float, float], poisson: float, density: float,
    muscles: list[tuple[int, float, float]],
) -> dict[str, Any]:  # fmt: skip
    """An arm with muscles given by side, end / L and pull, each from 0.8 R at the base to 0.6 R at its end."""
    base, tip = radii
    arm = {"length": length, "base_radius": base, "tip_radius": tip, "youngs_modulus": modulus}
    unit = modulus * np.pi * tip**3 / (4 * length)
    offsets = {"base_offset": 0.8 * base}
    return {
        "arm": arm | {"poisson_ratio": poisson, "density": density},
        "muscles": [
            offsets
            | {
                "side": side,
                "end": end * length,
                "end_offset": 0.6 * (base + (tip - base) * end),
                "tension": pull * unit,
            }
            for side, end, pull in muscles
        ],
    }


def alike(plain: dict[str, Any]) -> Scene:
    """The package's scene with what is absent made idle, so that one program serves all of a kind of section: two
    muscles on each side, some of them slack; gravity of nothing; for air, still water that weighs next to nothing."""
    muscles = plain["muscles"]
    slack = muscles[0] | {"tension": 0.0}
    sides = [[muscle for muscle in muscles if muscle["side"] == side] for side in (1, -1)]
    padded = [own + [slack | {"side": side}] * (2 - len(own)) for own, side in zip(sides, (1, -1), strict=True)]
    muscles = padded[0] + padded[1]
    idle = {"gravity": {"acceleration": 0.0}, "water": WATER | {"density": 1e-9, "viscosity": 0.0, "velocity": 0.0}}
    return scene_of(idle | plain | {"muscles": muscles})


def _decades(rng: np.random.Generator, bounds: tuple[float, float]) -> float:
    return float(np.exp(rng.uniform(*np.log(bounds))))
