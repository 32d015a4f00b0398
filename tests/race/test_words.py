"""Words in races reach the karts of the same agent, and no others."""

import numpy as np
import pytest

from stkzoo import OpponentPool, race_v0
from stkzoo.errors import AgentException, ConfigError
from stkzoo.race import Driver, RaceListener, find_driver, run_race
from stkzoo.race.remote import RaceServer
from stkzoo.suite import find_task
from tests.support.paths import AGENTS, ROOT

VIEW = find_task("talk-2v2").agent_view()
EXAMPLE = str(ROOT / "examples" / "talking")
RACE = {"track": "lighthouse", "seed": 5}
STRAIGHT = np.array([10, 0, 0, 0, 0])


def speaker(name, said, heard):
    """Returns a driver that says ``said(step)`` in each step and records what it hears."""

    def make(*_):
        log = []
        heard.append(log)

        def actor(observation):
            log.append((observation["messages"], observation["heard"]))
            return said(len(log) - 1)

        return actor

    return Driver.of_actor(name, make, VIEW)


def saying(word):
    return lambda _: {"action": STRAIGHT, "message": word}


def words(log):
    """Returns the words heard in each step, by row; -1 for none."""
    return [
        [int(row.argmax()) if one else -1 for row, one in zip(rows, heard, strict=True)]
        for rows, heard in log
    ]


def test_a_word_reaches_only_its_own_team_one_step_later():
    heard = []
    red, blue = (speaker(name, saying(w), heard) for name, w in (("Red", 3), ("Blue", 6)))
    result = run_race([red, blue, "heuristic", red, blue], max_steps=4, **RACE)
    assert not any(row.num_errors for row in result.agents)
    silence = [[-1] * 4]
    first, second, third, fourth = map(words, heard)
    assert first == silence + [[-1, -1, 3, -1]] * 3
    assert second == silence + [[-1, -1, -1, 6]] * 3
    assert third == silence + [[3, -1, -1, -1]] * 3
    assert fourth == silence + [[-1, 6, -1, -1]] * 3


class NearTheFinish(RaceListener):
    """Starts the first kart shortly before the finish line."""

    def env_options(self):
        return {"start": {"kart_0": 475.0, "kart_1": 48.0}}


def test_a_kart_that_has_finished_is_not_heard():
    heard, settings = [], {"track": "olivermath", "max_steps": 100, "max_steps_after_first": 2}
    red = speaker("Red", saying(2), heard)
    result = run_race([red, red], listeners=[NearTheFinish()], **settings)
    assert [row.agent for row in result.agents if row.finish_time] == ["kart_0"]
    assert words(heard[1]) == [[-1], *[[2]] * (result.steps - 3), [-1], [-1]]
    assert len(heard[0]) == result.steps - 2


@pytest.mark.parametrize(
    ("action", "text"),
    [
        ({"action": STRAIGHT, "message": 8}, "['message'] of agent 'kart_0' is 8"),
        ({"action": STRAIGHT, "message": [1, 2]}, "['message'] of agent 'kart_0' is [1, 2]"),
        ({"action": STRAIGHT}, "lacks message"),
        (STRAIGHT, "a dict with the keys action, message"),
    ],
)
def test_an_invalid_word_is_an_invalid_action(action, text):
    heard = []
    wrong = speaker("Red", lambda step: action if step == 1 else saying(4)(step), heard)
    result = run_race([wrong, wrong], max_steps=4, error_handling="catch", **RACE)
    row = next(row for row in result.agents if row.agent == "kart_0")
    assert (row.num_errors, row.errors[0].kind, row.errors[0].step) == (1, "error", 1)
    assert text in row.errors[0].message
    assert words(heard[1]) == [[-1], [4], [-1], [4]]  # no word in the step after the failure


def test_a_driver_that_has_retired_is_not_heard():
    heard = []
    wrong = speaker("Red", lambda step: {} if step == 2 else saying(1)(step), heard)
    good = speaker("Red", saying(5), heard)
    result = run_race([wrong, good], max_steps=6, **RACE)
    assert {row.agent: row.status for row in result.agents}["kart_0"] == "retired"
    assert words(heard[1]) == [[-1], [1], [1], [-1], [-1], [-1]]


@pytest.mark.slow
def test_an_unknown_word_is_an_invalid_action():
    shouts = str(AGENTS / "hostile" / "shouts.py")
    result = run_race([shouts, "heuristic"], max_steps=5, **RACE)
    row = next(row for row in result.agents if row.agent == "kart_0")
    assert (row.status, row.num_errors) == ("retired", 1)
    assert "action['message'] of agent 'kart_0' is 200" in row.errors[0].message


def test_an_agent_must_name_its_task_as_a_literal(tmp_path):
    computed = tmp_path / "computed.py"
    computed.write_text(
        "env_name = '-'.join(['stkzoo', 'suite/talk', '2v2', 'v1'])\n"
        "def get_actor(*_):\n"
        "    return lambda state, observation: None\n"
    )
    (row,) = run_race([str(computed)], max_steps=3, inline=True, **RACE).agents
    assert row.errors[0].kind == "start"
    assert "must assign env_name as a literal" in row.errors[0].message


def test_agents_that_talk_are_refused_where_words_are_not_supported():
    driver = find_driver(EXAMPLE)
    with pytest.raises(ConfigError, match="talks, but servers do not carry words"):
        RaceServer([driver])
    with pytest.raises(ConfigError, match="talks, but opponents cannot"):
        race_v0.parallel_env(num_kart=2, agents=1, opponents=[EXAMPLE], track="lighthouse")
    with pytest.raises(ConfigError, match="talks, but opponents cannot"):
        OpponentPool([driver])
    with pytest.raises((ConfigError, AgentException), match="no words are carried here"):
        race_v0.parallel_env(num_kart=2, track="lighthouse", view=VIEW)
