"""The log of visits to the test tracks lists every saved result."""

import csv
import json

import pytest

from stkzoo.evaluation import load_benchmark
from stkzoo.tracks import TEST_TRACKS
from tests.support.paths import ROOT

RESULTS = ROOT / "benchmarks" / "results"


def has_test_tracks(file):
    """Returns whether a saved result includes test tracks."""
    return not set(TEST_TRACKS).isdisjoint(json.loads(file.read_text())["plan"]["tracks"])


SAVED = sorted(filter(has_test_tracks, (RESULTS / "benchmark").rglob("*.json")))


def visits():
    """Returns the rows of the log, without its header."""
    with (RESULTS / "test_visits.csv").open(newline="") as file:
        return list(csv.reader(file))[1:]


@pytest.mark.parametrize("file", SAVED, ids=lambda file: file.stem)
def test_the_log_has_every_saved_result_on_test_tracks(file):
    result = load_benchmark(file)
    plan, races, ratio = result.plan, len(result.races), result.group().figures["time_ratio"].value
    row = [plan.agent.source, str(plan.settings.difficulty), str(races), f"{ratio:.3f}"]
    assert row in [visit[1:5] for visit in visits()]
