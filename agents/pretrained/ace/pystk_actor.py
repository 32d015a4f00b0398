"""A learned driver; see ``CARD.md``."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from stkzoo.agents.pretrained.driver import make_actor, new_state

__all__ = ["create_state", "env_name", "get_actor", "player_name"]

#: The environment that the driver was made for.
env_name = "supertuxkart/full-v0"

#: The name to show.
player_name = "ace"

create_state = partial(new_state, Path(__file__).parent)


def get_actor(module_dir: Path, observation_space: Any, action_space: Any) -> Callable[..., Any]:
    """The driver.

    Args:
        module_dir: this folder, where the weights are.
        observation_space: not needed.
        action_space: not needed.
    """
    del observation_space, action_space
    return make_actor(module_dir)
