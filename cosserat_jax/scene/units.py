"""Reads quantities with units, by pint: "10 MPa", "0:20:0.5 N", "0.2, 0.4 m/s". Numbers come out in SI."""

import functools as ft
import re
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError

_LONGEST_RANGE = 1_000_000
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"

cache_folder: Path | None = None  # where the command line has pint keep its units: parsing them takes long


@ft.cache
def _registry() -> Any:
    import pint  # here, not above: importing the package must not cost what a unit parser costs

    try:
        registry = pint.UnitRegistry(cache_folder=cache_folder)
    except Exception:  # whatever reading a broken file raises, or one that another process is writing
        registry = pint.UnitRegistry()
    registry.define("hertz = turn / second = Hz")  # pint's own is 1/s, so that 1 Hz would be 1 rad/s
    return registry


def to_si(value: Any, unit: str, where: str) -> float:
    """`value`, a number in SI or a string with a unit, as a float in SI `unit`. Raises `InputError` naming `where`."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise InputError(f'{where}: {value!r} is not a quantity; allowed: a number in SI or a string like "1 {unit}"')
    if not isinstance(value, str):
        return float(value)
    try:
        return float(value)  # a bare number in quotes is SI, as it is without them
    except ValueError:
        return _convert(_parse(value, unit, where), value, unit, where)


def series_to_si(given: Any, unit: str, where: str) -> np.ndarray:
    """A list of quantities, or the text of a range, as an array of floats in SI `unit`."""
    if isinstance(given, str):
        return range_to_si(given, unit, where)
    if not isinstance(given, list):
        raise InputError(f'{where}: {given!r} is not allowed; allowed: a list of quantities, or "V1, V2 {unit}"')
    return np.array([to_si(item, unit, f"{where}.{i}") for i, item in enumerate(given)], dtype=float)


def range_to_si(text: str, unit: str, where: str) -> np.ndarray:
    """The values of "START:STOP:STEP UNIT" (STOP included) or "V1, V2, ... UNIT" in SI `unit`, of shape (n,)."""
    matched = re.fullmatch(rf"\s*({_NUMBER}(?:\s*[:,]\s*{_NUMBER})*)\s*(.*)", text, re.DOTALL)
    if matched is None:
        raise InputError(f'{where}: {text!r} is not a range; allowed: "START:STOP:STEP {unit}" or "V1, V2 {unit}"')
    numbers, given_unit = matched.groups()
    if ":" not in numbers:
        values = np.array([float(x) for x in numbers.split(",")])
    elif "," in numbers or numbers.count(":") != 2:
        raise InputError(f'{where}: {text!r} is not a range; allowed: "START:STOP:STEP {unit}" or "V1, V2 {unit}"')
    else:
        start, stop, step = (float(x) for x in numbers.split(":"))
        values = _stepped(start, stop, step, text, where)
    scale, offset = 1.0, 0.0
    if given_unit.strip():
        offset = to_si(f"0 {given_unit}", unit, where)
        scale = to_si(f"1 {given_unit}", unit, where) - offset
    return values * scale + offset


def bounds_to_si(text: str, unit: str, where: str) -> tuple[float, float]:
    """The two values of "LOWER:UPPER UNIT" in SI `unit`."""
    matched = re.fullmatch(rf"\s*({_NUMBER})\s*:\s*({_NUMBER})\s*([^\s:,].*)?", text, re.DOTALL)
    if matched is None:
        raise InputError(f'{where}: {text!r} are no bounds; allowed: "LOWER:UPPER {unit}"')
    lower, upper = range_to_si(f"{matched[1]}, {matched[2]} {matched[3] or ''}", unit, where)
    return float(lower), float(upper)


def _stepped(start: float, stop: float, step: float, text: str, where: str) -> np.ndarray:
    if step == 0 or (stop - start) / step < 0:
        raise InputError(f"{where}: {text!r} never reaches its end; allowed: a step that leads from START to STOP")
    count = int(np.floor((stop - start) / step * (1 + 1e-12) + 1e-9)) + 1
    if count > _LONGEST_RANGE:
        raise InputError(f"{where}: {text!r} has {count} values; allowed: at most {_LONGEST_RANGE}")
    return start + step * np.arange(count)


def _parse(text: str, unit: str, where: str) -> Any:
    number = re.match(rf"\s*({_NUMBER}|[-+]?(?:inf|nan)\b)\s*", text)
    if number is None:
        raise InputError(f"{where}: {text!r} is not a quantity in {unit}; allowed: a number and a unit")
    try:  # the two apart: pint takes "98 degC" for a product with degC, which has no meaning
        return _registry().Quantity(float(number[1]), text[number.end() :])
    except Exception as error:  # pint raises a dozen kinds, from its tokenizer's to its own
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"{where}: {text!r} is not a quantity in {unit} ({reason})") from None


def _convert(quantity: Any, text: str, unit: str, where: str) -> float:
    try:
        converted = float(quantity.to("dimensionless" if unit == "1" else unit).magnitude)
    except Exception:  # a wrong dimension, or a magnitude that is no number
        kind = "a number without a unit" if unit == "1" else f"a quantity in {unit}"
        raise InputError(f"{where}: {text!r} has the wrong unit; allowed: {kind}") from None
    return float(f"{converted:.15g}")  # 0.998 kg/dm^3 is 998 kg/m^3, not 997.9999999999999
