"""Parameter paths: `muscles.0.tension` names one parameter in Python, in TOML, on the command line and in datasets."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax

from ..errors import InputError, nearest, quoted
from .parts import Muscle, Scene
from .quantity import ANY, Choice, Count, Declaration, Function, Quantity, Series, declaration
from .units import allowed_si, series_to_si


def parameters(scene: Scene) -> dict[str, Any]:
    """Every float leaf of `scene` by its path, in the order of the pytree's leaves."""
    leaves = jax.tree_util.tree_leaves_with_path(scene)
    return {".".join(_key_name(key) for key in keys): leaf for keys, leaf in leaves}


def lookup(scene: Scene, path: str) -> tuple[Any, Declaration]:
    """The value at `path` (None for one that is left out) and its declaration. Raises `InputError` for no such path."""
    part, rule = scene, None
    for depth, key in enumerate(path.split(".")):
        here = ".".join(path.split(".")[:depth])
        if isinstance(rule, Quantity) and rule.components > 1 and isinstance(part, tuple):
            part, rule = part[_index(part, key, path, here)], rule._replace(components=1)
        elif isinstance(part, tuple):
            part, rule = part[_index(part, key, path, here)], None
        elif dataclasses.is_dataclass(part):
            field = _field(part, key, path, here)
            part, rule = getattr(part, key), declaration(field)
        else:
            reason = "this scene has none" if part is None and rule is None else "it has no parts"
            raise InputError(f"{path}: no such parameter; {here}: {reason}")
    if rule is None and eqx.is_array_like(part):
        return part, Quantity("1", ANY)  # of a load or section law of the user's own, which declares no unit
    if rule is None:
        raise InputError(f"{path}: names a part, not a parameter")
    return part, rule


def unit_of(scene: Scene, path: str) -> str:
    """The SI unit of the parameter at `path`; "1" for one without a unit."""
    _, rule = lookup(scene, path)
    return rule.unit if isinstance(rule, Quantity | Series) else "1"


def replace(scene: Scene, values: Mapping[str, Any]) -> Scene:
    """`scene` with the parameters at these paths replaced; the scene itself is unchanged.

    A value is a number or array in SI, a string with a unit ("20 N"), or for a choice the choice ("rigid"). A muscle's
    `displacement` takes the place of its `tension`, and the other way round.
    Raises `InputError` for a path that does not exist and for a value that is not allowed there.
    """
    parsed = {}
    for path, value in values.items():
        _, rule = lookup(scene, path)
        parsed[path] = _parsed(value, rule, path) if isinstance(value, str) else value
    return _replaced(scene, {tuple(path.split(".")): value for path, value in parsed.items()})


def _parsed(text: str, rule: Declaration, path: str) -> Any:
    if isinstance(rule, Function):
        raise InputError(f"{path} must be a function, given in Python, but is {quoted(text)}")
    if isinstance(rule, Count):
        return int(text) if text.strip().isdecimal() and len(text) < 20 else text
    if isinstance(rule, Series):
        return series_to_si(text, rule.unit, path)
    if isinstance(rule, Choice):
        return next((value for value in rule.values if str(value).lower() == text.strip().lower()), text)
    if rule.components > 1:
        raise InputError(f"{path} must be set by its components, {path}.0 and so on, but is {quoted(text)}")
    return allowed_si(text, rule, path)


def _replaced(part: Any, values: dict[tuple[str, ...], Any]) -> Any:
    if () in values:
        return values[()]
    below: dict[str, dict[tuple[str, ...], Any]] = {}
    for (key, *rest), value in values.items():
        below.setdefault(key, {})[tuple(rest)] = value
    if isinstance(part, tuple):
        return tuple(_replaced(item, below[str(i)]) if str(i) in below else item for i, item in enumerate(part))
    new = {key: _replaced(getattr(part, key), sub) for key, sub in below.items()}
    if isinstance(part, Muscle):
        for one, other in (("tension", "displacement"), ("displacement", "tension")):
            if new.get(one) is not None:
                new.setdefault(other, None)
    return dataclasses.replace(part, **new)


def _field(part: Any, key: str, path: str, here: str) -> dataclasses.Field:
    fields = {field.name: field for field in dataclasses.fields(part)}
    if key not in fields:
        inside = f" in {here}" if here else ""
        raise InputError(f"{path}: no such parameter; no {key!r}{inside}; {nearest(key, list(fields))}")
    return fields[key]


def _index(items: tuple, key: str, path: str, here: str) -> int:
    if key not in map(str, range(len(items))):
        allowed = f"0 to {len(items) - 1}" if items else "none, the scene has no " + here
        raise InputError(f"{path}: no such parameter; {key!r} is not an index of {here}; allowed: {allowed}")
    return int(key)


def _key_name(key: Any) -> str:
    return str(getattr(key, "name", getattr(key, "idx", key)))
