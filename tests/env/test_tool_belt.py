"""Gymnasium's wrappers and utilities with stkzoo's ids, as listed in docs/how-to/tool-belt.md."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import wrappers
from gymnasium.spaces import Box
from gymnasium.utils import performance
from gymnasium.utils.save_video import save_video
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import vector

import stkzoo
from stkzoo.errors import ConfigError

RACE = {"track": "lighthouse", "num_kart": 2}
DRAWN = {"render_mode": "rgb_array", "render_backend": "map", "render_size": (64, 64)}
FLAT = ["simple", "flattened", "flattened_discrete", "flattened_continuous_actions"]
EVERY = ["full", "multi-full", *FLAT, "flattened_multidiscrete"]
NUMBERS = ["flattened_continuous_actions"]


def pixels(env):
    return wrappers.AddRenderObservation(env)


def flat(env):
    return wrappers.FlattenObservation(env)


def reshaped(env):
    (size,) = env.observation_space.shape
    return wrappers.ReshapeObservation(env, (1, size))


def same_action(env):
    return wrappers.TransformAction(env, lambda action: action, env.action_space)


def same_observation(env):
    return wrappers.TransformObservation(env, lambda seen: seen, env.observation_space)


def to_torch(env):
    import torch

    return wrappers.ArrayConversion(env, env_xp=np, target_xp=torch)


def first_key(env):
    return wrappers.FilterObservation(env, [next(iter(env.observation_space.spaces))])


WITHOUT_ARGUMENTS = (
    *("AddRenderObservation", "Autoreset", "FlattenObservation", "HumanRendering"),
    *("NormalizeReward", "OrderEnforcing", "PassiveEnvChecker", "RecordEpisodeStatistics"),
    *("RenderCollection", "TimeAwareObservation"),
)
#: For each wrapper, a function that wraps an environment, and the ids it works with.
WORKING = {
    **{name: (getattr(wrappers, name), EVERY) for name in WITHOUT_ARGUMENTS},
    "AddWhiteNoise": (lambda env: wrappers.AddWhiteNoise(env, 0.2), EVERY),
    "ArrayConversion": (to_torch, EVERY),
    "ClipAction": (wrappers.ClipAction, NUMBERS),
    "ClipReward": (lambda env: wrappers.ClipReward(env, -1, 1), EVERY),
    "DelayObservation": (lambda env: wrappers.DelayObservation(env, 2), EVERY),
    "DiscretizeAction": (lambda env: wrappers.DiscretizeAction(env, bins=3), NUMBERS),
    "DtypeObservation": (lambda env: wrappers.DtypeObservation(flat(env), np.float64), FLAT),
    "FilterObservation": (first_key, EVERY),
    "FrameStackObservation": (lambda env: wrappers.FrameStackObservation(env, 3), EVERY),
    "GrayscaleObservation": (lambda env: wrappers.GrayscaleObservation(pixels(env)), EVERY),
    "MaxAndSkipObservation": (lambda env: wrappers.MaxAndSkipObservation(flat(env), 2), FLAT),
    "NormalizeObservation": (lambda env: wrappers.NormalizeObservation(flat(env)), FLAT),
    "NumpyToTorch": (lambda env: wrappers.NumpyToTorch(env), EVERY),
    "ObstructView": (lambda env: wrappers.ObstructView(env, 0.2, obstruction_width=4), EVERY),
    "RepeatAction": (lambda env: wrappers.RepeatAction(env, 3), EVERY),
    "RescaleAction": (
        lambda env: wrappers.RescaleAction(env, np.float32(-1), np.float32(1)),
        NUMBERS,
    ),
    "RescaleObservation": (
        lambda env: wrappers.RescaleObservation(pixels(env), np.float32(0), np.float32(1)),
        EVERY,
    ),
    "ReshapeObservation": (lambda env: reshaped(flat(env)), FLAT),
    "ResizeObservation": (lambda env: wrappers.ResizeObservation(pixels(env), (32, 32)), EVERY),
    "StickyAction": (lambda env: wrappers.StickyAction(env, 0.3), EVERY),
    "TimeLimit": (lambda env: wrappers.TimeLimit(env, 3), EVERY),
    "TransformAction": (same_action, EVERY),
    "TransformObservation": (same_observation, EVERY),
    "TransformReward": (lambda env: wrappers.TransformReward(env, lambda r: 2 * r), EVERY),
}
#: Wrappers with their own tests below or in test_render.py.
ELSEWHERE = {"RecordVideo", "DiscretizeObservation"}
#: Wrappers for other environments: Atari, and environments written in JAX.
FOREIGN = {"AtariPreprocessing", "JaxToNumpy", "JaxToTorch"}
#: Every wrapper around the first of these ids that it works with; around the others nightly.
TRIED = ("flattened_discrete", "flattened_continuous_actions", "full", "multi-full")
PAIRS = [
    pytest.param(make, view, id=f"{name}-{view}", marks=[pytest.mark.matrix] if number else [])
    for name, (make, views) in WORKING.items()
    for number, view in enumerate(view for view in TRIED if view in views)
]


@pytest.fixture(autouse=True)
def dummy_screen(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")


def make(view, **options):
    return gym.make(f"supertuxkart/{view}-v0", **{**RACE, **options})


def action_for(env):
    action = env.action_space.sample()
    if any(isinstance(layer, wrappers.ArrayConversion) for layer in layers(env)):
        from gymnasium.wrappers.numpy_to_torch import numpy_to_torch

        return numpy_to_torch(action)
    return action


def layers(env):
    while isinstance(env, gym.Wrapper):
        yield env
        env = env.env


def test_all_wrappers_of_gymnasium_are_covered():
    known = {*WORKING, *ELSEWHERE, *FOREIGN, "vector"}
    assert {name for name in wrappers.__all__ if name not in known} == set()


@pytest.mark.slow
@pytest.mark.parametrize(("wrap", "view"), PAIRS)
@pytest.mark.filterwarnings("ignore:.*The obs returned by the .* method:UserWarning")
def test_a_gymnasium_wrapper_works_with_the_id(wrap, view):
    with wrap(make(view, **DRAWN)) as env:
        observation, _ = env.reset(seed=1)
        for _ in range(3):
            observation, reward, _, _, _ = env.step(action_for(env))
        if env.unwrapped.render_mode is not None:
            assert env.render() is not None or isinstance(env, wrappers.HumanRendering)
        assert np.isfinite(float(reward))
        if not any(isinstance(layer, wrappers.ArrayConversion) for layer in layers(env)):
            assert observation in env.observation_space


@pytest.mark.skipif(
    not hasattr(wrappers, "DiscretizeObservation"), reason="this Gymnasium does not have it"
)
def test_discretize_observation_works_with_bounded_observations():
    def speed_class(env):
        bounded = Box(-60.0, 60.0, (3,), np.float32)
        env = wrappers.TransformObservation(
            env, lambda seen: seen["velocity"].clip(-60, 60), bounded
        )
        return wrappers.DiscretizeObservation(env, bins=5)

    with speed_class(make("simple")) as env:
        observation, _ = env.reset(seed=1)
        assert observation in env.observation_space


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_record_video_and_save_video_film_a_race(tmp_path):
    options = {"max_episode_steps": 12, "num_kart": 1}
    drawn = {**DRAWN, "render_size": (128, 96)}
    with wrappers.RecordVideo(
        make("full", **options, **drawn), str(tmp_path / "a"), disable_logger=True
    ) as env:
        env.reset(seed=1)
        for _ in range(12):
            env.step(env.action_space.sample())
    with make("full", **options, **{**drawn, "render_mode": "rgb_array_list"}) as env:
        env.reset(seed=1)
        for _ in range(12):
            env.step(env.action_space.sample())
        save_video(env.render(), str(tmp_path / "b"), fps=env.metadata["render_fps"])
    films = [path for folder in "ab" for path in (tmp_path / folder).glob("*.mp4")]
    assert len(films) == 2
    assert all(film.stat().st_size > 1000 for film in films)


# ------------------------------------------------------------------ vectors


def vector_reshaped(envs):
    (size,) = envs.single_observation_space.shape
    return vector.ReshapeObservation(envs, (1, size))


VECTORS = {
    "ArrayConversion": lambda env: vector.NumpyToTorch(env),
    "ClipAction": vector.ClipAction,
    "ClipReward": lambda env: vector.ClipReward(env, -1, 1),
    "DictInfoToList": vector.DictInfoToList,
    "NormalizeReward": vector.NormalizeReward,
    "NumpyToTorch": lambda env: vector.NumpyToTorch(env),
    "RecordEpisodeStatistics": vector.RecordEpisodeStatistics,
    "RescaleAction": lambda env: vector.RescaleAction(env, np.float32(-1), np.float32(1)),
    "TransformAction": lambda env: vector.TransformAction(env, lambda action: action),
    "TransformReward": lambda env: vector.TransformReward(env, lambda reward: reward),
    "VectorizeTransformAction": lambda env: vector.VectorizeTransformAction(
        env, wrappers.ClipAction
    ),
    "VectorizeTransformReward": lambda env: vector.VectorizeTransformReward(
        env, wrappers.TransformReward, func=lambda reward: reward
    ),
}
#: Gymnasium does not support these wrappers with ``AutoresetMode.SAME_STEP``.
NEXT_STEP_ONLY = {
    "DtypeObservation": lambda env: vector.DtypeObservation(
        vector.FlattenObservation(env), np.float64
    ),
    "FilterObservation": lambda env: vector.FilterObservation(env, ["continuous"]),
    "FlattenObservation": vector.FlattenObservation,
    "NormalizeObservation": lambda env: vector.NormalizeObservation(vector.FlattenObservation(env)),
    "ReshapeObservation": lambda env: vector_reshaped(vector.FlattenObservation(env)),
    "TransformObservation": lambda env: vector.TransformObservation(env, lambda seen: seen),
}
#: Wrappers for images, windows and videos, and for environments written in JAX.
NOT_HERE = {
    "GrayscaleObservation",
    "HumanRendering",
    "JaxToNumpy",
    "JaxToTorch",
    "RecordVideo",
    "RescaleObservation",
    "ResizeObservation",
    "VectorizeTransformObservation",
}


def make_vec(view="flattened_continuous_actions", mode="vector_entry_point", num=2, **options):
    return gym.make_vec(
        f"supertuxkart/{view}-v0", num_envs=num, vectorization_mode=mode, **{**RACE, **options}
    )


def test_all_vector_wrappers_of_gymnasium_are_covered():
    assert set(vector.__all__) <= {*VECTORS, *NEXT_STEP_ONLY, *NOT_HERE}


@pytest.mark.slow
@pytest.mark.parametrize("name", VECTORS)
def test_a_gymnasium_vector_wrapper_works_with_many_races(name):
    envs = VECTORS[name](make_vec())
    envs.reset(seed=1)
    actions = envs.action_space.sample()
    if name in ("NumpyToTorch", "ArrayConversion"):
        import torch

        actions = torch.as_tensor(actions)
    for _ in range(3):
        _, rewards, *_ = envs.step(actions)
    assert len(rewards) == 2
    envs.close()


@pytest.mark.slow
@pytest.mark.parametrize("name", NEXT_STEP_ONLY)
def test_vector_observation_wrappers_work_with_sync_vectors(name):
    envs = NEXT_STEP_ONLY[name](make_vec(mode="sync"))
    envs.reset(seed=1)
    observations, *_ = envs.step(envs.action_space.sample())
    assert observations in envs.observation_space
    envs.close()
    quick = make_vec()
    with pytest.raises(ValueError, match="SAME_STEP"):
        NEXT_STEP_ONLY[name](quick)
    quick.close()


@pytest.mark.parametrize("view", [*FLAT, "flattened_multidiscrete"])
def test_make_vec_returns_a_race_vector_with_the_spaces_of_the_id(view):
    envs = make_vec(view, num=3)
    assert isinstance(envs.unwrapped, stkzoo.RaceVectorEnv)
    assert (envs.num_envs, envs.unwrapped.num_agents) == (3, 1)
    assert envs.metadata["autoreset_mode"] == AutoresetMode.SAME_STEP
    with make(view) as env:
        assert envs.single_observation_space == env.observation_space
        assert envs.single_action_space == env.action_space
    envs.close()


def test_make_vec_with_lists_of_varying_length_suggests_another_id():
    with pytest.raises(ConfigError, match=r'differ in size.*choose view="simple"'):
        make_vec("full")
    with pytest.raises(ConfigError, match="expected an AgentSpec"):
        make_vec("flattened", agent=3)


# ------------------------------------------------------------------ utilities


def test_gymnasiums_benchmark_functions_run():
    with make("flattened_discrete", **DRAWN) as env:
        assert performance.benchmark_step(env, target_duration=0, seed=1) > 0
        assert performance.benchmark_render(env, target_duration=0) > 0
