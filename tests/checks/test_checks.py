"""The checks pass on correct environments, and each of them detects its defect."""

from __future__ import annotations

import functools
import json
import os
import random
import re
import subprocess
import sys
import threading
import warnings

import cloudpickle
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.utils import seeding
from pettingzoo import ParallelEnv

from stkzoo import race_v0
from stkzoo.checks import CHECKS, CheckFailed, load_factory, play, run_check, trace
from stkzoo.checks import __main__ as command
from stkzoo.checks.play import CheckResult, fingerprint
from stkzoo.checks.values import expect_in
from stkzoo.errors import ConfigError
from stkzoo.views import VIEWS

# A fresh process cannot import the classes of a test module.
cloudpickle.register_pickle_by_value(sys.modules[__name__])

BUILT_IN_VIEWS = tuple(VIEWS)


class ToyRace(ParallelEnv):
    """A correct race of points on a line."""

    metadata = {"name": "toy_v0", "render_modes": [], "is_parallelizable": True}  # noqa: RUF012
    render_mode = None

    def __init__(self, max_cycles=50):
        self.max_cycles = max_cycles
        self.possible_agents = [f"racer_{number}" for number in range(3)]
        self.agents = []
        self.observation_spaces = {a: self.make_observation_space() for a in self.possible_agents}
        self.action_spaces = {a: self.make_action_space() for a in self.possible_agents}
        self.state_space = spaces.Box(-np.inf, np.inf, (3,))
        self.rng = None
        self.steps = 0

    def make_observation_space(self):
        return spaces.Dict({"where": spaces.Box(0, np.inf, (2,)), "steps": spaces.Discrete(1000)})

    def make_action_space(self):
        return spaces.Dict({"gas": spaces.Box(0, 1, (1,)), "gear": spaces.Discrete(2)})

    def observation_space(self, agent):
        return self.observation_spaces[agent]

    def action_space(self, agent):
        return self.action_spaces[agent]

    def draw(self, seed):
        if seed is not None or self.rng is None:
            self.rng, _ = seeding.np_random(seed)
        return self.rng.uniform(0.3, 1.5, 3)

    def reset(self, seed=None, options=None):  # noqa: ARG002
        self.speeds = dict(zip(self.possible_agents, self.draw(seed).tolist(), strict=True))
        self.distances = dict.fromkeys(self.possible_agents, 0.0)
        self.steps = 0
        self.agents = list(self.possible_agents)
        return self.observe(self.agents), self.infos(self.agents)

    def check(self, actions):
        for agent in self.agents:
            action = actions.get(agent)
            if not (isinstance(action, dict) and self.action_space(agent).contains(action)):
                raise ValueError(f"agent {agent} sent {action}")

    def step(self, actions):
        if not self.agents:
            return {}, {}, {}, {}, {}
        self.check(actions)
        acting = list(self.agents)
        self.steps += 1
        for agent in acting:
            gas = float(actions[agent]["gas"][0]) + int(actions[agent]["gear"])
            self.distances[agent] += self.speeds[agent] * gas
        ends = {agent: self.distances[agent] >= 12 for agent in acting}
        cuts = {agent: self.steps >= self.max_cycles and not ends[agent] for agent in acting}
        self.agents = [agent for agent in acting if not (ends[agent] or cuts[agent])]
        return self.observe(acting), self.rewards(acting), ends, cuts, self.infos(acting)

    def observe(self, agents):
        return {agent: self.see(agent) for agent in agents}

    def see(self, agent):
        where = np.array([self.distances[agent], self.speeds[agent]], np.float32)
        return {"where": where, "steps": self.steps}

    def rewards(self, agents):
        return {agent: self.speeds[agent] for agent in agents}

    def infos(self, agents):
        return {agent: {"distance": self.distances[agent], "steps": self.steps} for agent in agents}

    def state(self):
        return np.array(list(self.distances.values()), np.float32)

    def render(self):
        warnings.warn("nothing is shown", stacklevel=1)

    def close(self):
        self.agents = []


class ToyRaceWithWorker(ToyRace):
    """Has a child process, like a game, and starts another one if that has ended."""

    worker = None

    def reset(self, seed=None, options=None):
        if self.worker is None or self.worker.poll() is not None:
            self.close()
            self.worker = subprocess.Popen(["sleep", "60"])
        return super().reset(seed, options)

    def close(self):
        if self.worker is not None:
            self.worker.kill()
            self.worker.wait()
            self.worker = None
        super().close()


# ---------------------------------------------------------------- a defect for each check


class NewSpaceEachTime(ToyRace):
    def action_space(self, agent):  # noqa: ARG002
        return self.make_action_space()


class UnlikeSpaces(ToyRace):
    def __init__(self, max_cycles=50):
        super().__init__(max_cycles)
        self.observation_spaces["racer_1"]["steps"] = spaces.Discrete(2000)


class TooManySteps(ToyRace):
    def see(self, agent):
        seen = super().see(agent)
        return {**seen, "steps": 4711 if (agent, self.steps) == ("racer_1", 5) else self.steps}


class DoubleObservations(ToyRace):
    def see(self, agent):
        seen = super().see(agent)
        return {**seen, "where": seen["where"].astype(np.float64)}


class UnknownKey(ToyRace):
    def see(self, agent):
        return {**super().see(agent), "extra": 1}


class WrongState(ToyRace):
    def state(self):
        return np.full(3, np.nan, np.float32)


class OneState(ToyRace):
    buffer = np.zeros(3, np.float32)

    def state(self):
        return self.buffer


class NoLastInfo(ToyRace):
    def step(self, actions):
        *rest, infos = super().step(actions)
        return (*rest, {agent: infos[agent] for agent in self.agents})


class LateLeaver(ToyRace):
    def step(self, actions):
        acting = list(self.agents)
        result = super().step(actions)
        if len(self.agents) < len(acting):
            self.agents = acting
        return result


class NumpyEnds(ToyRace):
    def step(self, actions):
        observations, rewards, ends, *rest = super().step(actions)
        return observations, rewards, {a: np.bool_(end) for a, end in ends.items()}, *rest


class WholeRewards(ToyRace):
    def rewards(self, agents):
        return dict.fromkeys(agents, 1)


class PaysOnAndOn(ToyRace):
    def rewards(self, agents):  # noqa: ARG002
        return super().rewards(self.possible_agents)


class StopsAfterTheFirst(ToyRace):
    def step(self, actions):
        if 0 < len(self.agents) < 3:
            self.check(actions)
            agents = self.agents
            false = dict.fromkeys(agents, False)
            return self.observe(agents), self.rewards(agents), false, false, self.infos(agents)
        return super().step(actions)


class RaisesAfterTheEnd(ToyRace):
    def step(self, actions):
        if not self.agents:
            raise RuntimeError("the race is over")
        return super().step(actions)


class ListensToTheDeparted(ToyRace):
    def step(self, actions):
        for agent in set(actions) - set(self.agents):
            gas = float(actions[agent]["gas"][0])
            self.speeds = {racer: speed * (1 + gas) for racer, speed in self.speeds.items()}
        return super().step(actions)


class NamesInInfos(ToyRace):
    def infos(self, agents):
        return {agent: {"track": "toytown"} for agent in agents}


class LateInfos(ToyRace):
    def infos(self, agents):
        infos = super().infos(agents)
        return {a: {**infos[a], "late": 1.0} if self.steps == 3 else infos[a] for a in agents}


class OneInfo(ToyRace):
    def infos(self, agents):
        info = {"steps": self.steps}
        return dict.fromkeys(agents, info)


class SharedRows(ToyRace):
    def observe(self, agents):
        observations = super().observe(agents)
        row = np.zeros(4, np.float32)
        return {agent: {**seen, "where": row[1:3]} for agent, seen in observations.items()}


class ReusedArray(ToyRace):
    def see(self, agent):
        buffers = self.__dict__.setdefault("buffers", {})
        seen = super().see(agent)
        seen["where"] = (
            np.copyto(buffers.setdefault(agent, seen["where"]), seen["where"]) or (buffers[agent])
        )
        return seen


class OwnArrayHandedOut(ToyRace):
    def see(self, agent):
        self.__dict__.setdefault("kept", {}).setdefault(agent, np.zeros(2, np.float32))
        return {**super().see(agent), "where": self.kept[agent]}


class ChangesActions(ToyRace):
    def step(self, actions):
        result = super().step(actions)
        for action in actions.values():
            action["gas"] *= 0
        return result


class TakesAnything(ToyRace):
    def check(self, actions):
        pass

    def step(self, actions):
        coast = {"gas": np.zeros(1), "gear": 0}
        return super().step(dict.fromkeys(self.agents, coast) | dict.fromkeys(actions, coast))


class NamelessErrors(ToyRace):
    def check(self, actions):
        try:
            super().check(actions)
        except ValueError:
            raise ValueError("bad action") from None


class MovesBeforeRefusing(ToyRace):
    def step(self, actions):
        if self.agents:
            self.distances["racer_0"] += 0.1
        return super().step(actions)


class ClosedForEver(ToyRace):
    is_closed = False

    def reset(self, seed=None, options=None):
        if self.is_closed:
            raise RuntimeError("closed")
        return super().reset(seed, options)

    def close(self):
        self.is_closed = True


class SilentRender(ToyRace):
    def render(self):
        pass


class Chatty(ToyRace):
    def reset(self, seed=None, options=None):
        os.write(1, b"engine 2.0\n")
        return super().reset(seed, options)


class RemembersResets(ToyRace):
    resets = 0

    def draw(self, seed):
        self.resets += 1
        return super().draw(seed) + 0.01 * self.resets


class CountsEnvs(ToyRace):
    count = [0]  # noqa: RUF012

    def __init__(self, max_cycles=50):
        super().__init__(max_cycles)
        self.count[0] += 1
        self.number = self.count[0]

    def draw(self, seed):
        return super().draw(seed) + 0.01 * self.number


class DependsOnHashes(ToyRace):
    def draw(self, seed):
        return super().draw(seed) + hash("racer") % 99_991 / 1e6


class MissesItsWorker(ToyRaceWithWorker):
    deaths = 0

    def draw(self, seed):
        return super().draw(seed) + 0.01 * self.deaths

    def close(self):
        self.deaths += self.worker is not None
        super().close()


class DeafToSeeds(ToyRace):
    def draw(self, seed):  # noqa: ARG002
        return super().draw(0)


class FreshEntropy(ToyRace):
    def draw(self, seed):
        self.rng, _ = seeding.np_random(seed)
        return self.rng.uniform(0.3, 1.5, 3)


class AlwaysTheSame(ToyRace):
    last = None

    def draw(self, seed):
        self.last = self.last if seed is None else seed
        return super().draw(self.last)


class DrawsGlobally(ToyRace):
    def reset(self, seed=None, options=None):
        np.random.random()
        return super().reset(seed, options)


class SeedsGlobally(ToyRace):
    def reset(self, seed=None, options=None):
        random.seed(seed)
        return super().reset(seed, options)


class OneStreamForAll(ToyRace):
    shared = {}  # noqa: RUF012

    def draw(self, seed):
        self.shared["rng"], _ = seeding.np_random(seed)
        return super().draw(seed)

    def see(self, agent):
        return {**super().see(agent), "steps": int(self.shared["rng"].integers(1000))}


class Unpicklable(ToyRace):
    def __init__(self, max_cycles=50):
        super().__init__(max_cycles)
        self.lock = threading.Lock()


class ForgetfulCopy(ToyRace):
    def __reduce__(self):
        return type(self), (9,)


class Endless(ToyRace):
    def step(self, actions):
        observations, rewards, ends, _, infos = super().step(actions)
        self.agents, self.distances = list(self.possible_agents), dict(self.distances, racer_0=0.0)
        false = dict.fromkeys(ends, False)
        return observations, rewards, false, false, infos


class FourResults(ToyRace):
    def step(self, actions):
        return super().step(actions)[:4]


BROKEN = [
    (NewSpaceEachTime, "spaces_are_constant", r"action_space\('racer_0'\) is another object"),
    (UnlikeSpaces, "spaces_are_constant", r"observation_space\('racer_1'\) differs from .*racer_0"),
    (
        TooManySteps,
        "observations_are_in_their_spaces",
        r"step 5: observations\['racer_1'\]\['steps'\] is 4711",
    ),
    (DoubleObservations, "observations_are_in_their_spaces", "dtype float64, expected float32"),
    (UnknownKey, "observations_are_in_their_spaces", r"unknown keys \['extra'\]"),
    (WrongState, "state_is_in_its_space", r"step 0: state\(\)"),
    (OneState, "state_is_in_its_space", "shares memory"),
    (NoLastInfo, "keys_are_the_acting_agents", r"infos lacks \['racer_\d'\]"),
    (LateLeaver, "agents_leave_when_done", "neither terminated nor truncated"),
    (NumpyEnds, "types_of_rewards_and_ends", "step 1: terminations.*expected a finite bool"),
    (WholeRewards, "types_of_rewards_and_ends", "step 1: rewards.*expected a finite float"),
    (PaysOnAndOn, "finished_agents_leave_the_rest_racing", "rewards still serves"),
    (StopsAfterTheFirst, "finished_agents_leave_the_rest_racing", "nothing has moved"),
    (RaisesAfterTheEnd, "step_after_the_end_is_empty", "the race is over"),
    (ListensToTheDeparted, "actions_of_departed_agents_are_ignored", "first at step"),
    (NamesInInfos, "infos_are_plain_numbers", r"infos\['racer_0'\]\['track'\] is 'toytown'"),
    (LateInfos, "infos_are_plain_numbers", "step 3.*'late'"),
    (OneInfo, "infos_are_plain_numbers", "handed out before"),
    (SharedRows, "results_share_no_memory", "racer_.*shares memory with.*racer_"),
    (ReusedArray, "results_share_no_memory", "step 1.*shares memory with step 0"),
    (ReusedArray, "results_are_the_callers_own", "step 1 changed what step 0 had returned"),
    (OwnArrayHandedOut, "results_are_the_callers_own", "overwritten by the caller differ"),
    (ChangesActions, "results_are_the_callers_own", "changed the actions"),
    (TakesAnything, "bad_actions_are_refused", "step 0: no action of agent 'racer_2' was accepted"),
    (NamelessErrors, "bad_actions_are_refused", "expected a text that names the agent"),
    (MovesBeforeRefusing, "bad_actions_are_refused", "refused actions in between differ"),
    (ClosedForEver, "close_can_be_repeated_and_undone", "RuntimeError: closed"),
    (SilentRender, "render_without_a_mode_warns", "was silent"),
    (Chatty, "nothing_is_written_to_the_terminal", "engine 2.0"),
    (RemembersResets, "seed_repeats_in_one_env", "first at step 0 in observations"),
    (CountsEnvs, "seed_repeats_in_two_envs", "first at step 0 in observations"),
    (DependsOnHashes, "seed_repeats_in_a_fresh_process", "first at step 0 in observations"),
    (MissesItsWorker, "seed_repeats_after_a_killed_worker", "killed worker process differ"),
    (DeafToSeeds, "other_seed_differs", "gave the same race"),
    (FreshEntropy, "unseeded_resets_continue_the_stream", "races number 1"),
    (AlwaysTheSame, "unseeded_resets_continue_the_stream", "same race again and again"),
    (DrawsGlobally, "global_random_state_is_left_alone", "numpy.random has changed.*step 0"),
    (SeedsGlobally, "global_random_state_is_left_alone", "state of random has changed.*step 0"),
    (OneStreamForAll, "envs_in_turn_do_not_meet", "in turn with another environment's differ"),
    (Unpicklable, "pickled_copies_play_the_same_race", "cannot be copied"),
    (ForgetfulCopy, "pickled_copies_play_the_same_race", "pickled copy and of its original differ"),
    (Endless, "agents_leave_when_done", "has no end"),
    (FourResults, "agents_leave_when_done", r"step\(\) returned 4 values, expected a tuple of 5"),
]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("broken", "name", "why"), BROKEN, ids=[f"{b.__name__}-{n}" for b, n, _ in BROKEN]
)
def test_a_check_detects_a_defect_and_says_where(broken, name, why):
    outcome = run_check(CHECKS[name], broken)
    assert outcome.status == "failed"
    assert re.search(why, outcome.why, re.DOTALL), outcome.why


def test_every_check_has_a_defect_that_it_detects():
    assert {name for _, name, _ in BROKEN} == set(CHECKS)


@pytest.mark.parametrize("name", CHECKS)
def test_a_correct_environment_passes(name):
    outcome = run_check(CHECKS[name], ToyRaceWithWorker)
    assert outcome.status == "passed", outcome.why


def test_killing_a_worker_is_not_applicable_without_one():
    outcome = run_check(CHECKS["seed_repeats_after_a_killed_worker"], ToyRace)
    assert (outcome.status, outcome.why) == (
        "not applicable",
        "the environment starts no process of its own",
    )


# ---------------------------------------------------------------- the race itself

#: Checks of an agent's view; the others do the same work for every view.
VIEW_CHECKS = (
    "spaces_are_constant",
    "observations_are_in_their_spaces",
    "infos_are_plain_numbers",
    "results_share_no_memory",
    "results_are_the_callers_own",
    "bad_actions_are_refused",
)
RACE_CASES = [
    (view, name) for view in BUILT_IN_VIEWS for name in (CHECKS if view == "full" else VIEW_CHECKS)
]
# These checks also cover the memory of wrappers over a whole race.
RACE_CASES += [
    ("flattened_discrete", name)
    for name in (
        "actions_of_departed_agents_are_ignored",
        "pickled_copies_play_the_same_race",
        "seed_repeats_in_a_fresh_process",
        "seed_repeats_in_one_env",
    )
]


@pytest.mark.slow
@pytest.mark.parametrize(("view", "name"), RACE_CASES)
def test_the_race_passes(view, name):
    outcome = run_check(CHECKS[name], functools.partial(race_v0.parallel_env, view=view))
    assert outcome.status == "passed", outcome.why


# ---------------------------------------------------------------- the command


def _command(*arguments):
    return subprocess.run(
        [sys.executable, "-m", "stkzoo.checks", *arguments], capture_output=True, text=True
    )


@pytest.mark.slow
def test_the_command_prints_a_line_for_each_view_and_check():
    run = _command(
        "stkzoo.race_v0:parallel_env",
        *("--view", "simple", "flattened"),
        *("--track", "zengarden"),
        *("--check", "spaces_are_constant", "render_without_a_mode_warns"),
    )
    lines = [line.split(" (")[0] for line in run.stdout.splitlines()]
    assert lines == [
        "[simple zengarden] spaces are constant",
        "[simple zengarden] render without a mode warns",
        "[flattened zengarden] spaces are constant",
        "[flattened zengarden] render without a mode warns",
    ]
    assert all(line.endswith(": passed") for line in run.stdout.splitlines())
    assert (run.returncode, run.stderr) == (0, "")


@pytest.mark.slow
def test_the_command_checks_all_registered_views_by_default():
    run = _command(
        "stkzoo.race_v0:parallel_env", "--json", "--check", "render_without_a_mode_warns"
    )
    outcomes = json.loads(run.stdout)
    assert [outcome["variant"] for outcome in outcomes] == list(BUILT_IN_VIEWS)
    assert {outcome["status"] for outcome in outcomes} == {"passed"}


def test_the_command_fails_on_another_environment_and_says_why():
    run = _command(
        "pettingzoo.test.example_envs.generated_agents_parallel_v0:parallel_env",
        *("--check", "agents_leave_when_done"),
    )
    assert run.returncode == 1
    assert re.match(r"agents leave when done \(.*\): FAILED: .*possible_agents", run.stdout)


def test_the_command_ends_without_a_traceback_after_ctrl_c(monkeypatch, capsys):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(command, "_run", interrupt)
    environment = "pettingzoo.test.example_envs.generated_agents_parallel_v0:parallel_env"
    assert command.main([environment]) == 130
    assert capsys.readouterr().err == "interrupted\n"


def test_the_command_prints_texts_as_they_are(monkeypatch, capsys):
    outcome = CheckResult("failed", "kart:fire:red [red]", 0.0)
    monkeypatch.setattr(command, "run_check", lambda *_: outcome)
    environment = "pettingzoo.test.example_envs.generated_agents_parallel_v0:parallel_env"
    for words in ([], ["--json"]):
        assert command.main([environment, *words]) == 1
        assert "kart:fire:red [red]" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (["stkzoo.race_v0"], "expected module:callable"),
        (["stkzoo.race_v9:parallel_env"], "cannot be loaded"),
        (["stkzoo.race_v0:paralel_env"], "cannot be loaded"),
        (["stkzoo.race_v0:__all__"], "expected a function"),
        (["stkzoo.race_v0:parallel_env", "--view", "simpel"], "Did you mean 'simple'"),
        (["stkzoo.race_v0:parallel_env", "--check", "silence"], "unknown check"),
        (["stkzoo.config:AgentSpec", "--track", "mines"], "takes no 'track'"),
        (["stkzoo.race_v0:parallel_env", "--track", "lighthous"], "Did you mean 'lighthouse'"),
    ],
)
def test_invalid_arguments_exit_with_2(arguments, why):
    run = _command(*arguments)
    assert run.returncode == 2
    assert why in run.stderr


def test_a_factory_is_loaded_by_name():
    assert load_factory("stkzoo.race_v0:parallel_env") is race_v0.parallel_env


def test_a_missing_factory_is_a_config_error():
    with pytest.raises(ConfigError, match="cannot be loaded"):
        load_factory("stkzoo.race_v0:nothing")


@pytest.mark.parametrize(
    "wrong",
    [
        np.array([0, 2], np.float32),
        np.array([0, np.nan], np.float32),
        np.zeros(2, np.float64),
        np.zeros(3, np.float32),
    ],
    ids=["above the bounds", "not a number", "another dtype", "another shape"],
)
def test_a_wrong_entry_of_a_sequence_is_named(wrong):
    space, row = spaces.Sequence(spaces.Box(0, 1, (2,))), np.zeros(2, np.float32)
    expect_in(space, (row, row), "seen")
    with pytest.raises(CheckFailed, match=r"seen\[1\] (is|has dtype)"):
        expect_in(space, (row, wrong), "seen")


def test_a_fingerprint_distinguishes_sequences_of_arrays():
    row = np.zeros(2, np.float32)
    values = [
        (row, row),
        [row, row],
        (row,),
        (row, row, row),
        (row, row + 1),
        (row.astype(np.int32),) * 2,
        (row[:, None], row[:, None]),
        (row, row[:1]),
        (np.stack([row, row]),),
        np.stack([row, row]),
    ]
    assert len({fingerprint(value) for value in values}) == len(values)
    assert fingerprint((row, row)) == fingerprint((row.copy(), row.copy()))


def test_a_trace_distinguishes_types():
    class FloatSteps(ToyRace):
        def infos(self, agents):
            return {agent: {**i, "steps": float(i["steps"])} for agent, i in _infos(self, agents)}

    def _infos(env, agents):
        return ToyRace.infos(env, agents).items()

    assert trace(play(ToyRace(), 1)) != trace(play(FloatSteps(), 1))
