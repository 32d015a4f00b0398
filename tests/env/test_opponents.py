"""Opponents: karts that are not agents and have drivers of any kind."""

from __future__ import annotations

import logging
import pickle
from contextlib import ExitStack, closing
from dataclasses import replace
from functools import partial
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from pettingzoo.test import parallel_api_test

from stkzoo import OpponentPool, RaceVectorEnv, race_v0
from stkzoo.agents.pretrained.weights import save_weights
from stkzoo.agents.training.export import export_policy
from stkzoo.drivers import Driver, find_driver
from stkzoo.errors import AgentException, ConfigError
from stkzoo.views import VIEWS
from tests.support.networks import small_network

AGENTS = Path(__file__).parents[1] / "data" / "agents"
RACE = {"agents": 1, "track": "lighthouse", "view": "flattened_continuous_actions"}
FORWARD = np.array([1.0, 0.0], np.float32)
#: An action of the view `racing`.
CHOICES = np.array([10, 0, 0, 0, 0])


def forward(observation):
    """Drives at full throttle; checks that observations come in the agents' view."""
    assert observation["continuous"].shape == (92,)
    return FORWARD


class Fails:
    """A policy that raises an exception in its third step."""

    def __init__(self):
        self.steps = 0

    def __call__(self, _):
        self.steps += 1
        if self.steps == 3:
            raise ValueError("out of ideas")
        return FORWARD


class Batches:
    """A policy with the interface of Stable-Baselines3 that records its batch sizes."""

    def __init__(self):
        self.sizes = []

    def predict(self, observation, deterministic):
        assert deterministic
        self.sizes.append(len(observation["continuous"]))
        return np.tile(FORWARD, (self.sizes[-1], 1)), None


def against(opponents, **options):
    options = {**RACE, "num_kart": 1 + len(opponents), **options}
    return race_v0.parallel_env(opponents=opponents, **options)


def drive(env, steps):
    """Returns the locations of all karts after some steps at full throttle."""
    for _ in range(steps):
        env.step(dict.fromkeys(env.agents, FORWARD))
    return env.snapshot.karts["location"].copy()


@pytest.mark.slow
def test_opponents_of_all_kinds_drive():
    opponents = ["pretrained:ace", "heuristic", "ai:3", str(AGENTS / "plain"), forward]
    with against(opponents, num_kart=7) as env:
        observations, infos = env.reset(seed=1)
        assert env.possible_agents == [*observations] == [*infos] == ["kart_0"]
        assert env.state().shape == env.state_space.shape == (4 + 27 * 7,)
        assert env.race.opponents == ("pretrained:ace", "heuristic", "ai:3", "plain", "forward")
        assert env.race.difficulty == 3
        assert not {*env.race.kart_indices} & {*env.race.opponent_indices}
        start = env.snapshot.karts["location"].copy()
        end = drive(env, 60)
        moved = np.linalg.norm(end - start, axis=1)
        assert (moved[list(env.race.opponent_indices)] > 10).all()
        env.reset(seed=1)
        assert (drive(env, 60) == end).all()


def test_the_games_ai_runs_inside_the_game():
    with against(["ai", "ai:1"], num_kart=4) as env:
        env.reset(seed=1)
        assert env.race.difficulty == 1
        karts = [env.live_race.episode.setup.karts[kart] for kart in env.race.opponent_indices]
        assert all(kart.is_bot and not kart.reports_control for kart in karts)


@pytest.mark.slow
def test_a_pool_draws_each_race_from_the_environments_random_stream():
    pool = OpponentPool(["random", "ai:0", "heuristic"])

    def races(env, count=12):
        env.reset(seed=5)
        names = [env.race.opponents]
        for _ in range(count - 1):
            env.reset()
            names.append(env.race.opponents)
        return names

    with against([pool, "ai"], num_kart=3) as env, against([pool, "ai"], num_kart=3) as other:
        drawn = races(env)
        assert races(other) == drawn
        assert {names[0] for names in drawn} == {"random", "ai:0", "heuristic"}
        pool.add(forward, weight=1e9)
        env.reset()
        assert env.race.opponents == ("forward", "ai")


def test_a_single_pool_drives_all_karts_that_are_not_agents():
    pool = OpponentPool(["ai:1", "ai:3"])
    with race_v0.parallel_env(**RACE, num_kart=4, opponents=pool) as env:
        env.reset(seed=1, options={"difficulty": 1})
        assert env.race.opponents == ("ai:1", "ai:1", "ai:1")
        env.reset(seed=3)
        assert len({*env.race.opponents}) == 1


@pytest.mark.slow
def test_an_opponent_that_fails_drops_out_and_the_race_continues(caplog):
    hostile = str(AGENTS / "hostile" / "exits.py")
    with against([Fails(), hostile, lambda _: [9.0, 0.0]]) as env:
        env.reset(seed=1)
        with caplog.at_level(logging.WARNING, "stkzoo.env.opponents"):
            drive(env, 20)
        assert env.agents == ["kart_0"]
        said = [record.getMessage() for record in caplog.records]
        assert len(said) == 3
        assert "opponent Fails of kart_1 is out of the race: ValueError: out of ideas" in said
        assert any("opponent exits of kart_2 is out" in text for text in said)
        assert any("kart_3 is out" in text and "9.0" in text for text in said)
        env.reset(seed=2)
        assert len(env.live_race.opponents.ask(env.live_race.episode)) == 3


class _Counts(gym.ObservationWrapper):
    """Fails when it is made (0), at the observation of the reset (1), or at a later one."""

    def __init__(self, env, fails_at):
        super().__init__(env)
        self.count, self._fails_at = -1, fails_at
        self.observation(None)

    def observation(self, observation):
        self.count += 1
        if self.count == self._fails_at:
            raise ValueError("no more")
        return observation


@pytest.mark.parametrize("fails_at", [1, 4])
def test_an_opponent_whose_view_fails_in_a_race_drops_out(fails_at, caplog):
    made = []

    def view(env, fails_at=99):
        made.append(_Counts(VIEWS["racing"](env), fails_at))
        return made[-1]

    fails = Driver.of_policy(lambda _: CHOICES, view=partial(view, fails_at=fails_at))
    with against([fails, Driver.of_policy(lambda _: CHOICES, view=view), "ai"]) as env:
        with caplog.at_level(logging.WARNING, "stkzoo.env.opponents"):
            env.reset(seed=1)
            drive(env, 6)
        assert "kart_1 is out" in caplog.text
        assert "no more" in caplog.text
        assert [own.agent for own, _ in env.live_race.opponents.ask(env.live_race.episode)] == [
            "kart_2"
        ]
        assert made[-1].count == 7


def test_a_view_of_an_opponent_that_cannot_be_made_is_an_error():
    driver = Driver.of_policy(lambda _: CHOICES, view=lambda env: _Counts(env, 0))
    with (
        against(["ai", driver]) as env,
        pytest.raises(ConfigError, match=r"'kart_2' failed to wrap .* no more\); give"),
    ):
        env.reset(seed=1)


def test_policies_of_opponents_get_no_images():
    with (
        against([forward], view=("camera", {"backend": "map"})) as env,
        pytest.raises(ConfigError, match=r"a view of the opponents 'forward' fails .*no camera"),
    ):
        env.reset(seed=1)
    driver = Driver.of_policy(forward, view=RACE["view"])
    with against([driver], view=("camera", {"backend": "map"})) as env:
        env.reset(seed=1)
        assert len(env.live_race.opponents.ask(env.live_race.episode)) == 1


def test_a_mapping_is_a_pool_of_drivers_by_weight():
    with against([{"ai:1": 1, "heuristic": 3}, "random"]) as env:
        env.reset(seed=1)
        assert env.race.opponents[0] in ("ai:1", "heuristic")
    with against({"random": 1}) as env:
        env.reset(seed=1)
        assert env.race.opponents == ("random",)


def test_opponents_finish_while_the_agents_still_race():
    stand = np.zeros(2, np.float32)
    with against(["heuristic"], track="olivermath", max_cycles=800) as env:
        env.reset(seed=1)
        kart = env.race.opponent_indices[0]
        while not env.snapshot.karts["has_finished_race"][kart]:
            env.step({"kart_0": stand})
        for _ in range(3):
            assert env.agents == ["kart_0"]
            *_, infos = env.step({"kart_0": stand})
        assert infos["kart_0"]["position"] == 2


@pytest.mark.slow
def test_a_saved_state_includes_the_memory_of_opponents():
    opponents = [
        "pretrained:ace",
        "heuristic",
        "random",
        find_driver(str(AGENTS / "plain"), inline=True),
    ]
    with against(opponents) as env:
        env.reset(seed=3)
        drive(env, 40)
        with env.save_state() as state, env.clone() as twin:
            end = drive(env, 40)
            assert (drive(twin, 40) == end).all()
            env.restore_state(state)
            assert (drive(env, 40) == end).all()
            env.reset(options={"state": state})
            assert (drive(env, 40) == end).all()
            other = race_v0.parallel_env(**RACE, num_kart=5)
            with (
                other,
                pytest.raises(
                    ConfigError, match="an environment with the same karts, agents and opponents"
                ),
            ):
                other.reset(options={"state": state})


def test_a_saved_state_excludes_opponents_that_dropped_out():
    with against([Fails(), Driver.of_policy(lambda _: CHOICES, view="racing")]) as env:
        env.reset(seed=1)
        drive(env, 20)
        with env.save_state() as state:
            end = drive(env, 20)
            env.restore_state(state)
            assert (drive(env, 20) == end).all()
            env.reset(options={"state": state})
            assert (drive(env, 20) == end).all()


def test_a_scenario_starts_opponents_at_its_step(tmp_path):
    with against([forward, "ai"]) as env:
        env.reset(seed=3)
        drive(env, 20)
        env.scenario().save(tmp_path / "here.zip")
        end = drive(env, 20)
        env.reset(options={"scenario": tmp_path / "here.zip"})
        assert (drive(env, 20) == end).all()
    with against([forward, forward]) as env, pytest.raises(ConfigError, match="1 of them driven"):
        env.reset(options={"scenario": tmp_path / "here.zip"})


@pytest.mark.slow
def test_a_scenario_draws_opponents_of_the_same_kinds_from_a_pool():
    pool = OpponentPool(["pursuit", "ai"])
    with against([pool, "ai"]) as env:
        env.reset(seed=1)  # the same draws in every run
        kinds = {}
        while len(kinds) < 2:
            env.reset()
            kinds[env.race.opponents[0]] = env.scenario()
        assert kinds.keys() == {"pursuit", "ai"}
        for seed in range(4):
            for first, scenario in kinds.items():
                env.reset(seed=seed, options={"scenario": scenario})
                assert env.race.opponents == (first, "ai")


def keeps(_, __, ___):
    seen = []
    return lambda observation: seen.append(observation) or {}


@pytest.mark.parametrize(
    ("opponent", "why"),
    [
        (str(AGENTS / "plain"), r"its own process; to run it in this one, use find_driver\("),
        (Driver.of_actor("keeps", keeps), "use an object with __call__"),
    ],
)
def test_an_opponent_whose_memory_cannot_be_copied_is_an_error(opponent, why):
    with against([opponent]) as env:
        env.reset(seed=1)
        with pytest.raises(AgentException, match=rf"of kart_1 cannot be saved: .*{why}"):
            env.save_state()


def test_the_karts_of_one_driver_in_many_races_are_driven_together():
    policy = Batches()
    options = {**RACE, "num_kart": 4, "opponents": [policy, "pretrained:ace", policy]}
    envs = RaceVectorEnv(2, **options)
    envs.reset(seed=[7, 8])
    for _ in range(30):
        envs.step(np.tile(FORWARD, (2, 1)))
    assert policy.sizes == [4] * 30
    for number, race in enumerate(envs.races):
        with race_v0.parallel_env(**options) as env:
            env.reset(seed=7 + number)
            assert (drive(env, 30) == race.snapshot.karts["location"]).all()
    envs.close()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["heuristic", "pretrained:ace", "network"])
def test_a_shipped_driver_acts_the_same_for_a_batch_as_for_single_karts(name, tmp_path):
    """Bit for bit, on tracks with different numbers of segments and items."""
    if name == "network":
        save_weights(tmp_path / "policy-000000001.safetensors", small_network())
        (tmp_path / "arguments.json").write_text('{"seed": 7, "tracks": ["lighthouse"]}')
        policy = tmp_path / "policy-000000001.safetensors"
        name = str(export_policy(policy, "quick", tmp_path / "quick"))
    driver, ends = find_driver(name, inline=True), []
    assert driver.load(ExitStack()).act_together is not None
    alone = replace(driver, load=lambda stack: replace(driver.load(stack), act_together=None))
    for opponent in (driver, alone):
        options = {**RACE, "num_kart": 4, "opponents": [opponent, "ai", opponent]}
        tracks = ["minigolf", "lighthouse"]
        with closing(RaceVectorEnv(2, **options | {"track": tracks})) as envs:
            envs.reset(seed=1)
            assert [race.race.track for race in envs.races] == tracks
            for _ in range(80):
                envs.step(np.tile(FORWARD, (2, 1)))
            ends.append([race.snapshot.karts.tobytes() for race in envs.races])
    assert ends[0] == ends[1]


@pytest.mark.slow
def test_prefetched_races_have_the_same_opponents():
    ends = []
    for prefetch in (True, False):
        pool = OpponentPool(["random", "ai:3", forward])
        envs = RaceVectorEnv(1, **RACE, num_kart=3, opponents=pool, max_cycles=5, prefetch=prefetch)
        envs.reset(seed=2)
        names = []
        for _ in range(30):
            envs.step(FORWARD[None])
            names.append((envs.races[0].race.opponents, envs.races[0].snapshot.karts.tobytes()))
        ends.append(names)
        envs.close()
    assert ends[0] == ends[1]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*Box observation space")
def test_environments_with_opponents_pass_the_checkers():
    with against(["heuristic", forward], num_kart=4, agents=2, max_cycles=40) as env:
        parallel_api_test(env, num_cycles=60)
    env_id = "supertuxkart/flattened_continuous_actions-v0"
    with gym.make(env_id, num_kart=2, track="lighthouse", opponents=[forward]) as env:
        check_env(env.unwrapped, skip_render_check=True)
        assert env.unwrapped.core.race.opponents == ("forward",)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"opponents": "ai"}, r"opponents is 'ai', expected a list such as"),
        ({"opponents": ["aj"]}, r"unknown driver 'aj'\. .*\nKnown: ai, .*\. Or give the path"),
        ({"opponents": [3]}, "an opponent is 3, expected a driver's name"),
        ({"opponents": ["ai", "ai"]}, "an agent and 2 opponents for 2 karts; raise num_kart"),
        ({"opponents": ["ai"] * 2, "agents": None}, "an agent and 2 opponents for 2 karts"),
        ({"opponents": OpponentPool(), "agents": None}, "set the number of agents"),
        ({"opponents": ["ai:1", "ai:3"], "num_kart": 3}, r"the difficulties \[1, 3\]"),
    ],
)
def test_invalid_choices_of_opponents_are_refused(options, message):
    with pytest.raises(ConfigError, match=message):
        race_v0.parallel_env(**{**RACE, "num_kart": 2, **options})


def test_reset_refuses_another_difficulty():
    with against(["ai:3"]) as env, pytest.raises(ConfigError, match=r"difficulties \[1, 3\]"):
        env.reset(options={"difficulty": 1})


def test_opponents_of_an_environment_can_be_pickled():
    env = against(["pretrained:ace", "ai:3", forward])
    with env, pickle.loads(pickle.dumps(env)) as twin:
        for one in (env, twin):
            one.reset(seed=1)
        assert (drive(env, 5) == drive(twin, 5)).all()
