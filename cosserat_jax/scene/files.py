"""Scene files: TOML with units, read into a `Scene` and written from one; presets that ship with the package."""

import dataclasses
import json
import os
import tomllib
import typing
from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np

from ..errors import InputError, nearest, quoted
from .parts import Arm, Muscle, Notes, Scene
from .paths import lookup
from .quantity import Choice, Count, Function, Quantity, Series, declaration
from .units import allowed_si, range_to_si, series_to_si, to_si


class SceneFile(NamedTuple):
    """What a scene file says: the scene, a line that describes it, and the sweep to run when told nothing else."""

    name: str
    title: str
    scene: Scene
    sweep: dict[str, np.ndarray]


def load_scene(name: str | os.PathLike[str]) -> Scene:
    """The scene of a TOML file, or of a preset named by a bare word ("octopus").

    Raises `InputError` with one line that names file, path, the value given and what is allowed.
    """
    return read(name).scene


def read(name: str | os.PathLike[str]) -> SceneFile:
    """As `load`, with the title and the sweep that the file carries."""
    source = os.fspath(name)
    try:
        table = tomllib.loads(_text(source))
        title, sweep = _checked_title(table.pop("title", "")), _checked_sweep(table.pop("sweep", {}))
        _check_keys(Scene, table)
        scene = dataclasses.replace(_build(Scene, table, ""), notes=Notes(title, sweep))
        ranges = {path: given if isinstance(given, list) else str(given) for path, given in sweep.items()}
        return SceneFile(
            source, title, scene, {path: sweep_values(scene, path, given) for path, given in ranges.items()}
        )
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{source}: not a TOML file: {error}") from None
    except RecursionError:
        raise InputError(f"{source}: not a scene: tables nested too deep") from None
    except InputError as error:
        raise InputError(f"{source}: {error}") from None
    except ValueError as error:  # of a number that Python does not read
        raise InputError(f"{source}: not a TOML file: {error}") from None


def presets() -> tuple[str, ...]:
    """The names of the scenes that ship with the package."""
    folder = resources.files("cosserat_jax.scene") / "presets"
    return tuple(sorted(item.name.removesuffix(".toml") for item in folder.iterdir() if item.name.endswith(".toml")))


def dumps(scene: Scene) -> str:
    """`scene` as the text of a scene file, in SI, that `load` reads back to the same numbers, title and sweep.

    Raises `InputError` for a voltage or a law that is a Python function.
    """
    notes = scene.notes
    lines = [f"title = {_literal(notes.title)}"] if notes.title else []
    _write_table(scene, "", lines)
    if notes.sweep:
        lines += ["", "[sweep]", *(f"{_literal(path)} = {_literal(text)}" for path, text in notes.sweep.items())]
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
    except (OSError, ValueError) as error:  # ValueError: not UTF-8, or a name with a zero byte
        raise InputError(f"cannot be read: {getattr(error, 'strerror', None) or 'not a text file'}") from None


def _checked_title(title: Any) -> str:
    if not isinstance(title, str):
        raise InputError(f"title must be a string, but is {quoted(title)}")
    return title


def _checked_sweep(table: Any) -> dict[str, Any]:
    if not isinstance(table, dict):
        raise InputError(f"sweep must be a table [sweep], but is {quoted(table)}")
    return table


def _check_keys(kind: type[eqx.Module], table: Any, where: str = "") -> None:
    """Raises `InputError` for the first key that a table of `kind`, or one in it, has and must not, else for all keys
    that they must have and do not."""
    if missing := list(_missing(kind, table, f"{where}." if where else "")):
        raise InputError(f"{', '.join(missing)} must be given, but {'is' if len(missing) == 1 else 'are'} missing")


def _missing(kind: type[eqx.Module], table: Any, prefix: str) -> Iterator[str]:
    if not isinstance(table, dict):
        return  # which is refused where it is read
    hints, fields = typing.get_type_hints(kind), _fields(kind)
    known = [*fields, "title", "sweep"] if kind is Scene else list(fields)
    for key in table:
        if key not in fields:
            raise InputError(f"{prefix}{key[:80]}: unknown key; {nearest(key, known)}")
    for key, field in fields.items():
        if key not in table:
            if field.default is dataclasses.MISSING:
                yield f"{prefix}{key}"
        elif declaration(field) is None and "kinds" not in field.metadata:
            given = table[key]
            parts = {f"{key}.{i}": item for i, item in enumerate(given)} if isinstance(given, list) else {key: given}
            for name, part in parts.items():
                yield from _missing(_module_of(hints[key]), part, f"{prefix}{name}.")
    if kind is Arm and "stiffness" not in table:
        yield from (f"{prefix}{key}" for key in ("youngs_modulus", "poisson_ratio") if key not in table)
    if kind is Muscle and not table.keys() & {"tension", "displacement", "tcam"}:
        yield f"{prefix}tension"


def _fields(kind: type[eqx.Module]) -> dict[str, dataclasses.Field]:
    """The fields that a table has as keys."""
    return {field.name: field for field in dataclasses.fields(kind) if field.name != "notes"}


def _module_of(hint: Any) -> type[eqx.Module]:
    """The kind of part that a field holds, by its annotation."""
    return next(arg for arg in (hint, *typing.get_args(hint)) if isinstance(arg, type) and issubclass(arg, eqx.Module))


def _build(kind: type[eqx.Module], table: Any, prefix: str) -> Any:
    """A module of `kind` from a TOML table whose keys are its fields."""
    where = prefix.rstrip(".")
    if not isinstance(table, dict):
        raise InputError(f"{where} must be a table [{where}], but is {quoted(table)}")
    hints = typing.get_type_hints(kind)
    values = {}
    for key, field in _fields(kind).items():
        if key in table:
            values[key] = _value(field, hints[key], table[key], f"{prefix}{key}")
    if values.get("velocity_gradient") == 0:
        del values["velocity_gradient"]  # a current that does not change with height is the uniform one
    return kind(**values)


def _value(field: dataclasses.Field, hint: Any, given: Any, path: str) -> Any:
    rule, kinds = declaration(field), field.metadata.get("kinds")
    if isinstance(rule, Function):
        raise InputError(f"{path} must be a function, but a file has none; give it in Python")
    if isinstance(rule, Count):
        return given
    if isinstance(rule, Choice):
        if given not in rule.values or isinstance(given, bool) != isinstance(rule.values[0], bool):
            raise rule.refused(path, given)
        return rule.values[rule.values.index(given)]
    if isinstance(rule, Quantity) and rule.components > 1:
        if not isinstance(given, list) or len(given) != rule.components:
            raise InputError(
                f"{path} must be a list of {rule.components} quantities in {rule.unit}, but is {quoted(given)}"
            )
        return tuple(allowed_si(item, rule, f"{path}.{i}") for i, item in enumerate(given))
    if isinstance(rule, Quantity):
        return allowed_si(given, rule, path)
    if isinstance(rule, Series):
        return series_to_si(given, rule.unit, path)
    if kinds is not None:
        return _build_kind(kinds, given, path)
    kind = _module_of(hint)
    if typing.get_origin(hint) is not tuple:
        return _build(kind, given, f"{path}.")
    if not isinstance(given, list):
        raise InputError(f"{path} must be tables [[{path}]], but is {quoted(given)}")
    return tuple(_build(kind, item, f"{path}.{i}.") for i, item in enumerate(given))


def _build_kind(kinds: dict[str, type], given: Any, path: str) -> Any:
    if not isinstance(given, dict):
        raise InputError(f"{path} must be a table [{path}], but is {quoted(given)}")
    name = given.get("kind", next(iter(kinds)))
    if not isinstance(name, str) or name not in kinds:
        raise InputError(f"{path}.kind must be {' or '.join(map(repr, kinds))}, but is {quoted(name)}")
    given = {key: value for key, value in given.items() if key != "kind"}
    _check_keys(kinds[name], given, path)
    return _build(kinds[name], given, f"{path}.")


def sweep_values(scene: Scene, path: str, values: Any) -> np.ndarray:
    """The SI values for the parameter at `path` of `scene`: "START:STOP:STEP UNIT" or "V1, V2 UNIT", a quantity with a
    unit, or a sequence of such quantities and of numbers in SI."""
    _, rule = lookup(scene, path)
    if not isinstance(rule, Quantity) or rule.components > 1:
        raise InputError(f"{path} must be a parameter that is one number, but is none; it cannot be swept")
    if isinstance(values, str):
        return range_to_si(values, rule.unit, path)
    try:
        array = np.array(
            [to_si(value, rule.unit, path) if isinstance(value, str) else value for value in values], float
        )
    except InputError:
        raise
    except (TypeError, ValueError, OverflowError):
        array = np.zeros(0)
    if array.ndim != 1 or array.size == 0:
        raise InputError(f"{path} must be swept over one axis of values, not empty, but is {quoted(values)}")
    return array


def _write_table(part: Any, prefix: str, lines: list[str]) -> None:
    nested = []
    for field in dataclasses.fields(part):
        value, rule = getattr(part, field.name), declaration(field)
        if value is None or isinstance(value, Notes) or (isinstance(value, tuple) and not value):
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
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")  # the escapes are those of TOML
    if isinstance(value, list):
        return f"[{', '.join(map(_literal, value))}]"
    return repr(value if isinstance(value, int) else float(value))
