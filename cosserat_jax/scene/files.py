"""Scene files: TOML with units, read into a `Scene` and written from one; presets that ship with the package."""

import dataclasses
import os
import tomllib
import typing
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np

from ..errors import InputError, nearest
from .parts import Scene
from .paths import lookup
from .quantity import Choice, Count, Function, Quantity, Series, declaration
from .units import range_to_si, series_to_si, to_si


class SceneFile(NamedTuple):
    """What a scene file says: the scene, a line that describes it, and the sweep to run when told nothing else."""

    name: str
    title: str
    scene: Scene
    sweep: dict[str, np.ndarray]


def load(name: str | os.PathLike[str]) -> Scene:
    """The scene of a TOML file, or of a preset named by a bare word ("octopus").

    Raises `InputError` with one line that names file, path, the value given and what is allowed.
    """
    return read(name).scene


def read(name: str | os.PathLike[str]) -> SceneFile:
    """As `load`, with the title and the sweep that the file carries."""
    source = os.fspath(name)
    try:
        table = tomllib.loads(_text(source))
        title, sweep = table.pop("title", ""), table.pop("sweep", {})
        scene = _build(Scene, table, "")
        return SceneFile(source, _checked_title(title), scene, _build_sweep(scene, sweep))
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{source}: not a TOML file: {error}") from None
    except InputError as error:
        raise InputError(f"{source}: {error}") from None


def presets() -> tuple[str, ...]:
    """The names of the scenes that ship with the package."""
    folder = resources.files("cosserat_jax.scene") / "presets"
    return tuple(sorted(item.name.removesuffix(".toml") for item in folder.iterdir() if item.name.endswith(".toml")))


def dumps(scene: Scene) -> str:
    """`scene` as the text of a scene file, in SI, that `load` reads back to the same numbers.

    Raises `InputError` for a voltage or a law that is a Python function.
    """
    lines: list[str] = []
    _write_table(scene, "", lines)
    return "\n".join(lines).strip() + "\n"


def _text(source: str) -> str:
    if source in presets():
        return (resources.files("cosserat_jax.scene") / "presets" / f"{source}.toml").read_text(encoding="utf-8")
    path = Path(source)
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError:
        hint = "" if path.suffix else f" or preset; {nearest(source, list(presets()))}"
        raise InputError(f"no such file{hint}") from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be read: {getattr(error, 'strerror', None) or 'not a text file'}") from None


def _checked_title(title: Any) -> str:
    if not isinstance(title, str):
        raise InputError(f"title: {title!r} is not allowed; allowed: a string")
    return title


def _build(kind: type[eqx.Module], table: Any, prefix: str) -> Any:
    """A module of `kind` from a TOML table whose keys are its fields."""
    where = prefix.rstrip(".")
    if not isinstance(table, dict):
        raise InputError(f"{where}: {table!r} is not allowed; allowed: a table [{where}]")
    fields = {field.name: field for field in dataclasses.fields(kind)}
    known = [*fields, "title", "sweep"] if kind is Scene else list(fields)
    for key in table:
        if key not in fields:
            raise InputError(f"{prefix}{key}: unknown key; {nearest(key, known)}")
    hints = typing.get_type_hints(kind)
    values = {}
    for key, field in fields.items():
        if key in table:
            values[key] = _value(field, hints[key], table[key], f"{prefix}{key}")
        elif field.default is dataclasses.MISSING:
            raise InputError(f"{prefix}{key}: missing; it has no default")
    if values.get("velocity_gradient") == 0:
        del values["velocity_gradient"]  # a current that does not change with height is the uniform one
    return kind(**values)


def _value(field: dataclasses.Field, hint: Any, given: Any, path: str) -> Any:
    rule, kinds = declaration(field), field.metadata.get("kinds")
    if isinstance(rule, Function):
        raise InputError(f"{path}: a function cannot be given in a file; allowed: give it in Python")
    if isinstance(rule, Count):
        return given
    if isinstance(rule, Choice):
        if given not in rule.values or isinstance(given, bool) != isinstance(rule.values[0], bool):
            raise InputError(f"{path}: {given!r} is not allowed; allowed: {rule}")
        return rule.values[rule.values.index(given)]
    if isinstance(rule, Quantity) and rule.components > 1:
        if not isinstance(given, list) or len(given) != rule.components:
            raise InputError(
                f"{path}: {given!r} is not allowed; allowed: a list of {rule.components} quantities in {rule.unit}"
            )
        return tuple(to_si(item, rule.unit, f"{path}.{i}") for i, item in enumerate(given))
    if isinstance(rule, Quantity):
        return to_si(given, rule.unit, path)
    if isinstance(rule, Series):
        return series_to_si(given, rule.unit, path)
    if kinds is not None:
        return _build_kind(kinds, given, path)
    kind = next(arg for arg in (hint, *typing.get_args(hint)) if isinstance(arg, type) and issubclass(arg, eqx.Module))
    if typing.get_origin(hint) is not tuple:
        return _build(kind, given, f"{path}.")
    if not isinstance(given, list):
        raise InputError(f"{path}: {given!r} is not allowed; allowed: tables [[{path}]]")
    return tuple(_build(kind, item, f"{path}.{i}.") for i, item in enumerate(given))


def _build_kind(kinds: dict[str, type], given: Any, path: str) -> Any:
    if not isinstance(given, dict):
        raise InputError(f"{path}: {given!r} is not allowed; allowed: a table [{path}]")
    name = given.get("kind", next(iter(kinds)))
    if not isinstance(name, str) or name not in kinds:
        raise InputError(f"{path}.kind: {name!r} is not allowed; allowed: {' or '.join(map(repr, kinds))}")
    return _build(kinds[name], {key: value for key, value in given.items() if key != "kind"}, f"{path}.")


def _build_sweep(scene: Scene, table: Any) -> dict[str, np.ndarray]:
    if not isinstance(table, dict):
        raise InputError(f"sweep: {table!r} is not allowed; allowed: a table [sweep]")
    return {path: sweep_values(scene, path, text) for path, text in table.items()}


def sweep_values(scene: Scene, path: str, text: Any) -> np.ndarray:
    """The SI values of "START:STOP:STEP UNIT" or "V1, V2 UNIT" for the parameter at `path` of `scene`."""
    _, rule = lookup(scene, path)
    if not isinstance(rule, Quantity) or rule.components > 1:
        raise InputError(f"{path}: cannot be swept; allowed: a parameter that is one number")
    return range_to_si(str(text), rule.unit, path)


def _write_table(part: Any, prefix: str, lines: list[str]) -> None:
    nested = []
    for field in dataclasses.fields(part):
        value, rule = getattr(part, field.name), declaration(field)
        if value is None or (isinstance(value, tuple) and not value):
            continue
        if rule is None:
            nested.append((field, value))
        elif isinstance(rule, Function):
            raise InputError(f"{prefix}{field.name}: an object of Python has no text; leave it out of the scene")
        elif isinstance(rule, Series):
            lines.append(f"{field.name} = [{', '.join(_literal(item) for item in value)}]  # {rule.unit}")
        elif isinstance(rule, Choice | Count):
            lines.append(f"{field.name} = {_literal(value)}")
        elif rule.components > 1:
            lines.append(f"{field.name} = [{', '.join(_literal(item) for item in value)}]  # {rule.unit}")
        else:
            lines.append(f"{field.name} = {_literal(value)}  # {rule.unit}")
    for field, value in nested:
        name, kinds = f"{prefix}{field.name}", field.metadata.get("kinds")
        for item in value if isinstance(value, tuple) else (value,):
            lines += ["", f"[[{name}]]" if isinstance(value, tuple) else f"[{name}]"]
            if kinds is not None:
                lines += [f'kind = "{kind}"' for kind in _kinds_of(item, kinds, name)]
            _write_table(item, f"{name}.", lines)


def _kinds_of(item: Any, kinds: dict[str, type], path: str) -> list[str]:
    found = [name for name, kind in kinds.items() if type(item) is kind]
    if not found:
        raise InputError(f"{path}: a Python function has no text")
    return found


def _literal(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f'"{value}"' if isinstance(value, str) else repr(value if isinstance(value, int) else float(value))
