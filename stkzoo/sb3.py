"""Vectorized races for Stable-Baselines3, in which one policy controls every agent.

>>> from stkzoo.sb3 import ActiveDictRolloutBuffer, RaceVecEnv
>>> from stable_baselines3 import PPO
>>> envs = RaceVecEnv(2, num_kart=3, track="lighthouse", view="flattened_discrete")
>>> model = PPO(
...     "MultiInputPolicy", envs, rollout_buffer_class=ActiveDictRolloutBuffer, device="cpu"
... )
>>> envs.close()

This module needs the ``sb3`` extra (in a checkout, ``pip install ".[sb3]"``). ``import stkzoo``
does not import it.
"""

from __future__ import annotations

import copy
import os
import time
from collections.abc import Generator, Iterable, Iterator, Mapping
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from stkzoo._installation import install_command
from stkzoo.drivers.saving import ACTIVATIONS, write_mlp_agent
from stkzoo.env.vec.env import RaceVectorEnv, seeds_of_races
from stkzoo.env.vec.steps import InfoDicts, InfoTables, SlotSteps
from stkzoo.errors import ConfigError, shortened, unknown_name
from stkzoo.mdp import kart_action_space
from stkzoo.views import VIEWS
from stkzoo.views.agent_chain import AgentChain
from stkzoo.views.registry import base_space

try:
    import torch
    from stable_baselines3.common.buffers import DictRolloutBuffer, RolloutBuffer
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
    from stable_baselines3.common.policies import ActorCriticPolicy
    from stable_baselines3.common.torch_layers import FlattenExtractor
    from stable_baselines3.common.vec_env import VecEnv
except ImportError as error:
    raise ImportError(
        f"stkzoo.sb3 needs Stable-Baselines3 ({error}): {install_command('sb3')}"
    ) from error

__all__ = ["ActiveDictRolloutBuffer", "ActiveRolloutBuffer", "RaceVecEnv", "save_agent"]

_ACTIONS: dict[type[gym.Space[Any]], str] = {
    spaces.Discrete: "int(values.argmax())",
    spaces.MultiDiscrete: (
        "np.array([part.argmax() for part in np.split(values, action_space.nvec.cumsum()[:-1])])"
    ),
    spaces.Box: "np.clip(values, action_space.low, action_space.high)",
}

Indices = None | int | Iterable[int]


class RaceVecEnv(VecEnv):
    """A Stable-Baselines3 ``VecEnv`` in which every agent of every race is one environment.

    It wraps :class:`~stkzoo.env.vec.env.RaceVectorEnv`, which documents slots, episode ends and
    crashes. A slot is *idle* after its agent has finished while other agents of its race still
    drive. An idle slot reports ``done`` in every step, with an all-zero observation and no reward:
    each of its steps is an episode of length one, so no value is bootstrapped between idle and real
    steps. To exclude idle steps from updates, pass
    ``rollout_buffer_class=ActiveDictRolloutBuffer`` to the algorithm (or
    :class:`ActiveRolloutBuffer` with ``flat_observations``). Idle steps still count as timesteps.

    **Infos** are one mapping per slot, whose ``copy()`` is a dict: the agent's own entries,
    ``active`` and ``track``. At the end of an episode they also hold ``terminal_observation``,
    ``TimeLimit.truncated`` and ``episode`` (return ``r``, length ``l``, and time ``t`` since
    construction [s]). Stable-Baselines3 logs its means from ``episode``, without a ``VecMonitor``.

    Args:
        num_races: number of races.
        view: see :class:`~stkzoo.env.vec.env.RaceVectorEnv`. Actions must be a single array, as in
            ``flattened_discrete``, ``flattened_multidiscrete`` and
            ``flattened_continuous_actions``.
        flat_observations: flatten each observation to one ``Box``, like
            :func:`gymnasium.spaces.flatten`, for ``"MlpPolicy"``. By default, observations keep the
            form of the view, for ``"MultiInputPolicy"``.
        prefetch: see :class:`~stkzoo.env.vec.env.RaceVectorEnv`.
        num_starts: likewise.
        **options: options of :class:`~stkzoo.env.parallel.RaceParallelEnv`.

    Attributes:
        races: the same races as a Gymnasium vector environment. Use it for inspection only; step
            the races through this object.

    Raises:
        ConfigError: an argument is invalid, or Stable-Baselines3 does not support the view's
            actions.
        AssetError: the game's data is missing.
    """

    def __init__(
        self,
        num_races: int = 1,
        *,
        view: Any = "flattened_discrete",
        flat_observations: bool = False,
        prefetch: bool | None = None,
        num_starts: int | None = None,
        **options: Any,
    ) -> None:
        self.races = RaceVectorEnv(
            num_races, view=view, prefetch=prefetch, num_starts=num_starts, **options
        )
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
        """Number of times the game crashed or hung, over all races."""
        return self.races.num_crashes

    def seed(self, seed: int | None = None) -> list[int | None]:
        """Seeds the next :meth:`reset`: race ``n`` gets ``seed + n``.

        Args:
            seed: a whole number; ``None`` draws one from numpy's global random state, as
                Stable-Baselines3 does.

        Returns:
            The seed of each slot's race.
        """
        if seed is None:
            seed = int(np.random.randint(0, np.iinfo(np.uint32).max, dtype=np.uint32))
        self._race_seeds = seeds_of_races(seed, self.races.num_races)
        return [given for given in self._race_seeds for _ in range(self.races.num_agents)]

    def reset(self) -> Any:
        """Starts a new race in every environment and stores the infos in ``reset_infos``.

        Options from ``set_options`` hold for one episode; each race uses those of its first slot.
        For options that hold until you change them, call ``races.set_options``.

        Returns:
            Observations of all slots.
        """
        seeds, self._race_seeds = self._race_seeds, [None] * self.races.num_races
        options = [dict(given) for given in self._options[:: self.races.num_agents]]
        self._reset_options()
        steps = self.races.reset_slots(seeds, options)
        self.reset_infos = [self._first_info(steps, slot) for slot in range(self.num_envs)]
        return self._batch(steps.observations)

    def step_async(self, actions: npt.NDArray[Any]) -> None:
        """Starts a step of all races and returns before it is done.

        Args:
            actions: one action per slot; actions of idle slots are ignored.
        """
        self.races.step_async(actions)

    def step_wait(
        self,
    ) -> tuple[Any, npt.NDArray[np.float32], npt.NDArray[np.bool_], list[dict[str, Any]]]:
        """Waits for the step that :meth:`step_async` started.

        Returns:
            Observations, rewards ``(num_envs,)`` float32, dones ``(num_envs,)`` bool, and infos.
        """
        steps = self.races.wait_slots()
        done = steps.terminations | steps.truncations | ~steps.active
        tracks = [self.races.tracks[number] for number in steps.tracks]
        added = {track: {"track": track, "active": True} for track in {*tracks}}
        infos: list[Any] = [
            SlotInfo(steps.infos, slot, added[track]) for slot, track in enumerate(tracks)
        ]
        for slot in np.flatnonzero(done).tolist():
            if steps.infos.keys_of(slot):  # the slot's race has started again
                self.reset_infos[slot] = self._first_info(steps, slot)
            infos[slot] = self._ended(steps, slot, tracks[slot])
        return self._batch(steps.observations), steps.rewards.astype(np.float32), done, infos

    def close(self) -> None:
        """Stops the game processes."""
        self.races.close()

    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        """Returns an attribute of each slot's race, a ``RaceParallelEnv``."""
        return [getattr(self._race(slot), attr_name) for slot in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:
        """Sets an attribute, such as ``max_cycles``, on the race of each selected slot."""
        for slot in self._get_indices(indices):
            setattr(self._race(slot), attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: Indices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Calls a method once per race of the selected slots; returns its result per slot."""
        numbers = [slot // self.races.num_agents for slot in self._get_indices(indices)]
        results = {
            number: getattr(self.races.races[number], method_name)(*method_args, **method_kwargs)
            for number in dict.fromkeys(numbers)
        }
        return [results[number] for number in numbers]

    def env_is_wrapped(
        self, wrapper_class: type[gym.Wrapper[Any, Any, Any, Any]], indices: Indices = None
    ) -> list[bool]:
        """Returns, per slot, whether it has this wrapper.

        The answer is ``True`` for ``Monitor`` only, because the infos include what it records.
        """
        return [wrapper_class is Monitor for _ in self._get_indices(indices)]

    def _race(self, slot: int) -> Any:
        return self.races.races[slot // self.races.num_agents]

    def _first_info(self, steps: SlotSteps, slot: int) -> dict[str, Any]:
        """Returns the info of a slot after a reset."""
        track = self.races.tracks[steps.tracks[slot]]
        return SlotInfo(steps.infos, slot, {"track": track}).copy()

    def _ended(self, steps: SlotSteps, slot: int, track: str) -> dict[str, Any]:
        """Returns the info of a slot whose episode ended in this step, or which is idle."""
        last, info = steps.finals.get(slot) or (copy.deepcopy(self.races.idle_observation), {})
        age = round(time.monotonic() - self._born, 6)
        episode = {"episode": {**info["episode"], "t": age}} if "episode" in info else {}
        return {
            "track": track,
            **info,
            **episode,
            "active": bool(steps.active[slot]),
            "terminal_observation": spaces.flatten(self._space, last) if self._is_flat else last,
            "TimeLimit.truncated": bool(steps.truncations[slot]),
        }

    def _batch(self, batch: Any) -> Any:
        if not self._is_flat:
            return batch
        flat = np.concatenate(_flat_parts(self._space, batch, self.num_envs), axis=1)
        return flat.astype(self.observation_space.dtype, copy=False)


class SlotInfo(Mapping[str, Any]):
    """Info of a slot at one moment: values are read from the step's arrays on demand.

    ``copy()`` returns a dict.

    Args:
        infos: infos of all slots.
        slot: number of the slot.
        added: further entries, which take precedence.
    """

    __slots__ = ("_added", "_infos", "_keys", "_slot")

    def __init__(self, infos: InfoTables | InfoDicts, slot: int, added: Mapping[str, Any]) -> None:
        self._infos, self._slot, self._added = infos, slot, added
        self._keys = infos.keys_of(slot)

    def __getitem__(self, key: str) -> Any:
        if key in self._added:
            return self._added[key]
        return self._infos.value(self._slot, key)

    def __contains__(self, key: object) -> bool:
        return key in self._keys or key in self._added

    def get(self, key: str, default: Any = None) -> Any:
        """Returns the value of a key, or the default. Learners ask every slot in every step."""
        if key in self._keys or key in self._added:
            return self[key]
        return default

    def __iter__(self) -> Iterator[str]:
        return iter(dict.fromkeys((*self._keys, *self._added)))

    def __len__(self) -> int:
        return len({*self._keys, *self._added})

    def __repr__(self) -> str:
        return repr(self.copy())

    def copy(self) -> dict[str, Any]:
        """Returns the info as a new dict."""
        return {key: self[key] for key in self}


def _flat_parts(space: spaces.Space[Any], batch: Any, count: int) -> list[npt.NDArray[Any]]:
    """Flattens each row as :func:`gymnasium.spaces.flatten` does, one array per part."""
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
    """A rollout buffer that leaves out the steps of idle slots.

    Pass it as ``rollout_buffer_class`` to PPO or A2C with a :class:`RaceVecEnv`. It recognizes an
    idle step as an episode of length one, so it also works with wrapped environments. The step of a
    race that ends in its first step is left out, too. Batches have the usual size; there are fewer
    of them.

    Attributes:
        active: indices of the real steps in the flattened buffer, slot by slot. Set by
            :meth:`compute_returns_and_advantage`.
    """

    def compute_returns_and_advantage(
        self, last_values: torch.Tensor, dones: npt.NDArray[Any]
    ) -> None:
        """Computes returns and advantages, and determines which steps are real.

        Args:
            last_values: value estimates of the last observations, ``(num_envs,)``.
            dones: ``(num_envs,)`` whether the last step ended each slot's episode.

        Raises:
            ConfigError: no episode has more than one step.
        """
        super().compute_returns_and_advantage(last_values, dones)
        starts = self.episode_starts.astype(np.bool_)
        ends = np.vstack([starts[1:], dones.astype(np.bool_)[None]])
        self.active = np.flatnonzero(~(starts & ends).T)  # slot after slot, as steps lie flat
        if not len(self.active):
            raise ConfigError(
                "all episodes of the rollout have one step, and this buffer leaves such steps out; "
                "raise max_cycles, or leave out rollout_buffer_class"
            )

    def get(self, batch_size: int | None = None) -> Generator[Any, None, None]:
        """Yields the real steps in random order, in batches of ``batch_size``."""
        next(super().get(1))  # lays the steps flat
        order = np.random.permutation(self.active)
        size = batch_size or max(len(order), 1)
        for first in range(0, len(order), size):
            yield self._get_samples(order[first : first + size])


class ActiveDictRolloutBuffer(ActiveRolloutBuffer, DictRolloutBuffer):
    """:class:`ActiveRolloutBuffer` for dictionary observations."""


def save_agent(
    model: OnPolicyAlgorithm, folder: str | os.PathLike[str], *, view: str, name: str
) -> str:
    """Writes a trained policy as an agent folder: a ``pystk_actor.py`` and the weights.

    The agent picks the most likely action. It evaluates the network with numpy, so it starts
    quickly and needs neither PyTorch nor Stable-Baselines3.

    Args:
        model: a PPO or A2C model with ``"MlpPolicy"`` and tanh or ReLU activations, without
            ``features_extractor_class`` and ``squash_output``. Train it without wrappers that
            change observations or actions. A model that was loaded without its environment does not
            show whether ``VecNormalize`` scaled its observations.
        folder: the agent's folder, created if necessary. Existing files of the same names are
            replaced.
        view: name of the view in which the policy was trained, such as ``"racing"``.
        name: the agent's ``player_name``.

    Returns:
        The folder, for :func:`stkzoo.race.run_race` or ``stkzoo race``.

    Raises:
        ConfigError: the policy is not supported, or the view does not exist or is not that of the
            policy.
    """
    if view not in VIEWS:
        raise unknown_name("view", view, VIEWS)
    policy = model.policy
    action = _ACTIONS.get(type(model.action_space))
    activation = getattr(getattr(policy, "activation_fn", None), "__name__", "")
    is_box = isinstance(model.observation_space, spaces.Box)
    # Subclasses of the policy, such as recurrent ones, may compute something else.
    is_plain = (
        type(policy) is ActorCriticPolicy
        and type(policy.features_extractor) is FlattenExtractor
        and not policy.squash_output
    )
    if not is_plain or not is_box or not action or activation not in ACTIVATIONS:
        raise ConfigError(
            f"the policy is {type(policy).__name__} over {type(model.observation_space).__name__}, "
            'expected "MlpPolicy" with tanh or ReLU, without features_extractor_class and '
            "squash_output; write its pystk_actor.py by hand"
        )
    _check_inputs(model, view)
    modules = [*policy.mlp_extractor.policy_net, policy.action_net]
    layers = [module for module in modules if isinstance(module, torch.nn.Linear)]
    arrays = [(layer.weight.detach().cpu(), layer.bias.detach().cpu()) for layer in layers]
    return write_mlp_agent(
        folder, arrays, view=view, name=name, activation=activation, action=action
    )


def _check_inputs(model: OnPolicyAlgorithm, view: str) -> None:
    """Checks that an agent in a view gets what the model got in training."""
    normalization = model.get_vec_normalize_env()
    if normalization is not None and normalization.norm_obs:
        raise ConfigError(
            "the model was trained on observations that VecNormalize scaled, which agents do not "
            "get; train with norm_obs=False, or write its pystk_actor.py by hand"
        )
    chain = AgentChain("kart_0", base_space(VIEWS[view]), kart_action_space(), VIEWS[view])
    for what, own, expected in (
        ("observations", model.observation_space, chain.observation_space),
        ("actions", model.action_space, chain.action_space),
    ):
        if own != expected:
            raise ConfigError(
                f"the model's {what} are {shortened(own)}, and those of the view {view!r} are "
                f"{shortened(expected)}; give the view in which it was trained, without wrappers "
                f"that change {what} and without flat_observations"
            )
