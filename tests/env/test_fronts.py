"""Every front respects or refuses every option."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.vector import VectorEnv
from pettingzoo import AECEnv, ParallelEnv
from stable_baselines3.common.vec_env import VecEnv

import stkzoo
from stkzoo import ConfigError, EndReason, EngineError, Start, race_v0
from stkzoo.env.front import RaceFront
from stkzoo.sb3 import RaceVecEnv
from stkzoo.views import views
from stkzoo.wrappers.marl import MessageChannel, Teams
from tests.support.rendering import frames_of

#: The first lap ends at once, and GO comes halfway.
BASE = {
    "track": "lighthouse",
    "num_kart": 3,
    "laps": 2,
    "step_size": 0.2,
    "start": {"0": Start(share=0.998, speed=14.0)},
    "render_backend": "map",
    "render_size": (64, 64),
}
NUM_STEPS = 14
#: Options of an episode, which ``reset`` accepts too, with values that change the race.
OF_EPISODES = {
    "num_kart": 2,
    "track": "hacienda",
    "laps": 1,
    "difficulty": 0,
    "reverse": True,
    "mode": "time_trial",
    "max_paths": 1,
    "step_size": 0.1,
    "max_cycles": 4,
    "start": {"0": Start(distance=90.0)},
    "events": True,
    "end_when_stuck": 0.5,
    "end_when_wrong_way": 0.5,
    "end_off_road": 0.5,
    "end_when_first_finishes": 0,
}
OF_ENVIRONMENTS = {
    **OF_EPISODES,
    "agents": 1,
    "opponents": ["pursuit"],
    "reward": {"distance": lambda step: step.distance},
    "view": lambda env: gym.wrappers.TransformReward(env, lambda _: 7.0),
    "render_mode": "rgb_array",
    "render_size": (64, 48),
    "num_cameras": 2,
}


def of_id(name):
    return lambda **options: gym.make(f"supertuxkart/{name}-v0", **options)


def of_vector(mode):
    def make(**options):
        return gym.make_vec("supertuxkart/simple-v0", 1, mode, **options)

    return make


def of_reference(**options):
    from stkzoo._pystk2_gymnasium.envs import STKRaceEnv

    return STKRaceEnv(**options)


def adapted(**options):
    return stkzoo.MonoAgentWrapperAdapter(of_id("multi-full")(**{"agents": 2, **options}), {})


FRONTS = {
    "parallel": lambda **options: race_v0.parallel_env(**{"agents": 2, **options}),
    "aec": lambda **options: race_v0.env(**{"agents": 2, **options}),
    **{name: of_id(name) for name in views() if name != "camera"},
    "multi-full": lambda **options: of_id("multi-full")(**{"agents": 2, **options}),
    **{mode: of_vector(mode) for mode in ("sync", "async", "vector_entry_point")},
    "RaceVectorEnv": lambda **options: stkzoo.RaceVectorEnv(1, **{"agents": 2, **options}),
    "RaceVecEnv": lambda **options: RaceVecEnv(1, **{"agents": 2, **options}),
    "reference": of_reference,
    "adapter": adapted,
}
#: The rest of the table is checked nightly.
QUICK = ("flattened_discrete", "RaceVecEnv")
EACH_FRONT = pytest.mark.parametrize(
    "make",
    [
        pytest.param(make, id=name, marks=pytest.mark.slow if name in QUICK else pytest.mark.matrix)
        for name, make in FRONTS.items()
        if name != "async"  # drives the same races as sync, in processes that show no pictures
    ],
)


def as_text(value):
    """Returns a text that is equal for equal results, without the time since construction."""
    if hasattr(value, "keys"):
        return str({key: as_text(value[key]) for key in value.keys() if key != "t"})  # noqa: SIM118
    if isinstance(value, (tuple, list)):
        return str([as_text(part) for part in value])
    if isinstance(value, np.ndarray) and value.dtype != object:
        return str((value.dtype, value.shape, hash(value.tobytes())))
    return as_text(value.tolist()) if isinstance(value, np.ndarray) else repr(value)


def play(env, options):
    """Returns everything that an environment returns, and whether it is over."""
    if isinstance(env, RaceVecEnv):
        env.seed(1)
        env.set_options(options)
        yield env.reset(), env.reset_infos
    else:
        yield env.reset(seed=1, options=options)
    if isinstance(env, AECEnv):
        for agent in env.agent_iter(NUM_STEPS * env.num_agents):
            last = env.last()
            yield last
            env.step(None if last[2] or last[3] else sample(env.action_space(agent)))
        return
    for _ in range(NUM_STEPS):
        if isinstance(env, ParallelEnv):
            if not env.agents:
                return
            step = env.step({agent: sample(env.action_space(agent)) for agent in env.agents})
        else:
            actions = sample(env.action_space)
            step = env.step([actions] * env.num_envs if isinstance(env, RaceVecEnv) else actions)
        yield step
        if isinstance(env, gym.Env) and (step[2] or step[3]):
            return


def sample(space):
    """Returns the same action in every step, which never calls the rescue bird."""
    if isinstance(space, spaces.Dict):
        return {key: sample(part) for key, part in space.spaces.items()}
    space.seed(3)
    action = space.sample()
    return action if isinstance(space, spaces.Box) else np.zeros_like(action)


def race_of(env):
    """Returns the first race behind a front; ``None`` if it is in another process."""
    while env is not None and not isinstance(env, RaceFront):
        names = [name for name in ("races", "envs", "env") if hasattr(env, name)]
        env = getattr(env, names[0]) if names else None
        env = env[0] if isinstance(env, (list, tuple)) else env
    return env


def outcome(make, options, asked=None):
    """Returns what a front shows of a race with some options, or the error that refuses them."""
    try:
        env = make(**{**BASE, **options})
    except ConfigError as error:
        return f"refused: {error}"
    try:
        race = race_of(env)
        shown = [as_text(results) for results in play(env, asked)]
        if race is not None:  # else it is in another process
            shown += [as_text(frames_of(race)), as_text(race.render()) if race.render_mode else ""]
        return str(shown)
    except (ConfigError, EngineError) as error:
        return f"refused: {error}"
    finally:
        env.close()


@EACH_FRONT
def test_every_option_of_the_constructor_changes_something_or_is_refused(make):
    base = outcome(make, {})
    assert base == outcome(make, {})
    assert not base.startswith("refused")
    results = {name: outcome(make, {name: value}) for name, value in OF_ENVIRONMENTS.items()}
    if results["agents"].startswith("refused"):
        del results["num_cameras"]  # the only agent has one
    assert [name for name, result in results.items() if result == base] == []


@EACH_FRONT
def test_every_option_of_reset_changes_something_or_is_refused(make):
    base = outcome(make, {})
    results = {name: outcome(make, {}, {name: value}) for name, value in OF_EPISODES.items()}
    assert [name for name, result in results.items() if result == base] == []
    refused = [name for name, result in results.items() if result.startswith("refused")]
    assert refused == ["num_kart"]
    assert "Did you mean 'track'" in outcome(make, {}, {"trakc": 1})


@pytest.mark.parametrize("name", [name for name in FRONTS if name != "async"])
def test_options_of_processes_reach_the_game_or_are_refused(name):
    def settings(**options):
        try:
            env = FRONTS[name](**{**BASE, **options})
        except ConfigError as error:
            return str(error)
        session = race_of(env).live_race.session
        env.close()
        return type(session), getattr(session, "_timeouts", None)

    assert settings() == settings()
    assert settings(engine_timeout=5.0) != settings()
    assert settings(use_subprocess=False) != settings()


@pytest.mark.parametrize("view", ["flattened_discrete", "full"])
def test_infos_are_numbers_with_the_same_keys_with_every_option(view):
    options = {name: OF_EPISODES[name] for name in OF_EPISODES if name[:3] in ("end", "eve")}
    options |= {"view": view, "max_cycles": 12, "agents": 2, "opponents": ["pursuit"]}
    options["reward"] = {"kart_0": OF_ENVIRONMENTS["reward"], "kart_1": "placement"}
    with race_v0.parallel_env(**{**BASE, **options, "num_kart": 3}) as race:
        race = MessageChannel(Teams(race, teams=[[0], [1]]))
        (_, first), *steps = play(race, None)
    every = [first, *(step[4] for step in steps)]
    assert {tuple(info) for infos in every for info in infos.values()} == {tuple(first["kart_0"])}
    values = [value for infos in every for info in infos.values() for value in info.values()]
    assert {type(value) for value in values} == {int, float}
    assert {infos[a]["ended_by"] for infos in every for a in infos} > {EndReason.NONE}


@pytest.mark.slow
def test_slots_of_vectors_have_the_same_keys_from_reset_on():
    options = {**BASE, "agents": 2, "end_when_stuck": 1.0, "max_cycles": 12}
    envs = RaceVecEnv(1, **{**options, "num_kart": 2})
    (_, first), *steps = play(envs, None)
    kept = {tuple(sorted(info)) for info in first}
    for _, _, dones, infos in steps:
        kept |= {tuple(sorted(info)) for i, info in enumerate(infos) if not dones[i]}
    envs.close()
    assert len(kept) == 1


@pytest.mark.parametrize("make", FRONTS.values(), ids=FRONTS)
def test_an_unknown_argument_is_the_error_that_libraries_expect(make):
    with pytest.raises(TypeError, match="unexpected keyword argument 'frameskip'") as raised:
        make(frameskip=4)
    assert isinstance(raised.value, ConfigError)


def test_vector_environments_have_all_attributes_of_the_libraries_classes():
    slots = RaceVecEnv(1, **BASE)
    for envs, parent in ((slots.races, VectorEnv), (slots, VecEnv)):
        assert [name for name in dir(parent) if not hasattr(envs, name)] == []
    assert slots.races.autoreset_mode == slots.races.metadata["autoreset_mode"]
    slots.close()
