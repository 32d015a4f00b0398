"""``stkzoo tracks``, ``stkzoo karts`` and ``stkzoo completion``."""

import contextlib
import io
import json
import shutil
import subprocess

import pytest
from rich.console import Console

from stkzoo.cli import COMMANDS, _console, main


def test_tracks_shows_the_data_of_tracks(capsys):
    assert main(["tracks", "lighthouse", "olivermath", "--json"]) == 0
    track, other = json.loads(capsys.readouterr().out)
    assert (track["track"], other["track"]) == ("lighthouse", "olivermath")
    assert track["length"] == pytest.approx(880, abs=1)
    facts = ("split", "segments", "forks", "items")
    assert [track[name] for name in facts] == ["train", 115, 0, 25]
    assert 30 < track["time"] < 45
    assert (track["record"], track["record_laps"]) == (86.92, 4)


def test_karts_match_the_game(capsys):
    assert main(["karts", "--json"]) == 0
    karts = {kart["kart"]: kart for kart in json.loads(capsys.readouterr().out)}
    assert len(karts) == 16
    assert {kart["weight"] for kart in karts.values()} == {"light", "medium", "heavy"}
    assert karts["sara_the_racer"]["title"] == "Pepper"
    assert karts["tux"]["wheel_base"] == 1.008
    assert main(["karts"]) == 0
    shown = capsys.readouterr().out
    assert all(kart in shown for kart in karts)


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish", "tcsh"])
def test_completion_scripts_contain_all_commands(shell, capsys):
    assert main(["completion", shell]) == 0
    script = capsys.readouterr().out
    assert all(command in script for command in COMMANDS)


def completed(script, *words):
    """Returns bash's completions of the last word."""
    line = " ".join(words)
    program = f"""
source {script}
COMP_WORDS=({" ".join(repr(word) for word in words)})
COMP_CWORD={len(words) - 1}
COMP_LINE='{line}'
COMP_POINT={len(line)}
_shtab_stkzoo
printf '%s\\n' "${{COMPREPLY[@]}}"
"""
    shell = [shutil.which("bash"), "-c", program]
    done = subprocess.run(shell, capture_output=True, text=True, check=True)
    return done.stdout.split()


def test_bash_completes_commands_options_and_choices(tmp_path, capsys):
    main(["completion", "bash"])
    script = tmp_path / "stkzoo.bash"
    script.write_text(capsys.readouterr().out)
    assert completed(script, "stkzoo", "tour") == ["tournament"]
    assert "--track" in completed(script, "stkzoo", "race", "--tra")
    assert completed(script, "stkzoo", "race", "--error-handling", "re") == ["retire", "restart"]


def shown(monkeypatch, width, columns, rows, **options):
    """Returns a table as a terminal shows it; with the width None, as a pipe gets it."""
    file = io.StringIO()
    if width:
        console = Console(file=file, force_terminal=True, width=width, color_system=None)
        monkeypatch.setattr(_console, "make_console", lambda: console)
    with contextlib.redirect_stdout(file):
        _console.show_table(columns, rows, **options)
    return file.getvalue()


COLUMNS = ("rank", "driver", "kart", "time [s]", "distance [m]", "reward", "think [ms]")
NAME = "a_driver_whose_name_has_forty_characters"
ROW = (1, NAME, "kart_0", "not finished", 880.0, -123.456, None)


@pytest.mark.parametrize("width", [40, 160, None])
def test_names_and_numbers_are_not_cut_at_any_width(width, monkeypatch):
    text = shown(monkeypatch, width, COLUMNS, [ROW])
    assert all(word in text for word in (NAME, "kart_0", "not", "finished", "880.00", "-123.46"))


def test_brackets_in_titles_and_cells_are_shown(monkeypatch):
    text = shown(monkeypatch, None, ("x [s]",), [("1 [m] and more",)], title="[a]")
    assert all(part in text for part in ("x [s]", "1 [m]", "[a]"))
