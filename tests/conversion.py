"""Between scenes of the package and the plain dictionaries of the reference formulation."""

import dataclasses
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


def plain(scene: Scene) -> dict[str, Any]:
    """`scene` as the dictionaries that the reference takes, where what is absent has no entry instead of None."""
    return _plain(dataclasses.replace(scene, notes=None))


def _plain(part: Any) -> Any:
    if isinstance(part, tuple):
        return [_plain(entry) for entry in part]
    if not dataclasses.is_dataclass(part):
        return part
    entries = {field.name: getattr(part, field.name) for field in dataclasses.fields(part)}
    return {name: _plain(entry) for name, entry in entries.items() if entry is not None}
