"""A course repository: a package with relative imports, a state, and the view ``simple``."""

from .driving import Memory, drive

env_name = "supertuxkart/simple-v0"
player_name = "Alpha"
create_state = Memory


def get_actor(module_dir, observation_space, action_space):
    assert (module_dir / "driving.py").is_file()
    assert "paths_end" in observation_space.spaces
    return drive
