"""The table of the commands' defaults matches the commands."""

import re

import pytest

from stkzoo.cli import build_parser
from tests.support.paths import ROOT

PAGE = (ROOT / "docs" / "reference" / "differences.md").read_text("utf-8")
TABLE = PAGE.split("## Defaults of the commands")[1].split("\n## ")[0]


def default(command, option):
    (subparsers,) = (action for action in build_parser(command)._actions if action.choices)
    return subparsers.choices[command].get_default(option)


@pytest.mark.parametrize(
    ("command", "option", "row", "value"),
    [
        ("race", "error_handling", "--error-handling", "retire"),
        ("race", "action_timeout", "--action-timeout", 10),
        ("race", "window", "the game's window", False),
        ("race", "width", "--width", 854),
        ("race", "height", "--height", 480),
        ("race", "render_sub_steps", "--render-sub-steps", 3),
        ("race", "web_port", "--web-port", 8000),
        ("race", "web_host", "host of the page", "127.0.0.1"),
        ("race-server", "address", "race-server --address", "tcp://127.0.0.1:5555"),
        ("race-server", "threads", "race-server --threads", 8),
        ("race-client", "timeout", "race-client --timeout", None),
    ],
)
def test_a_default_matches_the_table(command, option, row, value):
    assert (default(command, option) or None) == (value or None)
    (cells,) = re.findall(rf"^\| [^|]*{re.escape(row)}[^|]* \|.*$", TABLE, re.MULTILINE)
    if value:
        assert str(value) in cells.split(" | ")[-1]
