"""Events in infos: steps, episodes, saved states, vector environments and opponents."""

import numpy as np
import pytest

from stkzoo import ConfigError, Start, race_v0
from stkzoo.mdp.events import EVENTS

#: The first kart blocks the second one.
RAM = {"kart_0": Start(distance=30.0), "kart_1": Start(distance=22.0, speed=15.0)}
SETTINGS = {"num_kart": 3, "agents": 2, "track": "lighthouse", "view": "flattened", "events": True}


def drive(throttle):
    return {"continuous": np.array([throttle, 0.0], "f4"), "discrete": np.zeros(5, int)}


ACTIONS = {"kart_0": drive(0.0), "kart_1": drive(1.0)}


def run(env, steps):
    """Returns the last infos and the sums of the events over all steps, by agent."""
    sums = {agent: dict.fromkeys(EVENTS, 0.0) for agent in env.possible_agents}
    infos = {}
    for _ in range(steps):
        if env.agents:
            infos |= env.step({agent: ACTIONS[agent] for agent in env.agents})[4]
            for agent, own in sums.items():
                for name in EVENTS:
                    own[name] += infos[agent][f"event/{name}"]
    return infos, sums


def episode_events(infos):
    return {
        agent: {name: info[f"episode/event/{name}"] for name in EVENTS}
        for agent, info in infos.items()
    }


def test_an_episodes_events_are_the_sums_of_its_steps():
    with race_v0.parallel_env(**SETTINGS, start=RAM) as env:
        _, infos = env.reset(seed=1)
        assert not any(any(own.values()) for own in episode_events(infos).values())
        infos, sums = run(env, 60)
        found = episode_events(infos)
        for agent, own in sums.items():
            assert own == pytest.approx(found[agent])
        assert sums["kart_0"]["kart_contact"] == sums["kart_1"]["kart_contact"] > 0
        assert episode_events(env.infos(env.agents)) == found


def test_a_saved_state_keeps_the_counts_but_an_episode_from_it_starts_at_zero():
    with race_v0.parallel_env(**SETTINGS, start=RAM) as env:
        env.reset(seed=1)
        contacts = run(env, 10)[1]["kart_1"]["kart_contact"]
        assert contacts > 0
        with env.save_state() as state:
            infos, _ = run(env, 40)
            expected = episode_events(infos)
            assert expected["kart_1"]["kart_contact"] > contacts
            env.restore_state(state)
            with env.clone() as clone:
                assert episode_events(run(clone, 40)[0]) == expected
            assert episode_events(run(env, 40)[0]) == expected
            _, infos = env.reset(options={"state": state})
            assert not any(any(own.values()) for own in episode_events(infos).values())
            later = episode_events(run(env, 40)[0])["kart_1"]["kart_contact"]
            assert later == expected["kart_1"]["kart_contact"] - contacts


def test_events_of_agents_that_have_left_do_not_count():
    settings = {**SETTINGS, "start": RAM, "end_when_stuck": 0.5, "max_cycles": 60}
    with race_v0.parallel_env(**settings) as env:
        env.reset(seed=1)
        infos = {}
        while "kart_0" in env.agents:
            infos |= env.step({agent: ACTIONS[agent] for agent in env.agents})[4]
        left = episode_events({"kart_0": infos["kart_0"]})
        while env.agents:
            env.step({agent: ACTIONS[agent] for agent in env.agents})
        assert episode_events(env.infos(["kart_0"])) == left


def test_a_reward_term_sees_events():
    def bump(step):
        return -step.event("kart_contact")

    with race_v0.parallel_env(**SETTINGS, start=RAM, reward={"bump": bump}) as env:
        env.reset(seed=1)
        infos, _ = run(env, 60)
        info = infos["kart_0"]
        assert info["episode/reward/bump"] == -info["episode/event/kart_contact"] < 0
    settings = {**SETTINGS, "events": False, "reward": {"bump": bump}}
    with race_v0.parallel_env(**settings) as env:
        env.reset(seed=1)
        with pytest.raises(ConfigError, match=r"'bump' failed.*events=True"):
            run(env, 1)
