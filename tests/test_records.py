"""The human world records."""

from stkzoo.evaluation import load_ai_times
from stkzoo.records import HUMAN_RECORDS, RECORD_DIFFICULTY
from stkzoo.tracks import SPLITS


def test_every_track_has_a_record():
    assert tuple(HUMAN_RECORDS) == SPLITS["all"]


def test_records_are_faster_per_lap_than_the_ai():
    times = load_ai_times()
    for track, record in HUMAN_RECORDS.items():
        ai = times.of(track, False, RECORD_DIFFICULTY).median
        assert 0.3 < record.seconds / record.laps / ai < 0.8, track
