"""The learned driver rookie; see ``CARD.md``."""

from stkzoo.agents.pretrained.driver import functions_in

__all__ = ["create_state", "env_name", "get_actor", "get_batch_actor", "player_name"]

env_name = "supertuxkart/racing-v0"
player_name = "rookie"
create_state, get_actor, get_batch_actor = functions_in(__file__)
