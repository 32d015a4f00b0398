"""The page of the commands is built from their parsers."""

from stkzoo.cli import COMMANDS
from tests.docs.test_extensions import extension


def test_the_page_has_all_commands_and_the_options_that_their_help_shows():
    (text,) = extension("command_page").pages().values()
    assert [line for line in text.splitlines() if line.startswith("## ")] == [
        f"## stkzoo {name}" for name in COMMANDS
    ]
    assert "| `--track TRACK` |" in text
    assert "SUPPRESS" not in text
