"""The keys that drive a kart, and what each combination of them means in a view.

The keys are the game's own. Their numbers are SDL's, which pygame and with it
``gymnasium.utils.play`` use.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.wrappers.utils import create_zero_array

from stkzoo.env.cameras import with_camera
from stkzoo.errors import ConfigError
from stkzoo.mdp.spaces import kart_action_space
from stkzoo.views import ViewFactory, base_space
from stkzoo.views.agent_chain import AgentChain
from stkzoo.wrappers.camera import CameraKind, Shot
from stkzoo.wrappers.control import ControlWrapper


@dataclass(frozen=True, slots=True)
class Key:
    """One key.

    Attributes:
        name: what is written on it.
        does: what it does to the kart.
        code: SDL's number.
    """

    name: str
    does: str
    code: int


#: All keys that drive.
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
    """The game's own action for the keys that are down.

    Braking lets go of the throttle; left and right together are straight ahead.

    Args:
        pressed: codes of keys; other keys do nothing.

    Returns:
        A value of :func:`~stkzoo.mdp.spaces.kart_action_space`.
    """
    held = {does for does, code in _CODE.items() if code in pressed}
    throttle = "accelerate" in held and "brake" not in held
    steer = ("steer right" in held) - ("steer left" in held)
    buttons = {name: int(name in held) for name in ("brake", "drift", "fire", "nitro", "rescue")}
    return {
        "acceleration": np.array([throttle], np.float32),
        "steer": np.array([steer], np.float32),
        **buttons,
    }


def keys_to_action(view: ViewFactory, name: str) -> dict[Any, Any]:
    """The action of a view for every combination of keys, none of them too.

    Args:
        view: the view.
        name: what to call it in errors.

    Returns:
        Actions by tuple of key codes; ``""`` is no key.

    Raises:
        ConfigError: the view's wrappers do not say how an action of the game looks there.
    """
    seen = base_space(view, use_ai=True)
    chain = AgentChain("kart_0", seen, kart_action_space(), with_camera(view, _NoCamera()))
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
            seen = chain.observe({**blank, "action": base_action(combination)})
            # Gymnasium refuses empty tuples, but takes an empty string for no key at all.
            chosen[combination or ""] = _action_in(seen, chain, name)
    return chosen


class _NoCamera:
    """Sees nothing; where nobody draws."""

    def open(self, _: CameraKind) -> None:
        pass

    def look(self, _: CameraKind) -> Shot:
        return Shot(np.zeros((1, 1, 3), np.uint8))


def _action_in(seen: Any, chain: AgentChain, name: str) -> Any:
    action = seen.get("action") if isinstance(seen, dict) else None
    if action is None or action not in chain.action_space:
        raise ConfigError(
            f"view {name} does not say which of its actions a key is: its wrappers do not turn "
            'the entry "action" of what AI agents observe; pass keys_to_action to play()'
        )
    return action
