"""The parameters of plans are tuned, on training tracks only."""

import json
import sys
from dataclasses import asdict, replace

import numpy as np
import pytest

from stkzoo.agents.planning.parameters import DriverParameters
from stkzoo.agents.training import tune_plans
from stkzoo.agents.training.tune_plans import BOUNDS, drive_all, from_unit, to_unit


def command(folder, generations):
    options = {"output": folder, "generations": generations, "population": 3}
    words = [f"--{name}={value}" for name, value in options.items()]
    module = "stkzoo.agents.training.tune_plans"
    return [sys.executable, "-m", module, *words, "--track=lighthouse"]


def test_default_parameters_are_within_their_bounds_and_survive_scaling():
    assert asdict(from_unit(to_unit(DriverParameters()))) == pytest.approx(
        asdict(DriverParameters())
    )
    assert all(0 <= share <= 1 for share in to_unit(DriverParameters()))
    assert from_unit(to_unit(DriverParameters()), learned_motion=True).learned_motion


def test_a_point_outside_is_moved_inside():
    for end, point in ((0, [-3.0] * len(BOUNDS)), (1, [7.0] * len(BOUNDS))):
        parameters = from_unit(point)
        assert all(
            getattr(parameters, name) == pytest.approx(bounds[end])
            for name, bounds in BOUNDS.items()
        )


@pytest.mark.slow
def test_bad_parameters_drive_badly_and_sets_do_not_affect_each_other():
    good, bad = DriverParameters(), replace(DriverParameters(), aim_time=0.1, greatest_room=2.5)
    places = [("lighthouse", False, 1), ("olivermath", False, 1)]
    told = drive_all([good, bad, good], 0, places)
    assert told[0] == told[2]
    assert told[0] < told[1]
    assert drive_all([bad], 0, places) == [told[1]]


@pytest.mark.slow
def test_test_tracks_are_refused(tmp_path, capsys):
    assert tune_plans.main([f"--output={tmp_path}", "--track", "zengarden"]) == 1
    assert "unknown training track 'zengarden'" in capsys.readouterr().err


@pytest.mark.slow
def test_tuning_resumes_where_it_stopped(tmp_path, monkeypatch, capsys):
    """Replaces the races: a set's cost is its distance from the default parameters."""
    present = np.array(to_unit(DriverParameters()))

    def drive_all(sets, _, places):
        assert [place[:2] for place in places] == [
            ("lighthouse", False),
            ("lighthouse", True),
        ]
        return [float(np.square(to_unit(one) - present).sum()) for one in sets]

    monkeypatch.setattr(tune_plans, "drive_all", drive_all)
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    for folder, generations in ((whole, 2), (parts, 1), (parts, 2)):
        assert tune_plans.main(command(folder, generations)[3:]) == 0
    lines = [json.loads(line) for line in (parts / "log.jsonl").read_text().splitlines()]
    assert [line["generation"] for line in lines] == [0, 1]
    assert (whole / "log.jsonl").read_text() == (parts / "log.jsonl").read_text()
    best = (parts / "best.json").read_text()
    assert DriverParameters(**json.loads(best))
    (parts / "best.json").unlink()  # as after a kill between the log and this file
    assert tune_plans.main(command(parts, 2)[3:]) == 0
    assert (parts / "best.json").read_text() == best
    assert tune_plans.main([*command(parts, 3)[3:], "--sigma", "0.3"]) == 1
    assert "sigma was" in capsys.readouterr().err
