"""What a scene does not need is left out of its program: operations counted in what is handed to the compiler."""

import dataclasses

import jax
import pytest

from cosserat_jax import Gravity, Muscle, Scene, load_scene, replace, solve

OCTOPUS = load_scene("octopus")
THREE = dataclasses.replace(
    OCTOPUS,
    water=dataclasses.replace(OCTOPUS.water, velocity_gradient=0.1),
    gravity=Gravity(9.81),
    muscles=(
        Muscle(base_offset=0.012, end_offset=0.001, tension=10.0),
        Muscle(base_offset=0.010, end_offset=0.005, tension=5.0, end=0.2, side=-1),
        Muscle(base_offset=0.010, end_offset=0.004, tension=5.0, end=0.3),
    ),
)
SCENES = {
    "full": THREE,
    "without water": dataclasses.replace(THREE, water=None),
    "without gravity": dataclasses.replace(THREE, gravity=None),
    "rigid section": replace(THREE, {"arm.cross_section": "rigid"}),
    "one muscle instead of three": dataclasses.replace(THREE, muscles=THREE.muscles[:1]),
    "one unknown instead of three": dataclasses.replace(
        THREE, water=dataclasses.replace(THREE.water, velocity_gradient=None)
    ),
    "none of it": dataclasses.replace(
        replace(THREE, {"arm.cross_section": "rigid"}), water=None, gravity=None, muscles=()
    ),
}


def operations(scene: Scene) -> int:
    lowered = jax.jit(lambda scene: solve(scene, points=3, throw=False)).lower(scene)
    return lowered.as_text().count(" = stablehlo.")


@pytest.fixture(scope="module")
def counts() -> dict[str, int]:
    return {name: operations(scene) for name, scene in SCENES.items()}


@pytest.mark.parametrize("name", list(SCENES)[1:])
def test_leaving_a_part_out_shrinks_the_program(counts: dict[str, int], name: str):
    assert counts[name] < counts["full"], counts
    assert counts["none of it"] <= counts[name], counts


if __name__ == "__main__":
    for name, scene in SCENES.items():
        print(f"| {name} | {operations(scene)} |")
