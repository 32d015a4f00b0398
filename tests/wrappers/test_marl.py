"""Teams, masks, messages and partial observations, on real races."""

import math
from contextlib import closing

import numpy as np
import pytest
from gymnasium import spaces
from pettingzoo.test import parallel_api_test

from stkzoo import ActionError, AgentSpec, ConfigError, race_v0
from stkzoo.views import VIEWS
from stkzoo.wrappers import FlattenerWrapper, JoinedObservations, PolarObservations
from stkzoo.wrappers.marl import ActionMasks, MessageChannel, PartialObservations, Teams
from tests.support.generic_env import full_views, kart_env

TEAMS = [["kart_0", 3], ["1", "kart_2"]]


def race(**options):
    env = race_v0.parallel_env(**{"num_kart": 4, "track": "lighthouse", **options})
    for space in env.action_spaces.values():
        space.seed(0)
    return env


def some_actions(env):
    return {agent: env.action_space(agent).sample() for agent in env.agents}


# ------------------------------------------------------------------ box views


@pytest.mark.slow
def test_a_box_view_matches_the_flattened_view():
    views = {}
    for view in ("flattened_discrete", "box_discrete"):
        with race(num_kart=3, view=view) as env:
            views[view] = [env.reset(seed=1)[0]["kart_1"]]
            for number in range(40):
                views[view].append(env.step(dict.fromkeys(env.agents, 44 + number))[0]["kart_1"])
    sizes = [10, 7, 7, 7, 7, 7, 2, 4, 10, 11]
    for flat, box in zip(views["flattened_discrete"], views["box_discrete"], strict=True):
        np.testing.assert_allclose(box[:92], flat["continuous"], rtol=1e-5, atol=1e-5)
        chosen = [np.argmax(part) for part in np.split(box[92:], np.cumsum(sizes)[:-1])]
        assert chosen == flat["discrete"].tolist()


# ------------------------------------------------------------------ masks


def masked(view):
    return lambda env: ActionMasks(VIEWS[view](env))


def numbers_of(action):
    """Returns the buttons that an action of flattened_discrete presses."""
    return {"fire": (action // 20) % 2, "nitro": (action // 40) % 2}


@pytest.mark.slow
def test_the_mask_is_correct_for_nitro_and_fire_during_a_whole_race():
    seen = set()
    with race(agents=1, num_kart=2, view="masked_discrete", max_cycles=600) as env:
        observations, _ = env.reset(seed=2)
        while env.agents:
            (full,) = full_views(env)
            mask = observations["kart_0"]["action_mask"]
            can = {"nitro": full["energy"][0] > 0, "fire": full["powerup_type"] != 0}
            for action in range(0, 1120, 7):
                pressed = numbers_of(action)
                expected = all(can[name] or not pressed[name] for name in pressed)
                assert bool(mask[action]) is expected
            seen.add((bool(can["nitro"]), bool(can["fire"])))
            action = steer_home(observations["kart_0"]["observation"])
            observations = env.step({"kart_0": action})[0]
    assert len(seen) >= 3  # the race had steps with and without nitro and powerups


def steer_home(vector):
    """Returns the action that steers to the end of the third segment ahead at full throttle."""
    angle = vector[52 + 3 * 3]
    return 4 + 160 * int(np.clip(round(3 + 6 * angle), 0, 6))


@pytest.mark.slow
def test_masked_buttons_have_no_effect_in_the_game():
    ends = []
    for buttons in (0, 20, 40, 60):  # none, fire, nitro, both; nothing is usable at the start
        with race(num_kart=2, view="masked_discrete") as env:
            observations, _ = env.reset(seed=5)
            for _ in range(45):
                action = 4 + 3 * 160 + buttons
                if buttons:
                    assert not observations["kart_0"]["action_mask"][action]
                observations = env.step({"kart_0": action, "kart_1": 0})[0]
            ends.append(env.snapshot.karts["location"].tobytes())
    assert len(set(ends)) == 1


def test_a_multidiscrete_mask_joins_the_masks_of_its_choices():
    with race(num_kart=2, view=masked("flattened_multidiscrete")) as env:
        observations, _ = env.reset(seed=1)
        sizes = env.action_space("kart_0").nvec
        mask = observations["kart_0"]["action_mask"]
        assert mask.shape == (sizes.sum(),)
        parts = tuple(np.split(mask, np.cumsum(sizes)[:-1]))
        names = ["acceleration", "brake", "drift", "fire", "nitro", "rescue", "steer"]
        for name, part in zip(names, parts, strict=True):
            expected = [1, 0] if name in ("fire", "nitro") else [1] * len(part)
            assert part.tolist() == expected
        action = env.action_space("kart_0").sample(mask=parts)
        assert action[3] == action[4] == 0


# ------------------------------------------------------------------ partial observations


@pytest.mark.slow
def test_karts_far_away_or_behind_are_hidden():
    def near(env):
        return PartialObservations(env, radius=20.0, angle=math.pi, of=["karts", "items"])

    with race(view={0: near, 1: near}) as env:
        observations, _ = env.reset(seed=1)
        for _ in range(60):
            observations = env.step(some_actions(env))[0]
        num_hidden, everything = 0, full_views(env)
        for row, agent in enumerate(("kart_0", "kart_1")):
            for key, others in (("karts_position", ()), ("items_position", ("items_type",))):
                rows = np.array(everything[row][key])
                kept = (np.linalg.norm(rows, axis=1) <= 20) & (rows[:, 2] >= 0)
                num_hidden += len(rows) - kept.sum()
                seen = np.array(observations[agent][key]).reshape(-1, 3)
                np.testing.assert_allclose(seen, rows[kept], rtol=1e-5, atol=1e-5)
                for other in others:
                    kinds = np.array(everything[row][other])[kept].tolist()
                    assert list(observations[agent][other]) == kinds
            assert env.observation_space(agent).contains(observations[agent])
        assert num_hidden > 0
        assert len(observations["kart_2"]["karts_position"]) == 3


@pytest.mark.parametrize(
    ("view", "text"),
    [
        (lambda env: PartialObservations(VIEWS["simple"](env)), "needs a list"),
        (
            lambda env: PartialObservations(PolarObservations(env), angle=1.0),
            r"found PolarObservations .*inside PolarObservations",
        ),
        (masked("flattened"), "wraps flattened_multidiscrete"),
        (JoinedObservations, "needs a flattened view"),
    ],
)
def test_a_wrapper_in_the_wrong_place_is_refused(view, text):
    with pytest.raises(ConfigError, match=text):
        race(view=view)


@pytest.mark.parametrize(
    ("wrapper", "options", "text"),
    [
        (PartialObservations, {"radius": 0}, "radius is 0"),
        (PartialObservations, {"angle": math.nan}, "angle is nan"),
        (PartialObservations, {"of": ["cart"]}, "unknown thing to see"),
        (Teams, {"teams": [[0, 1], [2]]}, "'kart_3' is in 0 teams"),
        (Teams, {"teams": [[0, 1], [1, 2, 3]]}, "'kart_1' is in 2 teams"),
        (Teams, {"teams": [[0, 1, 2, 3, 4]]}, "unknown agent 4"),
        (Teams, {"teams": [[0, 1, 2, 3], []]}, "not a list of agents, or is empty"),
        (Teams, {"teams": [[0, 1, 2, 3]], "share": 1.5}, "share is 1.5"),
        (MessageChannel, {"size": 0}, "size is 0"),
        (MessageChannel, {"words": 1}, "words is 1"),
        (MessageChannel, {"reach": -1}, "reach is -1"),
        (MessageChannel, {"within_teams": True}, "needs teams"),
    ],
)
def test_invalid_options_are_refused(wrapper, options, text):
    env = kart_env() if wrapper is PartialObservations else race()
    with pytest.raises(ConfigError, match=text):
        wrapper(env, **options)


# ------------------------------------------------------------------ teams


def test_team_rewards_are_shared_by_the_share():
    with race(view="flattened_discrete") as env:
        shared = Teams(env, teams=TEAMS, share=0.25)
        _, infos = shared.reset(seed=1)
        assert {agent: info["team"] for agent, info in infos.items()} == {
            "kart_0": 0,
            "kart_1": 1,
            "kart_2": 1,
            "kart_3": 0,
        }
        assert infos["kart_0"]["reward/own"] == infos["kart_0"]["reward/team"] == 0.0
        for _ in range(30):
            actions = {agent: 4 + 160 * number for number, agent in enumerate(env.agents)}
            _, rewards, _, _, infos = shared.step(actions)
            own = {agent: info["reward/own"] for agent, info in infos.items()}
            for one, other in (("kart_0", "kart_3"), ("kart_1", "kart_2")):
                mean = (own[one] + own[other]) / 2
                assert rewards[one] == pytest.approx(0.75 * own[one] + 0.25 * mean)
                assert infos[one]["reward/team"] == pytest.approx(mean)
        assert len(set(own.values())) > 1


def test_teams_can_be_those_of_the_agents_specs():
    specs = [AgentSpec(team=4), AgentSpec(team=1), AgentSpec(team=4)]
    with race(agents=specs) as env:
        assert Teams(env).teams == (("kart_1",), ("kart_0", "kart_2"))
    with (
        race(agents=[AgentSpec(team=0), AgentSpec()]) as env,
        pytest.raises(ConfigError, match="agent 'kart_1' is in 0 teams"),
    ):
        Teams(env)
    with pytest.raises(ConfigError, match="team of agent 0 is -1, expected a whole number"):
        race(agents=[AgentSpec(team=-1)])


def test_a_mate_that_was_terminated_no_longer_races_but_one_that_was_truncated_does():
    still, driving = np.zeros(2, np.float32), np.array([1.0, 0.0], np.float32)
    with race(num_kart=3, view="box_continuous", end_when_stuck=1.5, max_cycles=40) as env:
        team = MessageChannel(Teams(env, teams=[[0, 1, 2]], observe=True), size=1)
        team.reset(seed=1)
        while team.agents:
            actions = {a: still if a == "kart_0" else driving for a in team.agents}
            message = np.ones(1, np.float32)
            seen, rewards, *_, infos = team.step(
                {agent: {"action": act, "message": message} for agent, act in actions.items()}
            )
            own = [info["reward/own"] for info in infos.values()]  # nothing for one that has left
            assert rewards["kart_1"] == pytest.approx(sum(own) / 3)
        assert set(seen) == {"kart_1", "kart_2"}  # kart_0 was terminated earlier
        assert seen["kart_1"]["observation"]["mates"][:, -1].tolist() == [0, 1]
        assert seen["kart_1"]["heard"].tolist() == [0, 1]


def test_teammates_are_where_the_full_view_shows_them():
    with race() as env:
        team = Teams(env, teams=[[0, 1], [2], [3]], observe=True)
        observations, _ = team.reset(seed=1)
        for _ in range(50):
            observations = team.step(some_actions(team))[0]
        for agent, mate in (("kart_0", "kart_1"), ("kart_1", "kart_0")):
            seen = observations[agent]
            assert seen in team.observation_space(agent)
            assert seen["team"] == 0
            row = seen["mates"][0]
            shown = np.array(seen["observation"]["karts_position"])
            assert np.abs(shown - row[:3]).sum(axis=1).min() < 1e-3
            speed = np.linalg.norm(observations[mate]["observation"]["velocity"])
            assert np.linalg.norm(row[3:6]) == pytest.approx(speed, abs=1e-3)
            infos = env.infos([agent, mate])
            ahead = infos[mate]["distance"] - infos[agent]["distance"]
            assert row[6] == pytest.approx(ahead, abs=1e-3)
            assert row[7] == infos[mate]["position"]
            assert row[10] == 1.0
        assert not observations["kart_2"]["mates"].any()


# ------------------------------------------------------------------ messages


def say(env, messages):
    return {agent: {"action": 4 + 480, "message": messages[agent]} for agent in env.agents}


def test_messages_arrive_one_step_later_in_the_order_of_the_agents():
    with race(num_kart=3, view="flattened_discrete") as inner:
        env = MessageChannel(inner, size=2)
        observations, _ = env.reset(seed=1)
        assert not observations["kart_0"]["heard"].any()
        messages = {a: np.array([n / 10, -n / 10], np.float32) for n, a in enumerate(env.agents)}
        observations = env.step(say(env, messages))[0]
        np.testing.assert_array_equal(
            observations["kart_1"]["messages"], [messages["kart_0"], messages["kart_2"]]
        )
        assert observations["kart_1"]["heard"].tolist() == [1, 1]
        assert observations["kart_1"] in env.observation_space("kart_1")
        observations, _ = env.reset()
        assert not observations["kart_1"]["messages"].any()


def test_words_are_heard_as_one_hot_vectors():
    with race(num_kart=2, view="flattened_discrete") as inner:
        env = MessageChannel(inner, words=5)
        assert env.action_space("kart_0")["message"] == spaces.Discrete(5)
        env.reset(seed=1)
        observations = env.step(say(env, {"kart_0": 3, "kart_1": np.int64(0)}))[0]
        assert observations["kart_1"]["messages"].tolist() == [[0, 0, 0, 1, 0]]


def test_only_teammates_within_reach_are_heard():
    starts = {"kart_0": 100.0, "kart_1": 110.0, "kart_2": 400.0, "kart_3": 115.0}
    with race(view="flattened_discrete") as inner:
        env = MessageChannel(
            Teams(inner, teams=[[0, 1, 2], [3]]), words=2, reach=60.0, within_teams=True
        )
        env.reset(seed=1, options={"start": starts})
        observations = env.step(say(env, dict.fromkeys(env.agents, 1)))[0]
        assert observations["kart_0"]["heard"].tolist() == [1, 0, 0]
        assert observations["kart_3"]["heard"].tolist() == [0, 0, 0]


def test_an_invalid_message_is_refused_before_the_race_advances():
    with race(num_kart=2, view="flattened_discrete") as inner:
        env = MessageChannel(inner, words=2)
        env.reset(seed=1)
        before = inner.snapshot.karts.tobytes()
        with pytest.raises(ActionError, match="message of agent 'kart_1' is 2"):
            env.step(say(env, {"kart_0": 0, "kart_1": 2}))
        with pytest.raises(ActionError, match="expected a dict of 'action' and 'message'"):
            env.step({"kart_0": 4, "kart_1": 4})
        with pytest.raises(ActionError, match="the actions are None; expected a dict"):
            env.step(None)
        assert inner.snapshot.karts.tobytes() == before


@pytest.mark.parametrize("message", ["abc", [1, [2]], None, [0.5], [10**400, 0]])
def test_a_message_that_is_no_vector_is_refused(message):
    with race(num_kart=2, view="flattened_discrete") as inner:
        env = MessageChannel(inner, size=2)
        env.reset(seed=1)
        with pytest.raises(ActionError, match="message of agent 'kart_0' is"):
            env.step(say(env, dict.fromkeys(env.agents, message)))


# ------------------------------------------------------------------ combinations


@pytest.mark.slow
def test_channels_around_teams_pass_pettingzoos_test():
    def view(env):
        return FlattenerWrapper(VIEWS["simple"](env))

    with race(num_kart=3, view=view, max_cycles=60) as inner:
        env = MessageChannel(Teams(inner, teams=[[0, 2], [1]], observe=True), size=3)
        parallel_api_test(env, num_cycles=40)


def talking_teams():
    return MessageChannel(Teams(race(view="flattened_discrete"), teams=TEAMS, share=0.5), size=1)


def test_a_clone_has_the_teams_and_messages():
    env = talking_teams()
    env.reset(seed=1)
    actions = {agent: {"action": 484, "message": [0.5]} for agent in env.agents}
    env.step(actions)
    with closing(env), env.lookahead() as branch, closing(env.clone()) as follower:
        ahead = branch.step(actions)
        follower.follow(branch)
        (behind, far), near = (each.step(actions) for each in (branch, follower)), env.step(actions)
        for one, other in ((ahead, near), (behind, far)):
            for part, same in zip(one, other, strict=True):
                np.testing.assert_equal(part, same)
        assert "reward/team" in ahead[-1]["kart_0"]
