"""Many races for Stable-Baselines3: one policy drives every agent of every race.

>>> from stkzoo.sb3 import ActiveDictRolloutBuffer, RaceVecEnv
>>> from stable_baselines3 import PPO
>>> envs = RaceVecEnv(2, num_kart=3, track="lighthouse", view="flattened_discrete")
>>> model = PPO(
...     "MultiInputPolicy", envs, rollout_buffer_class=ActiveDictRolloutBuffer, device="cpu"
... )
>>> envs.close()

Needs the extra ``sb3`` (in a checkout, ``pip install ".[sb3]"``). Nothing else in stkzoo imports
Stable-Baselines3.
"""

from __future__ import annotations

import copy
import os
import time
from collections.abc import Generator, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from stkzoo._installation import install_command
from stkzoo._os import atomic_write, write_text
from stkzoo.env.vec.env import RaceVectorEnv, seeds_of_races
from stkzoo.env.vec.slots import SlotSteps
from stkzoo.errors import ConfigError, unknown_name
from stkzoo.views import VIEWS

try:
    import torch
    from stable_baselines3.common.buffers import DictRolloutBuffer, RolloutBuffer
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
    from stable_baselines3.common.vec_env import VecEnv
except ImportError as error:
    raise ImportError(
        f"stkzoo.sb3 needs Stable-Baselines3 ({error}): {install_command('sb3')}"
    ) from error

__all__ = ["ActiveDictRolloutBuffer", "ActiveRolloutBuffer", "RaceVecEnv", "save_agent"]

_ACTOR = '''"""A policy of Stable-Baselines3, evaluated with numpy."""

import numpy as np

env_name = "supertuxkart/{view}-v0"
player_name = {name!r}


def get_actor(module_dir, observation_space, action_space):
    data = np.load(module_dir / "policy.npz")
    layers = [(data[f"weights{{n}}"], data[f"bias{{n}}"]) for n in range(len(data.files) // 2)]

    def act(state, observation):
        values = np.ravel(observation)
        for weights, bias in layers[:-1]:
            values = np.{activation}
        weights, bias = layers[-1]
        values = weights @ values + bias
        return {action}

    return act
'''
_ACTIVATIONS = {
    "Tanh": "tanh(weights @ values + bias)",
    "ReLU": "maximum(weights @ values + bias, 0)",
}
_ACTIONS: dict[type[gym.Space[Any]], str] = {
    spaces.Discrete: "int(values.argmax())",
    spaces.MultiDiscrete: (
        "np.array([part.argmax() for part in np.split(values, action_space.nvec.cumsum()[:-1])])"
    ),
    spaces.Box: "np.clip(values, action_space.low, action_space.high)",
}

Indices = None | int | Iterable[int]


class RaceVecEnv(VecEnv):
    """Races side by side, in which every agent of every race is an environment.

    A form of :class:`~stkzoo.env.vec.env.RaceVectorEnv`, where slots, ends and crashes are
    described. An *idle* slot, whose agent has finished while others of its race still
    drive, is done in every step: its steps are episodes of one step, of all-zero
    observations and no reward, so that nothing flows from them into real ones. To keep
    them out of the updates altogether, give the algorithm
    ``rollout_buffer_class=ActiveDictRolloutBuffer`` (or :class:`ActiveRolloutBuffer` with
    ``flat_observations``). They do count as timesteps.

    **Infos**, a dict for each slot: the agent's own, ``active``, ``track``, and where an
    episode has ended ``terminal_observation``, ``TimeLimit.truncated`` and ``episode`` (return
    ``r``, length ``l``, seconds ``t`` since this was made), from which Stable-Baselines3 logs its
    means without a ``VecMonitor``.

    Args:
        num_races: how many races.
        view: as for :class:`~stkzoo.env.vec.env.RaceVectorEnv`; its actions must be one
            array (``flattened_discrete``, ``flattened_multidiscrete``,
            ``flattened_continuous_actions``).
        flat_observations: observations as one ``Box``, as :func:`gymnasium.spaces.flatten`
            makes it, for ``"MlpPolicy"``; otherwise the view's, for ``"MultiInputPolicy"``.
        prefetch: as for :class:`~stkzoo.env.vec.env.RaceVectorEnv`.
        **options: those of :class:`~stkzoo.env.parallel.RaceParallelEnv`.

    Attributes:
        races: the same races as a Gymnasium vector environment; step them through this one
            alone.

    Raises:
        ConfigError: an argument is invalid, or Stable-Baselines3 cannot act in the view.
        AssetError: the game's data is missing.
    """

    def __init__(
        self,
        num_races: int = 1,
        *,
        view: Any = "flattened_discrete",
        flat_observations: bool = False,
        prefetch: bool | None = None,
        **options: Any,
    ) -> None:
        self.races = RaceVectorEnv(num_races, view=view, prefetch=prefetch, **options)
        actions = self.races.single_action_space
        if not isinstance(
            actions, (spaces.Box, spaces.Discrete, spaces.MultiDiscrete, spaces.MultiBinary)
        ):
            self.races.close()
            raise ConfigError(
                f"the view {view!r} acts by a {type(actions).__name__}; Stable-Baselines3 needs "
                "an array: choose flattened_discrete, flattened_multidiscrete or "
                "flattened_continuous_actions"
            )
        self._space = self.races.single_observation_space
        self._is_flat = flat_observations
        self._race_seeds: list[int | None] = [None] * num_races
        self._born = time.monotonic()
        super().__init__(
            self.races.num_envs,
            spaces.flatten_space(self._space) if flat_observations else self._space,
            actions,
        )

    @property
    def num_crashes(self) -> int:
        """How often the game died or hung, in all races together."""
        return self.races.num_crashes

    def seed(self, seed: int | None = None) -> list[int | None]:
        """Seeds the next :meth:`reset`: race number ``n`` with ``seed + n``.

        Args:
            seed: a whole number; ``None`` draws one from numpy's global stream, as
                Stable-Baselines3 does.

        Returns:
            Every slot's seed, which is that of its race.
        """
        if seed is None:
            seed = int(np.random.randint(0, np.iinfo(np.uint32).max, dtype=np.uint32))
        self._race_seeds = seeds_of_races(seed, self.races.num_races)
        return [given for given in self._race_seeds for _ in range(self.races.num_agents)]

    def reset(self) -> Any:
        """New races everywhere; infos are in ``reset_infos``.

        Of ``set_options``, those of a race's first slot are the race's, for one episode. Options
        that hold until you change them: ``races.set_options``.

        Returns:
            Observations of all slots.
        """
        options = [dict(given) for given in self._options[:: self.races.num_agents]]
        steps = self.races.reset_slots(self._race_seeds, options)
        self.reset_infos = _infos(steps)
        self._race_seeds = [None] * self.races.num_races
        self._reset_options()
        return self._batch(steps.observations)

    def step_async(self, actions: npt.NDArray[Any]) -> None:
        """Asks all races for a step, which they take while the caller goes on.

        Args:
            actions: one for each slot; those of idle slots are not looked at.
        """
        self.races.step_async(actions)

    def step_wait(
        self,
    ) -> tuple[Any, npt.NDArray[np.float32], npt.NDArray[np.bool_], list[dict[str, Any]]]:
        """What came of the step that :meth:`step_async` asked for.

        Returns:
            Observations, rewards ``(num_envs,)`` float32, whose episode has ended
            ``(num_envs,)`` bool, and infos.
        """
        steps = self.races.wait_slots()
        done = steps.terminations | steps.truncations | ~steps.active
        infos = [{**info, "active": True} for info in _infos(steps)]
        for slot in np.flatnonzero(done).tolist():
            if steps.infos[slot]:  # the slot's race has started again
                self.reset_infos[slot] = {**steps.infos[slot], "track": steps.tracks[slot]}
            infos[slot] = self._ended(steps, slot)
        return self._batch(steps.observations), steps.rewards.astype(np.float32), done, infos

    def close(self) -> None:
        """Ends the games."""
        self.races.close()

    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        """An attribute of each slot's race, which is a ``RaceParallelEnv``."""
        return [getattr(self._race(slot), attr_name) for slot in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:
        """Sets an attribute of the slots' races, such as ``max_cycles``."""
        for slot in self._get_indices(indices):
            setattr(self._race(slot), attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: Indices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Calls a method of the slots' races, once for each race; the result by slot."""
        numbers = [slot // self.races.num_agents for slot in self._get_indices(indices)]
        results = {
            number: getattr(self.races.races[number], method_name)(*method_args, **method_kwargs)
            for number in dict.fromkeys(numbers)
        }
        return [results[number] for number in numbers]

    def env_is_wrapped(
        self, wrapper_class: type[gym.Wrapper[Any, Any, Any, Any]], indices: Indices = None
    ) -> list[bool]:
        """Whether each slot has a wrapper: a ``Monitor`` only, whose infos are here too."""
        return [wrapper_class is Monitor for _ in self._get_indices(indices)]

    def _race(self, slot: int) -> Any:
        return self.races.races[slot // self.races.num_agents]

    def _ended(self, steps: SlotSteps, slot: int) -> dict[str, Any]:
        """The info of a slot whose episode has ended in this step, or that idles."""
        last, info = steps.finals.get(slot) or (copy.deepcopy(self.races.idle_observation), {})
        age = round(time.monotonic() - self._born, 6)
        episode = {"episode": {**info["episode"], "t": age}} if "episode" in info else {}
        return {
            "track": steps.tracks[slot],
            **info,
            **episode,
            "active": bool(steps.active[slot]),
            "terminal_observation": spaces.flatten(self._space, last) if self._is_flat else last,
            "TimeLimit.truncated": bool(steps.truncations[slot]),
        }

    def _batch(self, observations: Sequence[Any]) -> Any:
        batch = self.races.batch(observations)
        if not self._is_flat:
            return batch
        flat = np.concatenate(_flat_parts(self._space, batch, self.num_envs), axis=1)
        return flat.astype(self.observation_space.dtype, copy=False)


def _infos(steps: SlotSteps) -> list[dict[str, Any]]:
    """Each slot's info with its race's track."""
    pairs = zip(steps.infos, steps.tracks, strict=True)
    return [{**info, "track": track} for info, track in pairs]


def _flat_parts(space: spaces.Space[Any], batch: Any, count: int) -> list[npt.NDArray[Any]]:
    """What :func:`gymnasium.spaces.flatten` makes of each row, part by part."""
    if isinstance(space, spaces.Dict):
        parts: Mapping[str, spaces.Space[Any]] = space.spaces
        return [flat for key in parts for flat in _flat_parts(parts[key], batch[key], count)]
    if isinstance(space, spaces.Discrete):
        return [np.eye(int(space.n))[batch - space.start]]
    if isinstance(space, spaces.MultiDiscrete):
        numbers = (batch - space.start).reshape(count, -1).T
        sizes = space.nvec.reshape(-1).tolist()
        return [np.eye(size)[number] for size, number in zip(sizes, numbers, strict=True)]
    return [np.asarray(batch).reshape(count, -1)]


class ActiveRolloutBuffer(RolloutBuffer):
    """A rollout buffer that gives out no steps of idle slots.

    For ``rollout_buffer_class`` of PPO and A2C with a :class:`RaceVecEnv`. Idle steps are
    known by being whole episodes of one step, which no race is; so it works through
    wrappers of the environment too. Batches are as large as asked for, but fewer.

    Attributes:
        active: indices of the real steps, slot after slot, as they lie in the buffer once batches
            have been asked for.
    """

    def compute_returns_and_advantage(
        self, last_values: torch.Tensor, dones: npt.NDArray[Any]
    ) -> None:
        """As :class:`RolloutBuffer` does; also finds out which steps are real."""
        super().compute_returns_and_advantage(last_values, dones)
        starts = self.episode_starts.astype(np.bool_)
        ends = np.vstack([starts[1:], dones.astype(np.bool_)[None]])
        self.active = np.flatnonzero(~(starts & ends).T)  # slot after slot, as steps lie flat

    def get(self, batch_size: int | None = None) -> Generator[Any, None, None]:
        """The real steps in random order, ``batch_size`` at a time."""
        next(super().get(1))  # lays the steps flat
        order = np.random.permutation(self.active)
        size = batch_size or max(len(order), 1)
        for first in range(0, len(order), size):
            yield self._get_samples(order[first : first + size])


class ActiveDictRolloutBuffer(ActiveRolloutBuffer, DictRolloutBuffer):
    """:class:`ActiveRolloutBuffer` for observations that are dicts."""


def save_agent(
    model: OnPolicyAlgorithm, folder: str | os.PathLike[str], *, view: str, name: str
) -> str:
    """Writes a trained policy as an agent that races: a ``pystk_actor.py`` and its weights.

    The agent takes the most likely action. It evaluates the network with numpy, so that it
    starts at once and needs neither torch nor Stable-Baselines3.

    Args:
        model: PPO or A2C with ``"MlpPolicy"``, tanh or ReLU.
        folder: made if it does not exist; files in it of the same names are replaced.
        view: the view that the policy was trained in, such as ``"racing"``.
        name: the agent's ``player_name``.

    Returns:
        The folder, for :func:`stkzoo.race.run_race` or ``stkzoo race``.

    Raises:
        ConfigError: the policy is of another kind, or there is no such view.
    """
    policy = model.policy
    if view not in VIEWS:
        raise unknown_name("view", view, VIEWS)
    action = _ACTIONS.get(type(model.action_space))
    activation = _ACTIVATIONS.get(getattr(getattr(policy, "activation_fn", None), "__name__", ""))
    if not isinstance(model.observation_space, spaces.Box) or not action or not activation:
        raise ConfigError(
            f"the policy is {type(policy).__name__} over {type(model.observation_space).__name__}, "
            'expected "MlpPolicy" with tanh or ReLU; write its pystk_actor.py by hand'
        )
    modules = [*policy.mlp_extractor.policy_net, policy.action_net]
    layers = [module for module in modules if isinstance(module, torch.nn.Linear)]
    arrays = {f"weights{n}": layer.weight.detach().cpu().numpy() for n, layer in enumerate(layers)}
    arrays |= {f"bias{n}": layer.bias.detach().cpu().numpy() for n, layer in enumerate(layers)}
    target = Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    with atomic_write(target / "policy.npz") as part, part.open("wb") as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]
    text = _ACTOR.format(view=view, name=name, activation=activation, action=action)
    write_text(target / "pystk_actor.py", text)
    return str(target)
