"""Fails at its third decision, and again after each restart."""


class Count:
    steps = 0


create_state = Count


def get_actor(module_dir, observation_space, action_space):
    def actor(state, observation):
        state.steps += 1
        if state.steps == 3:
            raise ZeroDivisionError("the third")
        action = action_space.sample()
        action["acceleration"][:] = 1
        return action

    return actor
