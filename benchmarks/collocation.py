"""From the tests: the reference formulation, `scipy.integrate.solve_bvp`, and the hard scenes."""

import dataclasses
import sys
from pathlib import Path
from typing import Any

from cosserat_jax import Scene

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
import hard
import reference

__all__ = ["hard", "plain", "reference"]


def plain(scene: Scene) -> dict[str, Any]:
    """`scene` as the dictionaries that the reference takes, where what is absent has no entry instead of None."""
    return _without_none(dataclasses.asdict(scene))


def _without_none(part: Any) -> Any:
    if isinstance(part, dict):
        return {name: _without_none(entry) for name, entry in part.items() if entry is not None}
    return [_without_none(entry) for entry in part] if isinstance(part, tuple) else part
