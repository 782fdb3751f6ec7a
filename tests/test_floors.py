"""The package is built in floors: a module imports modules of its own floor and of those below, never from above."""

import ast
from pathlib import Path

import pytest

import cosserat_jax

ROOT = Path(cosserat_jax.__file__).parent
FLOORS = ("errors", "numerics", "scene", "physics", "solver", "study", "report", "cli")  # from the ground up
MODULES = {".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
           for path in ROOT.rglob("*.py") if path != ROOT / "__init__.py"}  # fmt: skip


def imports(module: str) -> set[str]:
    """The modules of the package that a module imports: at the top, inside functions and for type checkers alike."""
    path, found = MODULES[module], set()
    package = module.split(".") if path.name == "__init__.py" else module.split(".")[:-1]
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names if alias.name.partition(".")[0] == "cosserat_jax"]
            assert not names, f"{module} imports {names}: imports within the package are relative"
        elif isinstance(node, ast.ImportFrom) and node.level:
            base = package[: len(package) - node.level + 1] + (node.module.split(".") if node.module else [])
            for alias in node.names:
                whole = ".".join([*base, alias.name])
                found.add(whole if whole in MODULES else ".".join(base))
    return found


def test_every_module_stands_on_a_floor() -> None:
    assert {module.partition(".")[0] for module in MODULES} == set(FLOORS)


@pytest.mark.parametrize("module", MODULES)
def test_a_module_imports_only_from_its_own_floor_and_those_below(module: str) -> None:
    own = FLOORS.index(module.partition(".")[0])
    above = {name for name in imports(module) if name not in MODULES or FLOORS.index(name.partition(".")[0]) > own}
    assert not above, f"{module} imports {sorted(above)}"


def test_no_circle_of_imports() -> None:
    waiting = {module: imports(module) - {module} for module in MODULES}
    while free := [module for module, needed in waiting.items() if not needed & waiting.keys()]:
        for module in free:
            del waiting[module]
    assert not waiting, f"these import each other: {sorted(waiting)}"


@pytest.mark.parametrize("wing", ["study.calibration", "study.inverse"])
def test_the_wings_of_the_study_floor_do_not_know_each_other(wing: str) -> None:
    other = {"study.calibration": "study.inverse", "study.inverse": "study.calibration"}[wing]
    for module in MODULES:
        if module.startswith(wing + "."):
            assert not {name for name in imports(module) if name.startswith(other)}, module
