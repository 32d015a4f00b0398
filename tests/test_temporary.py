"""Temporary folders are removed: at the end of a program, after a kill, whatever an agent left."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from stkzoo._temporary import TemporaryFolder, remove_stale_folders, remove_tree
from stkzoo.engine.assets.staging import Progress, lock
from tests.support.processes import run_program

#: More nested folders than Python recurses into, in a path longer than the system allows.
DEPTH, NAME = 1200, "nested" * 20

PROGRAM = """
import os, signal, sys, time
from stkzoo._temporary import TemporaryFolder
folder = TemporaryFolder("test")
(folder.path / "file").write_text("x")
print(folder.path, flush=True)
"""


@pytest.fixture(autouse=True)
def place(tmp_path, monkeypatch):
    """Returns the folder in which this test creates temporary folders."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    yield tmp_path
    subprocess.run(["rm", "-rf", tmp_path], check=True)  # pytest cannot remove nested folders


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def nest(folder):
    """Nests folders with a file in each."""
    inner = os.open(folder, os.O_RDONLY)
    for _ in range(DEPTH):
        os.close(os.open("file", os.O_CREAT, dir_fd=inner))
        os.mkdir(NAME, dir_fd=inner)
        outer, inner = inner, os.open(NAME, os.O_RDONLY, dir_fd=inner)
        os.close(outer)
    os.close(inner)


@pytest.mark.parametrize(
    "ending",
    [
        "pass",
        "sys.exit() if os.fork() == 0 else os.wait(); assert folder.path.exists()",
        "import multiprocessing as m; m.get_context('fork').Process(target=TemporaryFolder, "
        "args=('test',)).start()",
        "import stkzoo._temporary as t; kept, t.remove_tree = t.remove_tree, lambda _: "
        "signal.raise_signal(signal.SIGINT) \ntry: folder.close() \n"
        "except KeyboardInterrupt: t.remove_tree = kept",
    ],
    ids=["open", "forked", "multiprocessing", "interrupted"],
)
def test_a_program_removes_its_folders_at_its_end(place, ending):
    done = run_program(PROGRAM + ending, check=True)
    assert (names(place), done.stderr) == ([], "")


@pytest.mark.slow
def test_the_next_program_removes_the_folders_of_a_killed_one(place):
    nest_in_killed = PROGRAM + "os.kill(os.getpid(), signal.SIGKILL)"
    nest(run_program(nest_in_killed).stdout.strip())
    with TemporaryFolder("next") as folder:
        assert names(place) == [folder.path.parent.name]
        assert [path for path in folder.path.parent.iterdir() if path.is_dir()] == [folder.path]


def test_only_the_folders_of_killed_programs_are_removed(place):
    running = [sys.executable, "-c", PROGRAM + "time.sleep(60)"]
    with subprocess.Popen(running, stdout=subprocess.PIPE, text=True) as program:
        folder = program.stdout.readline().strip()
        (place / "stkzoo-run-file").write_text("mine")
        (place / "stkzoo-run-link").symlink_to(place)
        before = names(place)
        remove_stale_folders()
        assert names(place) == before
        assert os.path.isfile(f"{folder}/file")
        program.kill()


def test_folders_of_the_user_are_kept_whatever_their_names(place):
    killed = Path(run_program(PROGRAM + "os.kill(os.getpid(), signal.SIGKILL)").stdout.strip())
    names_of_users = ["mine", "0123456789abcdef", "saved", "marked", "linked"]
    users = [place / f"stkzoo-run-{name}" for name in names_of_users]
    users.append(place / ".stkzoo-staging-mine")
    shutil.copytree(killed.parent, users[2])  # with the mark, under another name
    for folder in users:
        folder.mkdir(exist_ok=True)
        (folder / "file").write_text("mine")
        folder.chmod(0o755)
    (users[3] / f".made-by-stkzoo-as-{users[3].name}").mkdir()
    (users[4] / f".made-by-stkzoo-as-{users[4].name}").symlink_to(users[4] / "file")
    unmarked = place / ".stkzoo-staging-killed"
    unmarked.mkdir()
    remove_stale_folders()
    with lock(place, Progress()):
        pass
    assert not killed.parent.exists()
    assert not unmarked.exists()
    for folder in users:
        assert (folder / "file").read_text() == "mine"
        assert folder.stat().st_mode & 0o777 == 0o755


def test_the_targets_of_links_are_kept(tmp_path):
    for name in ("folder/a", "kept"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "kept" / "file").write_text("mine")
    (tmp_path / "kept").chmod(0o755)
    for link in ("folder/link", "folder/a/link", "link"):
        (tmp_path / link).symlink_to(tmp_path / "kept")
    nest(tmp_path / "folder" / "a")  # so that programs remove it
    remove_tree(tmp_path / "folder")
    remove_tree(tmp_path / "link")
    assert names(tmp_path) == ["kept", "link"]
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
