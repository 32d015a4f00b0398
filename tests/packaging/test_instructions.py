"""Every install instruction works from a checkout or a wheel, in an empty environment.

pip resolves the requirements without installing them, because the libraries take gigabytes.
"""

import ast
import os
import re
import shutil
import subprocess
import venv

import pytest

from tests.packaging.test_release_files import PROJECT
from tests.support.paths import ROOT, copy_checkout

EXTRAS = PROJECT["project"]["optional-dependencies"]
URL = PROJECT["project"]["urls"]["Repository"]
TEXTS = [
    path
    for pattern in ("README.md", "docs/**/*.md", "docs/**/*.ipynb", "examples/**/*.py")
    for path in ROOT.glob(pattern)
]
CODE = [p for folder in ("stkzoo", "agents", "wrappers") for p in ROOT.glob(f"{folder}/**/*.py")]
COMMAND = re.compile(r"^[^#\n]*?(pip install [^\n`{]+)|`(pip install [^`{]+)`", re.M)
BRACKETS = re.compile(r"\[([\w,-]+)\]")


def instructions():
    """Returns the install commands in the documentation and in docstrings, with their files."""
    found = {}
    for path in [*TEXTS, *CODE]:
        text = path.read_text("utf-8").replace('\\"', '"')
        for command in COMMAND.findall(text):
            words = re.split(r"\s+#|&&|``| && ", "".join(command))[0].strip()
            if "..." not in words:
                found.setdefault(words, path.relative_to(ROOT).as_posix())
    return found


def run(command, folder, python, **variables):
    """Runs a bash command line with an environment's programs and an empty home folder."""
    settings = {k: v for k, v in os.environ.items() if k.startswith(("PIP_", "SSL_", "REQUESTS_"))}
    programs = os.pathsep.join([str(python.parent), "/usr/bin", "/bin"])
    home = str(folder.parent / "home")
    quick = {"PIP_NO_BUILD_ISOLATION": "0", "PIP_DISABLE_PIP_VERSION_CHECK": "1", "CFLAGS": "-O0"}
    done = subprocess.run(
        ["bash", "-c", command],
        cwd=folder,
        env={**settings, "PATH": programs, "HOME": home, **quick, **variables},
        capture_output=True,
        text=True,
        timeout=300,
    )
    return done.returncode, done.stdout + done.stderr


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """Builds a wheel in a copy of the checkout; returns the copy and an environment's Python."""
    checkout = copy_checkout(tmp_path_factory.mktemp("instructions") / "stkzoo")
    (checkout.parent / "home").mkdir()
    venv.create(checkout.parent / "env", with_pip=True, symlinks=True)
    python = checkout.parent / "env" / "bin" / "python"
    code, said = run("pip install --quiet --upgrade pip setuptools numpy", checkout, python)
    if code and re.search("connection|resolve|No matching", said):
        pytest.skip(f"pip reaches no index: {said[-300:]}")
    assert code == 0, said
    code, said = run("pip wheel --quiet --no-deps --wheel-dir dist .", checkout, python)
    assert code == 0, said
    (wheel,) = checkout.glob("dist/*.whl")
    shutil.copy(wheel, checkout)
    return checkout, python


def test_only_the_first_page_installs_stkzoo_by_name():
    found = instructions()
    assert {"pip install .", 'pip install "stkzoo[sb3]"'} <= set(found)
    by_name = {c: p for c, p in found.items() if re.search(r"install stkzoo(?!-)(?!.*@)", c)}
    assert set(by_name.values()) == {"README.md"}


def test_instructions_name_extras_that_exist():
    found = [names for command in instructions() for names in BRACKETS.findall(command)]
    assert set(",".join(found).split(",")) == set(EXTRAS)


@pytest.mark.slow
def test_messages_name_extras_that_exist():
    named = set()
    for path in CODE:
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            name = getattr(getattr(node, "func", None), "id", "")
            place = {"import_extra": 2, "install_command": 0}.get(name)
            if place is not None and isinstance(node.args[place], ast.Constant):
                named.add(node.args[place].value)
    assert named == {"", *EXTRAS} - {"all"}


def test_the_repository_url_is_the_same_everywhere():
    address_of_any = re.compile(r"https?://git(?:hub|lab)\.com/[\w.-]+/stkzoo\b")
    for path in [*TEXTS, ROOT / "CITATION.cff", ROOT / "docs" / "conf.py"]:
        for address in address_of_any.findall(path.read_text("utf-8")):
            assert address == URL, path
    for page in ("README.md", "docs/how-to/install.md"):
        assert f"git clone {URL} && cd stkzoo" in (ROOT / page).read_text("utf-8")
    assert f"repository-code: {URL}\n" in (ROOT / "CITATION.cff").read_text("utf-8")


@pytest.mark.matrix
def test_every_instruction_works(place):
    checkout, python = place
    # Without dependencies, pip does the same for all extras, so one of each form is enough.
    forms = {BRACKETS.sub("[]", command): command for command in instructions()}
    for command in forms.values():
        once = {"PIP_DRY_RUN": "1", "PIP_NO_DEPS": "1", "PIP_FIND_LINKS": "dist"}
        code, said = run(command, checkout, python, **once)
        assert code == 0, (command, said)
        assert "Would install" in said, (command, said)


@pytest.mark.matrix
@pytest.mark.parametrize("extra", ["all", "rllib"])
def test_the_libraries_of_extras_can_be_installed_together(place, extra):
    checkout, python = place
    # Pretend that torch is installed, as after the first step of the install guide.
    (site,) = python.parent.parent.glob("lib/python*/site-packages")
    info = site / "torch-2.13.0.dist-info"
    info.mkdir(exist_ok=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: torch\nVersion: 2.13.0\n")
    code, said = run(f'pip install ".[{extra}]"', checkout, python, PIP_DRY_RUN="1")
    shutil.rmtree(info)
    assert code == 0, said[-2000:]
    assert "PySuperTuxKart2" in said
    assert "nvidia" not in said


@pytest.mark.matrix
def test_an_installation_without_a_compiler_ends_with_one_sentence(place):
    checkout, python = place
    code, said = run("pip install --no-deps .", checkout, python, CC="no-compiler")
    assert code != 0
    assert "[1 lines of output]" in said
    assert "needs a C compiler and Python's headers: sudo apt install gcc libc6-dev" in said
    # Only metadata is needed to resolve the requirements.
    code, said = run("pip install --no-deps --dry-run .", checkout, python, CC="no-compiler")
    assert code == 0, said
