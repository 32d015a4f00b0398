"""Folders of commands that run many races, and what they say after Ctrl-C."""

from argparse import Namespace

import pytest

from stkzoo.cli import _batch, _console, main
from stkzoo.cli._batch import BatchArguments, file_name, run_batch, run_replays
from stkzoo.evaluation import BatchProgress

BATCH = BatchArguments(jobs=1, race_timeout=60.0)


def interrupted(*progress):
    """Returns a function that reports progress and is then interrupted."""

    def run(options):
        for done in progress:
            options.on_race(BatchProgress(*done))
        raise KeyboardInterrupt

    return run


def test_an_interrupted_batch_says_how_many_races_are_saved(capsys):
    assert run_batch(BATCH, interrupted((0, 18), (3, 18))) == (None, 130)
    expected = "interrupted; 3 of 18 races are saved; run the same command to resume"
    assert expected in capsys.readouterr().err


def test_without_a_terminal_a_batch_prints_a_line_of_progress_every_ten_seconds(
    capsys, monkeypatch
):
    seconds = iter([0.0, 4.0, 12.0, 12.0, 15.0, 23.0, 23.0])
    monkeypatch.setattr(_console, "time", Namespace(monotonic=lambda: next(seconds)))
    run_batch(BATCH, lambda options: [options.on_race(BatchProgress(n, 9)) for n in range(4)])
    assert capsys.readouterr().err == "1 of 9 races\n3 of 9 races\n"


@pytest.mark.parametrize("progress", [(), ((3, 18),)])
def test_interrupted_replays_say_that_nothing_was_saved(progress, capsys):
    def run(**options):
        for done in progress:
            options["on_race"](BatchProgress(*done))
        raise KeyboardInterrupt

    assert run_replays(BATCH, run) == (None, 130)
    assert capsys.readouterr().err == "stkzoo: interrupted; nothing was saved\n"


@pytest.mark.parametrize(
    ("label", "name"),
    [
        ("my_agent", "my_agent"),
        ("pretrained:ace", "pretrained-ace"),
        ("v1.2 (new)", "v1.2 (new)"),
        (".", "_"),
        ("..", "_"),
        ("../../home", "__.._home"),
        ("..\\home", "__home"),
        ("a/b", "a_b"),
    ],
)
def test_the_label_of_an_agent_becomes_a_safe_file_name(label, name):
    assert file_name(label) == name


@pytest.mark.parametrize(
    ("words", "folder"),
    [
        (["benchmark"], "benchmark/_"),
        (["benchmark", "--time-trial"], "benchmark/_-time-trial"),
        (["suite", "evaluate", "solo-1"], "suite/solo-1-_"),
    ],
)
def test_an_agent_does_not_choose_the_output_folder(words, folder, tmp_path, monkeypatch):
    agent = tmp_path / "pystk_actor.py"
    agent.write_text('player_name = ".."\n\n\ndef get_actor(*_):\n    return None\n')
    folders = []

    def run(_, planned, **_options):
        folders.append(planned.args[1])
        return None, 0

    monkeypatch.setattr(_batch, "run_batch", run)
    assert main([*words, str(agent)]) == 0
    assert [place.as_posix() for place in folders] == [folder]
