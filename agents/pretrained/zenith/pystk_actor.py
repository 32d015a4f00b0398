"""A learned driver; see ``CARD.md``."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from stkzoo.agents.pretrained.driver import make_actor as get_actor
from stkzoo.agents.pretrained.driver import make_batch_actor as get_batch_actor
from stkzoo.agents.pretrained.driver import new_state

__all__ = ["create_state", "env_name", "get_actor", "get_batch_actor", "player_name"]

#: The environment that the driver was made for.
env_name = "supertuxkart/ground-v0"

#: The name to show.
player_name = "zenith"

create_state = partial(new_state, Path(__file__).parent)
