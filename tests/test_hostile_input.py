"""Whatever a file or a table holds, reading it ends in a scene or in an `InputError` of one line, at once."""

import random
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cosserat_jax import InputError, Measurements, Scene, dumps, load_scene, presets, read_measurements, replace
from cosserat_jax.scene import parameters

SCENES = [dumps(load_scene(name)) for name in presets()]
TABLE = (
    "muscles.0.tension [N], water.velocity [m/s], tip.y [cm], sigma(tip.y) [mm]\n5, 0.2, 1.4, 0.1\n12, 0.4, 6, 0.1\n"
)
WORDS = [
    "", "0", "-1", "1e999", "nan", "inf", "true", "9" * 400, "9" * 5000, "1" + "0" * 310, "0x", '"', "'", '"""',
    "[", "]", "[[", "[]", "{}", "{ a = 1 }", "[arm]", "[[muscles]]", "[water.water]", "=", ";", "\t", "\n", "\r", "#",
    "\x00", "\x7f", "\ufeff", "\ud7ff", "µ", "1979-05-27", '"1 m**9**9**9"', '"10**(10**9)*m"', '"1 m!"', '"0-20 N"',
    '"0:1e300:1e-300"', '"5 furlongs/fortnight"', '"' + "m" * 130_000 + '"', "a." * 500 + "a = 1", "[" * 1500, '"none"',
    "sigma(", "y@", "y@1e9 [m]", "time [s]", "muscles.9999999999.tcam.voltage [V]", "tip.y [", "] [", "arm.length [m]",
]  # fmt: skip


def mutated(text: str, rng: random.Random) -> str:
    """The text with a piece or two of it cut, doubled or replaced, or a value replaced by a hostile word."""
    for _ in range(rng.randint(1, 2)):
        i = rng.randrange(len(text) + 1)
        j = min(len(text), i + rng.choice([0, 1, 3, 10]))
        if rng.random() < 0.6:  # the next value or cell
            i = next((i + k + 1 for k, mark in enumerate(text[i:]) if mark in "=,\n["), i)
            j = next((i + k for k, mark in enumerate(text[i:]) if mark in "#,\n]"), len(text))
        elsewhere = rng.randrange(len(text) + 1)
        text = (
            text[:i] + rng.choice(["", text[i:j] * 2, text[elsewhere:][:8], "5", " 1 ", rng.choice(WORDS)]) + text[j:]
        )
    return text


def came_of(read: Callable[[], Any]) -> Any:
    """What `read` gives, or the `InputError` that it raises, within two seconds."""
    begin = time.perf_counter()
    try:
        result = read()
    except InputError as error:
        result = error
    assert time.perf_counter() - begin < 2
    return result


def is_one_line(error: Any) -> bool:
    return isinstance(error, InputError) and "\n" not in str(error) and len(str(error)) < 800


@pytest.mark.parametrize("part", range(4))
def test_a_mutated_scene_is_a_scene_or_one_line(part: int, tmp_path: Path) -> None:
    rng, path, scenes = random.Random(part), tmp_path / "scene.toml", 0
    for number in range(250):
        text = mutated(rng.choice(SCENES), rng)
        path.write_bytes(text.encode("utf-8", "surrogatepass"))
        read = came_of(lambda: load_scene(path))
        assert isinstance(read, Scene) or is_one_line(read), (number, text[:2000])
        if isinstance(read, Scene):
            path.write_text(dumps(read), encoding="utf-8")
            assert load_scene(path) == read, (number, text[:2000])
            scenes += 1
    assert 20 < scenes < 200  # the mutations are neither harmless nor all fatal


@pytest.mark.parametrize("part", range(2))
def test_a_mutated_table_is_measurements_or_one_line(part: int, tmp_path: Path) -> None:
    rng, path, scene, tables = random.Random(part), tmp_path / "tips.csv", load_scene("octopus"), 0
    for number in range(250):
        text = mutated(TABLE, rng)
        path.write_bytes(text.encode("utf-8", "surrogatepass"))
        read = came_of(lambda: read_measurements(scene, path))
        assert isinstance(read, Measurements) or is_one_line(read), (number, text[:2000])
        tables += isinstance(read, Measurements)
    assert 15 < tables < 200


PATHS = [
    *parameters(load_scene("octopus")),
    "arm.cross_section",
    "muscles.0.tangent",
    "",
    "arm",
    "muscles.1.end",
    "no.such",
]
VALUES = st.one_of(
    st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=20), st.sampled_from(WORDS),
    st.sampled_from([10**400, 10**5000, [], [1.0], {}, "1 m", object()]),
)  # fmt: skip


@settings(max_examples=200, derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.sampled_from(PATHS), VALUES)
def test_any_value_at_any_path_makes_a_scene_or_one_line(path: str, value: object) -> None:
    made = came_of(lambda: replace(load_scene("octopus"), {path: value}))
    assert isinstance(made, Scene) or is_one_line(made)


@pytest.mark.parametrize("name", ["a\x00b.toml", "", ".", "x" * 5000])
def test_names_that_are_no_files_are_one_line(name: str) -> None:
    assert is_one_line(came_of(lambda: load_scene(name)))
    assert is_one_line(came_of(lambda: read_measurements(load_scene("octopus"), name)))
