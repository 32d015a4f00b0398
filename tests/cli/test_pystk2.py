"""The command ``stkzoo pystk2``, compared with the reference's ``pystk2``."""

import json
import os
import shutil
import subprocess
import sys
import venv
from pathlib import Path

import pytest

from stkzoo.cli import build_parser, main
from stkzoo.cli.pystk2 import _DEFAULTS
from tests.support.paths import AGENTS, ROOT
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


def test_options_and_defaults_match_the_reference():
    command = [sys.executable, "-c", REFERENCE]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    ours = choices_of(choices_of(build_parser("pystk2"))["pystk2"])
    for name, options in json.loads(said).items():
        known = options_of(ours[name])
        assert options.keys() <= known.keys()
        for option, default in options.items():
            if option not in OWN_DEFAULTS:
                assert (ours[name].get_default(known[option].dest) or None) == (default or None)


def test_every_default_belongs_to_an_option():
    known = options_of(choices_of(choices_of(build_parser("pystk2"))["pystk2"])["race"])
    assert _DEFAULTS.keys() <= {action.dest for action in known.values()}


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
        "no window opens, because there is no display",
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
        (["rac"], "Did you mean 'race'?"),
        (["race", "ai", "--trak", "x"], "Did you mean '--track'?"),
        (["race", "ai", "ai", "ai", "ai"], "--num-karts is 3, but 4 drivers are named"),
        (["race-server", "ai"], "name it on the client"),
    ],
)
def test_bad_usage_is_reported_in_one_line(words, text, capsys):
    assert main(["pystk2", *words, *(["--hide"] if words[0] == "race" else [])]) == 2
    said = capsys.readouterr().err
    assert text in said
    assert said.count("\n") == 1


@pytest.fixture
def environment(tmp_path):
    """Returns a function that creates an environment with stkzoo and returns its ``bin`` folder."""

    def make(*, with_reference):
        folder = tmp_path / "an env"
        venv.create(folder, with_pip=False, symlinks=True)
        (site,) = folder.glob("lib/python*/site-packages")
        for place in (Path(path) for path in sys.path if path.endswith("site-packages")):
            for entry in place.iterdir():
                is_reference = entry.name.startswith("pystk2_gymnasium")
                is_needed = entry.suffix != ".pth" and (with_reference or not is_reference)
                if is_needed and not (site / entry.name).exists():
                    (site / entry.name).symlink_to(entry)
        (site / "stkzoo.pth").write_text(f"{ROOT}\n")
        command = folder / "bin" / "stkzoo"  # like the script that pip writes
        command.write_text(
            f'#!/bin/sh\nexec "{folder}/bin/python" -c '
            '"import sys; from stkzoo.cli import main; sys.exit(main())" "$@"\n'
        )
        command.chmod(0o755)
        return folder / "bin"

    return make


def run(*words, **options):
    done = subprocess.run(words, capture_output=True, text=True, check=False, **options)
    return done.returncode, done.stdout + done.stderr


@pytest.mark.slow
def test_the_command_is_written_if_it_is_missing(environment, tmp_path):
    folder = environment(with_reference=False)
    code, said = run(folder / "stkzoo", "pystk2", "install")
    assert code == 0, said
    assert str(folder / "pystk2") in said
    script = tmp_path / "course.sh"
    script.write_text(f"pystk2 race {AGENTS / 'plain'} --track lighthouse --max-steps 2 --hide")
    paths = {**os.environ, "PATH": f"{folder}:{os.environ['PATH']}"}
    code, said = run("sh", script, env=paths, cwd=tmp_path)
    assert code == 0, said
    assert "Plain" in said
    (folder / "pystk2").write_text("somebody's own")
    code, said = run(folder / "stkzoo", "pystk2", "install")
    assert code == 1
    assert "cannot be written (File exists); `stkzoo pystk2 race ...` works without it" in said
    assert (folder / "pystk2").read_text() == "somebody's own"


@pytest.mark.slow
@pytest.mark.parametrize("is_there", [True, False])
def test_an_installed_reference_keeps_its_command(environment, is_there):
    folder = environment(with_reference=True)
    script = folder / "pystk2"
    if is_there:
        script.write_text(
            f"#!{shutil.which('env')} -S '{folder}/python'\n"
            "import sys; from pystk2_gymnasium.cli import main; sys.exit(main())\n"
        )
        script.chmod(0o755)
        before = script.read_bytes()
    code, said = run(folder / "stkzoo", "pystk2", "install")
    assert code == 1
    assert "the command of the package pystk2_gymnasium, which is installed here" in said
    assert script.exists() == is_there
    if is_there:
        assert script.read_bytes() == before
        assert "Run a race with one or more agents" in run(script, "--help")[1]
