"""Drivers that come with stkzoo, each a package ``stkzoo.agents.<name>`` found by its name.

A driver is a package with

``env_name``
    id of the environment that it was made for, which determines its observations and actions;
``player_name``
    display name;
``get_actor(module_dir, observation_space, action_space)``
    returns a callable ``actor(state, observation) -> action``;
``create_state()``
    returns the actor's state for one race; optional.

These packages use only interfaces that are available to your own drivers.
"""

from stkzoo._imports import lazy_names

__getattr__ = lazy_names(__name__)
