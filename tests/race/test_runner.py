"""The race runner, from the grid to the result (D26, D27)."""

import json

import jsonschema
import pytest

from stkzoo.errors import AgentError, ConfigError
from stkzoo.race import AgentFailure, Driver, RaceListener, RaceResult, RaceSettings, run_race
from tests.support.paths import SCHEMAS
from tests.support.remote_race import write_agent

SCHEMA = SCHEMAS / "race-result.schema.json"


@pytest.fixture(scope="module")
def result():
    return run_race(["heuristic", "ai", "ai", "random"], track="olivermath", seed=3, max_steps=400)


def failing_driver(step):
    def make_actor(_, action_space, __):
        calls = iter(range(1000))

        def act(_):
            if next(calls) == step:
                raise ZeroDivisionError("no way")
            return action_space.sample()

        return act

    return Driver.of_actor("clumsy", make_actor)


def test_earlier_finishers_rank_better_and_others_are_unfinished(result):
    assert [row.rank for row in result.agents] == [1, 2, 3, 4]
    *finish_times, last = [row.finish_time for row in result.agents]
    assert finish_times == sorted(finish_times)
    assert (result.agents[-1].driver, last, result.is_finished) == ("random", None, False)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_race(result):
    again = run_race(["heuristic", "ai", "ai", "random"], track="olivermath", seed=3, max_steps=400)
    assert again == result


@pytest.mark.slow
def test_the_difficulty_changes_the_speed_of_agents_too():
    race = {"track": "lighthouse", "seed": 1, "max_steps": 100}
    results = [run_race(["heuristic"], difficulty=level, **race) for level in range(4)]
    driven = [result.agents[0].distance for result in results]
    assert driven == sorted(driven)
    assert driven[3] > 1.2 * driven[0]


@pytest.mark.slow
def test_a_kart_that_never_moves_does_not_hang_the_race():
    def stand(_, action_space, __):
        action = {key: space.sample() * 0 for key, space in action_space.items()}
        return lambda _: action

    result = run_race([Driver.of_actor("parked", stand)], track="olivermath")
    assert not result.is_finished


class Ear(RaceListener):
    """Records all its calls."""

    def __init__(self, stop_at=None):
        self.calls, self.heard, self.result = [], [], None
        self.stop_at = stop_at

    def started(self, race):
        self.calls.append("started")
        self.heard.append(race)

    def stepped(self, race):
        self.calls.append("stepped")
        self.heard.append(race)
        if race.steps == self.stop_at:
            race.stop("seen enough")

    def ended(self, result):
        self.calls.append("ended")
        self.result = result

    def closed(self):
        self.calls.append("closed")


def test_a_listener_is_called_for_every_step():
    ear = Ear()
    result = run_race(["heuristic"], track="olivermath", max_steps=30, listeners=[ear])
    assert [race.steps for race in ear.heard] == list(range(result.steps + 1))
    assert ear.calls == ["started", *["stepped"] * 30, "ended", "closed"]
    assert ear.result == result


def test_names_of_drivers_are_one_printable_line():
    drivers = ["ai@:A\nB\x1b[31m", "heuristic@:C\tD\x07", "ai@:\n"]
    result = run_race(drivers, track="olivermath", max_steps=1)
    names = {row.agent: row.driver for row in result.agents}
    assert names == {"kart_0": "A B", "kart_1": "C D", "kart_2": "kart_2"}


def test_names_that_differ_only_in_case_get_numbers():
    drivers = ["heuristic@:Ada", "random@:\uff21DA", "ai", "ai"]
    result = run_race(drivers, track="olivermath", max_steps=1)
    names = [row.driver for row in sorted(result.agents, key=lambda row: row.agent)]
    assert names == ["Ada", "ADA-2", "ai", "ai"]


def test_a_listener_gets_observations_actions_and_rewards():
    ear = Ear()
    drivers = ["heuristic", "ai@:Bot"]
    result = run_race(drivers, track="olivermath", max_steps=30, seed=2, listeners=[ear])
    last = ear.heard[-1]
    assert {row.agent: row.reward for row in result.agents} == last.total_rewards  # D27
    assert last.names == {"kart_0": "heuristic", "kart_1": "Bot"}
    assert "paths_end" in last.observations["kart_0"]
    assert last.actions["kart_0"].keys() == {
        *("acceleration", "steer", "brake", "drift", "fire", "nitro", "rescue")
    }
    assert last.total_rewards["kart_0"] == pytest.approx(
        sum(race.rewards["kart_0"] for race in ear.heard[1:])
    )
    assert last.infos["kart_1"]["episode/length"] == 30


def test_a_listener_can_stop_the_race():
    result = run_race(["ai"], track="olivermath", listeners=[Ear(stop_at=7)])
    assert (result.steps, result.status) == (7, "seen enough")


def test_listeners_are_closed_after_an_error():
    ear = Ear()
    with pytest.raises(ConfigError, match="Did you mean 'lighthouse'"):
        run_race(["ai"], track="lighthous", listeners=[ear])
    assert ear.calls == ["closed"]


def test_a_race_without_drivers_is_refused():
    with pytest.raises(ConfigError, match="name at least one"):
        run_race([])


@pytest.mark.parametrize("max_steps", [0, -1, 2.5, True])
def test_an_invalid_step_limit_is_refused(max_steps):
    with pytest.raises(ConfigError, match="max_steps"):
        run_race(["ai"], track="olivermath", max_steps=max_steps)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"mode": "soccer"}, "unknown mode 'soccer'. Known: normal, time_trial"),
        ({"kart": "tank"}, "unknown kart 'tank'"),
        ({"error_handling": "pray"}, "unknown error_handling 'pray'. Known: catch, raise"),
        ({"action_timeout": -1}, "action_timeout is -1, expected a number of seconds"),
        ({"start_timeout": 0}, "start_timeout is 0"),
        ({"agent_memory": 1.5}, "agent_memory is 1.5"),
        ({"max_step": 5}, "unknown setting of a race 'max_step'. Did you mean 'max_steps'"),
        ({"adapter": "nowhere.py"}, "there is no adapter .*nowhere.py"),
    ],
)
def test_invalid_settings_are_refused(settings, message):
    with pytest.raises(ConfigError, match=message):
        run_race(["tests/data/agents/plain"], track="olivermath", **settings)


def test_settings_can_be_kept_and_changed():
    settings = RaceSettings(track="olivermath", seed=3, max_steps=4)
    assert run_race(["ai"], settings=settings, seed=4).seed == 4


def test_a_failing_driver_is_named():
    drivers = ["ai", failing_driver(5)]
    with pytest.raises(AgentError, match=r"'clumsy' of kart_1 failed: ZeroDivisionError") as caught:
        run_race(drivers, track="olivermath", error_handling="raise")
    assert caught.value.key == "kart_1"


@pytest.mark.slow
def test_a_failing_driver_affects_only_its_own_race():
    result = run_race(["ai", failing_driver(5)], track="olivermath", seed=1)
    winner, loser = result.agents
    assert (result.status, winner.status, loser.status) == ("finished", "finished", "retired")
    assert loser.errors == (AgentFailure(5, "error", "ZeroDivisionError: no way"),)
    assert 'ZeroDivisionError("no way")' in loser.errors[0].trace


@pytest.mark.slow
@pytest.mark.parametrize(
    ("settings", "status"),
    [
        ({"max_steps": 20}, "max_steps"),
        ({"karts_finished": 1}, "karts_finished"),
        ({"max_steps_after_first": 3}, "max_steps_after_first"),
        ({}, "finished"),
    ],
)
def test_the_result_says_why_the_race_ended(settings, status):
    """D26: a race that was stopped early has another status than a finished one."""
    result = run_race(["ai", "ai", "ai"], track="olivermath", seed=1, **settings)
    assert result.status == status
    assert result.is_finished == (status == "finished")


@pytest.mark.slow
def test_a_long_race_is_not_cut_short():
    """D26: the race takes longer than 1500 steps, after which the reference stops."""
    result = run_race(["ai"], track="candela_city", laps=4, seed=1)
    assert result.steps > 1500
    assert (result.status, result.agents[0].laps) == ("finished", 4)


def test_the_result_matches_the_published_schema(result):
    """D27: the result includes the seed, grid, finish times, ends and errors."""
    schema = json.loads(SCHEMA.read_text())
    jsonschema.Draft202012Validator.check_schema(schema)
    failed = run_race(["ai", failing_driver(5)], track="olivermath", max_steps=9)
    for race in (result, failed):
        jsonschema.validate(json.loads(race.to_json()), schema)
    assert sorted(row.start_position for row in result.agents) == [1, 2, 3, 4]


def test_a_result_of_another_version_is_refused(result):
    text = result.to_json().replace('"schema_version": 1', '"schema_version": 99')
    with pytest.raises(ConfigError, match="of version 99, expected"):
        RaceResult.from_json(text)


def test_action_times_are_reported(result):
    times = {row.driver: row.action_time for row in result.agents}
    assert times["ai"] is None
    for part in (times["heuristic"].mean, times["heuristic"].p99):
        assert 0 < part <= times["heuristic"].max


@pytest.mark.slow
def test_numbers_outside_a_space_are_clipped_and_counted_but_nan_fails(tmp_path, caplog):
    backwards = write_agent(
        tmp_path, "backwards", "return {**action_space.sample(), 'acceleration': [-1.0]}"
    )
    undefined = write_agent(
        tmp_path, "undefined", "return {**action_space.sample(), 'steer': [float('nan')]}"
    )

    eager = Driver.of_actor("eager", lambda _, space, __: lambda _: space.sample() | {"steer": 2.0})
    odd = write_agent(
        tmp_path, "odd", "return {**action_space.sample(), 'fire': [0.63], 'jump': 1}"
    )
    drivers = [backwards, undefined, eager, odd]
    result = run_race(drivers, track="lighthouse", seed=1, max_steps=5)
    rows = {row.agent: row for row in result.agents}
    assert [rows[f"kart_{n}"].num_clipped for n in range(4)] == [5, 0, 5, 5]
    status = [rows[f"kart_{n}"].status for n in range(4)]
    assert status == ["racing", "retired", "racing", "racing"]
    assert "nan" in rows["kart_1"].errors[0].message
    warned = [record.getMessage() for record in caplog.records]
    assert [text.split()[3] for text in warned if "clipped" in text] == [
        "backwards",
        "eager",
        "odd",
    ]
    assert RaceResult.from_json(result.to_json()) == result
    jsonschema.validate(json.loads(result.to_json()), json.loads(SCHEMA.read_text()))
