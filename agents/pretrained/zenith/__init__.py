"""The learned driver zenith; see ``CARD.md``."""

from .pystk_actor import create_state, env_name, get_actor, get_batch_actor, player_name

__all__ = ["create_state", "env_name", "get_actor", "get_batch_actor", "player_name"]
