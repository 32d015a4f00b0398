"""A team that talks: an agent that sees a kart says so, and its teammate uses its item too.

    stkzoo race examples/talking examples/talking heuristic heuristic --track lighthouse
    stkzoo suite evaluate talk-2v2 examples/talking

The agent has the observations and actions of the task ``talk-2v2``: it sees other karts within
25 m, and in each step it says one of eight words to its team.
"""

import numpy as np

from stkzoo.wrappers.racing import PEDALS, PLACES, RESCUE, STEERS

env_name = "stkzoo-suite/talk-2v2-v1"
player_name = "Talking"

QUIET, KART = 0, 1  # words; the other six have no meaning here
GO = PEDALS.index("go")
AHEAD = 4  # index of the road point that the kart steers to, 19 m ahead
FAST_ENOUGH = 0.05  # of 20 m/s
STUCK_STEPS = 40


class State:
    slow_steps = 0


create_state = State


def get_actor(module_dir, observation_space, action_space):
    def actor(state, observation):
        view = observation["observation"]
        heard = observation["messages"].sum(axis=0)  # only the teammate's row is not zero

        state.slow_steps = state.slow_steps + 1 if view[2] < FAST_ENOUGH else 0
        is_stuck = state.slow_steps > STUCK_STEPS
        if is_stuck:
            state.slow_steps = 0

        right, _, ahead = view[PLACES["marks_direction"]].reshape(-1, 3)[AHEAD]
        steer = np.abs(STEERS - 1.5 * np.arctan2(right, ahead)).argmin()
        sees_kart = view[PLACES["karts_nearness"]].max() > 0
        fires = sees_kart or heard[KART] > 0
        return {
            "action": np.array([steer, RESCUE if is_stuck else GO, 0, 1, fires]),
            "message": KART if sees_kart else QUIET,
        }

    return actor
