def get_actor(module_dir, observation_space, action_space):
    def actor(state, observation):
        while True:
            pass

    return actor
