"""The vector environment drives the same races as single environments, in slots."""

import logging
import os
import select
import signal
from contextlib import closing

import gymnasium as gym
import numpy as np
import pytest

from stkzoo import (
    ActionError,
    AgentSpec,
    ApiOrderError,
    ConfigError,
    EngineCrashed,
    RaceVectorEnv,
    race_v0,
)
from stkzoo.env.vec.starts import AheadStarts
from stkzoo.views import VIEWS
from tests.support.playing import vector_maker
from tests.support.processes import process_exists, wait_until

OPTIONS = {"num_kart": 3, "agents": 2, "track": "olivermath", "max_cycles": 30}
NUM_STEPS = 70  # two whole races and part of a third one


@pytest.fixture
def make():
    """Makes environments, and closes them after the test."""
    with vector_maker(RaceVectorEnv, **OPTIONS) as make:
        yield make


def random_actions(envs, num_steps=NUM_STEPS):
    envs.action_space.seed(5)
    return [envs.action_space.sample() for _ in range(num_steps)]


def play(envs, actions, seed=1):
    """Returns everything that the environment returns, for comparisons."""
    trace = [envs.reset(seed=seed)]
    trace.extend(envs.step(action) for action in actions)
    return trace


def row(batch, slot):
    return {key: column[slot] for key, column in batch.items()}


def same(one, other):
    """Returns whether two results are equal bit for bit."""
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    if isinstance(one, (list, tuple)):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, np.ndarray) and one.dtype == object:
        return same(list(one), list(other))
    if isinstance(one, np.ndarray):
        return one.dtype == other.dtype and one.tobytes() == other.tobytes()
    return one == other


def pids(envs):
    return [race.live_race.session.pid for race in envs.races]


def next_pids(envs):
    """Returns the process ids of prefetched races."""
    ahead = [race.live_race.starts._next for race in envs.races]
    return [following[1].pid for following in ahead if following]


def are_gone(pids):
    return wait_until(lambda: not any(map(process_exists, pids)))


def info_of(infos, slot):
    """Returns the info of one slot from the arrays."""
    return {
        key: values[slot].item()
        for key, values in infos.items()
        if not key.startswith("_")
        and key not in {"active", "crashed", "track", "final_obs", "final_info"}
        and infos[f"_{key}"][slot]
    }


# ---------------------------------------------------------------------- the same races


@pytest.mark.slow
@pytest.mark.parametrize("prefetch", [False, True])
@pytest.mark.parametrize("view", ["flattened_discrete", "simple"])
def test_slots_equal_the_agents_of_single_races(make, view, prefetch):
    with_all = make(view=view, prefetch=prefetch)
    actions = random_actions(with_all)
    trace = play(with_all, actions)
    with_all.close()
    for number in range(2):
        with race_v0.parallel_env(**OPTIONS, view=view) as race:
            slots = {agent: number * 2 + n for n, agent in enumerate(race.possible_agents)}
            observations, infos = race.reset(seed=1 + number)
            for agent, slot in slots.items():
                assert same(row(trace[0][0], slot), dict(observations[agent]))
                assert info_of(trace[0][1], slot) == infos[agent]
            for action, (batch, rewards, ends, cuts, all_infos) in zip(
                actions, trace[1:], strict=True
            ):
                singles = list(gym.vector.utils.iterate(with_all.action_space, action))
                result = race.step({agent: singles[slot] for agent, slot in slots.items()})
                for agent, slot in slots.items():
                    assert rewards[slot] == result[1][agent]
                    assert ends[slot] == result[2][agent]
                    assert cuts[slot] == result[3][agent]
                if not race.agents:
                    for agent, slot in slots.items():
                        assert same(all_infos["final_obs"][slot], dict(result[0][agent]))
                    result = race.reset()[0], None, None, None, race.infos(race.agents)
                for agent, slot in slots.items():
                    assert same(row(batch, slot), dict(result[0][agent]))
                    assert info_of(all_infos, slot) == result[4][agent]


def test_with_prefetch_the_next_race_is_the_prefetched_one(make):
    envs = make(1, prefetch=True)
    envs.reset(seed=1)
    ahead = next_pids(envs)
    before = pids(envs)
    for action in random_actions(envs, 30):
        envs.step(action)
    assert pids(envs) == ahead
    assert are_gone(before)


@pytest.mark.parametrize("kind", ["state", "scenario"])
def test_no_race_is_prefetched_for_one_that_begins_at_a_moment(make, kind):
    with race_v0.parallel_env(**OPTIONS) as race:
        race.reset(seed=1)
        with race.save_state() as state:
            moment = {"state": state, "scenario": race.scenario()}[kind]
            envs = make(1, prefetch=True, max_cycles=2)
            envs.set_options({kind: moment})
            envs.reset(seed=1)
            for _ in range(3):
                assert next_pids(envs) == []
                envs.step(envs.action_space.sample())
            envs.close()


def test_a_prefetched_race_that_died_is_started_again(make):
    envs = make(1, prefetch=True)
    actions = random_actions(envs)
    expected = play(envs, actions)
    trace = [envs.reset(seed=1)]
    os.kill(next_pids(envs)[0], signal.SIGKILL)
    trace.extend(envs.step(action) for action in actions)
    assert same(trace, expected)
    assert envs.num_crashes == 0


def test_a_seeded_reset_discards_prefetched_races(make):
    envs = make(1, prefetch=True)
    actions = random_actions(envs, 5)
    expected = play(envs, actions, seed=9)
    play(envs, actions, seed=1)
    ahead = next_pids(envs)
    assert same(play(envs, actions, seed=9), expected)
    assert are_gone(ahead)


def test_all_races_start_a_step_before_any_is_waited_for(make):
    envs = make(2)
    envs.reset(seed=1)
    os.kill(pids(envs)[0], signal.SIGSTOP)
    envs.step_async(envs.action_space.sample())
    connection = envs.races[1].live_race.session._process.connection
    assert select.select([connection], [], [], 5.0)[0]
    os.kill(pids(envs)[0], signal.SIGCONT)
    assert envs.step_wait()[4]["active"].all()


# ---------------------------------------------------------------------- seeds


@pytest.mark.slow
@pytest.mark.parametrize("prefetch", [True, False])
def test_set_options_applies_from_the_next_race_until_it_is_changed(make, prefetch):
    envs = make(max_cycles=2, prefetch=prefetch)
    _, infos = envs.reset(seed=1, options={"max_cycles": 3})
    actions = envs.action_space.sample()
    tracks = [[envs.tracks[number] for number in infos["track"]]]
    for step in range(9):
        if step == 1:
            envs.set_options([{"track": "zengarden"}, None])
        if step == 5:
            envs.set_options(None)
        *_, infos = envs.step(actions)
        tracks.append([envs.tracks[number] for number in infos["track"]])
        if "final_info" in infos:
            assert [envs.tracks[number] for number in infos["final_info"]["track"]] == tracks[-2]
    plain, changed = ["olivermath"] * 4, ["zengarden"] * 2 + ["olivermath"] * 2
    # The first race takes three steps. The second and third races have the options.
    assert tracks == [plain] * 3 + [changed] * 4 + [plain] * 3


def test_options_of_reset_override_those_of_set_options(two_races):
    two_races.set_options({"track": "zengarden", "laps": 2})
    two_races.reset(seed=1, options={"track": "lighthouse"})
    assert [(each.race.track, each.race.laps) for each in two_races.races] == [
        ("lighthouse", 2)
    ] * 2
    two_races.set_options({})


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"trakc": "hacienda"}, "unknown option 'trakc'.*Did you mean 'track'"),
        ({"track": "hacienda2"}, "unknown track"),
        ({"num_kart": 5}, "5 karts, but this environment has 3"),
        ([{}], "a list of 2, one per race"),
        ([{}, {"difficulty": 9}], "difficulty is 9"),
    ],
)
def test_set_options_refuses_invalid_options_and_changes_nothing(two_races, options, message):
    two_races.set_options({"laps": 2})
    with pytest.raises(ConfigError, match=message):
        two_races.set_options(options)
    two_races.reset(seed=1)
    assert [race.race.laps for race in two_races.races] == [2, 2]
    two_races.set_options({})


def test_set_options_refuses_moments_of_other_races(two_races, tmp_path):
    with race_v0.parallel_env(num_kart=4, track="olivermath") as env:
        env.reset(seed=1)
        with env.save_state() as state:
            for options, message in (
                ({"state": state}, "the state has 4 karts and 4 agents, but"),
                ({"scenario": env.scenario()}, "the scenario has 4 karts and 4 agents, but"),
                ({"state": 3}, "state is 3, expected a RaceState from save_state"),
                ({"scenario": tmp_path / "none"}, "cannot be read"),
            ):
                with pytest.raises(ConfigError, match=message):
                    two_races.set_options([{}, options])


@pytest.fixture(scope="module")
def two_races():
    with closing(RaceVectorEnv(2, **OPTIONS, prefetch=False)) as envs:
        yield envs


# ---------------------------------------------------------------------- ends of episodes


def test_infos_have_the_last_observation_and_sums_of_an_episode(make):
    envs = make()
    trace = play(envs, random_actions(envs, 30))
    _, _, ends, cuts, infos = trace[-1]
    assert cuts.all()
    assert not ends.any()
    returns = sum(step[1] for step in trace[1:])
    episode = infos["final_info"]["episode"]
    assert np.array_equal(episode["r"], returns)
    assert (episode["l"] == 30).all()
    assert all(obs in envs.single_observation_space for obs in infos["final_obs"])
    assert (infos["final_info"]["episode/length"] == 30).all()
    assert (infos["episode/length"] == 0).all()


class Finishes:
    """A race in which three bots are agents and finish at different times, and the next race."""

    def __init__(self):
        envs = RaceVectorEnv(
            1, agents=[AgentSpec(use_ai=True)] * 3, num_kart=3, track="olivermath", prefetch=True
        )
        self.steps = [(*envs.reset(seed=2), envs.racing)]
        self.results = []
        action = envs.action_space.sample()
        while sum(result[2].any() for result in self.results) < 3:
            self.results.append((*envs.step(action), envs.racing))
        self.results.append((*envs.step(action), envs.racing))
        envs.close()
        self.ends = [
            next(t for t, result in enumerate(self.results) if result[2][slot]) for slot in range(3)
        ]
        self.early = int(np.argmin(self.ends))
        self.idle = range(min(self.ends) + 1, max(self.ends) + 1)


@pytest.fixture(scope="module")
def finishes():
    return Finishes()


@pytest.mark.slow
def test_an_agent_that_finishes_is_terminated_once(finishes):
    terminations = sum(result[2].astype(int) for result in finishes.results)
    assert terminations.tolist() == [1, 1, 1]
    assert len(set(finishes.ends)) > 1


def test_an_idle_slot_has_only_zeros_until_its_race_restarts(finishes):
    for step in finishes.idle:
        _, rewards, ends, cuts, _, _ = finishes.results[step]
        assert (rewards[finishes.early], ends[finishes.early], cuts[finishes.early]) == (0, 0, 0)
        before = finishes.results[step - 1][0]
        assert not any(np.any(part) for part in row(before, finishes.early).values())
    assert finishes.results[finishes.idle[-1]][0]["continuous"][finishes.early].any()


def test_only_transitions_of_racing_agents_are_active(finishes):
    last = max(finishes.ends)
    for step, result in enumerate(finishes.results):
        expected = [step <= end or step > last for end in finishes.ends]
        assert result[4]["active"].tolist() == expected
        if step:
            assert finishes.results[step - 1][5].tolist() == expected  # racing, a step earlier


# ---------------------------------------------------------------------- crashes


@pytest.mark.slow
@pytest.mark.parametrize("prefetch", [False, True])
def test_a_killed_game_is_replaced_and_the_others_continue(make, prefetch, caplog):
    envs = make(prefetch=prefetch)
    actions = random_actions(envs)
    expected = play(envs, actions)
    trace = [envs.reset(seed=1)]
    for step, action in enumerate(actions):
        if step == 10:
            os.kill(pids(envs)[0], signal.SIGKILL)
        trace.append(envs.step(action))
    _, rewards, ends, cuts, infos = trace[11]
    assert cuts.tolist() == [True, True, False, False]
    assert infos["crashed"].tolist() == [True, True, False, False]
    assert not ends.any()
    assert not rewards[:2].any()
    assert same(infos["final_obs"][0], row(trace[10][0], 0))
    assert infos["final_info"]["episode"]["l"].tolist() == [11, 11, 0, 0]
    assert envs.num_crashes == 1
    assert [record.levelno for record in caplog.records] == [logging.WARNING]
    assert "race 0" in caplog.text
    assert "SIGKILL" in caplog.text
    for one, other in zip(trace, expected, strict=True):
        assert same(row(one[0], 2), row(other[0], 2))
    assert trace[-1][4]["active"].all()


def test_the_infos_of_a_crash_have_no_rewards_of_the_step_before(make):
    envs = make(reward={"always": lambda step: np.ones(len(step.after.karts))})
    envs.reset(seed=1)
    before = envs.step(envs.action_space.sample())[4]
    os.kill(pids(envs)[0], signal.SIGKILL)
    _, rewards, _, _, infos = envs.step(envs.action_space.sample())
    last = infos["final_info"]
    assert before["reward/always"].tolist() == [1.0] * 4
    assert last["reward/always"][:2].tolist() == rewards[:2].tolist() == [0.0, 0.0]
    assert last["episode/reward/always"][:2].tolist() == [1.0, 1.0]


@pytest.mark.slow
def test_a_hanging_game_is_replaced(make):
    envs = make(engine_timeout=0.3)
    envs.reset(seed=1)
    os.kill(pids(envs)[1], signal.SIGSTOP)
    cuts = envs.step(envs.action_space.sample())[3]
    assert cuts.tolist() == [False, False, True, True]
    assert envs.num_crashes == 1
    assert envs.step(envs.action_space.sample())[4]["active"].all()


# ---------------------------------------------------------------------- Gymnasium's API


def test_the_random_streams_and_their_seeds_are_those_of_the_races(make):
    envs = make()
    assert envs.np_random_seed == (-1, -1)
    for seed in ([7, None], None):
        envs.reset(seed=seed)
        assert envs.np_random_seed == (7, -1)
        assert envs.np_random == tuple(race.np_random for race in envs.races)


# ---------------------------------------------------------------------- errors


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"view": "full"}, "differ in size"),
        ({"agents": [AgentSpec(), AgentSpec(use_ai=True)]}, "use_ai to all of them"),
        ({"view": {"kart_0": "simple", "kart_1": "flattened"}}, "the same view"),
        ({"render_mode": "human"}, "render_mode"),
        ({"use_subprocess": False}, "use_subprocess"),
        ({"num_races": 0}, "num_races is 0"),
        ({"prefetch": "yes"}, "prefetch is 'yes'"),
    ],
)
def test_invalid_options_are_refused(make, options, message):
    with pytest.raises(ConfigError, match=message):
        make(**options)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ([{}, {}], "expected a dict from names of options"),
        ({"reset_mask": np.ones(4, np.bool_)}, "reset_mask"),
    ],
)
def test_invalid_options_of_a_reset_are_refused(two_races, options, message):
    with pytest.raises(ConfigError, match=message):
        two_races.reset(options=options)


@pytest.mark.parametrize("starts", [{}, {"num_starts": 2}])
@pytest.mark.parametrize("seed", [-5, [1.5, None], [None, -1], True, [1, 2, 3]])
def test_invalid_seeds_are_refused(make, seed, starts):
    envs = make(**starts)
    with pytest.raises(ConfigError, match=r"seed is|one per race"):
        envs.reset(seed=seed)


def test_infos_of_wrappers_can_be_arrays_and_large_whole_numbers(make):
    class Marks(gym.Wrapper):
        def step(self, action):
            *parts, info = self.env.step(action)
            own = {"place": np.array([action, 2.0]), "marks": [1, action], "big": 2**60 + 1}
            return *parts, info | own

    envs = make(view=lambda env: Marks(VIEWS["flattened_discrete"](env)))
    envs.reset(seed=1)
    infos = envs.step([700, 701, 702, 703])[-1]
    assert infos["place"].tolist() == [[700.0 + slot, 2.0] for slot in range(4)]
    assert infos["marks"].tolist() == [[1, 700 + slot] for slot in range(4)]
    assert infos["_place"].all()
    assert infos["big"].tolist() == [2**60 + 1] * 4


@pytest.mark.parametrize("actions", [[0, 0, 0], [0, 0, 0, 0, 0], None, 3])
def test_a_wrong_number_of_actions_is_refused(make, actions):
    envs = make()
    envs.reset(seed=1)
    with pytest.raises(ActionError, match="4 slots"):
        envs.step(actions)


def test_calls_in_the_wrong_order_are_refused(make):
    envs = make()
    actions = envs.action_space.sample()
    with pytest.raises(ApiOrderError, match=r"reset\(\)"):
        envs.step(actions)
    with pytest.raises(ApiOrderError, match="step_async"):
        envs.step_wait()
    envs.reset(seed=1)
    envs.step_async(actions)
    with pytest.raises(ApiOrderError, match="step_wait"):
        envs.step_async(actions)
    envs.close()
    for call in (envs.reset, lambda: envs.step(actions)):
        with pytest.raises(ApiOrderError, match="close"):
            call()


def test_reset_can_be_called_between_step_async_and_step_wait(make):
    envs = make()
    actions = random_actions(envs, 5)
    expected = play(envs, actions)
    envs.step_async(actions[0])
    assert same(play(envs, actions), expected)


def test_a_race_that_does_not_start_is_an_error(make, monkeypatch):
    envs = make(1, prefetch=False)
    envs.reset(seed=1)

    def start_and_die(_, setup, session):
        session.start(setup)
        os.kill(session.pid, signal.SIGKILL)
        session.step(np.zeros((2, 7), np.float32))

    monkeypatch.setattr(AheadStarts, "begin", start_and_die)
    with pytest.raises(EngineCrashed, match="SIGKILL"):
        envs.reset()
    assert envs.num_crashes == 2
    with pytest.raises(ApiOrderError, match="reset"):
        envs.step(envs.action_space.sample())


# ---------------------------------------------------------------------- processes


@pytest.mark.parametrize("prefetch", [False, True])
def test_closing_leaves_no_process(make, prefetch):
    envs = make(prefetch=prefetch)
    envs.reset(seed=1)
    everybody = [*pids(envs), *next_pids(envs)]
    assert len(everybody) == (4 if prefetch else 2)
    envs.close()
    envs.close()
    assert are_gone(everybody)


def test_an_unreferenced_environment_leaves_no_process():
    envs = RaceVectorEnv(2, **OPTIONS, prefetch=True)
    envs.reset(seed=1)
    everybody = [*pids(envs), *next_pids(envs)]
    del envs
    assert are_gone(everybody)


# ---------------------------------------------------------------------- one race


def test_requesting_twice_or_waiting_without_a_request_is_an_error():
    with race_v0.parallel_env(**OPTIONS, view="flattened_discrete") as race:
        race.reset(seed=1)
        with pytest.raises(ApiOrderError, match="step_async"):
            race.step_wait()
        race.step_async(dict.fromkeys(race.agents, 0))
        with pytest.raises(ApiOrderError, match="step_wait"):
            race.step_async(dict.fromkeys(race.agents, 0))
        race.reset(seed=1)
        assert race.step(dict.fromkeys(race.agents, 0))[1].keys() == {"kart_0", "kart_1"}
