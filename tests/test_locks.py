"""Files and folders are locked, and can be used where the file system has no locks."""

import errno
import os

import pytest

from stkzoo._locks import locked_folder, try_lock
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
    names = (".checkpoint.pt.x1y2.part", "agent/.card.json.x1y2.part", "agent/card.json")
    (tmp_path / "agent").mkdir()
    for name in names:
        (tmp_path / name).touch()
    with locked_folder(tmp_path, "run"):
        files = [path.name for path in tmp_path.rglob("*") if path.is_file()]
    assert sorted(files) == ["card.json", "lock"]
