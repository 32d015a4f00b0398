from __future__ import annotations

import gc
import threading

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.wrappers import (
    FrameStackObservation,
    RecordEpisodeStatistics,
    TimeLimit,
    TransformAction,
)

from stkzoo.engine.snapshot import CONTROLS
from stkzoo.errors import ActionError, AgentException
from stkzoo.views import AgentChains
from stkzoo.wrappers import FlattenerWrapper
from tests.support.generic_env import RandomMoment, assert_same, kart_env, wrap
from tests.support.playing import kart_action


def make_chains(*factories, ai=()):
    agents = [f"kart_{number}" for number in range(len(factories))]
    return AgentChains(dict(zip(agents, factories, strict=True)), ai)


def view(name):
    return lambda env: wrap(env, name)


def flat_observation(env):
    """Reduces the observation to the velocity vector."""
    box = spaces.Box(-np.inf, np.inf, (3,), np.float32)
    return gym.wrappers.TransformObservation(env, lambda obs: obs["velocity"], box)


class TenTimes(gym.RewardWrapper):
    def reward(self, reward):
        return 10 * reward


def decode(chains, actions, agents):
    """Returns the base actions of the agents, one row each."""
    moment = RandomMoment(np.random.default_rng(0))
    return chains.convert(chains.check(actions, moment.seats(agents)), moment)


def decoded(chains, actions, agents):
    """Returns the decoded actions by key of the base action space."""
    controls = decode(chains, actions, agents)
    assert (controls.dtype, controls.shape) == (np.float32, (len(agents), 7))
    return dict(zip(CONTROLS, controls.T, strict=True))


class Race:
    """Feeds chains with random observations, as a race would."""

    def __init__(self, chains, seed=0):
        self.chains = chains
        self.agents = list(chains.action_spaces)
        self.random = np.random.default_rng(seed)

    def reset(self, seed=None, options=None):
        infos = {agent: {"position": 1} for agent in self.agents}
        self.moment = RandomMoment(self.random)
        seats = self.moment.seats(self.agents)
        return self.chains.reset(seats, self.moment, infos, seed=seed, options=options)

    def step(self, actions, agents=None, terminated=False):
        agents = self.agents if agents is None else agents
        self.controls = decoded(self.chains, actions, agents)
        self.moment = RandomMoment(self.random)
        seats = self.moment.seats(agents)
        parts = (
            self.chains.observe(seats, self.moment),
            {agent: float(self.agents.index(agent) + 1) for agent in agents},
            dict.fromkeys(agents, terminated),
            dict.fromkeys(agents, False),
            {agent: {"position": 1} for agent in agents},
        )
        self.chains.finish(seats, parts)
        return parts

    def sample(self):
        return {agent: space.sample() for agent, space in self.chains.action_spaces.items()}


STEADY = kart_action(1.0)


def threads():
    return [thread for thread in threading.enumerate() if thread is not threading.main_thread()]


# ---------------------------------------------------------------- views


def test_rows_follow_the_order_of_the_agents():
    chains = make_chains(view("full"), view("flattened_discrete"), view("full"))
    actions = {
        "kart_0": {**STEADY, "steer": -0.5},
        "kart_1": 6,
        "kart_2": {**STEADY, "steer": 0.5},
    }
    controls = decoded(chains, actions, ["kart_2", "kart_1", "kart_0"])
    assert controls["steer"].tolist() == [0.5, -1.0, -0.5]


class Slower(gym.ObservationWrapper):
    def observation(self, observation):
        return {**observation, "velocity": observation["velocity"] / 2}


class SlowerByStep(gym.Wrapper):
    def step(self, action):
        observation, *rest = self.env.step(action)
        return {**observation, "velocity": observation["velocity"] / 2}, *rest


@pytest.mark.parametrize("users_own", [Slower, SlowerByStep])
def test_wrappers_around_a_user_wrapper_get_its_observations(users_own):
    race = Race(make_chains(lambda env: FlattenerWrapper(users_own(wrap(env, "simple")))))
    race.reset()
    (observation,) = race.step(race.sample())[0].values()
    env = FlattenerWrapper(Slower(wrap(kart_env(), "simple")))
    (base,) = race.moment.full(race.agents)
    for wrapper in (env.env.env.env, env.env.env, env.env, env):
        base = wrapper.observation(base)
    assert_same(observation, base)


# ---------------------------------------------------------------- actions


@pytest.mark.parametrize(
    ("key", "values"),
    [
        ("steer", [0.5, np.float64(0.5), np.array(0.5), [0.5], np.array([0.5]), [[0.5]]]),
        ("steer", [1, 1 + 9e-7]),  # out of bounds by rounding
        ("brake", [1, True, np.True_, np.int8(1), np.array([1]), 1.0]),
    ],
)
def test_a_value_can_have_any_form(key, values):
    chains, agents = make_chains(None, None), ["kart_0", "kart_1"]
    for value in values:
        actions = {"kart_0": STEADY, "kart_1": {**STEADY, key: value}}
        assert decoded(chains, actions, agents)[key].tolist() == [0, values[0]]


@pytest.mark.parametrize("actions", [{}, {"kart_0": {**STEADY}}, {"kart_0": "rubbish"}])
@pytest.mark.parametrize("factory", [None, TenTimes, lambda env: TimeLimit(env, 9)])
def test_actions_of_an_ignored_agent_have_no_effect(actions, factory):
    chains = make_chains(factory, None, ai={"kart_0"})
    race = Race(chains)
    race.reset()
    race.step({**actions, "kart_1": STEADY})
    assert race.controls["acceleration"].tolist() == [0.0, 1.0]


def test_actions_are_checked_before_any_wrapper_sees_one():
    seen = []

    class Spy(gym.ActionWrapper):
        def action(self, action):
            seen.append(action)
            return action

    chains = make_chains(Spy, None)
    with pytest.raises(ActionError):
        decoded(chains, {"kart_0": STEADY, "kart_1": 3}, ["kart_0", "kart_1"])
    assert seen == []


def test_the_action_after_a_user_wrapper_is_checked_too():
    factory = lambda env: TransformAction(  # noqa: E731
        env, lambda action: {**action, "steer": 7}, env.action_space
    )
    chains = make_chains(factory)
    with pytest.raises(ActionError, match=r"action after its wrappers\['steer'\].*is 7"):
        decoded(chains, {"kart_0": STEADY}, ["kart_0"])


def test_other_action_spaces_use_their_own_checks():
    def factory(env):
        space = spaces.MultiBinary(2)
        return TransformAction(env, lambda pressed: {**STEADY, "fire": pressed[0]}, space)

    chains = make_chains(factory)
    pressed = np.array([1, 0], np.int8)
    assert decoded(chains, {"kart_0": pressed}, ["kart_0"])["fire"].tolist() == [1]
    with pytest.raises(ActionError, match="MultiBinary"):
        decoded(chains, {"kart_0": 1}, ["kart_0"])


# ---------------------------------------------------------------- any wrapper


def test_frames_are_stacked():
    chains = make_chains(
        lambda env: FrameStackObservation(flat_observation(env), 3), flat_observation
    )
    race = Race(chains)
    first = race.reset()[0]["kart_0"]
    second = race.step(race.sample())[0]["kart_0"]
    assert first.shape == (3, 3)
    assert np.array_equal(second[:2], first[1:])
    assert np.array_equal(second[2], race.moment.full(race.agents)[0]["velocity"])


def test_a_time_limit_truncates_its_agent_only():
    race = Race(make_chains(lambda env: TimeLimit(env, 2), None))
    race.reset()
    ends = [race.step(race.sample())[3] for _ in range(2)]
    assert ends[0] == {"kart_0": False, "kart_1": False}
    assert ends[1] == {"kart_0": True, "kart_1": False}


def test_episode_statistics_are_recorded():
    race = Race(make_chains(RecordEpisodeStatistics, None))
    race.reset()
    race.step(race.sample())
    infos = race.step(race.sample(), terminated=True)[4]
    assert (infos["kart_0"]["episode"]["r"], infos["kart_0"]["episode"]["l"]) == (2.0, 2)
    assert "episode" not in infos["kart_1"]


def test_a_wrapper_with_its_own_step_changes_actions_and_rewards():
    class Own(gym.Wrapper):
        def step(self, action):
            observation, reward, *rest = self.env.step({**action, "fire": 1})
            return observation, reward - 5, *rest

    race = Race(make_chains(Own, None))
    race.reset()
    rewards = race.step({"kart_0": STEADY, "kart_1": STEADY})[1]
    assert race.controls["fire"].tolist() == [1, 0]
    assert rewards == {"kart_0": -4.0, "kart_1": 2.0}


def test_reset_seeds_each_wrapper_differently():
    class Noise(gym.ObservationWrapper):
        def __init__(self, env):
            super().__init__(env)
            self.observation_space = spaces.Box(0, 1, (1,))

        def observation(self, _):
            return self.np_random.random(1).astype(np.float32)

    race = Race(make_chains(Noise, Noise))
    first, second = race.reset(seed=5)[0], race.reset(seed=np.int64(5))[0]
    assert_same(first, second)
    assert first["kart_0"] != first["kart_1"]
    assert race.reset()[0]["kart_0"] != first["kart_0"]


# ---------------------------------------------------------------- failures


def fail(*_, **__):
    raise ValueError("oh dear")


def failing(method):
    base = gym.ObservationWrapper if method == "observation" else gym.Wrapper
    return type("Failing", (base,), {method: fail})


class FailsAfterwards(gym.Wrapper):
    def step(self, action):
        self.env.step(action)
        raise ValueError("oh dear")


@pytest.mark.parametrize(
    "factory",
    [fail, lambda env: 3, lambda env: kart_env()],  # noqa: ARG005
)
def test_a_factory_that_fails_names_its_agent(factory):
    with pytest.raises(AgentException, match="'kart_1' failed to wrap") as caught:
        make_chains(None, factory)
    assert caught.value.key == "kart_1"


@pytest.mark.parametrize(
    "factory", [failing("reset"), failing("observation"), failing("step"), FailsAfterwards]
)
def test_a_wrapper_that_fails_names_its_agent(factory):
    race = Race(make_chains(None, factory))
    with pytest.raises(AgentException, match="ValueError: oh dear") as caught:
        race.reset(), race.step(race.sample())
    assert caught.value.key == "kart_1"
    assert isinstance(caught.value.__cause__, ValueError)


@pytest.mark.parametrize(
    ("method", "function", "text"),
    [
        ("step", lambda self, action: (0, 0.0, False, False, {}), "without a call"),  # noqa: ARG005
        ("step", lambda self, action: (self.env.step(action), self.env.step(action))[1], "twice"),
        ("step", lambda self, action: (self.env.step(action), self.env.reset()), "middle of a"),
        ("reset", lambda self, **_: self.env.step(STEADY), "outside its own step"),
    ],
)
def test_a_wrapper_must_step_the_race_exactly_once(method, function, text):
    race = Race(make_chains(type("Odd", (gym.Wrapper,), {method: function})))
    with pytest.raises(AgentException, match=text):
        race.reset(), race.step(race.sample())


def test_a_race_continues_after_a_failure_and_a_reset():
    calls = []

    class FailsOnce(gym.Wrapper):
        def step(self, action):
            calls.append(action)
            if len(calls) == 1:
                raise ValueError("oh dear")
            return self.env.step(action)

    race = Race(make_chains(lambda env: TimeLimit(env, 5), FailsOnce))
    race.reset()
    with pytest.raises(AgentException):
        race.step(race.sample())
    race.reset()
    assert race.step(race.sample())[3] == {"kart_0": False, "kart_1": False}


# ---------------------------------------------------------------- threads


def test_no_threads_exist_between_steps():
    race = Race(make_chains(*[lambda env: TimeLimit(env, 5)] * 3))
    race.reset()
    race.step(race.sample())
    assert threads() == []


def end_of(waiting):
    for thread in waiting:
        thread.join(timeout=5)
    return [thread for thread in waiting if thread.is_alive()]


@pytest.mark.parametrize("ending", ["close", "reset", "decode", "collect"])
def test_a_waiting_thread_ends_with_its_step(ending):
    race = Race(make_chains(lambda env: TimeLimit(env, 5)))
    race.reset()
    decode(race.chains, race.sample(), race.agents)
    waiting = threads()
    assert len(waiting) == 1
    if ending == "close":
        race.chains.close()
    elif ending == "reset":
        race.reset()
    elif ending == "decode":
        decode(race.chains, race.sample(), race.agents)
    else:
        race.chains = None
        gc.collect()
    assert end_of(waiting) == []
    if race.chains is not None:
        race.chains.close()
