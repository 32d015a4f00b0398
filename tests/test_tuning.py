"""The heuristic driver's numbers are tuned, on training tracks alone."""

import json
import random
import subprocess
import sys
from dataclasses import asdict

import pytest

from stkzoo.agents.heuristic import DriverParameters
from stkzoo.agents.training.tune_heuristic import BOUNDS, draw_trials, from_unit, to_unit
from stkzoo.tracks import TEST_TRACKS, TRAIN_TRACKS
from tests.processes import children_of, process_exists, wait_until


def command(folder, generations):
    options = {"output": folder, "generations": generations, "population": 3, "races": 1}
    words = [f"--{name}={value}" for name, value in options.items()]
    module = "stkzoo.agents.training.tune_heuristic"
    return [sys.executable, "-m", module, *words, "--alone=1", "--jobs=2"]


def tune(folder, generations):
    return subprocess.run(command(folder, generations), capture_output=True, text=True, timeout=300)


def test_present_numbers_are_within_their_bounds_and_come_back():
    assert asdict(from_unit(to_unit(DriverParameters()))) == pytest.approx(
        asdict(DriverParameters())
    )
    assert all(0 <= share <= 1 for share in to_unit(DriverParameters()))


def test_a_point_outside_is_moved_inside():
    for end, point in ((0, [-3.0] * len(BOUNDS)), (1, [7.0] * len(BOUNDS))):
        parameters = from_unit(point)
        assert all(
            getattr(parameters, name) == pytest.approx(bounds[end])
            for name, bounds in BOUNDS.items()
        )


def test_only_training_tracks_are_driven_each_equally_often():
    trials = draw_trials(45, 3, 0.5, random.Random(1))
    counts = {track: sum(trial.track == track for trial in trials) for track in TRAIN_TRACKS}
    assert set(counts.values()) == {3}
    assert not {trial.track for trial in trials} & set(TEST_TRACKS)
    assert {(trial.rivals, trial.place) for trial in trials} == {(0, 1), (4, 1), (4, 5)}


def test_tuning_goes_on_where_it_was(tmp_path):
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    for folder, generations in ((whole, 2), (parts, 1), (parts, 1)):
        ended = tune(folder, generations)
        assert ended.returncode == 0, ended.stderr[-2000:]
    lines = [json.loads(line) for line in (parts / "log.jsonl").read_text().splitlines()]
    assert [line["generation"] for line in lines] == [0, 1]
    assert (whole / "log.jsonl").read_text() == (parts / "log.jsonl").read_text()
    assert DriverParameters(**json.loads((parts / "best.json").read_text()))


def test_nothing_goes_on_when_tuning_is_killed(tmp_path):
    with subprocess.Popen(command(tmp_path, 5)) as program:
        assert wait_until(lambda: len(children_of(program.pid)) >= 3, 30)  # 2, and a tracker
        workers = children_of(program.pid)
        program.kill()
    assert wait_until(lambda: not any(map(process_exists, workers)), 10)
