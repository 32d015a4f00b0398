"""Files and folders are locked, and can be used where the file system has no locks."""

import errno
import os
import shutil
from contextlib import nullcontext

import pytest

from stkzoo._locks import locked_folder, try_lock
from stkzoo._os import write_whole
from stkzoo.errors import ConfigError


@pytest.fixture
def without_locks(monkeypatch):
    """Makes all file systems ones without locks."""
    fail_with(errno.ENOSYS, monkeypatch)


def fail_with(code, monkeypatch):
    def refuse(*_):
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr("fcntl.flock", refuse)


@pytest.fixture
def descriptor(tmp_path):
    handle = os.open(tmp_path, os.O_RDONLY)
    yield handle
    os.close(handle)


def test_a_locked_file_cannot_be_locked_again(tmp_path, descriptor):
    other = os.open(tmp_path, os.O_RDONLY)
    try:
        assert try_lock(other)
        assert not try_lock(descriptor)
    finally:
        os.close(other)
    assert try_lock(descriptor)


@pytest.mark.usefixtures("without_locks")
def test_without_locks_every_file_counts_as_locked(descriptor):
    assert try_lock(descriptor)
    assert not try_lock(descriptor, if_unsupported=False)


def test_other_errors_are_raised(descriptor, monkeypatch):
    fail_with(errno.EIO, monkeypatch)
    with pytest.raises(OSError, match="Input/output error"):
        try_lock(descriptor)


def test_a_folder_is_used_by_one_program_at_a_time(tmp_path):
    folder = tmp_path / "runs" / "first"
    with (
        locked_folder(folder, "run"),
        pytest.raises(ConfigError, match=r"another program works on the run in .*first; wait"),
        locked_folder(folder, "run"),
    ):
        pass
    with locked_folder(folder, "run"):
        pass


def test_incomplete_files_of_a_killed_program_are_removed(tmp_path):
    (tmp_path / "agent").mkdir()
    for file in (tmp_path / "checkpoint.pt", tmp_path / "agent" / "card.json"):
        with write_whole(file) as part:
            shutil.copy(part, tmp_path / "kept")
            (tmp_path / "kept").rename(part.with_name(part.name.replace("stkzoo-", "stkzoo-1")))
            file.with_name(".film.a1b2c3d4.part").touch()  # of the user
    with locked_folder(tmp_path, "run"):
        files = [path.name for path in tmp_path.rglob("*") if path.is_file()]
    mine = [".film.a1b2c3d4.part"] * 2
    assert sorted(files) == [*mine, "card.json", "checkpoint.pt", "lock"]


@pytest.mark.parametrize("name", ["races", "replays", "members", "agent"])
def test_a_linked_folder_in_a_folder_is_refused(name, tmp_path):
    users, folder = tmp_path / "mine", tmp_path / "received"
    users.mkdir()
    folder.mkdir()
    (users / ".stkzoo-notes.part").write_text("mine")
    (folder / name).symlink_to(users)
    with (
        pytest.raises(ConfigError, match=rf"/{name} is a link to a folder, .*; replace it"),
        locked_folder(folder, "run"),
    ):
        pytest.fail("it must not be used")
    assert [path.name for path in users.iterdir()] == [".stkzoo-notes.part"]


@pytest.mark.parametrize("odd", ["link", "dangling", "pipe", "folder", "folder of a part"])
def test_an_odd_entry_in_place_of_a_lock_is_replaced_or_refused(odd, tmp_path):
    lock, target = tmp_path / "lock", tmp_path / "mine"
    match odd:
        case "link" | "dangling":
            if odd == "link":
                target.write_text("mine")
            lock.symlink_to(target)
        case "pipe":
            os.mkfifo(lock)
        case "folder":
            lock.mkdir()
        case _:
            (tmp_path / ".stkzoo-x.part").mkdir()
    refusal = pytest.raises(ConfigError, match=r"the run's folder .* cannot be used: Is a dir")
    with refusal if odd.startswith("folder") else nullcontext(), locked_folder(tmp_path, "run"):
        pass
    assert target.exists() == (odd == "link")
    assert lock.is_symlink() is False
