"""Folders are removed whatever an agent left in them."""

import os
import subprocess
import sys

import pytest

from stkzoo._temporary import LockedTemporaryDirectory, remove_tree
from tests.support.processes import run_program

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="needs descriptors of folders")

#: More nested folders than Python recurses into, in a path longer than the system allows.
DEPTH, NAME = 1200, "nested" * 20


@pytest.fixture
def home(tmp_path):
    yield tmp_path
    subprocess.run(["rm", "-rf", tmp_path], check=True)  # pytest cannot remove nested folders


def nest(folder):
    """Nests folders with a file in each."""
    place = os.open(folder, os.O_RDONLY)
    for _ in range(DEPTH):
        os.close(os.open("file", os.O_CREAT, dir_fd=place))
        os.mkdir(NAME, dir_fd=place)
        outer, place = place, os.open(NAME, os.O_RDONLY, dir_fd=place)
        os.close(outer)
    os.close(place)


def test_a_folder_with_files_and_folders_is_removed(tmp_path):
    for name in ("folder/a/b", "folder/a/c", "folder/d"):
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / "file").write_text("x")
    remove_tree(tmp_path / "folder")
    assert list(tmp_path.iterdir()) == []


def test_deeply_nested_folders_are_removed(home):
    folder = home / "folder"
    folder.mkdir()
    nest(folder)
    remove_tree(folder)
    assert not folder.exists()


def test_a_killed_programs_deeply_nested_folders_do_not_stop_the_next_program(home, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(home))
    left = LockedTemporaryDirectory("test")
    nest(left.path)
    left.release()
    LockedTemporaryDirectory("next").close()
    assert list(home.iterdir()) == []


def test_the_targets_of_links_are_kept(tmp_path):
    for name in ("folder/a", "kept"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "kept" / "file").write_text("mine")
    (tmp_path / "kept").chmod(0o755)
    for link in ("folder/link", "folder/a/link", "link"):
        (tmp_path / link).symlink_to(tmp_path / "kept")
    remove_tree(tmp_path / "folder")
    remove_tree(tmp_path / "link")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["kept", "link"]
    assert (tmp_path / "kept" / "file").read_text() == "mine"
    assert (tmp_path / "kept").stat().st_mode & 0o777 == 0o755


def test_folders_without_permissions_are_removed():
    code = """
        import os, tempfile
        from pathlib import Path
        from stkzoo._temporary import remove_tree
        if os.geteuid() == 0:
            os.seteuid(65534)  # root needs no permissions
        folder = Path(tempfile.mkdtemp(dir="/tmp"))
        for name in ("a/b", "a/c", "d"):
            (folder / name).mkdir(parents=True)
            (folder / name / "file").touch()
        for name in ("a/b", "a/c", "a", "d", "."):
            (folder / name).chmod(0o500 if name == "d" else 0)
        remove_tree(folder)
        print(folder.exists())
    """
    done = run_program(code)
    assert done.stdout == "False\n", done.stderr


def test_a_missing_folder_is_no_error(tmp_path):
    remove_tree(tmp_path / "missing")
