"""The forms of the environment and their operations, for fault injection."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

import stkzoo
from stkzoo import AgentSpec, race_v0
from stkzoo.engine import fork_client
from tests.support.paths import AGENTS
from tests.support.playing import fingerprint

__all__ = ["FORMS", "Form"]

#: Engine timeout of a step [s]; short, so that a stopped game is detected soon.
ENGINE_TIMEOUT = 4.0
TRACK = "olivermath"
_STEPS = 15
_TRACE_STEPS = 25
_TRACE_SEED = 7


class Form:
    """One form of the environment, and the operations during which faults occur.

    Attributes:
        name: name of the form in faults.
        moments: names of the operations, which are methods; all but ``construct`` and ``begin``
            need a race.
        targets: roles of its processes.
    """

    name = ""
    moments: tuple[str, ...] = ("construct", "begin", "reset", "reset", "step", "step", "close")
    targets: tuple[str, ...] = ("race", "race", "race", "fork server", "program")

    def __init__(self) -> None:
        self._env: Any = None
        self._seed = 0

    def make(self) -> Any:
        """Returns a new environment."""
        raise NotImplementedError

    def construct(self) -> None:
        """Creates the environment."""
        self._env = self.make()

    def begin(self) -> None:
        """Creates the first environment of a program, which starts a new fork server."""
        fork_client._close_all()
        self.construct()
        self.reset()

    def reset(self) -> None:
        """Starts a race with the next seed."""
        self._seed += 1
        self._env.reset(seed=self._seed)

    def step(self) -> None:
        """Takes some steps."""
        for _ in range(_STEPS):
            self._step(self._env)

    def render(self) -> None:
        """Renders images during a race."""
        for _ in range(3):
            self._env.render()
            self._step(self._env)

    def close(self) -> None:
        """Ends the races. Repeated calls do nothing."""
        if self._env is not None:
            self._env.close()

    def mend(self) -> None:
        """Creates a new environment if there is none, or if the old one cannot be reset."""
        if self._env is None:
            self.construct()

    def trace(self) -> str:
        """Returns a digest of one short race with a fixed seed."""
        parts = [self._env.reset(seed=_TRACE_SEED)]
        parts.extend(self._step(self._env) for _ in range(_TRACE_STEPS))
        return fingerprint(parts)

    @property
    def num_crashes(self) -> int:
        """Number of crashes from which the form has recovered by itself."""
        return 0

    def _step(self, env: Any) -> Any:
        return env.step(dict.fromkeys(env.agents, 700))


class ParallelForm(Form):
    """The parallel environment, in a race with bots, with saved and restored states."""

    name = "ParallelEnv"
    moments = (*Form.moments, "render", "save", "save", "clone", "clone")

    def make(self) -> Any:
        return race_v0.parallel_env(
            agents=[AgentSpec(), AgentSpec(use_ai=True)],
            num_kart=3,
            track=TRACK,
            view="flattened_discrete",
            engine_timeout=ENGINE_TIMEOUT,
            render_mode="rgb_array",
            render_backend="map",
            render_size=(96, 64),
        )

    def save(self) -> None:
        """Saves states, takes a step and restores them."""
        for _ in range(4):
            state = self._env.save_state()
            try:
                self._step(self._env)
                self._env.restore_state(state)
            finally:
                state.close()

    def clone(self) -> None:
        """Creates copies and takes a step in each."""
        for _ in range(4):
            copy = self._env.clone()
            try:
                self._step(copy)
            finally:
                copy.close()


class GymnasiumForm(Form):
    """One kart through Gymnasium."""

    name = "Gymnasium id"

    def make(self) -> Any:
        return gym.make(
            "supertuxkart/flattened_discrete-v0",
            num_kart=3,
            track=TRACK,
            engine_timeout=ENGINE_TIMEOUT,
            disable_env_checker=True,
        )

    def _step(self, env: Any) -> Any:
        return env.step(700)


class VectorForm(Form):
    """Two races in one batch, with prefetch."""

    name = "RaceVectorEnv"

    def make(self) -> Any:
        return stkzoo.RaceVectorEnv(
            2,
            num_kart=2,
            track=TRACK,
            max_cycles=12,  # so that races end and restart within the steps
            prefetch=True,
            engine_timeout=ENGINE_TIMEOUT,
        )

    @property
    def num_crashes(self) -> int:
        """Number of crashes that the environment has counted."""
        return 0 if self._env is None else int(self._env.num_crashes)

    def close(self) -> None:
        """Ends the races and drops the environment."""
        super().close()
        self._env = None

    def _step(self, env: Any) -> Any:
        return env.step(np.full(env.num_envs, 700))


class DrawnForm(Form):
    """The parallel environment, rendered by the game."""

    name = "drawn by the game"
    moments = ("reset", "render", "render", "finish")
    targets = ("drawing", "drawing", "race", "program")

    def make(self) -> Any:
        return race_v0.parallel_env(
            num_kart=2,
            track=TRACK,
            view="flattened_discrete",
            engine_timeout=ENGINE_TIMEOUT,
            render_mode="rgb_array",
            render_backend="engine",
            render_size=(96, 64),
        )

    def finish(self) -> None:
        """Renders an image and closes the environment."""
        self._env.render()
        self._env.close()


class RunnerForm(Form):
    """A race of agents, one of them in its own process, that is saved as a replay."""

    name = "run_race"
    moments = ("race",)
    targets = ("race", "fork server", "agent", "agent", "program")

    def reset(self) -> None:
        """Does nothing: ``race`` runs whole races."""

    def step(self) -> None:
        """Does nothing."""

    def construct(self) -> None:
        """Does nothing."""

    def race(self) -> None:
        """Runs one race and checks the saved replay."""
        from stkzoo.race import run_race
        from stkzoo.race.replay import ReplayWriter, load_replay

        agent = AGENTS / "plain"
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "race.stkz"
            try:
                result = run_race(
                    [str(agent), "heuristic", "ai"],
                    track=TRACK,
                    seed=_TRACE_SEED,
                    max_steps=_TRACE_STEPS * 4,
                    action_timeout=ENGINE_TIMEOUT,
                    start_timeout=20.0,
                    listeners=[ReplayWriter(file)],
                )
            finally:
                if file.exists():  # after a fault, the replay may be partial but must be valid
                    load_replay(file)
            assert [path.name for path in Path(folder).iterdir()] == ["race.stkz"]
        failed = [row.agent for row in result.agents if row.num_errors]
        assert set(failed) <= {"kart_0"}, result
        self.last = result

    def trace(self) -> str:
        """Returns the results of a race as text."""
        self.race()
        assert not self.last.has_errors, self.last
        return repr([(row.agent, row.distance, row.reward) for row in self.last.agents])


#: All forms by name. Those that render or run agents take longer.
FORMS: dict[str, type[Form]] = {
    kind.name: kind
    for kind in (
        ParallelForm,
        GymnasiumForm,
        VectorForm,
        DrawnForm,
        RunnerForm,
    )
}
