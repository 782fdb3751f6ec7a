"""Checks a scene's values, one line an error: where, the value given, what is allowed.

Values that JAX is tracing cannot be looked at and pass; the solver gives such a rod its own outcome. A batched leaf is
checked element by element.
"""

import dataclasses
import functools as ft
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from ..errors import InputError, quoted
from .quantity import Choice, Count, Quantity, Series, concrete, declaration
from .tcam import TCAM
from .voltage import AbstractVoltage, Pulses, Sampled


def validate(scene: Any) -> None:
    """Raises `InputError` for the first value of `scene` that is not allowed."""
    _check_declared(scene)
    _check_material(scene.arm)
    for i, load in enumerate(scene.loads):
        if not callable(getattr(load, "per_length", None)):
            raise InputError(f"loads.{i} must be an AbstractLoad, but is {quoted(load)}")
    for i, muscle in enumerate(scene.muscles):
        _check_muscle(f"muscles.{i}", muscle, scene.arm)
        _check_source(f"muscles.{i}", muscle)


def validate_tcam(tcam: TCAM, path: str = "tcam") -> None:
    """Raises `InputError` for the first value of `tcam`, which stands at `path`, that is not allowed."""
    _check_declared(tcam, f"{path}.")
    _check_voltage(f"{path}.voltage", tcam.voltage)
    _check_above_ambient(path, tcam)


def is_allowed(scene: Any) -> Array:
    """Whether every quantity of `scene` is in its own range, as a value that JAX can trace; of a batch, element by
    element."""
    quantities = [(value, declaration(field)) for _, field, value in declared(scene) if value is not None]
    held = [
        rule.allowed.holds(jnp.asarray(number))
        for value, rule in quantities
        if isinstance(rule, Quantity | Series)
        for number in jax.tree.leaves(value)
    ]
    return ft.reduce(jnp.logical_and, held)


def declared(part: Any, prefix: str = "") -> Iterator[tuple[str, dataclasses.Field, Any]]:
    """Every declared field below `part`: its path, the field, its value (None where it is left out)."""
    if not dataclasses.is_dataclass(part):
        return  # inside a function that a user wrote
    for field in dataclasses.fields(part):
        path, value = f"{prefix}{field.name}", getattr(part, field.name)
        if declaration(field) is not None:
            yield path, field, value
        elif isinstance(value, tuple):
            for i, item in enumerate(value):
                yield from declared(item, f"{path}.{i}.")
        else:
            yield from declared(value, f"{path}.")


def _check_declared(part: Any, prefix: str = "") -> None:
    for path, field, value in declared(part, prefix):
        rule = declaration(field)
        if isinstance(rule, Choice) and value not in rule.values:
            raise rule.refused(path, value)
        if isinstance(rule, Count) and not (type(value) is int and 1 <= value <= rule.highest):
            raise rule.refused(path, value)
        if isinstance(rule, Quantity | Series) and value is not None:
            _check_quantity(path, value, rule)


def _check_quantity(path: str, value: Any, rule: Quantity | Series) -> None:
    components = rule.components if isinstance(rule, Quantity) else 1
    values = value if components > 1 else (value,)
    if components > 1 and (not isinstance(value, tuple | list) or len(value) != components):
        raise InputError(f"{path} must have {components} components [{rule.unit}], but is {quoted(value)}")
    for component in values:
        try:
            number = concrete(component)
        except (TypeError, ValueError, OverflowError):
            raise InputError(f"{path} must be a number [{rule.unit}], but is {quoted(component)}") from None
        if number is not None and not (ok := rule.allowed.holds(number)).all():
            raise rule.refused(path, _first(number, ~ok))


def _check_material(arm: Any) -> None:
    missing = [name for name in ("youngs_modulus", "poisson_ratio") if getattr(arm, name) is None]
    instead = [name for name in ("stiffness", "section_law") if getattr(arm, name) is not None]
    if not instead and missing:
        raise InputError(
            f"{' and '.join(f'arm.{name}' for name in missing)} must be given, but is missing; or give a table "
            "arm.stiffness, or in Python a section_law"
        )
    if len(instead) == 2:
        raise InputError("arm.stiffness must be given without section_law, but is given beside it; leave one out")
    if instead and len(missing) < 2:
        raise InputError(
            f"arm.{instead[0]} must be given without youngs_modulus and poisson_ratio, but is given beside them; "
            "leave the one or the others out"
        )
    if arm.stiffness is not None and arm.cross_section != "rigid":
        raise InputError(f"arm.cross_section must be 'rigid' with arm.stiffness, but is {arm.cross_section!r}")


def _check_muscle(path: str, muscle: Any, arm: Any) -> None:
    end = arm.length if muscle.end is None else muscle.end
    given = (arm.length, arm.base_radius, arm.tip_radius, muscle.base_offset, muscle.end_offset, end)
    numbers = [number for value in given if (number := concrete(value)) is not None]
    if len(numbers) < len(given):
        return  # JAX is tracing some of them
    length, base_radius, tip_radius, base_offset, end_offset, end = numbers
    if (bad := end > length).any():
        allowed = f"at most {_first(length, bad):g} m, the arm's length"
        raise InputError(f"{path}.end must be {allowed}, but is {_first(end, bad):g} m")
    if muscle.tangent == "unit":
        return
    end_radius = base_radius + (tip_radius - base_radius) * end / length
    for name, offset, radius in (("base_offset", base_offset, base_radius), ("end_offset", end_offset, end_radius)):
        if (bad := offset > radius * (1 + 1e-12)).any():
            raise InputError(
                f"{path}.{name} must be at most {_first(radius, bad):g} m, the arm's radius there, but is "
                f"{_first(offset, bad):g} m, outside the arm; or give tangent = 'unit'"
            )


def _check_source(path: str, muscle: Any) -> None:
    """A muscle's tension is given, found from its tendon displacement, or made by a TCAM."""
    given = [name for name in ("tension", "displacement", "tcam") if getattr(muscle, name) is not None]
    if not given:
        raise InputError(
            f"{path}.tension must be given, but is missing; or give {path}.displacement, or a table {path}.tcam that "
            "makes it"
        )
    if len(given) > 1:
        others = " and ".join(f"{path}.{name}" for name in given[1:])
        raise InputError(f"{path}.{given[0]} must be given alone, but is given beside {others}; give one of the three")
    if muscle.tcam is not None:
        if not isinstance(muscle.tcam, TCAM):
            raise InputError(f"{path}.tcam must be a TCAM, but is {quoted(muscle.tcam)}")
        validate_tcam(muscle.tcam, f"{path}.tcam")


def _check_voltage(path: str, voltage: Any) -> None:
    if voltage is not None and not isinstance(voltage, AbstractVoltage):
        raise InputError(f"{path} must be a voltage or a function of time, but is {quoted(voltage)}")
    if isinstance(voltage, Pulses):
        allowed = "at most {:g} s, the period"
        _check_order(f"{path}.width", voltage.width, voltage.period, np.less_equal, allowed)
    if isinstance(voltage, Sampled):
        times, values = np.shape(voltage.times), np.shape(voltage.values)
        if times != values or times[-1:] < (2,):
            raise InputError(f"{path} must have as many times as values, at least 2, but has {times} and {values}")
        seconds = concrete(voltage.times)
        if seconds is not None and (bad := np.diff(seconds) <= 0).any():
            raise InputError(
                f"{path}.times must ascend, but {_first(seconds[..., 1:], bad):g} s does not come after the one before"
            )
        volts = concrete(voltage.values)
        if seconds is not None and volts is not None and seconds.ndim == 1:
            _check_start(path, seconds, volts)


def _check_start(path: str, seconds: np.ndarray, volts: np.ndarray) -> None:
    """A muscle is at its ambient temperature at 0 s: what heats it from then on must be known."""
    if seconds[0] > 1.5 * (seconds[1] - seconds[0]) and volts[0] != 0:
        raise InputError(
            f"{path}.times must start at 0 s, where the muscle is at its ambient temperature, but start at "
            f"{seconds[0]:g} s with {volts[0]:g} V; subtract {seconds[0]:g} s, or give the voltage before"
        )


def _check_above_ambient(path: str, tcam: TCAM) -> None:
    allowed = "more than {:g} K, the ambient temperature"
    for name in ("limit_temperature", "reference_temperature"):
        _check_order(f"{path}.{name}", getattr(tcam, name), tcam.ambient_temperature, np.greater, allowed)


def _check_order(path: str, value: Any, other: Any, holds: np.ufunc, allowed: str) -> None:
    """That `holds(value, other)`, where both can be looked at."""
    first, second = concrete(value), concrete(other)
    if first is not None and second is not None and (bad := ~holds(first, second)).any():
        raise InputError(f"{path} must be {allowed.format(_first(second, bad))}, but is {_first(first, bad):g}")


def _first(values: np.ndarray, where: np.ndarray) -> float:
    """The first of `values` (broadcast) at which `where` holds: the one an error names."""
    values, where = np.broadcast_arrays(values, where)
    return float(values[where].flat[0])
