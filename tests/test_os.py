"""Files are replaced as a whole, keep their permissions, and replace links."""

import os

import pytest

from stkzoo._os import check_writable, write_text
from stkzoo.errors import ConfigError


@pytest.fixture(autouse=True)
def umask():
    """Sets a umask that hides new files from other users."""
    before = os.umask(0o077)
    yield
    os.umask(before)


def mode_of(file):
    return file.stat().st_mode & 0o777


def test_a_new_file_has_the_permissions_of_the_umask(tmp_path):
    file = tmp_path / "result.json"
    write_text(file, "new")
    assert mode_of(file) == 0o600
    os.umask(0o022)
    write_text(tmp_path / "other.json", "new")
    assert mode_of(tmp_path / "other.json") == 0o644


@pytest.mark.parametrize("mode", [0o600, 0o640, 0o444, 0o755])
def test_a_replaced_file_keeps_its_permissions(mode, tmp_path):
    file = tmp_path / "result.json"
    file.write_text("old")
    file.chmod(mode)
    write_text(file, "new")
    assert (file.read_text(), mode_of(file)) == ("new", mode)


@pytest.mark.parametrize("link_kind", ["link", "hard link", "chain", "dangling"])
def test_a_file_replaces_a_link_and_what_it_names_stays(link_kind, tmp_path):
    target, output = tmp_path / "profile", tmp_path / "output"
    target.write_text("mine")
    target.chmod(0o644)
    match link_kind:
        case "hard link":
            output.hardlink_to(target)
        case "chain":
            (tmp_path / "other").symlink_to(target)
            output.symlink_to("other")
        case _:
            output.symlink_to(target if link_kind == "link" else "missing")
    check_writable(output, "the result")
    write_text(output, "new")
    assert (output.read_text(), output.is_symlink()) == ("new", False)
    assert (target.read_text(), mode_of(target)) == ("mine", 0o644)
    assert not (tmp_path / "missing").exists()


@pytest.mark.parametrize("target", [".", os.devnull, "/proc/self/fd/1", "pipe"])
def test_a_link_to_something_that_is_no_file_is_refused(target, tmp_path):
    os.mkfifo(tmp_path / "pipe")
    output = tmp_path / "output"
    output.symlink_to(target)
    with pytest.raises(ConfigError, match="not a regular file; choose another name"):
        check_writable(output, "the result")
    with pytest.raises(ConfigError, match=r"cannot be written: .*not a regular file"):
        write_text(output, "new")
    assert os.readlink(output) == target


def test_the_longest_names_of_files_can_be_written(tmp_path):
    for name in ("a" * 255, "é" * 127):
        check_writable(tmp_path / name, "the result")
        write_text(tmp_path / name, "text")
        assert (tmp_path / name).read_text() == "text"


def test_a_name_that_is_too_long_is_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"the result cannot be .*: File name too long; choose"):
        check_writable(tmp_path / ("a" * 256), "the result")
