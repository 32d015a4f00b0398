"""The house rules that a reader may rely on: layers, the engine's one door, light imports."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import stkzoo

ROOT = Path(stkzoo.__file__).resolve().parent

#: Bottom first. A layer may import those before it and itself.
LAYERS = [
    (
        "base",
        [
            "stkzoo.errors",
            "stkzoo.names",
            "stkzoo.config",
            "stkzoo.tracks",
            "stkzoo._os",
            "stkzoo.kernel",
            "stkzoo.agent_names",
        ],
    ),
    (
        "engine",
        [
            "stkzoo.engine",
            "stkzoo.kernel.reference.car_controller",
            "stkzoo.kernel.reference.game_stepper",
        ],
    ),
    (
        "mdp",
        [
            "stkzoo.mdp",
            "stkzoo.kernel.reference.kart_observer",
            "stkzoo.kernel.reference.step_scorer",
        ],
    ),
    ("render", ["stkzoo.render"]),
    ("views", ["stkzoo.views", "stkzoo.wrappers", "stkzoo.kernel.reference.racing_observer"]),
    ("env", ["stkzoo.env", "stkzoo.race_v0"]),
    ("front", ["stkzoo", "stkzoo.compat", "stkzoo.checks"]),
    ("race", ["stkzoo.race", "stkzoo.play"]),
    ("evaluation", ["stkzoo.evaluation"]),
    ("cli", ["stkzoo.cli", "stkzoo.__main__"]),
]


def layer_of(module):
    matches = [
        (len(prefix), level)
        for level, (_, prefixes) in enumerate(LAYERS)
        for prefix in prefixes
        if module == prefix or module.startswith(prefix + ".")
    ]
    return max(matches)[1]


def module_name(path):
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(["stkzoo", *(part for part in parts if part != "__init__")])


def imports_of(path):
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module


SOURCES = [p for p in sorted(ROOT.rglob("*.py")) if "agents" not in p.relative_to(ROOT).parts]


@pytest.mark.parametrize("path", SOURCES, ids=module_name)
def test_imports_point_down(path):
    module = module_name(path)
    above = [
        name
        for name in imports_of(path)
        if name.split(".")[0] == "stkzoo" and name != "stkzoo" and layer_of(name) > layer_of(module)
    ]
    assert above == []


@pytest.mark.parametrize("path", SOURCES, ids=module_name)
def test_the_engine_has_one_door(path):
    if "pystk2" in imports_of(path):
        assert module_name(path).startswith("stkzoo.engine.")


@pytest.mark.parametrize("path", SOURCES, ids=module_name)
def test_nobody_imports_the_agents_or_the_tests(path):
    outside = {"stkzoo.agents", "tests", "benchmarks", "agents"}
    assert not outside & {".".join(name.split(".")[:2]) for name in imports_of(path)}


def test_importing_stkzoo_is_light():
    code = "import stkzoo, sys; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout
    assert not {"pystk2", "torch", "numba", "pygame", "rich", "requests"} & set(loaded.split())


def test_all_public_names_are_listed_and_sorted():
    assert stkzoo.__all__ == sorted(stkzoo.__all__)
    assert all(hasattr(stkzoo, name) for name in stkzoo.__all__)


def test_the_version_is_that_of_the_package():
    from importlib.metadata import version

    assert stkzoo.__version__ == version("stkzoo")


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no_such_thing"):
        stkzoo.no_such_thing  # noqa: B018
