"""Several environments in one program, and crashes of the game in one of them."""

import os
import signal

import pytest

from stkzoo import AgentSpec, ApiOrderError, EngineCrashed, EngineTimeout, race_v0


def make_env(**options):
    agents = [AgentSpec(), AgentSpec(use_ai=True)]
    defaults = {"num_kart": 3, "track": "olivermath", "view": "flattened_discrete"}
    return race_v0.parallel_env(agents=agents, **{**defaults, **options})


def play(env, seed, steps=60):
    """Returns a trace of an environment in which every step has the same action."""
    trace = [env.reset(seed=seed)]
    trace.extend(env.step({"kart_0": 700}) for _ in range(steps))
    return repr(trace)


def pid_of(env):
    return env.live_race.session.pid


@pytest.mark.slow
def test_three_environments_stepped_in_turn_race_as_they_do_alone():
    with make_env() as env:
        alone = [play(env, seed) for seed in (1, 2, 3)]
    envs = [make_env() for _ in range(3)]
    traces = [[env.reset(seed=seed)] for env, seed in zip(envs, (1, 2, 3), strict=True)]
    for _ in range(60):
        for env, trace in zip(envs, traces, strict=True):
            trace.append(env.step({"kart_0": 700}))
    for env in envs:
        env.close()
    assert [repr(trace) for trace in traces] == alone


def test_a_step_after_a_crash_asks_for_a_reset():
    with make_env() as env:
        env.reset(seed=1)
        os.kill(pid_of(env), signal.SIGKILL)
        with pytest.raises(EngineCrashed):
            env.step({"kart_0": 0})
        with pytest.raises(ApiOrderError, match="reset"):
            env.step({"kart_0": 0})


def test_a_hanging_game_times_out():
    with make_env(engine_timeout=0.3) as env:
        env.reset(seed=1)
        os.kill(pid_of(env), signal.SIGSTOP)
        with pytest.raises(EngineTimeout):
            env.step({"kart_0": 0})
        env.reset(seed=1)
        assert env.step({"kart_0": 0})[1].keys() == {"kart_0", "kart_1"}


def test_calls_in_the_wrong_order_are_refused():
    env = make_env()
    for call in (lambda: env.step({}), env.state, lambda: env.observe(["kart_0"])):
        with pytest.raises(ApiOrderError, match="reset"):
            call()
    env.reset(seed=1)
    env.close()
    with pytest.raises(ApiOrderError, match="reset"):
        env.step({"kart_0": 0})
