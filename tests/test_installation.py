"""Messages have the command that installs what is missing."""

import sys
from importlib import metadata
from pathlib import Path

import pytest

from stkzoo import ConfigError, _installation
from stkzoo._imports import import_extra
from stkzoo._installation import install_command, library_remedy, project_url, requirements


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Installs a fake distribution; returns the folder that has it."""
    info = tmp_path / "stkzoo-9.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: stkzoo\nVersion: 9\n"
        "Project-URL: Repository, https://example.org/stkzoo\n"
        'Requires-Dist: numpy\nRequires-Dist: aiohttp>=3; extra == "races"\n'
    )
    (info / "INSTALLER").write_text("pip\n")
    monkeypatch.syspath_prepend(tmp_path)
    pip = str(Path(sys.executable).parent / "pip")
    monkeypatch.setattr(_installation, "which", {"pip": pip}.get)
    return tmp_path


@pytest.mark.usefixtures("install")
def test_without_its_own_pip_on_the_path_the_command_runs_this_python(monkeypatch):
    monkeypatch.setattr(_installation, "which", {"pip": "/elsewhere/pip"}.get)
    assert install_command("races") == f'"{sys.executable}" -m pip install "stkzoo[races]"'
    assert install_command("").endswith("pip install stkzoo")


@pytest.mark.usefixtures("install")
def test_stale_metadata_in_a_checkout_does_not_hide_the_install(monkeypatch, tmp_path):
    stale = tmp_path / "checkout" / "stkzoo.egg-info"
    stale.mkdir(parents=True)
    (stale / "PKG-INFO").write_text("Metadata-Version: 2.1\nName: stkzoo\nVersion: 8\n")
    monkeypatch.syspath_prepend(stale.parent)
    assert metadata.version("stkzoo") == "8"
    assert project_url("Repository") == "https://example.org/stkzoo"
    assert requirements()["races"] == ["aiohttp>=3"]


@pytest.mark.usefixtures("install")
def test_a_missing_library_is_reported_with_its_install_command():
    with pytest.raises(ConfigError) as caught:
        import_extra("no_such_library.part", "the plot needs", "races", "or pass --no-plot")
    assert str(caught.value) == (
        "the plot needs no_such_library (extra races), which is not installed: "
        'pip install "stkzoo[races]" or pass --no-plot'
    )


def test_a_library_that_does_not_load_is_reported_with_the_cause(install):
    (install / "broken_library.py").write_text("raise ImportError('libGL.so.1 is missing')")
    with pytest.raises(ConfigError, match=r"does not load \(libGL.so.1 is missing\): pip install"):
        import_extra("broken_library", "the window needs", "races")


def test_the_remedy_for_glib_is_a_command():
    problem = "libglib-2.0.so.0: cannot open shared object file: No such file or directory"
    remedy = library_remedy(f"Traceback (most recent call last):\nImportError: {problem}\n")
    assert "sudo apt install libglib2.0-0" in remedy
    assert library_remedy("ImportError: No module named pystk2") == ""
