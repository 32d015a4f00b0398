"""Observed velocities and headings of the other karts."""

import gymnasium as gym
import numpy as np
import pytest

from stkzoo import AgentSpec, ConfigError, MonoAgentWrapperAdapter, race_v0
from stkzoo.drivers import Driver
from stkzoo.kernel import to_polar
from stkzoo.mdp.geometry import rotation_matrices, to_kart_frame
from stkzoo.race import run_race
from stkzoo.views import full_with
from stkzoo.wrappers import ConstantSizedObservations
from stkzoo.wrappers.marl import PartialObservations
from tests.support.playing import kart_action

MOVING = full_with(["motion"])
WITH_MOTION = ("simple", {"karts_motion": True, "state_karts": 4})
STAY = kart_action()


def course(step_size=1 / 60, steps=300, seed=5):
    """Returns what a standing kart observes of another one, and the game's kart records."""
    agents = [AgentSpec(rank_start=1), AgentSpec(rank_start=0, use_ai=True)]
    options = {"num_kart": 2, "agents": agents, "track": "lighthouse", "step_size": step_size}
    with race_v0.parallel_env(**options, view={0: MOVING}) as env:
        seen, records = [env.reset(seed=seed)[0]["kart_0"]], [env.live_race.episode.snapshot.karts]
        for _ in range(steps):
            seen.append(env.step({"kart_0": STAY})[0]["kart_0"])
            records.append(env.live_race.episode.snapshot.karts)
        mine, other = env.live_race.episode.race.kart_indices
    rows = {
        key: np.array([one[key][0] for one in seen], np.float64)
        for key in ("karts_position", "karts_velocity", "karts_heading")
    }
    return rows, np.array(records)[:, [mine, other]]


@pytest.fixture(scope="module")
def a_course():
    return course()


def test_the_velocity_is_the_rate_of_change_of_the_position(a_course):
    rows, records = a_course
    assert np.ptp(records["location"][100:, 0], axis=0).max() < 0.05  # the observer stands still
    there = rows["karts_position"][100:]
    from_places = (there[2:] - there[:-2]) * 30
    speed = np.linalg.norm(from_places, axis=1)
    assert speed.max() > 15
    error = np.linalg.norm(rows["karts_velocity"][101:-1] - from_places, axis=1)
    # The game's velocities are one tick ahead of its positions: 0.1 m/s at full throttle.
    assert np.median(error) < 0.2
    assert np.quantile(error, 0.95) < 0.3


def test_the_heading_is_the_direction_of_the_front(a_course):
    rows, records = a_course
    nose = (records["front"] - records["location"]).astype(np.float64)[..., [0, 2]]
    x, z = nose[:, 1].T
    forward_x, forward_z = nose[:, 0].T
    right = np.arctan2(x * forward_z - z * forward_x, x * forward_x + z * forward_z)
    np.testing.assert_allclose(rows["karts_heading"][:, 0], right, atol=0.03)
    assert np.ptp(right) > 0.3  # the kart drove through a bend


def test_velocities_have_the_order_of_positions():
    with race_v0.parallel_env(num_kart=4, track="lighthouse", view=WITH_MOTION) as env:
        env.reset(seed=2)
        for space in env.action_spaces.values():
            space.seed(1)
        for _ in range(40):
            actions = {a: env.action_space(a).sample() | {"rescue": 0} for a in env.agents}
            observations = env.step(actions)[0]
        karts = env.live_race.episode.snapshot.karts
        indices = dict(
            zip(env.possible_agents, env.live_race.episode.race.kart_indices, strict=True)
        )
    for agent, seen in observations.items():
        assert not seen["karts_velocity"][3:].any()  # padding
        assert not seen["karts_heading"][3:].any()
        own = karts[[indices[agent]]]
        turn = rotation_matrices(own["rotation"])
        places = to_polar(to_kart_frame(karts["location"][None], own["location"], turn)[0])
        order = [np.abs(places - at).sum(axis=1).argmin() for at in seen["karts_position"][:3]]
        assert len({*order, indices[agent]}) == 4
        speeds = np.linalg.norm(karts["velocity"][order], axis=1)
        ours = np.linalg.norm(seen["karts_velocity"][:3], axis=1)
        np.testing.assert_allclose(ours, speeds, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("view", ["flattened", "box_discrete", "masked_discrete", "control"])
def test_views_of_fixed_size_accept_the_option_and_stay_compiled(view):
    size = {}
    for options in ({}, {"karts_motion": True}):
        env = gym.make(f"supertuxkart/{view}-v0", num_kart=2, track="lighthouse", **options)
        with env:
            observation, _ = env.reset(seed=1)
            assert env.observation_space.contains(observation)
            assert env.unwrapped.core.live_race.chains._chains["kart_0"].is_empty
            size[len(size)] = gym.spaces.flatdim(env.observation_space)
    assert size[1] - size[0] == 5 * (3 + 1)


def test_hidden_karts_have_no_motion():
    def near(env, radius=3.0):
        return PartialObservations(env, radius=radius)

    near.sees_motion = True
    with race_v0.parallel_env(num_kart=5, track="lighthouse", view=near) as env:
        observations, _ = env.reset(seed=1)
    counts = set()
    for seen in observations.values():
        lengths = {len(seen[f"karts_{key}"]) for key in ("position", "velocity", "heading")}
        assert len(lengths) == 1
        counts |= lengths
    assert counts - {4}


def test_opponents_observe_motion_like_agents():
    seen = []

    def policy(observation):
        seen.append(observation["karts_velocity"].shape)
        return STAY

    options = {"num_kart": 2, "agents": 1, "track": "lighthouse"}
    with race_v0.parallel_env(**options, opponents=[Driver.of_policy(policy, WITH_MOTION)]) as env:
        env.reset(seed=1)
        env.step({"kart_0": STAY})
    assert seen == [(4, 3)]


MODULE = """
env_name = (
    "supertuxkart/simple-v0",
    {"karts_motion": True, "state_karts": 2},
)


def get_actor(module_dir, observation_space, action_space):
    def act(state, observation):
        assert observation["karts_velocity"].shape == (2, 3)
        return action_space.sample()

    return act
"""


@pytest.mark.slow
@pytest.mark.parametrize("inline", [True, False])
def test_agents_from_files_can_request_motion(tmp_path, inline):
    (tmp_path / "pystk_actor.py").write_text(MODULE)
    result = run_race([str(tmp_path), "ai"], track="lighthouse", seed=1, max_steps=5, inline=inline)
    assert result.agents[0].errors == ()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: MonoAgentWrapperAdapter(race_v0.parallel_env(num_kart=1), {0: WITH_MOTION}),
            "the simple view needs an environment that observes how the other karts move",
        ),
        (
            lambda: ConstantSizedObservations(gym.make("supertuxkart/full-v0"), karts_motion=True),
            "karts_motion needs an environment that observes how the other karts move",
        ),
    ],
)
def test_environments_without_motion_are_refused(make, message):
    with pytest.raises(ConfigError, match=message):
        make()
