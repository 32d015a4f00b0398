"""What commands that run many races say after Ctrl-C."""

from argparse import Namespace

import pytest

from stkzoo.cli._batch import run_batch, run_replays
from stkzoo.evaluation import BatchProgress

ARGUMENTS = Namespace(jobs=1, race_timeout=60.0)


def interrupted(*progress):
    """Returns a function that reports progress and is then interrupted."""

    def run(options):
        for done in progress:
            options.on_race(BatchProgress(*done))
        raise KeyboardInterrupt

    return run


def test_an_interrupted_batch_says_how_many_races_are_saved(capsys):
    assert run_batch(ARGUMENTS, interrupted((0, 18), (3, 18))) == (None, 130)
    expected = "interrupted; 3 of 18 races are saved; run the same command to resume"
    assert expected in capsys.readouterr().err


@pytest.mark.parametrize("progress", [(), ((3, 18),)])
def test_interrupted_replays_say_that_nothing_was_saved(progress, capsys):
    def run(**options):
        for done in progress:
            options["on_race"](BatchProgress(*done))
        raise KeyboardInterrupt

    assert run_replays(ARGUMENTS, run) == (None, 130)
    assert capsys.readouterr().err == "stkzoo: interrupted; nothing was saved\n"


def test_a_batch_interrupted_while_it_is_planned_says_that_nothing_was_saved(capsys):
    run_batch(ARGUMENTS, interrupted())
    assert capsys.readouterr().err == "stkzoo: interrupted; nothing was saved\n"
