"""On all tracks, the default reward is higher for better driving.

The races were recorded by ``python -m benchmarks.rewards --record``.
"""

import gymnasium as gym
import numpy as np
import pytest

from benchmarks.rewards import IDLERS, KARTS, RecordedRace, drive, recorded
from stkzoo import RaceVectorEnv, race_v0
from stkzoo.tracks import SPLITS

RACES = {f"{race.track}-{race.reverse}": race for race in recorded()}


def check_order(race: RecordedRace) -> None:
    """Checks that idle karts have negative returns, and that earlier finishers earn more."""
    returns, finishers = race.returns("race"), race.finishers()
    assert sorted(finishers) == list(range(IDLERS, len(KARTS)))
    assert (returns[:IDLERS] < 0).all()
    earned = returns[finishers]
    assert (earned > 0).all()
    assert (np.diff(earned) < 0).all()


def test_every_track_is_recorded_in_both_directions():
    assert set(RACES) == {f"{track}-{way}" for track in SPLITS["all"] for way in (False, True)}


@pytest.mark.parametrize("name", RACES)
def test_idle_karts_lose_and_faster_drivers_earn_more(name):
    check_order(RACES[name])


@pytest.mark.parametrize("name", RACES)
def test_a_return_follows_the_formula(name):
    race = RACES[name]
    returns = race.returns("race")
    for place, kart in enumerate(race.finishers(), start=1):
        steps = race.steps[race.karts["has_finished_race"][:, kart].argmax()]
        places = 20 * (len(KARTS) - place) / (len(KARTS) - 1)
        assert returns[kart] == pytest.approx(
            race.length / 10 + places + 10 - 0.02 * steps, rel=1e-6
        )


@pytest.mark.parametrize("name", RACES)
def test_half_a_race_earns_less_than_a_whole_one(name):
    race = RACES[name]
    half_way = len(race.karts) // 2
    half = RecordedRace(
        race.track, race.reverse, race.length, race.karts[:half_way], race.steps[:half_way]
    )
    drivers = slice(IDLERS, None)
    assert (half.returns("race")[drivers] < race.returns("race")[drivers]).all()
    assert (half.returns("race")[drivers] > 0).all()


def test_the_engine_reproduces_the_recorded_returns():
    live, kept = drive("olivermath", reverse=False), RACES["olivermath-False"]
    check_order(live)
    assert live.returns("race") == pytest.approx(kept.returns("race"))


def test_the_reference_formula_rewards_a_kart_that_stands_still():
    assert drive("olivermath", reverse=False, every=1).returns("reference")[0] > 0


RACE = {"track": "olivermath", "num_kart": 2}


@pytest.mark.parametrize(
    ("make", "term"),
    [
        (lambda: race_v0.parallel_env(**RACE), "advance"),
        (lambda: gym.make("supertuxkart/simple-v0", **RACE), "rank"),
        (lambda: gym.make("supertuxkart/simple-v0", **RACE, reward="race"), "advance"),
        (lambda: gym.make("supertuxkart/simple-v0", **RACE, reward={"rank": 2.0}), "rank"),
        (lambda: gym.make("supertuxkart/multi-full-v0", **RACE, reward={"0": "race"}), "rank"),
        (lambda: RaceVectorEnv(**RACE), "advance"),
        (
            lambda: gym.make_vec(
                "supertuxkart/simple-v0", 1, vectorization_mode="vector_entry_point", **RACE
            ),
            "rank",
        ),
    ],
)
def test_ids_of_the_reference_keep_its_formula_and_others_use_the_default(make, term):
    env = make()
    _, infos = env.reset(seed=1)
    env.close()
    assert f"reward/{term}" in str(infos)
