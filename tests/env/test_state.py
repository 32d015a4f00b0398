"""States of races are saved, restored and cloned bit for bit, and leave no processes behind."""

import gc
import os
import signal
import subprocess
import sys
import textwrap
import threading

import gymnasium as gym
import numpy as np
import pytest

from stkzoo import AgentSpec, race_v0
from stkzoo.engine import fork_client
from stkzoo.engine.assets import find_assets
from stkzoo.errors import (
    AgentException,
    ApiOrderError,
    ConfigError,
    EngineCrashed,
    EngineError,
    EngineTimeout,
)
from tests.support.playing import fingerprint, kart_action
from tests.support.processes import children_of, process_exists, run_program, wait_until
from tests.support.views import marked

SPECS = [AgentSpec(), AgentSpec(use_ai=True), AgentSpec()]


def make(track="olivermath", **options):
    return race_v0.parallel_env(**{"num_kart": 3, "track": track, "max_paths": 5, **options})


@pytest.fixture
def env():
    with make(agents=2) as env:
        yield env


def actions_at(env, number):
    """Returns actions that depend only on the step's number, so that any race can repeat them."""
    random = np.random.default_rng(number)
    return {
        agent: kart_action(
            1.0,
            random.uniform(-0.4, 0.4),
            **{name: int(random.random() < 0.2) for name in ("drift", "fire", "nitro")},
        )
        for agent in env.agents
    }


def drive(env, start=30, stop=60):
    """Runs steps ``start`` to ``stop``; returns fingerprints of everything the env returns."""
    prints = []
    for number in range(start, stop):
        if not env.agents:
            break
        prints.append(fingerprint([env.step(actions_at(env, number)), env.agents, env.state()]))
    return prints


def started(env, steps=30, seed=3):
    env.reset(seed=seed)
    drive(env, 0, steps)
    return env


def fork_server_pid():
    return fork_client.start_fork_server(find_assets().root)._process.pid


@pytest.mark.slow
@pytest.mark.parametrize("track", marked(["olivermath", "zengarden"], ["olivermath"]))
@pytest.mark.parametrize("agents", [2, SPECS], ids=["bots", "ai-agents"])
def test_a_restored_race_equals_the_original_to_its_end(track, agents):
    with (
        make(track, agents=agents, num_kart=4, max_cycles=350) as env,
        make(track, agents=agents, num_kart=4, max_cycles=350) as other,
    ):
        state = started(env, 60).save_state()
        original = drive(env, 60, 350)
        other.restore_state(state)
        assert drive(other, 60, 350) == original
        env.restore_state(state)
        assert drive(env, 60, 350) == original


def test_saving_does_not_change_the_race(env):
    expected = drive(started(env), 30, 90)
    started(env)
    saved = []
    for number in range(30, 90, 10):
        saved.append(env.save_state())
        assert drive(env, number, number + 10) == expected[number - 30 : number - 20]


def test_restoring_repeats_the_unseeded_resets_that_follow(env):
    state = started(env).save_state()
    env.reset()
    expected = env.race.seed
    env.restore_state(state)
    env.reset()
    assert env.race.seed == expected


# ---------------------------------------------------------------------- clones


def test_a_clone_continues_independently(env):
    started(env)
    with env.clone() as clone:
        expected = drive(clone)
        clone.reset()
        assert drive(env) == expected


def test_lookahead_does_not_change_the_environment(env):
    expected = drive(started(env))
    started(env)
    with env.lookahead() as branch:
        drive(branch, 31, 50)
        branch.action_space("kart_0").sample()
        branch.reset()
        pid = branch.live_race.session.pid
    assert drive(env) == expected
    assert wait_until(lambda: not process_exists(pid))


# ---------------------------------------------------------------------- resets


def test_a_reset_to_a_saved_start_repeats_the_start(env):
    first = env.reset(seed=5)
    state = env.save_state()
    expected = drive(env)
    assert fingerprint(env.reset(options={"state": state})) == fingerprint(first)
    assert drive(env) == expected


def test_a_reset_to_a_state_starts_its_counts_at_zero(env):
    state = started(env).save_state()
    _, infos = env.reset(options={"state": state})
    assert infos["kart_0"]["episode/length"] == infos["kart_0"]["episode/return"] == 0
    assert (
        infos["kart_0"]["distance"]
        == state.snapshot.karts["overall_distance"].clip(0)[state.race.kart_indices[0]]
    )


def test_a_reset_to_a_state_accepts_a_new_step_limit_but_no_other_track(env):
    state = started(env).save_state()
    with pytest.raises(ConfigError, match="track"):
        env.reset(options={"state": state, "track": "zengarden"})
    env.reset(options={"state": state, "max_cycles": 5})
    assert len(drive(env)) == 5


def test_a_reset_to_a_race_that_is_over_is_refused():
    with make(max_cycles=5) as env:
        state = started(env, 5).save_state()
        with pytest.raises(ApiOrderError, match="no agent can act"):
            env.reset(options={"state": state})


# ---------------------------------------------------------------------- Gymnasium


@pytest.mark.parametrize("name", ["simple", "flattened_discrete"])
def test_the_gymnasium_ids_restore_and_clone_bit_for_bit(name):
    env = gym.make(f"supertuxkart/{name}-v0", track="olivermath").unwrapped

    def race(env):
        env.action_space.seed(0)
        return [fingerprint(env.step(env.action_space.sample())) for _ in range(30)]

    env.reset(seed=3)
    race(env)
    state = env.save_state()
    clone = env.clone()
    expected = race(env)
    env.restore_state(state)
    with env.lookahead() as branch:
        assert race(branch) == race(clone) == race(env) == expected
    clone.close()
    env.close()


def test_the_multi_agent_env_keeps_which_agents_have_finished():
    agents = [AgentSpec(use_ai=True), AgentSpec()]
    env = gym.make(
        "supertuxkart/multi-full-v0", agents=agents, num_kart=2, track="olivermath", max_paths=5
    ).unwrapped
    env.reset(seed=1)
    idle = {key: space.sample() for key, space in env.action_space.items()}
    info = {"done": {"0": False}}
    while not info["done"]["0"]:
        *_, info = env.step(idle)
    state = env.save_state()
    expected = fingerprint(env.step(idle))
    env.restore_state(state)
    assert fingerprint(env.step(idle)) == expected
    observations, info = env.reset(options={"state": state})
    assert set(observations) == {"0", "1"}
    assert info["done"] == {"0": True, "1": False}
    env.close()


# ---------------------------------------------------------------------- wrappers


class Remembering(gym.Wrapper):
    """Adds its number of steps and random noise to infos."""

    def __init__(self, env):
        super().__init__(env)
        self.seen = [0]

    def step(self, action):
        *parts, info = super().step(action)
        self.seen.append(self.seen[-1] + 1)
        return *parts, info | {"seen": len(self.seen), "noise": float(self.np_random.random())}


@pytest.mark.slow
def test_the_memory_of_wrappers_is_part_of_the_state():
    with make(view=Remembering, agents=2) as env:
        state = started(env).save_state()
        with env.clone() as clone:
            expected = drive(env)
            assert drive(clone) == expected
        env.restore_state(state)
        assert drive(env) == expected


def test_a_wrapper_that_cannot_be_copied_is_named():
    def locked(env):
        env = gym.Wrapper(env)
        env.lock = threading.Lock()
        return env

    with make(view={"kart_1": locked}) as env:
        env.reset(seed=1)
        with pytest.raises(AgentException, match=r"kart_1.*copied"):
            env.save_state()


@pytest.mark.slow
def test_a_state_of_other_wrappers_is_refused_and_the_race_continues(env):
    with make(view=Remembering, agents=2) as other:
        state = started(other).save_state()
        expected = drive(started(env))
        started(env)
        with pytest.raises(AgentException, match="'kart_0' has other wrappers"):
            env.restore_state(state)
        assert drive(env) == expected


# ---------------------------------------------------------------------- refusals


def test_saving_before_the_first_reset_is_refused(env):
    with pytest.raises(ApiOrderError, match="reset"):
        env.save_state()
    with pytest.raises(ApiOrderError, match="reset"):
        env.clone()


@pytest.mark.parametrize(
    "options", [{"num_kart": 4}, {"agents": 1}, {"agents": [AgentSpec(), AgentSpec(use_ai=True)]}]
)
def test_a_state_of_other_karts_or_agents_is_refused(env, options):
    state = started(env).save_state()
    other = make(**{"agents": 2, **options})
    with pytest.raises(ConfigError, match="karts and 2 agents"):
        other.restore_state(state)


@pytest.mark.slow
def test_a_race_of_a_spawned_process_cannot_be_saved_but_continues(env, monkeypatch):
    monkeypatch.setenv("STKZOO_START_METHOD", "spawn")
    started(env)
    with pytest.raises(EngineError, match="STKZOO_START_METHOD"):
        env.save_state()
    assert len(drive(env)) == 30


def test_saving_a_state_waits_for_a_step_in_progress(env):
    expected = drive(started(env))
    started(env)
    env.step_async(actions_at(env, 30))
    with pytest.raises(ApiOrderError, match="step_wait"):
        env.save_state()
    with pytest.raises(ApiOrderError, match="step_wait"):
        env.clone()
    result = env.step_wait()
    assert fingerprint([result, env.agents, env.state()]) == expected[0]


def test_restoring_discards_a_step_in_progress(env):
    state = started(env).save_state()
    expected = drive(env)
    env.restore_state(state)
    env.step_async(actions_at(env, 30))
    env.restore_state(state)
    assert drive(env) == expected


def test_a_closed_state_cannot_be_restored(env):
    state = started(env).save_state()
    with state:
        pass
    with pytest.raises(ApiOrderError, match="closed"):
        env.restore_state(state)
    assert "closed" in repr(state)


# ---------------------------------------------------------------------- processes


def test_a_state_outlives_its_environment():
    with make() as env:
        state = started(env).save_state()
        expected = drive(env)
    del env
    with make() as other:
        other.restore_state(state)
        assert drive(other) == expected


def test_a_killed_state_is_an_error_and_the_race_continues(env):
    expected = drive(started(env))
    state = started(env).save_state()
    os.kill(state.pid, signal.SIGKILL)
    with pytest.raises(EngineCrashed, match=r"saved state \(olivermath\) .*SIGKILL.*save another"):
        env.restore_state(state)
    assert drive(env) == expected


def restore(env, state):
    env.restore_state(state)


def reset(env, state):
    env.reset(options={"state": state})


@pytest.mark.parametrize(
    ("go_on", "place"),
    [(restore, "_go_on_from"), (reset, "_from_state")],
    ids=["restore", "reset"],
)
def test_only_a_reset_goes_on_after_an_interrupt_between_two_moments(
    env, monkeypatch, go_on, place
):
    state = started(env).save_state()
    expected = drive(env)
    whole = getattr(env.live_race, place)

    def interrupted(*arguments):
        whole(*arguments)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(env.live_race, place, interrupted)
        with pytest.raises(KeyboardInterrupt):
            go_on(env, state)
    assert not env.agents
    with pytest.raises(ApiOrderError, match="call reset"):
        env.step({})
    assert drive(started(env)) == expected


def test_a_stopped_state_times_out_and_is_ended():
    with make(engine_timeout=0.3) as env:
        state = started(env).save_state()
        pid = state.pid
        os.kill(pid, signal.SIGSTOP)
        with pytest.raises(EngineTimeout, match="saved state"):
            env.restore_state(state)
        assert wait_until(lambda: not process_exists(pid))


def test_a_killed_race_does_not_harm_its_states(env):
    state = started(env).save_state()
    expected = drive(env)
    os.kill(env.live_race.session.pid, signal.SIGKILL)
    with pytest.raises(EngineCrashed):
        drive(env)
    env.restore_state(state)
    assert drive(env) == expected


def test_states_lost_with_a_killed_fork_server_are_an_error(env):
    state = started(env).save_state()
    pid = state.pid
    os.kill(fork_server_pid(), signal.SIGKILL)
    assert wait_until(lambda: not process_exists(pid))
    with pytest.raises(EngineCrashed, match="saved state"):
        env.restore_state(state)
    assert len(drive(started(env))) == 30


@pytest.mark.slow
def test_many_states_leave_no_process_and_no_open_file_behind(env):
    started(env).save_state().close()
    before = children_of(fork_server_pid())
    files = len(os.listdir("/proc/self/fd"))
    files_of_game = set()
    for _ in range(100):
        with env.save_state() as state:
            env.restore_state(state)
            env.step(actions_at(env, 30))
        files_of_game.add(len(os.listdir(f"/proc/{env.live_race.session.pid}/fd")))
    assert wait_until(lambda: len(children_of(fork_server_pid())) == 1), before
    assert len(os.listdir("/proc/self/fd")) == files
    assert len(files_of_game) == 1


def test_unreferenced_states_and_clones_end(env):
    started(env)
    state, clone = env.save_state(), env.clone()
    pids = [state.pid, clone.live_race.session.pid]
    del state, clone
    gc.collect()
    assert wait_until(lambda: not any(map(process_exists, pids)))


PROGRAM = """
    import os, signal, sys, time
    from stkzoo import race_v0
    from stkzoo.engine import fork_client
    env = race_v0.parallel_env(track="olivermath")
    env.reset(seed=1)
    states = [env.save_state() for _ in range(3)]
    clone = env.clone()
    (fork_server,) = fork_client._fork_servers.values()
    print(fork_server._process.pid, env.live_race.session.pid, clone.live_race.session.pid,
          *(state.pid for state in states), flush=True)
    {ending}
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    "ending",
    [
        "[os.kill(s.pid, signal.SIGSTOP) for s in states]; os.kill(os.getpid(), signal.SIGKILL)",
        "os.kill(states[0].pid, signal.SIGSTOP); os.kill(fork_server._process.pid, signal.SIGKILL)",
        "time.sleep(4) if os.fork() == 0 else os.kill(os.getpid(), signal.SIGKILL)",
    ],
    ids=["stopped", "fork-server-killed", "forked"],
)
def test_no_state_outlives_the_program(ending):
    program = textwrap.dedent(PROGRAM).format(ending=ending)
    child = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    pids = child.stdout.readline().split()
    child.stdout.close()
    child.wait(30)
    assert len(pids) == 6
    assert wait_until(lambda: not any(map(process_exists, pids)))


@pytest.mark.slow
def test_a_forked_copy_of_the_program_does_not_end_states():
    code = """
        import os
        from stkzoo import race_v0
        from stkzoo.errors import ApiOrderError
        env = race_v0.parallel_env(track="olivermath")
        env.reset(seed=1)
        state = env.save_state()
        if os.fork() == 0:
            try:
                env.restore_state(state)
            except ApiOrderError as error:
                print("forked" in str(error), flush=True)
            state.close()
            os._exit(0)
        os.wait()
        env.restore_state(state)
        print(len(env.agents))
    """
    assert run_program(code).stdout.split() == ["True", "3"]
