"""Keyboard control: the keys, and the action of each key combination in a view.

The keys are those of the game. Their codes are SDL key codes, as used by pygame and
``gymnasium.utils.play``.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.wrappers.utils import create_zero_array

from stkzoo.engine.snapshot import CONTROLS
from stkzoo.errors import ConfigError
from stkzoo.mdp.spaces import action_of, kart_action_space
from stkzoo.views import ViewFactory, base_space
from stkzoo.views.agent_chain import AgentChain
from stkzoo.wrappers.camera import CameraKind, Shot
from stkzoo.wrappers.control import ControlWrapper


@dataclass(frozen=True, slots=True)
class Key:
    """One key.

    Attributes:
        name: label of the key.
        does: effect on the kart.
        code: SDL key code.
    """

    name: str
    does: str
    code: int


#: All keys that control the kart.
KEYS = (
    Key("up", "accelerate", 0x40000052),
    Key("down", "brake", 0x40000051),
    Key("left", "steer left", 0x40000050),
    Key("right", "steer right", 0x4000004F),
    Key("space", "fire", ord(" ")),
    Key("n", "nitro", ord("n")),
    Key("v", "drift", ord("v")),
    Key("backspace", "rescue", ord("\b")),
)
_CODE = {key.does: key.code for key in KEYS}


def base_action(pressed: Collection[int]) -> dict[str, Any]:
    """Returns the game's action for the keys that are held down.

    Braking overrides the throttle; left and right together cancel out.

    Args:
        pressed: key codes; other keys have no effect.

    Returns:
        A value of :func:`~stkzoo.mdp.spaces.kart_action_space`.
    """
    held = {does for does, code in _CODE.items() if code in pressed}
    throttle = "accelerate" in held and "brake" not in held
    steer = ("steer right" in held) - ("steer left" in held)
    buttons = [name in held for name in CONTROLS[2:]]
    return action_of(np.array([throttle, steer, *buttons], np.float32))


def keys_to_action(view: ViewFactory, name: str) -> dict[Any, Any]:
    """Returns a view's action for every combination of keys, including no key.

    Args:
        view: the view.
        name: name of the view in error messages.

    Returns:
        Actions by tuple of key codes; ``""`` is no key.

    Raises:
        ConfigError: the view's wrappers do not convert the ``action`` entry of observations.
    """
    seen = base_space(view, use_ai=True)
    chain = AgentChain("kart_0", seen, kart_action_space(), view, _NoCamera())
    blank: dict[str, Any] = create_zero_array(chain.base_observation_space)
    wrapper: Any = chain.env
    while isinstance(wrapper, gym.Wrapper):
        if isinstance(wrapper, ControlWrapper):
            wrapper.reads_keys = True
        wrapper = wrapper.env
    codes = sorted(key.code for key in KEYS)
    chosen: dict[Any, Any] = {}
    for number in range(len(codes) + 1):
        for combination in combinations(codes, number):
            seen, _ = chain.reset({**blank, "action": base_action(combination)}, {})
            # Gymnasium rejects an empty tuple, but accepts an empty string for "no key".
            chosen[combination or ""] = _action_in(seen, chain, name)
    return chosen


class _NoCamera:
    """A camera without a renderer; it returns a single black pixel."""

    def open(self, _: CameraKind) -> None:
        pass

    def look(self, _: CameraKind) -> Shot:
        return Shot(np.zeros((1, 1, 3), np.uint8))


def _action_in(seen: Any, chain: AgentChain, name: str) -> Any:
    action = seen.get("action") if isinstance(seen, dict) else None
    if action is None or action not in chain.action_space:
        raise ConfigError(
            f"view {name} has no default keys, because its wrappers do not convert the "
            'observation\'s entry "action"; pass keys_to_action to play()'
        )
    return action
