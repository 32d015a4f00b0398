"""Recordings of a person's driving as dataset files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

import stkzoo
from stkzoo._arrays import write_arrays
from stkzoo._os import check_writable
from stkzoo.errors import ConfigError
from stkzoo.mdp.spaces import columns_of, kart_action_space
from stkzoo.race import RaceListener, RaceProgress, RaceResult
from stkzoo.views import VIEWS, base_space
from stkzoo.views.agent_chain import AgentChain

_AGENT, _ENDING = "kart_0", ".safetensors"


class DatasetWriter(RaceListener):
    """Writes one driver's episode to a ``.safetensors`` file when the race is over.

    For ``T`` steps the file contains ``observations`` ``(T + 1, ...)``, ``actions`` ``(T, ...)``,
    ``rewards`` ``(T,)`` float64, and ``terminations`` and ``truncations`` ``(T,)`` bool. Its
    metadata has ``about``, a JSON text with view, track, seed and other facts. Dictionary
    observations and actions become one array per entry, such as ``observations/continuous``.

    Args:
        path: path of the file.
        view: name of a view with a fixed size that consists of stkzoo's wrappers.

    Raises:
        ConfigError: the path or the view is invalid, or the file exists.
    """

    def __init__(self, path: str, view: str) -> None:
        self._path = Path(path)
        if self._path.suffix != _ENDING:
            raise ConfigError(f"the dataset is {path!r}, expected a path that ends in {_ENDING}")
        check_writable(path, "the dataset")
        if self._path.exists():  # a recording cannot be repeated
            raise ConfigError(f"the dataset {path!r} exists; choose another name, or delete it")
        self._view = view
        seen = base_space(VIEWS[view])
        self._chain = AgentChain(_AGENT, seen, kart_action_space(), VIEWS[view])
        if not self._chain.is_pure or not self._chain.observation_space.is_np_flattenable:
            raise ConfigError(
                f"observations in view {view!r} differ in size from step to step, or depend on "
                "earlier ones; record in simple or a flattened view"
            )
        self._observations: list[Any] = []
        self._actions: list[Any] = []
        self._rewards: list[float] = []
        self._is_finished = False
        self._about: dict[str, Any] = {}

    def decided(self, observation: Any, action: Any) -> None:
        """Records an observation and its action, both in the format of the view."""
        self._observations.append(observation)
        self._actions.append(action)

    def started(self, race: RaceProgress) -> None:
        """Records facts about the race."""
        self._about = {
            "view": self._view,
            "env_id": f"supertuxkart/{self._view}-v0",
            "track": race.race_info.track,
            "reverse": race.race_info.reverse,
            "mode": race.race_info.mode,
            "laps": race.env.options.laps,
            "num_kart": race.env.options.num_kart,
            "difficulty": race.env.options.difficulty,
            "step_size": race.env.options.step_size,
            "seed": race.seed,
            "driver": race.names[_AGENT],
            "stkzoo": stkzoo.__version__,
        }

    def stepped(self, race: RaceProgress) -> None:
        """Records the outcome of the driver's last action."""
        if len(self._rewards) == len(self._actions):
            return  # the driver has finished, and other karts are still racing
        self._rewards.append(float(race.rewards[_AGENT]))
        self._last = self._chain.observe(race.observations[_AGENT])
        self._is_finished = race.infos[_AGENT]["finish_time"] > 0

    def ended(self, _: RaceResult) -> None:
        """Writes the file atomically.

        Raises:
            ConfigError: the file cannot be written.
        """
        steps = len(self._rewards)
        if not steps:
            return
        ends = np.zeros(steps, np.bool_)
        ends[-1] = True
        never = np.zeros(steps, np.bool_)
        arrays: dict[str, Any] = {
            **columns_of(
                "observations",
                self._chain.observation_space,
                [*self._observations[:steps], self._last],
            ),
            **columns_of("actions", self._chain.action_space, self._actions[:steps]),
            "rewards": np.array(self._rewards),
            "terminations": ends if self._is_finished else never,
            "truncations": never if self._is_finished else ends,
        }
        write_arrays(self._path, arrays, "the dataset", json.dumps(self._about))
