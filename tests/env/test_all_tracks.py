"""All of the game's tracks can be raced on in both directions."""

from __future__ import annotations

import functools

import pytest

from stkzoo import race_v0
from stkzoo.engine.assets import find_assets
from stkzoo.tracks import SPLITS
from tests.support.playing import assert_in, kart_action, play
from tests.support.views import marked

pytestmark = pytest.mark.slow

NUM_STEPS = 60


@pytest.mark.parametrize("reverse", [False, True], ids=["forward", "reverse"])
@pytest.mark.parametrize("track", marked(SPLITS["all"], ("lighthouse", "zengarden")))
def test_a_track_can_be_raced_on(track, reverse):
    # max_paths: without a limit, the full view of the longest track is large.
    make = functools.partial(race_v0.parallel_env, track=track, reverse=reverse, max_paths=50)
    top_speed = 0.0
    with make(num_kart=2) as env:
        for step in play(env, 1, max_steps=NUM_STEPS, policy=full_throttle):
            for agent, observation in step.observations.items():
                assert_in(env.observation_space(agent), observation, agent)
            top_speed = max(top_speed, env.snapshot.karts["speed"].max())
        assert step.number == NUM_STEPS
        assert env.race.track == track
    assert top_speed > 5.0


def test_the_split_contains_all_tracks_of_the_game():
    assert set(SPLITS["all"]) == set(find_assets().tracks)


def full_throttle(step):
    return dict.fromkeys(step.agents, kart_action(1.0))
