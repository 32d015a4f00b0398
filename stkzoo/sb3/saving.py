"""Trained policies as agents in folders."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import FlattenExtractor

from stkzoo._checks import check_name, shortened
from stkzoo._os import make_folder, write_text, write_whole
from stkzoo.errors import ConfigError
from stkzoo.mdp import kart_action_space
from stkzoo.views import VIEWS
from stkzoo.views.agent_chain import AgentChain
from stkzoo.views.registry import base_space

_ACTOR = '''"""A trained network, evaluated with numpy."""

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
#: The supported activations by the names of torch's classes, as expressions of numpy.
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
        ConfigError: the policy is not supported, the view does not exist or is not that of the
            policy, or the folder has an agent that is not from this function.
    """
    check_name("view", view, VIEWS)
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
    if not is_plain or not is_box or not action or activation not in _ACTIVATIONS:
        raise ConfigError(
            f"the policy is {type(policy).__name__} over {type(model.observation_space).__name__}, "
            'expected "MlpPolicy" with tanh or ReLU, without features_extractor_class and '
            "squash_output; write its pystk_actor.py by hand"
        )
    _check_inputs(model, view)
    modules = [*policy.mlp_extractor.policy_net, policy.action_net]
    layers = [module for module in modules if isinstance(module, torch.nn.Linear)]
    arrays: dict[str, Any] = {}
    for number, layer in enumerate(layers):
        arrays[f"weights{number}"] = layer.weight.detach().cpu().numpy()
        arrays[f"bias{number}"] = layer.bias.detach().cpu().numpy()
    target = Path(folder)
    make_folder(target, "agent")
    actor = target / "pystk_actor.py"
    if actor.is_file() and not actor.read_bytes().startswith(_ACTOR[:40].encode()):
        raise ConfigError(f"{actor} is not from this function; move it away, or name a new folder")
    with write_whole(target / "policy.npz", "the policy") as part, part.open("wb") as file:
        np.savez(file, **arrays)
    text = _ACTOR.format(view=view, name=name, activation=_ACTIVATIONS[activation], action=action)
    write_text(actor, text)
    return str(target)


def _check_inputs(model: OnPolicyAlgorithm, view: str) -> None:
    """Checks that an agent in a view gets what the model got in training."""
    normalization = model.get_vec_normalize_env()
    if normalization is not None and normalization.norm_obs:
        raise ConfigError(
            "the model was trained on observations that VecNormalize scaled, which agents do not "
            "get; train with norm_obs=False, or write its pystk_actor.py by hand"
        )
    chain = AgentChain("kart_0", base_space(VIEWS[view]), kart_action_space(), VIEWS[view])
    for what, value, expected in (
        ("observations", model.observation_space, chain.observation_space),
        ("actions", model.action_space, chain.action_space),
    ):
        if value != expected:
            raise ConfigError(
                f"the model's {what} are {shortened(value)}, and those of the view {view!r} are "
                f"{shortened(expected)}; give the view in which it was trained, without wrappers "
                f"that change {what}"
            )
