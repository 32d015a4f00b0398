"""The time budget of a driver for all its decisions together."""

import time
from dataclasses import replace

import pytest

from stkzoo.errors import AgentError, AgentTimeout, ConfigError
from stkzoo.race import Driver, RaceResult, run_race
from tests.support.paths import AGENTS

SLOW = str(AGENTS / "hostile" / "slow.py")


def race(*drivers, **settings):
    return run_race(list(drivers), track="lighthouse", seed=1, **{"max_steps": 12, **settings})


def by_driver(result):
    return {row.driver: row for row in result.agents}


@pytest.mark.slow
@pytest.mark.parametrize("handling", ["retire", "catch"])
def test_an_agent_that_uses_up_its_time_budget_is_retired(handling):
    result = race(SLOW, str(AGENTS / "plain"), time_budget=1.0, error_handling=handling)
    rows = by_driver(result)
    assert result.time_budget == 1.0
    assert [rows[name].status for name in ("slow", "Plain")] == ["retired", "racing"]
    (failure,) = rows["slow"].errors
    assert failure.kind == "timeout"
    assert failure.step <= 3  # earlier on a busy machine
    assert failure.message == "it has used up its time budget of 1 s for decisions"
    assert rows["slow"].action_time.total > 1.0


@pytest.mark.slow
def test_a_budget_ends_a_decision_without_a_limit():
    result = race(str(AGENTS / "hostile" / "loop.py"), time_budget=0.5, action_timeout=0)
    assert result.agents[0].errors[0].message.startswith("it has used up its time budget")


def test_failed_decisions_count():
    def make(*_):
        def actor(_):
            time.sleep(0.2)
            raise ValueError

        return actor

    driver = Driver.of_actor("failing", make)
    result = race(driver, time_budget=0.5, error_handling="catch", max_steps=9)
    assert [failure.step for failure in result.agents[0].errors] == [0, 1, 2]
    assert "time budget" in result.agents[0].errors[-1].message


def failing_with(message):
    """Returns a driver whose every decision fails, with the message twice in its traceback."""

    def make(*_):
        def actor(_):
            raise AgentError(message, trace=f"{message}\n{message}")

        return actor

    return Driver.of_actor("failing", make)


@pytest.mark.slow
@pytest.mark.parametrize("letter", ["a", ",", "\u00e9", "\U0001f600"])
def test_a_result_with_long_errors_of_256_agents_can_be_read(letter):
    options = {"error_handling": "catch", "max_steps": 25}
    result = race(failing_with(20_000 * letter), **options)
    (row,) = result.agents
    assert (row.num_errors, len(row.errors)) == (25, 20)
    full = replace(result, agents=tuple(replace(row, agent=f"kart_{n}") for n in range(256)))
    assert RaceResult.from_json(full.to_json()) == full


def test_later_long_errors_of_an_agent_are_shortened():
    message = "abc" * 1000
    result = race(failing_with(message), error_handling="catch", max_steps=4)
    first, *_, last = result.agents[0].errors
    assert (first.message, first.trace) == (message, f"{message}\n{message}")
    assert last.message.startswith("abcabc")
    assert len(last.message) < 300
    assert last.trace == ""


def test_raise_ends_the_race_when_a_time_budget_is_used_up():
    driver = Driver.of_actor("slow", lambda *_: lambda _: time.sleep(0.2))
    with pytest.raises(AgentTimeout, match=r"time budget of 0.1 s"):
        race(driver, time_budget=0.1, error_handling="raise")


def test_a_time_budget_of_0_means_no_limit():
    assert race("heuristic", time_budget=0, max_steps=2).time_budget is None


@pytest.mark.parametrize("value", [-1, float("nan"), float("inf"), "long"])
def test_an_invalid_time_budget_is_refused(value):
    with pytest.raises(ConfigError, match="time_budget is"):
        race("heuristic", time_budget=value)
