"""Camera images and depths in observations."""

from functools import partial

import gymnasium as gym
import numpy as np
import pytest

import stkzoo
from stkzoo import race_v0
from stkzoo.errors import ConfigError
from stkzoo.render.renderer import RaceRenderer
from stkzoo.views import VIEWS
from stkzoo.wrappers import CameraObservations
from tests.support.rendering import who_draws

RACE = {"num_kart": 3, "track": "lighthouse"}
ON_MAP = {"size": (64, 48), "backend": "map"}


def filmed(env, view="flattened_discrete", **options):
    return CameraObservations(VIEWS[view](env), **options)


def race(**options):
    return race_v0.parallel_env(**RACE, view=partial(filmed, **options))


def drive(env, steps, seed=1):
    """Yields the observations of a race at full throttle, by agent."""
    observations, _ = env.reset(seed=seed)
    yield observations
    for _ in range(steps):
        observations, *_ = env.step(dict.fromkeys(env.agents, 484))
        yield observations


@pytest.fixture
def drawings(monkeypatch):
    """Records the snapshots that are drawn."""
    drawn = []
    pictures = RaceRenderer.pictures

    def noted(self, snapshot):
        drawn.append(snapshot)
        return pictures(self, snapshot)

    monkeypatch.setattr(RaceRenderer, "pictures", noted)
    return drawn


@pytest.mark.slow
def test_each_agent_gets_its_own_camera_from_one_drawing(drawings):
    with race(**ON_MAP) as env:
        steps = list(drive(env, 20))
        assert all(obs[a] in env.observation_space(a) for obs in steps for a in obs)
    assert len(drawings) == len(set(map(id, drawings))) == 21
    images = [steps[-1][agent]["image"] for agent in env.possible_agents]
    assert images[0].shape == (48, 64, 3)
    assert len({image.tobytes() for image in images}) == 3


@pytest.mark.slow
def test_the_image_shows_the_current_step():
    with race(**ON_MAP) as env:
        for number, observations in enumerate(drive(env, 30)):
            if number % 10 == 0:
                view = RaceRenderer("map", (64, 48))
                view.begin(env.scene)
                karts = env.race.kart_indices
                # Only the trails of the karts depend on earlier snapshots.
                alike = observations["kart_0"]["image"] == view.pictures(env.snapshot)[karts[0]]
                assert alike.mean() > 0.97
                view.close()


@pytest.mark.parametrize("every", [1, 3])
def test_the_frame_rate_can_be_chosen(drawings, every):
    with race(**ON_MAP, every=every) as env:
        steps = list(drive(env, 12))
    assert len(drawings) == 12 // every + 1
    images = [obs["kart_0"]["image"].tobytes() for obs in steps]
    for number in range(12):
        if (number + 1) % every:
            assert images[number + 1] == images[number]


@pytest.mark.slow
def test_cameras_change_neither_the_race_nor_other_observations():
    with race(**ON_MAP) as env, race_v0.parallel_env(**RACE, view="flattened_discrete") as plain:
        for seen, bare in zip(drive(env, 20), drive(plain, 20), strict=True):
            for agent in bare:
                assert set(seen[agent]) == {*bare[agent], "image"}
                for key, value in bare[agent].items():
                    # The compiled kernel differs by rounding errors.
                    np.testing.assert_allclose(seen[agent][key], value, rtol=1e-5, atol=1e-5)
            assert env.snapshot.data == plain.snapshot.data


def test_returned_images_are_not_shared():
    with race(**ON_MAP, every=2) as env:
        steps = drive(env, 2)
        first = next(steps)["kart_0"]["image"]
        kept = first.copy()
        second = next(steps)["kart_0"]["image"]
        second[:] = 0
        np.testing.assert_array_equal(first, kept)
        third = next(steps)["kart_0"]["image"]
        assert third.any()


def test_agents_can_have_different_cameras_or_none():
    views = {
        "kart_0": partial(filmed, **ON_MAP),
        "kart_1": partial(filmed, size=(32, 32), backend="map"),
        "kart_2": "flattened_discrete",
    }
    with race_v0.parallel_env(**RACE, view=views) as env:
        observations = list(drive(env, 3))[-1]
    assert observations["kart_0"]["image"].shape == (48, 64, 3)
    assert observations["kart_1"]["image"].shape == (32, 32, 3)
    assert "image" not in observations["kart_2"]


def test_it_wraps_a_single_agent_id():
    with CameraObservations(
        gym.make("supertuxkart/flattened_discrete-v0", **RACE), **ON_MAP
    ) as env:
        first, _ = env.reset(seed=1)
        second, *_ = env.step(484)
        assert first in env.observation_space
        assert second in env.observation_space


@pytest.mark.slow
def test_restored_states_have_their_images():
    with race(**ON_MAP, every=3) as env:
        for _ in drive(env, 10):
            pass
        state = env.save_state()
        ahead = [env.step(dict.fromkeys(env.agents, 484))[0] for _ in range(5)]
        env.restore_state(state)
        again = [env.step(dict.fromkeys(env.agents, 484))[0] for _ in range(5)]
        with env.lookahead() as branch:
            seen = branch.step(dict.fromkeys(branch.agents, 484))[0]
        real = env.step(dict.fromkeys(env.agents, 484))[0]
        for first, second in zip([*ahead, real], [*again, seen], strict=True):
            alike = first["kart_1"]["image"] == second["kart_1"]["image"]
            assert alike.mean() > 0.97  # trails start again


@pytest.mark.slow
def test_vector_environments_can_have_cameras():
    envs = stkzoo.RaceVectorEnv(2, num_kart=2, track="lighthouse", view=partial(filmed, **ON_MAP))
    observations, _ = envs.reset(seed=1)
    observations, *_ = envs.step(envs.action_space.sample())
    assert observations["image"].shape == (4, 48, 64, 3)
    assert observations in envs.observation_space
    envs.close()


@pytest.mark.skipif(who_draws() != "engine", reason="the game cannot draw on this machine")
@pytest.mark.slow
def test_the_games_images_and_depths_are_observed():
    with race(size=(96, 64), depth=True) as env:
        steps = list(drive(env, 25))
    last = steps[-1]
    for agent, seen in last.items():
        assert seen in env.observation_space(agent)
        assert seen["depth"].shape == (64, 96, 1)
        depth = seen["depth"][..., 0]
        # The lower part of the image shows the road, which is nearer on average.
        assert depth[-16:].mean() < depth[:16].mean()
        assert seen["image"].std() > 10
    assert len({seen["image"].tobytes() for seen in last.values()}) == 3
    moved = np.abs(last["kart_0"]["image"].astype(int) - steps[0]["kart_0"]["image"]).mean()
    assert moved > 3


@pytest.mark.skipif(who_draws() != "engine", reason="the game cannot draw on this machine")
@pytest.mark.slow
def test_the_camera_view_is_also_an_id():
    with gym.make("supertuxkart/camera-v0", **RACE) as env:
        observation, _ = env.reset(seed=1)
        assert observation in env.observation_space
        assert env.observation_space["image"].shape == (84, 84, 3)
        assert set(observation) == {"continuous", "discrete", "image"}
        assert len(env.unwrapped.get_keys_to_action()) == 256
        assert observation["image"].std() > 10
    with race_v0.parallel_env(**RACE, view="camera") as env:
        assert env.observation_space("kart_1")["image"].shape == (84, 84, 3)


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"size": (16, 16)}, r"size is \(16, 16\), expected \(width, height\) from 32 to 4096"),
        ({"size": (64,)}, "from 32 to 4096 pixels each"),
        ({"every": 0}, "every is 0"),
        ({"backend": "mapp"}, "'mapp'"),
        ({"backend": "map", "depth": True}, "the map has no depth"),
    ],
)
def test_invalid_options_are_refused(options, match):
    with pytest.raises(ConfigError, match=match):
        CameraObservations(gym.make("supertuxkart/flattened-v0", **RACE), **options)


def test_an_environment_without_a_camera_is_refused():
    with pytest.raises(ConfigError, match="has no camera"):
        CameraObservations(gym.make("CartPole-v1"))


def test_two_cameras_for_one_agent_are_refused():
    env = CameraObservations(gym.make("supertuxkart/flattened-v0", **RACE), **ON_MAP)
    with pytest.raises(ConfigError, match="already have image"):
        CameraObservations(env, **ON_MAP)


def test_more_cameras_than_the_game_supports_are_refused():
    with pytest.raises(stkzoo.errors.StkzooError, match="9 agents have views with a camera"):
        race_v0.parallel_env(num_kart=9, view=partial(filmed, **ON_MAP))
