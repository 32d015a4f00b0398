"""The tasks of the suite for BenchMARL, whose algorithms learn in them as in its own tasks.

>>> from stkzoo.suite.benchmarl import SuiteTask
>>> SuiteTask.TEAM_2V2.get_task({"is_one_group": True}).task.name
'team-2v2'

This module needs the ``benchmarl`` extra (in a checkout, ``pip install ".[benchmarl]"``).
``import stkzoo.suite`` does not import it.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from typing import Any

from stkzoo.drivers.saving import ACTIVATIONS, write_mlp_agent
from stkzoo.errors import ConfigError, import_extra, unknown_name
from stkzoo.suite.flat import FEW_CHOICES
from stkzoo.suite.tasks import SUITE, find_task
from stkzoo.wrappers.racing import CHOICES

import_extra("benchmarl.environments", "stkzoo.suite.benchmarl needs", "benchmarl")

from benchmarl.environments import common  # noqa: E402 - after the message about a missing library
from benchmarl.experiment import Experiment  # noqa: E402
from benchmarl.models.mlp import Mlp  # noqa: E402
from tensordict import TensorDictBase  # noqa: E402
from torchrl.data import Composite  # noqa: E402
from torchrl.envs import Transform  # noqa: E402

from stkzoo.suite.torchrl import SuiteRaces, TaskOptions  # noqa: E402

__all__ = ["PresentReward", "SuiteTask", "SuiteTaskClass", "save_agent"]

#: The choices of the view ``racing`` for the outputs of a network, by form of actions.
_CHOICE_EXPRESSIONS = {
    "few": f"np.array({FEW_CHOICES.tolist()})[values.argmax()]",
    "all": f"np.array(np.unravel_index(values.argmax(), {CHOICES}))",
}


class PresentReward(Transform):
    """Makes a group's common reward the mean over its agents that are still racing.

    VDN and QMIX learn from one reward per group, the mean over all agents. An agent that has left
    counts as 0 there, which would halve the reward of a team of two when its first kart finishes.

    Args:
        group: name of the group.
    """

    def __init__(self, group: str) -> None:
        super().__init__()
        self._group = group

    def forward(self, tensordict: Any) -> Any:
        """Changes the common reward in a batch of a replay buffer, if there is one."""
        if ("next", "reward") in tensordict.keys(include_nested=True):
            mask = tensordict[self._group, "mask"].unsqueeze(-1)
            rewards = tensordict["next", self._group, "reward"] * mask
            tensordict["next", "reward"] = rewards.sum(-2) / mask.sum(-2).clamp(min=1)
        return tensordict


class SuiteTaskClass(common.TaskClass):
    """A task of the suite with its options.

    Args:
        name: name of the member of :class:`SuiteTask`.
        config: fields of :class:`~stkzoo.suite.torchrl.TaskOptions`.

    Attributes:
        task: the task.
        options: its options.

    Raises:
        ConfigError: there is no such task, or an option is invalid.
    """

    def __init__(self, name: str, config: dict[str, Any] | None = None) -> None:
        super().__init__(name, config or {})
        self.task = find_task(name.lower().replace("_", "-"))
        self.options = TaskOptions.of(self.config)

    def get_env_fun(
        self, num_envs: int, continuous_actions: bool, seed: int | None, device: Any
    ) -> Callable[[], SuiteRaces]:
        """Returns a function that makes the races.

        Args:
            num_envs: number of races.
            continuous_actions: whether actions are continuous.
            seed: seed of the first race; see :class:`~stkzoo.suite.torchrl.SuiteRaces`.
            device: device of the tensors.
        """
        return partial(
            SuiteRaces,
            self.task,
            num_envs,
            is_continuous=continuous_actions,
            options=self.options,
            seed=seed,
            device=device,
        )

    def supports_continuous_actions(self) -> bool:
        """Returns ``True``; see :class:`~stkzoo.suite.FlatTask`."""
        return True

    def supports_discrete_actions(self) -> bool:
        """Returns ``True``; see :class:`~stkzoo.suite.FlatTask`."""
        return True

    def max_steps(self, env: Any) -> int:
        """Returns the maximum number of steps of a race.

        Raises:
            ConfigError: the race has no limit, which BenchMARL's evaluation needs.
        """
        if env.max_steps is None:
            raise ConfigError("max_cycles is None, expected a number: BenchMARL needs a limit")
        return int(env.max_steps)

    def has_render(self, env: Any) -> bool:  # noqa: ARG002 - BenchMARL's interface
        """Returns ``False``."""
        return False

    def group_map(self, env: Any) -> dict[str, list[str]]:  # noqa: ARG002
        """Returns the agents of each group."""
        return self.options.group_map(self.task)

    def observation_spec(self, env: Any) -> Composite:
        """Returns the spec of the groups' observations."""
        spec = env.full_observation_spec_unbatched
        return Composite(
            {
                group: Composite(observation=spec[group, "observation"], shape=spec[group].shape)
                for group in self.group_map(env)
            }
        )

    def state_spec(self, env: Any) -> Composite:
        """Returns the spec of the state."""
        return Composite(state=env.full_observation_spec_unbatched["state"])

    def action_spec(self, env: Any) -> Composite:
        """Returns the spec of the groups' actions."""
        return env.full_action_spec_unbatched

    def info_spec(self, env: Any) -> None:
        """Returns ``None``: there are no infos."""

    def action_mask_spec(self, env: Any) -> None:
        """Returns ``None``: all actions are valid."""

    def get_replay_buffer_transforms(self, env: Any, group: str) -> list[Transform]:  # noqa: ARG002
        """Returns the transforms of batches of a group."""
        return [PresentReward(group)]

    @staticmethod
    def env_name() -> str:
        """Returns the name of the suite."""
        return SUITE

    @staticmethod
    def log_info(batch: Any) -> dict[str, float]:
        """Returns the share of karts that finished, of those whose race ended in the batch."""
        finished = ended = 0
        masks = {key: own["mask"] for key, own in batch.items() if "mask" in _keys_of(own)}
        for group, mask in masks.items():
            after = batch["next", group]
            ended += int((after["done"][..., 0] & mask).sum())
            finished += int((after["terminated"][..., 0] & mask).sum())
        return {"collection/finished": finished / ended} if ended else {}


class SuiteTask(common.Task):
    """The tasks of the suite. Pass ``SuiteTask.VERSUS.get_task()`` to a BenchMARL experiment."""

    SOLO_1 = None
    SOLO_GENERAL = None
    VERSUS = None
    SELFPLAY_5 = None
    TEAM_2V2 = None
    TALK_2V2 = None

    @staticmethod
    def associated_class() -> type[SuiteTaskClass]:
        """Returns the class of the tasks."""
        return SuiteTaskClass

    def get_from_yaml(self, path: str | None = None) -> SuiteTaskClass:
        """Returns the task with the options in a file.

        Args:
            path: the file; ``None`` for the default options.

        Raises:
            ConfigError: an option is invalid.
        """
        task: SuiteTaskClass = (
            self.get_task(config={}) if path is None else super().get_from_yaml(path)
        )
        return task


def save_agent(
    experiment: Experiment, folder: str | os.PathLike[str], *, name: str, group: str | None = None
) -> str:
    """Writes the policy of an experiment as an agent folder, which ``stkzoo suite evaluate`` takes.

    The agent picks the most likely or most valuable action. It evaluates the network with numpy,
    so it needs neither PyTorch nor BenchMARL.

    Args:
        experiment: an experiment with discrete actions, ``MlpConfig`` with tanh or ReLU and
            without normalization, and shared parameters.
        folder: the agent's folder, created if necessary. Existing files of the same names are
            replaced.
        name: the agent's ``player_name``.
        group: the group whose policy to write; ``None`` for the first.

    Returns:
        The folder.

    Raises:
        ConfigError: there is no such group, or the policy is not supported.
    """
    groups, config = experiment.group_map, experiment.model_config
    if group is not None and group not in groups:
        raise unknown_name("group", group, groups)
    network = experiment.algorithm.get_policy_for_loss(group or next(iter(groups)))[0]
    activation = getattr(getattr(config, "activation_class", None), "__name__", "")
    actions = experiment.task.options.actions
    is_known = isinstance(network, Mlp) and network.share_params and activation in ACTIVATIONS
    if not is_known or config.norm_class or experiment.continuous_actions:
        raise ConfigError(
            "only policies with discrete actions, MlpConfig with tanh or ReLU and shared "
            "parameters can be written; write a pystk_actor.py by hand"
        )
    if experiment.task.task.words:
        raise ConfigError(
            f"save_agent writes agents that say no words, and {experiment.task.task.name} has "
            "words; write a pystk_actor.py by hand"
        )
    parts = network.mlp.params
    layers = [parts[key] for key in sorted(parts.keys(), key=int)]
    arrays = [(own["weight"].detach().cpu(), own["bias"].detach().cpu()) for own in layers]
    return write_mlp_agent(
        folder,
        arrays,
        view=experiment.task.task.view,
        name=name,
        activation=activation,
        action=_CHOICE_EXPRESSIONS[actions],
    )


def _keys_of(value: Any) -> Any:
    return value.keys() if isinstance(value, TensorDictBase) else ()
