"""Folders of commands that run many races, and what they say after Ctrl-C."""

from argparse import Namespace

import pytest

from stkzoo.cli import _console, main
from stkzoo.cli._batch import file_name, run_batch
from stkzoo.evaluation import BatchProgress
from stkzoo.evaluation.batch.run import BatchKind


@pytest.mark.parametrize(
    ("progress", "is_saved", "text"),
    [
        ([(0, 18), (3, 18)], True, "3 of 18 races are saved; run the same command to resume"),
        ([(3, 18)], False, "nothing was saved"),
        ([], True, "nothing was saved"),
    ],
)
def test_an_interrupted_batch_says_how_many_races_are_saved(progress, is_saved, text, capsys):
    def run(on_race):
        for done in progress:
            on_race(BatchProgress(*done))
        raise KeyboardInterrupt

    assert run_batch({}, run, is_saved=is_saved) == (None, 130)
    assert capsys.readouterr().err == f"stkzoo: interrupted; {text}\n"


def test_without_a_terminal_a_batch_prints_a_line_of_progress_every_ten_seconds(
    capsys, monkeypatch
):
    seconds = iter([0.0, 0.0, 4.0, 12.0, 12.0, 15.0, 23.0, 23.0, 34.0, 34.0])
    monkeypatch.setattr(_console, "time", Namespace(monotonic=lambda: next(seconds)))
    reports = [*(BatchProgress(n, 9) for n in range(4)), BatchProgress(3, 9, failed=2)]
    run_batch({}, lambda on_race: [on_race(report) for report in reports])
    expected = "races: 1 of 9\nraces: 3 of 9\nraces: 3 of 9, 2 failed\n"
    assert capsys.readouterr().err == expected


@pytest.mark.parametrize(
    ("label", "name"),
    [
        ("v1.2 (new)", "v1.2 (new)"),
        ("pretrained:ace", "pretrained-ace"),
        ("..", "_"),
        ("../..\\home", "__.._home"),
    ],
)
def test_the_label_of_an_agent_becomes_a_safe_file_name(label, name):
    assert file_name(label) == name


@pytest.mark.parametrize(
    ("words", "folder"),
    [
        (["benchmark"], "benchmark/_"),
        (["benchmark", "--time-trial"], "benchmark/_-time-trial"),
        (["suite", "evaluate", "solo-general", "--class", "learned"], "suite/solo-general-_"),
    ],
)
def test_an_agent_does_not_choose_the_output_folder(words, folder, tmp_path, monkeypatch):
    agent = tmp_path / "pystk_actor.py"
    agent.write_text('player_name = ".."\n\n\ndef get_actor(*_):\n    return None\n')
    folders = []

    def run(*arguments):
        folders.append(arguments[2])
        raise KeyboardInterrupt

    monkeypatch.setattr(BatchKind, "run", run)
    assert main([*words, str(agent)]) == 130
    assert [place.as_posix() for place in folders] == [folder]
