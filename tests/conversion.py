"""A scene of the package from the plain dictionaries of the reference formulation."""

from typing import Any

from cosserat_jax import Arm, Gravity, Muscle, Scene, SectionStiffness, Tip, Water


def scene_of(plain: dict[str, Any]) -> Scene:
    """The package's scene with the numbers of `plain`."""
    arm = dict(plain["arm"])
    if "stiffness" in arm:
        arm["stiffness"] = SectionStiffness(**arm["stiffness"])
    return Scene(
        arm=Arm(**arm),
        muscles=tuple(Muscle(**muscle) for muscle in plain.get("muscles", ())),
        water=Water(**plain["water"]) if "water" in plain else None,
        gravity=Gravity(**plain["gravity"]) if "gravity" in plain else None,
        tip=Tip(**plain["tip"]) if "tip" in plain else None,
    )
