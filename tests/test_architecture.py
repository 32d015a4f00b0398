"""Rules of the architecture: layers, access to the engine, public names, light imports."""

import ast
import functools
import importlib
import os
import re
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

import pytest

import stkzoo

ROOT = Path(stkzoo.__file__).resolve().parent

#: Layers from the bottom up. A module may import from its own layer and those below.
LAYERS = [
    (
        "base",
        [
            "stkzoo.errors",
            "stkzoo.names",
            "stkzoo.config",
            "stkzoo.tracks",
            "stkzoo.records",
            "stkzoo._arguments",
            "stkzoo._arrays",
            "stkzoo._checks",
            "stkzoo._imports",
            "stkzoo._installation",
            "stkzoo._left_out",
            "stkzoo._locks",
            "stkzoo._logs",
            "stkzoo._os",
            "stkzoo._reading",
            "stkzoo._schema",
            "stkzoo._temporary",
            "stkzoo.kernel",
            "stkzoo.agent_names",
        ],
    ),
    ("engine", ["stkzoo.engine"]),
    ("mdp", ["stkzoo.mdp"]),
    ("render", ["stkzoo.render"]),
    ("views", ["stkzoo.views", "stkzoo.wrappers"]),
    ("drivers", ["stkzoo.drivers"]),
    ("env", ["stkzoo.env", "stkzoo.race_v0"]),
    ("front", ["stkzoo", "stkzoo.compat", "stkzoo._pystk2_gymnasium"]),
    ("race", ["stkzoo.race", "stkzoo.sb3"]),
    ("evaluation", ["stkzoo.evaluation", "stkzoo.play", "stkzoo.suite"]),
    ("agents", ["stkzoo.agents"]),
    ("cli", ["stkzoo.cli", "stkzoo.__main__"]),
]

#: Modules with names that agents import although no package exports them, and the reason.
NOT_EXPORTED = {
    "stkzoo._arguments": "training declares its options in the same way as the commands",
    "stkzoo._arrays": "training stores its lessons as datasets are stored",
    "stkzoo._checks": "agents check their arguments as the package does",
    "stkzoo._imports": "training imports libraries of extras as the package does",
    "stkzoo._locks": "training locks the folders of its runs, as batches do",
    "stkzoo._os": "training writes its files whole, as the rest of the package does",
    "stkzoo._reading": "training reads its files in bounds, as the rest of the package does",
    "stkzoo._schema": "training declares the bounds of its files in the same way",
    "stkzoo._temporary": "training removes only folders that it made",
    "stkzoo.race.rescues": "the planner counts rescues in copies of a race, as races do",
}

#: Class names that are used twice, and the reason.
SHARED_CLASS_NAMES: dict[str, str] = {}


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


def sources():
    """Returns all modules, including linked folders (wrappers, agents), which ``rglob`` skips."""
    found = []
    for folder, _, files in os.walk(ROOT, followlinks=True):
        found += [Path(folder, file) for file in files if file.endswith(".py")]
    return sorted(found)


SOURCES = sources()
AGENT_SOURCES = [path for path in SOURCES if module_name(path).startswith("stkzoo.agents.")]
PACKAGES = [module_name(path) for path in SOURCES if path.name == "__init__.py"]


@functools.cache
def parsed(path):
    return ast.parse(path.read_text())


def imports_of(path):
    """Yields the module and the names of each import statement."""
    package = module_name(path).split(".")
    if path.name != "__init__.py":
        package.pop()
    for node in ast.walk(parsed(path)):
        if isinstance(node, ast.Import):
            yield from ((alias.name, []) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = package[: len(package) + 1 - node.level] if node.level else []
            module = ".".join([*above, *([node.module] if node.module else [])])
            yield module, [alias.name for alias in node.names]


def test_wrappers_and_agents_are_found():
    modules = {module_name(path) for path in SOURCES}
    assert {
        "stkzoo.wrappers.observations",
        "stkzoo.agents.heuristic",
        "stkzoo.env.parallel",
    } <= modules


def test_modules_import_only_from_their_layer_or_below():
    above = [
        (module_name(path), name)
        for path in SOURCES
        for name, _ in imports_of(path)
        if name.split(".")[0] == "stkzoo"
        and name != "stkzoo"
        and layer_of(name) > layer_of(module_name(path))
    ]
    assert above == []


def test_the_architecture_page_lists_the_layers():
    page = (ROOT.parent / "docs" / "architecture.md").read_text("utf-8")
    rows = re.findall(r"^\| (\w+) \|", page.split("## Layers")[1].split("## ")[0], re.MULTILINE)
    assert rows[1:] == [name for name, _ in reversed(LAYERS)]


def test_only_the_engine_package_imports_pystk2():
    users = {
        module_name(path)
        for path in SOURCES
        if "pystk2" in {name.split(".")[0] for name, _ in imports_of(path)}
    }
    assert [name for name in users if not name.startswith("stkzoo.engine.")] == []


def test_only_agents_import_agents_and_only_tests_import_tests():
    outside = {"tests", "benchmarks", "agents", "wrappers"}
    for path in SOURCES:
        imported = {".".join(name.split(".")[:2]) for name, _ in imports_of(path)}
        forbidden = outside if path in AGENT_SOURCES else {*outside, "stkzoo.agents"}
        assert not forbidden & imported, module_name(path)


# ---------------------------------------------------------------------- public names


def test_a_package_lists_what_it_exports():
    for package in PACKAGES:
        module = importlib.import_module(package)
        exported = getattr(module, "__all__", [])
        unfit = [
            name
            for name in exported
            if (name.startswith("_") and name != "__version__") or not hasattr(module, name)
        ]
        assert unfit == [], package
        assert len(exported) == len(set(exported)), package
        assert not exported or dir(module) == sorted(exported), package


#: A name in the documentation, except in an import, and those that are no attributes: programs,
#: files, and an example.
DOCUMENTED = re.compile(
    r"(?<!from )(?<!import )(?<![\w./@:-])stkzoo(?:\.[A-Za-z]\w*)+\b(?!\.?[\w-])"
)
NO_ATTRIBUTE = re.compile(r"stkzoo\.(agents\.(training|steady)|cli)\b|\.(md|py|toml|json)$")

RESOLVE = """
import sys, stkzoo
for name in sys.argv[1:]:
    found = stkzoo
    for part in name.split(".")[1:]:
        if part in getattr(found, "__annotations__", ()):
            break
        if not hasattr(found, part):
            print(name)
            break
        found = getattr(found, part)
"""


def documented_names():
    """Returns the names below ``stkzoo`` that pages and docstrings write."""
    project = ROOT.parent
    pages = [project / "README.md", project / "CONTRIBUTING.md", *project.glob("docs/**/*.md")]
    texts = [page.read_text("utf-8") for page in pages]
    for path in SOURCES:
        kinds = ast.Module, ast.ClassDef, ast.FunctionDef
        nodes = (node for node in ast.walk(parsed(path)) if isinstance(node, kinds))
        texts += [ast.get_docstring(node) or "" for node in nodes]
    names = {name for text in texts for name in DOCUMENTED.findall(text)}
    return sorted(name for name in names if not NO_ATTRIBUTE.search(name))


def test_names_in_the_documentation_resolve_after_import_stkzoo():
    names = documented_names()
    assert len(names) > 150
    command = [sys.executable, "-W", "ignore", "-c", RESOLVE, *names]
    done = subprocess.run(command, capture_output=True, text=True)
    assert (done.stdout, done.stderr, done.returncode) == ("", "", 0)


def test_names_that_a_package_reexports_are_in_its_list():
    for path in SOURCES:
        if path.stem == "__init__":
            assert unlisted_names(path) == set(), module_name(path)


def unlisted_names(path):
    """Returns the names that a package takes from its modules, but does not list."""
    taken, used, package = set(), set(), module_name(path)
    for node in ast.walk(parsed(path)):
        if isinstance(node, ast.ImportFrom) and (node.level or node.module.startswith("stkzoo")):
            taken |= {alias.asname or alias.name for alias in node.names}
        elif isinstance(node, ast.Name):
            used.add(node.id)
    listed = getattr(importlib.import_module(package), "__all__", [])
    others = {name for name in taken - used if not name.startswith("_")} - {*listed, "*"}
    return {name for name in others if f"{package}.{name}" not in sys.modules}


def is_public(module, name):
    """Returns whether a package or top-level module lists a name in ``__all__``."""
    if any(part.startswith("_") for part in module.split(".")):
        return False
    found = importlib.import_module(module)
    is_home = hasattr(found, "__path__") or module.count(".") == 1
    return is_home and name in [*getattr(found, "__all__", []), "race_v0"]


def private_imports_of(path):
    """Yields the names that an agent imports from other packages that do not export them."""
    for module, names in imports_of(path):
        if module.split(".")[0] == "stkzoo" and not module.startswith("stkzoo.agents"):
            yield from ((module, name) for name in names if not is_public(module, name))


def test_agents_use_public_names_only():
    private = [
        (module_name(path), home, name)
        for path in AGENT_SOURCES
        for home, name in private_imports_of(path)
        if home not in NOT_EXPORTED
    ]
    assert private == []


def test_exceptions_for_agents_are_up_to_date():
    used = {home for path in AGENT_SOURCES for home, _ in private_imports_of(path)}
    assert set(NOT_EXPORTED) - used == set()


def test_class_names_are_unique():
    homes = defaultdict(list)
    for path in SOURCES:
        for node in parsed(path).body:
            if isinstance(node, ast.ClassDef):
                homes[node.name].append(module_name(path))
    shared = {name: modules for name, modules in homes.items() if len(modules) > 1}
    assert {name: shared[name] for name in shared if name not in SHARED_CLASS_NAMES} == {}
    assert [name for name in SHARED_CLASS_NAMES if name not in shared] == []


def test_code_for_a_new_interpreter_never_searches_the_current_folder():
    direct = re.compile(r'sys\.executable,\s*"-[cm]"')
    found = [module_name(path) for path in SOURCES if direct.search(path.read_text())]
    assert found == [], "use stkzoo._imports.python_command"


# ---------------------------------------------------------------------- light imports


def modules_after(code):
    program = f"{code}\nimport sys; print(*sys.modules)"
    return set(
        subprocess.run(
            [sys.executable, "-c", program], capture_output=True, text=True, check=True
        ).stdout.split()
    )


def test_importing_stkzoo_is_light():
    heavy = {"pystk2", "torch", "numba", "pygame", "rich", "requests", "matplotlib", "PIL"}
    assert not heavy & modules_after("import stkzoo")


def test_importing_stkzoo_race_does_not_load_the_runner():
    assert not {"pystk2", "torch", "stkzoo.race.runner"} & modules_after("import stkzoo.race")


def test_all_public_names_are_listed_once():
    assert len(stkzoo.__all__) == len({*stkzoo.__all__})
    assert all(hasattr(stkzoo, name) for name in stkzoo.__all__)


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no_such_thing"):
        stkzoo.no_such_thing  # noqa: B018
