"""Each program removes the temporary folders of killed programs, and no others."""

import os
import subprocess
import sys
import threading

import pytest

from stkzoo._temporary import LockedTemporaryDirectory, remove_stale_directories
from tests.support.processes import run_program

PROGRAM = """
import os, time
from stkzoo._temporary import LockedTemporaryDirectory
folder = LockedTemporaryDirectory("test")
(folder.path / "file").write_text("x")
print(folder.path, flush=True)
time.sleep(60)
"""

IMPORTS = "import os, sys\nfrom stkzoo._temporary import LockedTemporaryDirectory\n"


@pytest.fixture(autouse=True)
def own_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def start_program():
    program = subprocess.Popen([sys.executable, "-c", PROGRAM], stdout=subprocess.PIPE, text=True)
    program.folder = program.stdout.readline().strip()
    program.stdout.close()
    return program


def test_a_folder_exists_until_it_is_closed(tmp_path):
    with LockedTemporaryDirectory("test") as folder:
        assert folder.path.is_dir()
        assert names(tmp_path) == [folder.path.name]
    assert names(tmp_path) == []
    folder.close()


def test_the_next_program_removes_a_killed_programs_folder(tmp_path):
    program = start_program()
    program.kill()
    program.wait()
    assert os.path.isdir(program.folder)
    LockedTemporaryDirectory("next").close()
    assert names(tmp_path) == []


def test_the_folder_of_a_running_program_is_kept():
    program = start_program()
    try:
        remove_stale_directories()
        assert os.path.isfile(f"{program.folder}/file")
    finally:
        program.kill()
        program.wait()


def test_the_next_program_removes_a_released_folder(tmp_path):
    folder = LockedTemporaryDirectory("test")
    folder.release()
    remove_stale_directories()
    assert names(tmp_path) == []


def test_a_program_removes_its_open_folders_at_its_end(tmp_path):
    run_program(
        IMPORTS + "LockedTemporaryDirectory('one'), LockedTemporaryDirectory('two')", check=True
    )
    assert names(tmp_path) == []


@pytest.mark.parametrize("name", ["try_lock", "remove_tree"])
def test_ctrl_c_in_the_creation_or_removal_of_a_folder_does_not_leave_it(tmp_path, name):
    code = f"""
import stkzoo._temporary as module

def interrupted(*_, **__):
    module.{name} = function
    raise KeyboardInterrupt

function, module.{name} = module.{name}, interrupted
try:
    LockedTemporaryDirectory("test").close()
except KeyboardInterrupt:
    assert os.listdir({str(tmp_path)!r})
"""
    run_program(IMPORTS + code, check=True)
    assert names(tmp_path) == []


def test_a_forked_process_keeps_its_parents_folder():
    code = """
folder = LockedTemporaryDirectory("test")
if not os.fork():
    sys.exit()
os.wait()
assert folder.path.is_dir()
"""
    run_program(IMPORTS + code, check=True)


def test_nothing_else_is_removed(tmp_path):
    (tmp_path / "stkzoo-other").mkdir()
    (tmp_path / "stkzoo-run-file").write_text("mine")
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "stkzoo-run-link").symlink_to(tmp_path / "elsewhere")
    remove_stale_directories()
    assert names(tmp_path) == ["elsewhere", "stkzoo-other", "stkzoo-run-file", "stkzoo-run-link"]


def test_concurrent_folders_are_not_removed(tmp_path):
    lost = []

    def make():
        for _ in range(50):
            with LockedTemporaryDirectory("test") as folder:
                if not folder.path.is_dir():
                    lost.append(folder.path)

    threads = [threading.Thread(target=make) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert lost == []
    assert names(tmp_path) == []
