"""Rules for parallel environments that the checks of PettingZoo and Gymnasium do not cover."""

import copy
import itertools
import math
import random
import warnings

import numpy as np
import pytest
from gymnasium import spaces

from stkzoo import ActionError, AgentSpec, race_v0
from tests.support.paths import ROOT
from tests.support.playing import RandomPolicy, arrays_in, assert_in, fingerprint, play, trace
from tests.support.processes import run_program
from tests.support.views import each_view_and_a_walked_one


def make(view="full", **options):
    """Makes races of three agents that end after a few steps."""
    options = {"num_kart": 3, "track": "olivermath", "max_cycles": 30, **options}
    return race_v0.parallel_env(view=view, **options)


def make_whole(view="full"):
    """Makes races to the finish: one agent acts at random, the game drives two and a bot."""
    agents = [AgentSpec(), AgentSpec(use_ai=True), AgentSpec(use_ai=True)]
    return make(view, num_kart=4, agents=agents, max_cycles=380)


# ---------------------------------------------------------------- a whole race


@pytest.fixture(scope="module")
def whole_race():
    with make_whole() as env:
        return list(play(env, 9))


@pytest.mark.slow
def test_results_have_the_acting_agents_as_keys_also_in_their_last_step(whole_race):
    for step in whole_race:
        for name, part in step.parts.items():
            assert tuple(part) == step.acting, f"step {step.number}: {name}"


@pytest.mark.slow
def test_agents_leave_when_they_end_and_the_others_race_on(whole_race):
    for step in whole_race[1:]:
        assert step.agents == tuple(a for a in step.acting if not step.is_end_of(a))
    lengths = {len(step.acting) for step in whole_race}
    assert len(lengths) > 1, "all agents ended in the same step"
    before, after = (
        [s.observations["kart_0"] for s in whole_race if len(s.acting) == n][-1]
        for n in sorted(lengths)[-2:][::-1]
    )
    assert fingerprint(before) != fingerprint(after)


def test_rewards_are_floats_and_ends_are_bools_that_are_never_both_true(whole_race):
    for step in whole_race[1:]:
        assert all(type(v) is float and math.isfinite(v) for v in step.rewards.values())
        for ends in (step.terminations, step.truncations):
            assert {type(end) for end in ends.values()} == {bool}
        assert not any(step.terminations[a] and step.truncations[a] for a in step.acting)


def test_infos_are_new_dicts_of_numbers_with_the_same_keys(whole_race):
    infos = [info for step in whole_race for info in step.infos.values()]
    assert len({id(info) for info in infos}) == len(infos)
    assert {frozenset(info) for info in infos} == {frozenset(infos[0])}
    kinds = {np.asarray(value).dtype.kind for info in infos for value in info.values()}
    assert kinds <= set("biuf")


@pytest.mark.slow
def test_actions_of_departed_agents_are_ignored(whole_race):
    with make_whole() as env:
        policy = RandomPolicy(env, with_departed=True)
        assert trace(play(env, 9, policy=policy)) == trace(whole_race)


def test_a_step_after_the_end_is_empty():
    with make(max_cycles=1) as env:
        actions = list(play(env, 8))[-1].actions
        for late in ({}, actions, {}):
            assert env.step(dict(late)) == ({}, {}, {}, {}, {})


def test_the_state_is_a_new_array_in_its_space():
    with make() as env:
        states = [env.state() for _ in play(env, 3)]
    for number, state in enumerate(states):
        assert_in(env.state_space, state, f"step {number}: state()")
    assert len({state.ctypes.data for state in states}) == len(states)


# ---------------------------------------------------------------- values of every view


@each_view_and_a_walked_one
def test_observations_are_in_spaces_that_never_change(view):
    with make(view) as env:
        both = [env.observation_space, env.action_space]
        expected = [space(agent) for space in both for agent in env.possible_agents]
        for step in play(env, 2):
            for agent, observation in step.observations.items():
                path = f"step {step.number}: observations[{agent!r}]"
                assert_in(env.observation_space(agent), observation, path)
        actual = [space(agent) for space in both for agent in env.possible_agents]
    assert all(a is b for a, b in zip(expected, actual, strict=True))
    assert all(space == expected[0] for space in expected[:3])  # equal for a group of agents


@each_view_and_a_walked_one
def test_no_arrays_share_memory(view):
    with make(view) as env:
        arrays = [
            found
            for step in play(env, 11)
            for name, part in {"actions": step.actions, **step.parts}.items()
            for found in arrays_in(part, f"step {step.number}: {name}")
            if found[1].size
        ]
    arrays.sort(key=lambda found: np.lib.array_utils.byte_bounds(found[1]))
    for (path, array), (other, neighbor) in itertools.pairwise(arrays):
        assert not np.shares_memory(array, neighbor), f"{path} and {other}"


@each_view_and_a_walked_one
def test_a_caller_may_keep_or_overwrite_actions_and_results(view):
    with make(view) as env:
        steps, kept = [], []
        for step in play(env, 12):
            steps.append(step)
            kept.append(copy.deepcopy([step.actions, step.parts]))
        assert fingerprint([[s.actions, s.parts] for s in steps]) == fingerprint(kept)
        assert trace(overwritten(play(env, 12))) == trace(steps)


def overwritten(steps):
    """Yields the steps and overwrites their values once they are recorded."""
    for step in steps:
        yield step
        for _, array in arrays_in([step.actions, step.parts]):
            if array.flags.writeable:
                array.fill(0 if array.dtype.kind in "US" else 77)
        for part in step.parts.values():
            for entry in part.values():
                if isinstance(entry, dict):
                    entry.clear()
            part.clear()


@each_view_and_a_walked_one
def test_an_invalid_action_is_refused_with_the_agents_name_and_changes_nothing(view):
    with make(view, max_cycles=10) as env:
        expected = trace(play(env, 14))
        assert trace(play(env, 14, policy=Misbehaving(env))) == expected


class Misbehaving(RandomPolicy):
    """Tries all invalid actions of the last agent before it returns valid ones."""

    def __init__(self, env):
        super().__init__(env)
        self._env = env

    def __call__(self, step):
        actions = super().__call__(step)
        agent = step.agents[-1]
        good = actions[agent]
        self._expect_refusal({a: actions[a] for a in step.agents[:-1]}, agent, "no action")
        for what, bad in invalid_actions(self._env.action_space(agent), good, "action"):
            self._expect_refusal({**actions, agent: bad}, agent, what)
        return actions

    def _expect_refusal(self, actions, agent, what):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                self._env.step(actions)
                error = None
            except ActionError as refusal:
                error = refusal
        assert agent in str(error), f"{what}: {error}"


def invalid_actions(space, good, path):
    """Yields descriptions and actions that are not in a space."""
    yield f"{path}=None", None
    yield f"{path}='left'", "left"
    if isinstance(space, spaces.Dict):
        for key, part in space.spaces.items():
            yield f"{path} without {key!r}", {k: v for k, v in good.items() if k != key}
            for what, bad in invalid_actions(part, good[key], f"{path}[{key!r}]"):
                yield what, {**good, key: bad}
    elif isinstance(space, spaces.Box):
        yield from invalid_arrays(space, path)
    elif isinstance(space, spaces.Discrete):
        for number in (space.start - 1, space.start + space.n, space.start + 0.5, math.nan):
            yield f"{path}={number}", number
    elif isinstance(space, spaces.MultiDiscrete):
        yield f"{path} above its bounds", np.asarray(space.start + space.nvec, space.dtype)
        yield f"{path} below its bounds", np.asarray(space.start - 1, space.dtype)
        yield f"{path} of another shape", np.zeros((*space.nvec.shape, 3), space.dtype)


def invalid_arrays(space, path):
    if space.dtype.kind == "f":
        for number in (np.nan, np.inf, -np.inf):
            yield f"{path}={number}", np.full(space.shape, number, space.dtype)
    yield f"{path} above its bounds", np.asarray(space.high + 1, space.dtype)
    yield f"{path} below its bounds", np.asarray(space.low - 1, space.dtype)
    yield f"{path} of another shape", np.broadcast_to(space.low[..., None], (*space.shape, 3))


# ---------------------------------------------------------------- the life of an environment


@pytest.mark.slow
def test_unseeded_resets_continue_the_random_stream_of_the_seed():
    with make("simple") as env:
        once, again = ([trace(play(env, seed)) for seed in (13, None, None)] for _ in range(2))
    assert once == again
    assert not once[0] == once[1] == once[2]


def test_the_global_random_generators_are_left_alone():
    def states():
        return fingerprint([random.getstate(), np.random.get_state()])

    before = states()
    with make("simple") as env:
        for seed in (13, None):
            assert all(states() == before for _ in play(env, seed))
    assert states() == before


def test_close_can_be_repeated_and_a_reset_works_after_it():
    make().close()
    with make("simple") as env:
        expected = trace(play(env, 14))
        env.close()
        env.close()
        assert trace(play(env, 14)) == expected


def test_rendering_without_a_mode_warns():
    with make() as env:
        env.reset(seed=1)
        with pytest.warns(UserWarning, match="render"):
            assert env.render() is None


@pytest.mark.slow
def test_a_race_prints_nothing():
    code = "from tests.env.test_conformance import make, play\nwith make() as env: [*play(env, 1)]"
    done = run_program(code, cwd=ROOT)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
