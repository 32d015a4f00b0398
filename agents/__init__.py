"""Drivers that come with stkzoo, each found by its name: ``stkzoo.agents.<name>``.

A driver is a package with

``env_name``
    id of the environment that it was made for, which says what it sees and how it acts;
``player_name``
    the name to show;
``get_actor(module_dir, observation_space, action_space)``
    makes a callable ``actor(state, observation) -> action``;
``create_state()``
    makes what the actor remembers in one race; optional.

These packages use only what a user's own driver could use.
"""

__all__: list[str] = []
