"""Options that end an episode early, and the reason that infos give."""

import numpy as np

from stkzoo import EndReason, Start, race_v0
from tests.support.playing import kart_action


def race_to_the_end(env, actions, **reset):
    """Returns the number, flags and info of each agent's last step."""
    _, first = env.reset(seed=1, **reset)
    ends, number = {}, 0
    while env.agents:
        number += 1
        parts = env.step({agent: actions[agent] for agent in env.agents})
        for agent, info in parts[4].items():
            if parts[2][agent] or parts[3][agent]:
                ends[agent] = number, parts[2][agent], parts[3][agent], info
            else:
                assert info.get("ended_by", 0) == EndReason.NONE
            assert info.keys() == first[agent].keys()
            assert all(isinstance(value, (int, float)) for value in info.values())
    return ends


def test_a_standing_agent_is_stuck_and_a_driving_one_is_not():
    with race_v0.parallel_env(
        num_kart=2, track="lighthouse", end_when_stuck=2.0, max_cycles=80
    ) as env:
        ends = race_to_the_end(env, {"kart_0": kart_action(0.0), "kart_1": kart_action(0.6)})
        stood, terminated, truncated, info = ends["kart_0"]
        assert (terminated, truncated, info["ended_by"]) == (True, False, EndReason.STUCK)
        # Two seconds after GO, which comes after 19 steps.
        assert 38 <= stood <= 41
        assert ends["kart_1"][1:3] == (False, True)
        assert ends["kart_1"][3]["ended_by"] == EndReason.MAX_CYCLES
        assert env.infos(["kart_0"])["kart_0"]["ended_by"] == EndReason.STUCK


def test_agents_that_turn_around_or_leave_the_road_are_terminated():
    starts = {
        "kart_0": Start(distance=60.0, heading=np.pi, speed=8.0),
        "kart_1": Start(distance=90.0, heading=np.pi / 2, speed=8.0),
    }
    with race_v0.parallel_env(
        num_kart=2,
        track="lighthouse",
        start=starts,
        end_when_wrong_way=1.0,
        end_off_road=1.5,
        max_cycles=100,
    ) as env:
        ends = race_to_the_end(env, {"kart_0": kart_action(0.5), "kart_1": kart_action(0.5)})
    (back, *back_ends), (off, *off_ends) = ends["kart_0"], ends["kart_1"]
    assert (back_ends[:2], back_ends[2]["ended_by"]) == ([True, False], EndReason.WRONG_WAY)
    assert (off_ends[:2], off_ends[2]["ended_by"]) == ([True, False], EndReason.OFF_ROAD)
    assert back < off < 60


def test_a_race_is_truncated_some_steps_after_the_first_finish():
    starts = {"kart_0": Start(share=0.97, speed=20.0), "kart_1": Start(distance=50.0)}
    options = {"start": starts}
    with race_v0.parallel_env(num_kart=2, track="lighthouse", max_cycles=400) as env:
        actions = {"kart_0": kart_action(1.0), "kart_1": kart_action(0.0)}
        for steps in (0, 5):
            now = {**options, "end_when_first_finishes": steps}
            ends = race_to_the_end(env, actions, options=now)
            first, last = ends["kart_0"], ends["kart_1"]
            assert (first[1:3], first[3]["ended_by"]) == ((True, False), EndReason.FINISH)
            assert (last[1:3], last[3]["ended_by"]) == ((False, True), EndReason.FIRST_FINISH)
            assert last[0] - first[0] == steps


def test_infos_contain_nothing_that_was_not_requested():
    with race_v0.parallel_env(num_kart=1, track="lighthouse", max_cycles=2) as env:
        (_, terminated, truncated, info) = race_to_the_end(env, {"kart_0": kart_action(0.0)})[
            "kart_0"
        ]
    assert (terminated, truncated) == (False, True)
    assert not [key for key in info if "event" in key or key == "ended_by"]


def test_a_saved_state_keeps_how_long_a_kart_has_been_stuck():
    with race_v0.parallel_env(num_kart=2, track="lighthouse", end_when_stuck=2.0) as env:
        actions = {"kart_0": kart_action(0.0), "kart_1": kart_action(0.6)}

        def steps_to_the_end():
            number = 0
            while "kart_0" in env.agents:
                number += 1
                env.step({agent: actions[agent] for agent in env.agents})
            return number

        env.reset(seed=1)
        for _ in range(30):
            env.step(actions)
        with env.save_state() as state:
            left = steps_to_the_end()
            env.restore_state(state)
            assert steps_to_the_end() == left < 12
            env.reset(options={"state": state})
            assert steps_to_the_end() == 20
            env.reset(options={"state": state, "end_when_stuck": 1.0})
            assert steps_to_the_end() == 10
