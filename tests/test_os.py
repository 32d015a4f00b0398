"""Files are replaced as a whole, and keep their links and permissions."""

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


def test_the_file_that_a_link_names_is_replaced(tmp_path):
    (tmp_path / "disk").mkdir()
    file, link = tmp_path / "disk" / "result.json", tmp_path / "link.json"
    link.symlink_to("disk/result.json")
    for text in ("first", "second"):
        write_text(link, text)
        assert (file.read_text(), link.is_symlink()) == (text, True)
    assert [path.name for path in (tmp_path / "disk").iterdir()] == ["result.json"]


def test_a_link_into_a_missing_folder_is_reported_before_the_work(tmp_path):
    link = tmp_path / "link.json"
    link.symlink_to("missing/result.json")
    with pytest.raises(ConfigError, match=r"there is no folder .*missing"):
        check_writable(link, "the result")


def test_the_longest_names_of_files_can_be_written(tmp_path):
    for name in ("a" * 255, "é" * 127):
        check_writable(tmp_path / name, "the result")
        write_text(tmp_path / name, "text")
        assert (tmp_path / name).read_text() == "text"


def test_a_name_that_is_too_long_is_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"the result cannot be .*: File name too long; choose"):
        check_writable(tmp_path / ("a" * 256), "the result")
