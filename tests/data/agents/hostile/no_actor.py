def get_actor(module_dir, observation_space, action_space):
    raise FileNotFoundError("weights.pth")
