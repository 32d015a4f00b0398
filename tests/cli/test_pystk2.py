"""The command ``stkzoo pystk2``, compared with the reference's ``pystk2``."""

import json
import re
import sys

import pytest

from stkzoo.cli import build_parser, main
from tests.support.paths import AGENTS
from tests.support.remote_race import server_process, write_agent

#: Prints the options of each of the reference's commands, with their defaults.
REFERENCE = """
import argparse, json
from pystk2_gymnasium import cli

def describe(parser):
    (commands,) = (action for action in parser._actions if action.choices)
    print(json.dumps({
        name: {option: action.default for action in child._actions
               for option in action.option_strings if option != "--help"}
        for name, child in commands.choices.items()}, default=str))
    raise SystemExit

argparse.ArgumentParser.parse_args = describe
cli.main()
"""

#: Options with stkzoo's own defaults or defaults computed later; see docs/reference/differences.md.
OWN_DEFAULTS = {"-h", "--address", "--threads", "--screen-width", "--screen-height"}


def options_of(parser):
    return {option: action for action in parser._actions for option in action.option_strings}


def choices_of(parser):
    (commands,) = (action for action in parser._actions if action.nargs == "A...")
    return commands.choices


def test_options_and_defaults_match_the_reference(programs):
    said = programs.run(REFERENCE).stdout
    ours = choices_of(choices_of(build_parser("pystk2"))["pystk2"])
    for name, options in json.loads(said).items():
        known = options_of(ours[name])
        assert options.keys() <= known.keys()
        for option, default in options.items():
            if option not in OWN_DEFAULTS:
                assert (ours[name].get_default(known[option].dest) or None) == (default or None)


@pytest.mark.parametrize("command", ["race", "race-client"])
def test_documented_options_of_the_reference_are_second_names_of_stkzoos(command):
    parser = choices_of(build_parser(command))[command]
    options, text = options_of(parser), parser.format_help()
    aliases = {"video": "record", "width": "screen-width", "height": "screen-height"}
    value = "" if sys.version_info >= (3, 13) else " [A-Z]+"  # shown once, or with each name
    for name, alias in aliases.items():
        assert options[f"--{name}"] is options[f"--{alias}"]
        assert re.search(rf"--{name}{value}, --{alias} [A-Z]+", text)


@pytest.mark.slow
def test_a_result_has_the_references_format(tmp_path, capsys):
    words = f"race {AGENTS / 'plain'}@:Ada --track lighthouse --max-steps 5 --hide"
    assert main(["pystk2", *words.split(), "--output", str(tmp_path / "result.json")]) == 0
    result = json.loads((tmp_path / "result.json").read_text())
    (row,) = result.pop("results")
    assert result.pop("elapsed_seconds") > 0
    assert result == {"type": "results", "track": "lighthouse", "steps": 5}
    assert row.pop("avg_action_time") > 0
    assert row.pop("position") in (1, 2, 3)  # the reference's default is three karts
    assert isinstance(row.pop("reward"), float)
    assert row == {"key": 0, "name": "Ada"}
    assert capsys.readouterr().err == ""


@pytest.mark.slow
def test_a_failure_ends_the_race_and_is_its_result(tmp_path, capsys):
    file = tmp_path / "result.json"
    words = f"race ai {AGENTS / 'hostile' / 'once.py'} --track lighthouse --hide --output {file}"
    assert main(["pystk2", *words.split()]) == 3
    result = json.loads(file.read_text())
    assert (result["type"], result["key"]) == ("error", 1)
    assert "ZeroDivisionError: the third" in result["message"]
    assert 'raise ZeroDivisionError("the third")' in "".join(result["traceback"])
    assert "ZeroDivisionError" in capsys.readouterr().err


@pytest.mark.slow
def test_differences_are_reported_in_one_line(monkeypatch, capsys):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
        monkeypatch.delenv(name, raising=False)
    words = "race ai --track lighthouse --max-steps 2 --cameras 2 --width 600 --web-port 9"
    assert main(["pystk2", *words.split()]) == 0
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    for text in (
        "--cameras does nothing without --video",
        "--width does nothing",
        "--web-port does nothing without --web",
        "no window opens, because no display is named by DISPLAY or WAYLAND_DISPLAY",
    ):
        assert text in said


@pytest.mark.slow
def test_agents_on_a_server_can_race(tmp_path):
    file = tmp_path / "result.json"
    with server_process(write_agent(tmp_path, "ada")) as (_, address):
        words = f"race-client --server {address} --track lighthouse --max-steps 3 --hide"
        assert main(["pystk2", "-v", *words.split(), "--output", str(file)]) == 0
    (row,) = json.loads(file.read_text())["results"]
    assert (row["key"], row["name"]) == (0, "ada")


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["race", "ai", "ai", "ai", "ai"], "--num-karts is 3, but 4 drivers are named"),
        (["race-server", "ai"], "name it on the client"),
    ],
)
def test_bad_usage_is_reported_in_one_line(words, text, capsys):
    assert main(["pystk2", *words, *(["--hide"] if words[0] == "race" else [])]) == 2
    said = capsys.readouterr().err
    assert text in said
    assert said.count("\n") == 1
