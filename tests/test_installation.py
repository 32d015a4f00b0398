"""The install command for an extra is correct for every origin of stkzoo."""

import json
import sys
from importlib import metadata
from pathlib import Path

import pytest

from stkzoo import ConfigError, _installation
from stkzoo._installation import (
    extra_requirements,
    install_command,
    library_remedy,
    repository_url,
)
from stkzoo.errors import import_extra


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Returns a function that installs a fake distribution with the origin that pip records."""

    def make(origin):
        info = tmp_path / "stkzoo-9.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(
            "Metadata-Version: 2.1\nName: stkzoo\nVersion: 9\n"
            "Project-URL: Repository, https://example.org/stkzoo\n"
            'Requires-Dist: numpy\nRequires-Dist: aiohttp>=3; extra == "web"\n'
            'Requires-Dist: stkzoo[web]; extra == "all"\n'
        )
        (info / "INSTALLER").write_text("pip\n")
        if origin:
            (info / "direct_url.json").write_text(json.dumps(origin))
        monkeypatch.syspath_prepend(tmp_path)
        pip = str(Path(sys.executable).parent / "pip")
        monkeypatch.setattr(_installation, "which", {"pip": pip}.get)
        return tmp_path

    return make


def test_an_editable_install_names_its_checkout(install, tmp_path):
    install({"url": tmp_path.as_uri(), "dir_info": {"editable": True}})
    assert install_command("web") == f'pip install -e "{tmp_path}[web]"'


def test_a_normal_install_from_a_checkout_stays_normal(install, tmp_path):
    install({"url": tmp_path.as_uri(), "dir_info": {}})
    assert install_command("web") == f'pip install "{tmp_path}[web]"'


def test_an_install_from_a_wheel_names_the_wheel(install, tmp_path):
    wheel = tmp_path / "stkzoo-9-py3-none-any.whl"
    wheel.touch()
    install({"url": wheel.as_uri(), "archive_info": {}})
    assert install_command("web") == f'pip install "stkzoo[web] @ {wheel.as_uri()}"'


def test_an_install_from_a_repository_names_the_same_commit(install):
    install({"url": "https://example.org/a.git", "vcs_info": {"vcs": "git", "commit_id": "1a2b"}})
    assert (
        install_command("web") == 'pip install "stkzoo[web] @ git+https://example.org/a.git@1a2b"'
    )


@pytest.mark.parametrize("extra", ["web", "all"])
@pytest.mark.parametrize("origin", [None, {"url": "file:///gone/stkzoo.whl", "archive_info": {}}])
def test_without_a_known_origin_the_command_names_the_libraries(install, origin, extra):
    install(origin)
    assert install_command(extra) == 'pip install "aiohttp>=3"'


def test_without_its_own_pip_on_the_path_the_command_runs_this_python(install, monkeypatch):
    install(None)
    monkeypatch.setattr(_installation, "which", {"pip": "/elsewhere/pip"}.get)
    assert install_command("web") == f'"{sys.executable}" -m pip install "aiohttp>=3"'


def test_stale_metadata_in_a_checkout_does_not_hide_the_install(install, monkeypatch, tmp_path):
    install(None)
    stale = tmp_path / "checkout" / "stkzoo.egg-info"
    stale.mkdir(parents=True)
    (stale / "PKG-INFO").write_text("Metadata-Version: 2.1\nName: stkzoo\nVersion: 8\n")
    monkeypatch.syspath_prepend(stale.parent)
    assert metadata.version("stkzoo") == "8"
    assert repository_url() == "https://example.org/stkzoo"
    assert extra_requirements()["web"] == ["aiohttp>=3"]


def test_a_missing_library_is_reported_with_its_install_command(install):
    install(None)
    with pytest.raises(ConfigError) as caught:
        import_extra("no_such_library.part", "the plot needs", "web", "or pass --no-plot")
    assert str(caught.value) == (
        "the plot needs no_such_library, which is not installed: "
        'pip install "aiohttp>=3" or pass --no-plot'
    )


def test_a_library_that_does_not_load_is_reported_with_the_cause(install):
    (install(None) / "broken_library.py").write_text("raise ImportError('libGL.so.1 is missing')")
    with pytest.raises(ConfigError, match=r"does not load \(libGL.so.1 is missing\): pip install"):
        import_extra("broken_library", "the window needs", "play")


def test_the_remedy_for_glib_is_a_command():
    problem = "libglib-2.0.so.0: cannot open shared object file: No such file or directory"
    remedy = library_remedy(f"Traceback (most recent call last):\nImportError: {problem}\n")
    assert "sudo apt install libglib2.0-0" in remedy
    assert library_remedy("ImportError: No module named pystk2") == ""
