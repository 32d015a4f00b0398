"""The reference page of the commands matches their parsers."""

from stkzoo.cli import COMMANDS
from tests.docs.test_extensions import extension


def test_the_page_matches_the_parsers():
    module = extension("command_page")
    text = module.FILE.read_text("utf-8")
    assert text == module.page(), "run: python docs/_extensions/command_page.py"
    assert [line for line in text.splitlines() if line.startswith("## ")] == [
        f"## stkzoo {name}" for name in COMMANDS
    ]
    assert "| `--track TRACK` |" in text


def test_options_that_the_help_hides_are_not_on_the_page():
    assert "SUPPRESS" not in extension("command_page").page()
