"""On all tracks, the default reward is higher for better driving.

``tests/data/rewards.npz`` has a race of six karts on each track in each direction, one row per
second. Three karts do nothing useful; three drivers race. ``benchmarks/rewards.py`` recorded it, at
commit 402b4c78.
"""

from dataclasses import dataclass, replace
from itertools import count, pairwise

import gymnasium as gym
import numpy as np
import pytest

from stkzoo import AgentSpec, RaceVectorEnv, race_v0
from stkzoo.engine.snapshot import HEADER_DTYPE, ITEM_DTYPE, KART_DTYPE, Snapshot
from stkzoo.mdp.rewards import REWARDS
from stkzoo.mdp.spaces import kart_action_space
from stkzoo.mdp.transition import Transition
from stkzoo.tracks import SPLITS
from tests.support.paths import ROOT
from tests.support.rewards import values_of

#: What each kart does, in grid order.
KARTS = ("stands", "rescues", "reverses", "AI 0", "pursuit", "heuristic")
IDLERS = 3
#: Fields of a kart that the built-in rewards read.
FIELDS = ["overall_distance", "position", "has_finished_race", "finish_time"]
ACTIONS = ({}, {"rescue": 1}, {"brake": 1})


@dataclass(frozen=True)
class RecordedRace:
    """A race: its length [m], one row of karts for each recorded step, and those steps."""

    length: float
    karts: np.ndarray
    steps: np.ndarray

    def returns(self, name):
        """Returns the return of each kart over the race for a built-in reward.

        Sums of potentials and of rewards at the finish do not depend on the sampling interval. The
        rank term of the reference's formula does: it needs every step.
        """
        totals = np.zeros(len(KARTS))
        for row, (before, after) in enumerate(pairwise(map(snapshot, self.karts))):
            terms = values_of(REWARDS[name], Transition(before, after, self.length))
            if "time" in terms:  # earned in every step
                terms["time"] = terms["time"] * (self.steps[row + 1] - self.steps[row])
            is_racing = before.karts["has_finished_race"] == 0
            totals += np.where(is_racing, sum(terms.values()), 0.0)
        return totals

    def finishers(self):
        """Returns the karts that finished, the winner first."""
        times = self.karts["finish_time"].max(axis=0)
        return [kart for kart in np.argsort(times) if times[kart] > 0]


def snapshot(row):
    header = np.zeros(1, HEADER_DTYPE)
    header["num_kart"] = len(row)
    karts = np.zeros(len(row), KART_DTYPE)
    for name in FIELDS:
        karts[name] = row[name]
    return Snapshot.of(header[0], karts, np.zeros(0, ITEM_DTYPE))


def recorded():
    """Returns the recorded races by track and direction."""
    kinds = [(name, KART_DTYPE[name]) for name in FIELDS]
    races = {}
    with np.load(ROOT / "tests" / "data" / "rewards.npz") as arrays:
        for name in [key.removesuffix("/length") for key in arrays if key.endswith("/length")]:
            steps = arrays[f"{name}/steps"]
            karts = np.zeros((len(steps), len(KARTS)), kinds)
            for field in FIELDS:
                karts[field] = arrays[f"{name}/{field}"]
            races[name] = RecordedRace(float(arrays[f"{name}/length"]), karts, steps)
    return races


def drive(track, every=1):
    """Runs a race until its drivers have finished, and records every ``every`` steps."""
    with race_v0.parallel_env(
        agents=[AgentSpec(rank_start=kart) for kart in range(IDLERS)],
        num_kart=len(KARTS),
        opponents=["ai:0", "pursuit", "heuristic"],
        track=track,
        max_cycles=None,
    ) as env:
        env.reset(seed=1)
        actions = dict(zip(env.agents, map(action, ACTIONS), strict=True))
        steps, rows = [0], [env.snapshot.karts[FIELDS].copy()]
        for step in count(1):
            env.step(actions)
            karts = env.snapshot.karts[FIELDS]
            has_new = (karts["has_finished_race"] > rows[-1]["has_finished_race"]).any()
            if step % every == 0 or has_new:
                rows.append(karts.copy())
                steps.append(step)
            if karts["has_finished_race"][IDLERS:].all():
                break
        return RecordedRace(env.track_map.length, np.stack(rows), np.array(steps))


def action(wanted):
    """Returns an action in which all other entries are 0."""
    zeros = {key: np.zeros_like(value) for key, value in kart_action_space().sample().items()}
    return zeros | {key: np.full_like(zeros[key], value) for key, value in wanted.items()}


RACES = recorded()


def check_order(race):
    """Checks that idle karts have negative returns, and that earlier finishers earn more."""
    returns, finishers = race.returns("race"), race.finishers()
    assert sorted(finishers) == list(range(IDLERS, len(KARTS)))
    assert (returns[:IDLERS] < 0).all()
    earned = returns[finishers]
    assert (earned > 0).all()
    assert (np.diff(earned) < 0).all()


def test_on_every_track_idle_karts_lose_and_faster_drivers_earn_more():
    assert set(RACES) == {track + way for track in SPLITS["all"] for way in ("", "-reverse")}
    for race in RACES.values():
        check_order(race)


def test_a_return_follows_the_formula():
    for name, race in RACES.items():
        returns = race.returns("race")
        for place, kart in enumerate(race.finishers(), start=1):
            steps = race.steps[race.karts["has_finished_race"][:, kart].argmax()]
            places = 20 * (len(KARTS) - place) / (len(KARTS) - 1)
            expected = race.length / 10 + places + 10 - 0.02 * steps
            assert returns[kart] == pytest.approx(expected, rel=1e-6), name


def test_half_a_race_earns_less_than_a_whole_one():
    drivers = slice(IDLERS, None)
    for race in RACES.values():
        middle = len(race.karts) // 2
        half = replace(race, karts=race.karts[:middle], steps=race.steps[:middle])
        assert (half.returns("race")[drivers] < race.returns("race")[drivers]).all()
        assert (half.returns("race")[drivers] > 0).all()


@pytest.mark.slow
def test_the_engine_reproduces_the_recorded_returns():
    live, kept = drive("olivermath", every=10), RACES["olivermath"]
    check_order(live)
    assert live.returns("race") == pytest.approx(kept.returns("race"))


@pytest.mark.slow
def test_the_reference_formula_rewards_a_kart_that_stands_still():
    assert drive("olivermath").returns("reference")[0] > 0


RACE = {"track": "olivermath", "num_kart": 2}


@pytest.mark.parametrize(
    ("make", "term"),
    [
        (lambda: race_v0.parallel_env(**RACE), "advance"),
        (lambda: gym.make("supertuxkart/simple-v0", **RACE), "rank"),
        (lambda: gym.make("supertuxkart/simple-v0", **RACE, reward="race"), "advance"),
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
