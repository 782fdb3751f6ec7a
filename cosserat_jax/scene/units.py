"""Reads quantities with units, by pint: "10 MPa", "0:20:0.5 N", "0.2, 0.4 m/s". Numbers come out in SI."""

import functools as ft
import re
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError, quoted
from .quantity import Quantity

_LONGEST_RANGE = 1_000_000  # values
_LONGEST_TEXT = 100_000  # characters of a range
_LONGEST_UNIT = 60
_NUMBER = r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?"
_DECIMAL_COMMA = r"\s*[-+]?\d+,\d+(?![\d.]*[,:])"

# What pint may see of a unit: names with whole exponents of two digits, joined by * / or a space, in parentheses once.
# It would compute a tower of powers to its end, and take "m!" and "m #x" for meters.
_POWER = r"(?:\s*(?:\^|\*\*)\s*[-+]?\d{1,2}|[⁺⁻]?[¹²³⁴⁵⁶⁷⁸⁹⁰]{1,2})"
_FACTOR = rf"(?:1|%|°?[^\W\d_][\w°]*){_POWER}?"
_JOINED = r"(?:\s*[*/·]\s*|\s+)"
_PRODUCT = rf"{_FACTOR}(?:{_JOINED}{_FACTOR})*"
_GROUP = rf"(?:{_FACTOR}|\(\s*{_PRODUCT}\s*\))"
_UNIT = re.compile(rf"{_GROUP}(?:{_JOINED}{_GROUP})*")

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
        raise InputError(f'{where} must be a number in SI or a string like "1 {unit}", but is {quoted(value)}')
    if not isinstance(value, str):
        try:
            return float(value)
        except OverflowError:
            raise InputError(f"{where} must be a finite number [{unit}], but is {quoted(value)}") from None
    text = value[:_LONGEST_TEXT]
    number = re.match(rf"\s*({_NUMBER}|[-+]?(?:inf|nan)(?!\w))", text)
    given = text[number.end() :].strip() if number else ""
    if number is None or re.match(r"(?!1\s*/)[\d.,:+-]", given):
        kind = "a number" if unit == "1" else f"a number and a unit, such as 1 {unit}"
        raise InputError(f"{where} must be {kind}, but is {quoted(value)}{_hint(value)}")
    if np.isinf(float(number[1])) and "inf" not in number[1]:
        raise InputError(f"{where} must be finite, but is {quoted(value)}")
    if not given:
        return float(number[1])  # a bare number in quotes is SI, as it is without them
    return _converted(float(number[1]), given, unit, where, value)


def allowed_si(value: Any, rule: Quantity, where: str) -> float:
    """As `to_si`, of a value that the declaration of the quantity allows."""
    number = to_si(value, rule.unit, where)
    if not rule.allowed.holds(number):
        raise rule.refused(where, value)
    return number


def series_to_si(given: Any, unit: str, where: str) -> np.ndarray:
    """A list of quantities, or the text of a range, as an array of floats in SI `unit`."""
    if isinstance(given, str):
        return range_to_si(given, unit, where)
    if not isinstance(given, list):
        raise InputError(f'{where} must be a list of quantities, or "V1, V2 {unit}", but is {quoted(given)}')
    return np.array([to_si(item, unit, f"{where}.{i}") for i, item in enumerate(given)], dtype=float)


def range_to_si(text: str, unit: str, where: str) -> np.ndarray:
    """The values of "START:STOP:STEP UNIT" (STOP included) or "V1, V2, ... UNIT" in SI `unit`, of shape (n,)."""
    matched = None
    if len(text) <= _LONGEST_TEXT:
        matched = re.fullmatch(rf"\s*({_NUMBER}(?:\s*[:,]\s*{_NUMBER})*)\s*(.*)", text, re.DOTALL)
    numbers, given = matched.groups() if matched else ("", "")
    colons, commas = numbers.count(":"), numbers.count(",")
    if not numbers or (colons and commas) or colons not in (0, 2) or re.match(r"(?!1\s*/)[\d.,:+-]", given):
        raise InputError(
            f'{where} must be "START:STOP:STEP {unit}" or "V1, V2 {unit}", but is {quoted(text)}{_hint(text)}'
        )
    if colons:
        start, stop, step = (float(x) for x in numbers.split(":"))
        values = _stepped(start, stop, step, text, where)
    else:
        values = np.array([float(x) for x in numbers.split(",")])
    if not np.isfinite(values).all():
        raise InputError(f"{where} must have finite values, but is {quoted(text)}")
    if not given.strip():
        return values
    offset = _converted(0.0, given.strip(), unit, where, text)
    scale = _converted(1.0, given.strip(), unit, where, text) - offset
    return values * scale + offset


def bounds_to_si(text: str, unit: str, where: str) -> tuple[float, float]:
    """The two values of "LOWER:UPPER UNIT" in SI `unit`."""
    matched = None
    if len(text) <= _LONGEST_TEXT:
        matched = re.fullmatch(rf"\s*({_NUMBER})\s*:\s*({_NUMBER})\s*([^\s:,].*)?", text, re.DOTALL)
    if matched is None:
        raise InputError(f'{where} must be "LOWER:UPPER {unit}", but is {quoted(text)}{_hint(text)}')
    lower, upper = (float(number) for number in matched.groups()[:2])
    if not np.isfinite([lower, upper]).all():
        raise InputError(f"{where} must have finite bounds, but is {quoted(text)}")
    given = (matched[3] or "").strip()
    if not given:
        return lower, upper
    return _converted(lower, given, unit, where, text), _converted(upper, given, unit, where, text)


def scale_to_si(given: str, unit: str, where: str) -> tuple[float, float]:
    """The factor and the offset from a unit, such as that in the head of a column, to SI `unit`."""
    offset = _converted(0.0, given, unit, where, given)
    return _converted(1.0, given, unit, where, given) - offset, offset


def _stepped(start: float, stop: float, step: float, text: str, where: str) -> np.ndarray:
    if step == 0 or (stop - start) / step < 0:
        raise InputError(f"{where} must have a step that leads from START to STOP, but {quoted(text)} never reaches it")
    intervals = (stop - start) / step * (1 + 1e-12) + 1e-9
    if not intervals < _LONGEST_RANGE:
        count = f"{np.floor(intervals) + 1:.0f}" if intervals < 1e15 else "too many"
        raise InputError(f"{where} must have at most {_LONGEST_RANGE} values, but {quoted(text)} has {count}")
    return start + step * np.arange(int(intervals) + 1)


def _converted(number: float, given: str, unit: str, where: str, text: str) -> float:
    """`number` of the unit `given` in SI `unit`; `text` is what was typed."""
    kind = "a number without a unit" if unit == "1" else f"a quantity in {unit}"
    if len(given) > _LONGEST_UNIT or _UNIT.fullmatch(given) is None:
        raise InputError(f"{where} must be {kind}, but is {quoted(text)}; {quoted(given)} is no unit{_hint(text)}")
    import pint

    written = re.sub(r"(?<![\w^*])([^\W\d_]+)([2-9])(?![\w.])", r"\1^\2", given)  # m3, which pint takes for a name
    try:  # the two apart: pint takes "98 degC" for a product with degC, which has no meaning
        quantity = _registry().Quantity(number, written)
    except Exception:  # pint raises a dozen kinds, from its tokenizer's to its own
        raise InputError(f"{where} must be {kind}, but is {quoted(text)}; {quoted(given)} is an unknown unit") from None
    try:
        converted = float(quantity.to("dimensionless" if unit == "1" else unit).magnitude)
    except pint.DimensionalityError:
        raise InputError(f"{where} must be {kind}, but {quoted(text)} has the wrong unit") from None
    except Exception:  # a magnitude that is no number, or one that no float holds
        raise InputError(f"{where} must be {kind}, but is {quoted(text)}, which cannot be converted") from None
    return float(f"{converted:.15g}")  # 0.998 kg/dm^3 is 998 kg/m^3, not 997.9999999999999


def _hint(text: str) -> str:
    """What was probably meant."""
    if re.match(_DECIMAL_COMMA, text[:200]):
        return "; a decimal point is written ."
    if re.match(rf"\s*{_NUMBER}\s*(?:-|\.\.|to)\s*{_NUMBER}", text[:200]):
        return "; a range is written with colons"
    return ""
