"""Another course repository with modules of the same names."""

from stk_actor.driving import drive  # by the package's own name, as many repositories do

env_name = "supertuxkart/flattened_multidiscrete-v0"
player_name = "Beta"


def get_actor(module_dir, observation_space, action_space):
    return drive
