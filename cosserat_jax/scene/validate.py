"""Checks a scene's values, one line an error: where, the value given, what is allowed.

Values that JAX is tracing cannot be looked at and pass; the solver gives such a rod its own outcome. A batched leaf is
checked element by element.
"""

import dataclasses
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from .quantity import Choice, Quantity, SceneError, concrete, declaration


def validate(scene: Any) -> None:
    """Raises `SceneError` for the first value of `scene` that is not allowed."""
    for path, field, value in declared(scene):
        rule = declaration(field)
        if isinstance(rule, Choice) and value not in rule.values:
            raise SceneError(f"{path}: {value!r} is not allowed; allowed: {rule}")
        if isinstance(rule, Quantity) and value is not None:
            _check_quantity(path, value, rule)
    _check_material(scene.arm)
    for i, muscle in enumerate(scene.muscles):
        _check_muscle(f"muscles.{i}", muscle, scene.arm)


def is_allowed(scene: Any) -> Array:
    """Whether every quantity of `scene` is in its own range, as a value that JAX can trace."""
    quantities = [(value, declaration(field)) for _, field, value in declared(scene) if value is not None]
    held = [
        rule.allowed.holds(jnp.asarray(number))
        for value, rule in quantities
        if isinstance(rule, Quantity)
        for number in jax.tree.leaves(value)
    ]
    return jnp.stack(held).all()


def declared(part: Any, prefix: str = "") -> Iterator[tuple[str, dataclasses.Field, Any]]:
    """Every declared field below `part`: its path, the field, its value (None where it is left out)."""
    for field in dataclasses.fields(part):
        path, value = f"{prefix}{field.name}", getattr(part, field.name)
        if declaration(field) is not None:
            yield path, field, value
        elif isinstance(value, tuple):
            for i, item in enumerate(value):
                yield from declared(item, f"{path}.{i}.")
        elif value is not None:
            yield from declared(value, f"{path}.")


def _check_quantity(path: str, value: Any, rule: Quantity) -> None:
    values = value if rule.components > 1 else (value,)
    if rule.components > 1 and (not isinstance(value, tuple | list) or len(value) != rule.components):
        raise SceneError(f"{path}: {value!r} is not allowed; allowed: {rule.components} components [{rule.unit}]")
    for component in values:
        try:
            number = concrete(component)
        except (TypeError, ValueError):
            raise SceneError(f"{path}: {component!r} is not a number [{rule.unit}]") from None
        if number is not None and not (ok := rule.allowed.holds(number)).all():
            raise SceneError(f"{path}: {_first(number, ~ok):g} is not allowed; allowed: {rule.allowed} [{rule.unit}]")


def _check_material(arm: Any) -> None:
    missing = [name for name in ("youngs_modulus", "poisson_ratio") if getattr(arm, name) is None]
    if arm.stiffness is None and missing:
        raise SceneError(f"arm.{missing[0]}: missing; give youngs_modulus and poisson_ratio, or a table arm.stiffness")
    if arm.stiffness is not None and len(missing) < 2:
        raise SceneError("arm.stiffness: given beside youngs_modulus or poisson_ratio; allowed: the one or the other")
    if arm.stiffness is not None and arm.cross_section != "rigid":
        raise SceneError(
            f"arm.cross_section: {arm.cross_section!r} is not allowed with arm.stiffness; allowed: 'rigid'"
        )


def _check_muscle(path: str, muscle: Any, arm: Any) -> None:
    end = arm.length if muscle.end is None else muscle.end
    given = (arm.length, arm.base_radius, arm.tip_radius, muscle.base_offset, muscle.end_offset, end)
    numbers = [number for value in given if (number := concrete(value)) is not None]
    if len(numbers) < len(given):
        return  # JAX is tracing some of them
    length, base_radius, tip_radius, base_offset, end_offset, end = numbers
    if (bad := end > length).any():
        allowed = f"more than 0 to {_first(length, bad):g} [m], the arm's length"
        raise SceneError(f"{path}.end: {_first(end, bad):g} is not allowed; allowed: {allowed}")
    if muscle.tangent == "unit":
        return
    end_radius = base_radius + (tip_radius - base_radius) * end / length
    for name, offset, radius in (("base_offset", base_offset, base_radius), ("end_offset", end_offset, end_radius)):
        if (bad := offset > radius * (1 + 1e-12)).any():
            raise SceneError(
                f"{path}.{name}: {_first(offset, bad):g} lies outside the arm; "
                f"allowed: 0 to {_first(radius, bad):g} [m], its radius there, or tangent = 'unit'"
            )


def _first(values: np.ndarray, where: np.ndarray) -> float:
    """The first of `values` (broadcast) at which `where` holds: the one an error names."""
    values, where = np.broadcast_arrays(values, where)
    return float(values[where].flat[0])
