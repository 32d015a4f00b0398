"""Another course repository, with the same module names."""

from stk_actor.driving import drive  # imports by the package's own name, as many repositories do

env_name = "supertuxkart/flattened_multidiscrete-v0"
player_name = "Beta"


def get_actor(module_dir, observation_space, action_space):
    return drive
