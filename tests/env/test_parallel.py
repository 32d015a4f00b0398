"""The phases of a step run in order, and no phase calls another one."""

from __future__ import annotations

import sys

import pytest

import stkzoo
from stkzoo import race_v0
from stkzoo.engine.session import WorkerSession
from stkzoo.env import race
from stkzoo.env.episode import Episode
from stkzoo.errors import ActionError, ConfigError
from stkzoo.views import AgentChains

PHASES = [
    (AgentChains, "check"),
    (AgentChains, "convert"),
    (race, "drive_opponents"),
    (WorkerSession, "step_async"),
    (WorkerSession, "step_wait"),
    (Episode, "advance"),
    (AgentChains, "observe"),
    (Episode, "infos"),
    (AgentChains, "finish"),
]


@pytest.fixture
def phases(monkeypatch):
    """Records in order which phases of a step begin and end."""
    seen = []

    def recorded(name, method):
        def call(*args, **kwargs):
            seen.append(f"{name} begins")
            result = method(*args, **kwargs)
            seen.append(f"{name} ends")
            return result

        return call

    for owner, name in PHASES:
        monkeypatch.setattr(owner, name, recorded(name, getattr(owner, name)))
    return seen


def actions_of(env):
    return {agent: env.action_space(agent).sample() for agent in env.agents}


@pytest.mark.parametrize("view", ["full", "masked_discrete", "flattened_control"])
def test_a_step_runs_its_phases_one_after_another(phases, view):
    with race_v0.parallel_env(num_kart=3, track="lighthouse", view=view, opponents=["ai"]) as env:
        env.reset(seed=1)
        actions = actions_of(env)
        phases.clear()
        env.step(actions)
        assert phases == [f"{name} {when}" for _, name in PHASES for when in ("begins", "ends")]


def modules_of_a_step(env):
    """Returns the package's modules that a step runs."""
    root, seen = stkzoo.__path__[0], set()
    home = root.removesuffix("stkzoo")
    actions = actions_of(env)

    def note(frame, event, _):
        if event == "call" and frame.f_code.co_filename.startswith(home):
            seen.add(frame.f_code.co_filename.removeprefix(home))

    before = sys.getprofile()
    sys.setprofile(note)
    try:
        env.step(actions)
    finally:
        sys.setprofile(before)
    return {name for name in seen if not name.startswith("tests")}


def test_a_default_step_runs_at_most_seven_modules():
    with race_v0.parallel_env(num_kart=2, track="lighthouse") as env:
        env.reset(seed=1)
        env.step(actions_of(env))
        assert len(modules_of_a_step(env)) <= 7


def test_the_keys_of_the_agents_dict_are_the_agents_names():
    with stkzoo.STKRaceMultiEnv(agents=3, num_kart=3, track="lighthouse") as env:
        env.reset(seed=1)
        good = env.action_space.sample()
        bad = {**good, "2": {**good["2"], "brake": 7}}
        for actions, text in (
            (bad, "agent '2' is 7; expected a whole number"),
            (
                {key: good[key] for key in "01"},
                "no action for agent '2'; actions came for '0', '1'",
            ),
        ):
            with pytest.raises(ActionError, match=text) as caught:
                env.step(actions)
            assert caught.value.agent == "2"
            assert "kart_" not in str(caught.value)
        with pytest.raises(
            ActionError, match="expected a dict with an action for each of '0', '1', '2'"
        ):
            env.step([good["0"]])


def test_unknown_agents_of_observations_and_infos_are_refused():
    with race_v0.parallel_env(num_kart=2, agents=1, track="lighthouse") as env:
        env.reset(seed=1)
        for ask in (env.observe, env.infos):
            with pytest.raises(ConfigError, match="unknown agent 'kart_9'"):
                ask(["kart_9"])
            with pytest.raises(ConfigError, match="expected a list"):
                ask("kart_0")
        assert env.infos([0]).keys() == {"kart_0"}
