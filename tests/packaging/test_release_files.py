"""Files for the forge and the package index agree with the project."""

import re
import sys

import pytest
import yaml

import stkzoo
from tests.support.paths import ROOT

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib  # a dependency of pytest

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
FORGE = sorted((ROOT / ".github").rglob("*.yml"))
VERSIONS = [
    line.rpartition(":: ")[2]
    for line in PROJECT["project"]["classifiers"]
    if re.search(r":: 3\.\d+$", line)
]


@pytest.mark.parametrize("path", FORGE, ids=lambda path: path.name)
def test_files_for_the_forge_are_yaml(path):
    assert isinstance(yaml.safe_load(path.read_text("utf-8")), dict)


def test_workflows_and_pages_name_existing_targets():
    makefile = (ROOT / "Makefile").read_text("utf-8")
    called = set()
    for path in [*FORGE, *ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")]:
        called |= set(re.findall(r"(?:run: |`)make ([\w-]+)", path.read_text("utf-8")))
    assert {"check", "test", "test-lowest", "docs"} <= called
    for target in called:
        assert re.search(rf"^{target}:", makefile, re.M), target


def test_every_supported_python_is_tested_and_has_wheels():
    tests = yaml.safe_load((ROOT / ".github" / "workflows" / "tests.yml").read_text("utf-8"))
    assert tests["jobs"]["test"]["strategy"]["matrix"]["python"] == VERSIONS
    built = PROJECT["tool"]["cibuildwheel"]["build"].split()
    assert built == [f"cp{version.replace('.', '')}-*" for version in VERSIONS]


def test_versions_agree():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))
    assert citation["version"] == PROJECT["project"]["version"] == stkzoo.__version__
    assert citation["license"] == PROJECT["project"]["license"]
    changes = (ROOT / "CHANGELOG.md").read_text("utf-8")
    assert f"\n## {citation['version']} - {citation['date-released']}\n" in changes


def test_all_includes_every_extra_for_users():
    extras = PROJECT["project"]["optional-dependencies"]
    (everything,) = extras["all"]
    named = set(re.search(r"\[(.*)\]", everything)[1].split(","))
    assert set(extras) - named == {"all", "rllib"}  # RLlib needs an older Gymnasium
