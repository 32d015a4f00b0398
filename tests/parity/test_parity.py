"""Races in stkzoo and in pystk2-gymnasium 0.10.0 are equal except for documented differences."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.parity import ENV_IDS, MODES, compare_race, jobs_for, record_race, reference_process
from benchmarks.parity_compare import compare
from benchmarks.parity_reference import Leaf

pytestmark = pytest.mark.slow

STEPS = 60


@pytest.fixture(scope="module")
def reference():
    with reference_process() as process:
        yield process


@pytest.mark.parametrize("track", ["lighthouse", "olivermath"])
@pytest.mark.parametrize("env_id", ENV_IDS)
def test_races_match_the_reference(reference, env_id, track):
    for job in jobs_for([env_id], [track], STEPS):
        _, result = compare_race(job, reference)
        assert result.undocumented == []
        assert result.steps == STEPS


def test_a_whole_race_matches_the_reference_except_for_repeated_bonuses(reference):
    *_, job = jobs_for(["supertuxkart/multi-full-v0"], ["olivermath"], 300)
    _, result = compare_race(job, reference)
    assert result.undocumented == []
    assert result.steps < 300
    assert result.intended["D05"] > 0


@pytest.mark.parametrize("env_id", ENV_IDS)
def test_races_match_the_references_own_process_except_for_dropped_entries(reference, env_id):
    dropped = 0
    for job in jobs_for([env_id], ["lighthouse"], STEPS, ["process"]):
        _, result = compare_race(job, reference)
        assert result.undocumented == []
        assert result.steps == STEPS
        dropped += result.intended["D31"]
    assert dropped > 0


@pytest.mark.parametrize("mode", MODES)
def test_d31_phase_and_ticks_follow_the_race(reference, mode):
    job, *_ = jobs_for(["supertuxkart/full-v0"], ["lighthouse"], STEPS, [mode])
    sides = record_race(job, reference)[:2]
    phases, ticks = (
        [[m.observation[key].values.item() for m in side.moments] for side in sides]
        for key in ("phase", "aux_ticks")
    )
    assert sorted(set(phases[0])) == [0, 1, 2, 3]
    assert all(np.diff(ticks[0]) >= 0)  # the ticks count up until the start
    assert ticks[0][-1] > ticks[0][0] > 0
    if mode == "process":
        assert set(phases[1]) == {3}
        assert set(ticks[1]) == {0}


@pytest.fixture(scope="module")
def recordings(reference):
    job, *_ = jobs_for(["supertuxkart/full-v0"], ["lighthouse"], 5)
    return record_race(job, reference)


def changed(recording, step, **parts):
    """Returns the recording with one changed moment."""
    moments = list(recording.moments)
    moments[step] = moments[step]._replace(**parts)
    return replace(recording, moments=moments)


def test_an_equal_recording_has_no_differences(recordings):
    ours, theirs, context = recordings
    assert compare(ours, theirs, context).undocumented == []


@pytest.mark.parametrize(
    ("key", "leaf"),
    [
        ("velocity", lambda leaf: leaf._replace(values=leaf.values + np.float32(2e-4))),
        ("paths_start", lambda leaf: leaf._replace(values=leaf.values[::-1])),
        ("items_type", lambda leaf: leaf._replace(values=leaf.values + 1)),
        ("energy", lambda leaf: leaf._replace(kind="array float64 (1,)")),
        ("karts_position", lambda leaf: leaf._replace(values=leaf.values[:-1])),
        ("kart_type", lambda _: Leaf("str", np.array("nolok"))),
        ("phase", lambda leaf: leaf._replace(values=leaf.values + 1)),
    ],
)
def test_a_changed_entry_is_reported(recordings, key, leaf):
    ours, theirs, context = recordings
    observation = ours.moments[3].observation
    observation = {**observation, key: leaf(observation[key])}
    result = compare(changed(ours, 3, observation=observation), theirs, context)
    assert [text.partition(" ")[0] for text in result.undocumented] == [f"observation/{key}"]
    assert "at step 3" in result.undocumented[0]


def test_a_missing_entry_is_reported(recordings):
    ours, theirs, context = recordings
    observation = dict(ours.moments[3].observation)
    del observation["front"]
    result = compare(changed(ours, 3, observation=observation), theirs, context)
    assert len(result.undocumented) == 1
    assert "observation/front (missing)" in result.undocumented[0]


@pytest.mark.parametrize("parts", [{"reward": 7.0}, {"terminated": True}, {"truncated": True}])
def test_another_reward_or_end_is_reported(recordings, parts):
    ours, theirs, context = recordings
    result = compare(changed(ours, 3, **parts), theirs, context)
    assert [text.partition(" ")[0] for text in result.undocumented] == list(parts)


def test_a_shorter_race_is_reported(recordings):
    ours, theirs, context = recordings
    result = compare(replace(ours, moments=ours.moments[:-1]), theirs, context)
    assert result.undocumented[0].startswith("length")


def test_another_space_is_reported(recordings):
    ours, theirs, context = recordings
    spaces = {**ours.action_space, "steer": "Box(-2.0, 2.0, (1,), float32)"}
    result = compare(replace(ours, action_space=spaces), theirs, context)
    assert result.undocumented[0].startswith("action_space/steer")
