"""Fonts that can write the names of drivers."""

from pathlib import Path

import matplotlib as mpl
import pytest

from stkzoo.render import pictures
from stkzoo.render.pictures import font_of

DEJAVU = str(Path(mpl.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf")


@pytest.fixture
def installed(monkeypatch):
    """Returns a function that sets the fonts of the system."""
    pictures._font_file.cache_clear()
    yield lambda *files: monkeypatch.setattr(pictures, "FALLBACK_FONTS", files)
    pictures._font_file.cache_clear()


def draws_boxes(text, font):
    return any([*font.getmask(letter)] == [*font.getmask("\uffff")] for letter in text)


@pytest.mark.parametrize("name", ["José", "Жуков", "Ελένη", "عمر"])
def test_a_name_is_written_in_an_installed_font_that_has_its_letters(name, installed):
    installed("missing.ttf", DEJAVU)
    assert draws_boxes(name, font_of(20))
    assert not draws_boxes(name, font_of(20, name))


@pytest.mark.parametrize("name", ["Ada", "a long na…"])
def test_the_built_in_font_writes_all_names_that_it_can(name, installed):
    installed(DEJAVU)
    assert font_of(20, name) is font_of(20)


def test_a_name_without_a_font_is_written_in_the_built_in_one(installed):
    installed("missing.ttf")
    assert font_of(20, "José") is font_of(20)
