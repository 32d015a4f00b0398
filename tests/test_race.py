"""The race runner and its command."""

import json

import pytest

from stkzoo.cli import main
from stkzoo.errors import AgentError, ConfigError
from stkzoo.race import Driver, RaceResult, find_driver, run_race


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

    return Driver("clumsy", make_actor)


def test_ranks_are_given_once_each(result):
    assert [row.rank for row in result.agents] == [1, 2, 3, 4]


def test_whoever_finishes_earlier_ranks_better(result):
    finish_times = [row.finish_time for row in result.agents if row.finish_time is not None]
    assert len(finish_times) == 3
    assert finish_times == sorted(finish_times)


def test_whoever_does_not_finish_is_said_to_be_unfinished(result):
    assert result.agents[-1].driver == "random"
    assert result.agents[-1].finish_time is None
    assert not result.is_finished


def test_result_survives_json(result):
    assert RaceResult.from_json(result.to_json()) == result


def test_same_seed_is_the_same_race(result):
    again = run_race(["heuristic", "ai", "ai", "random"], track="olivermath", seed=3, max_steps=400)
    assert again == result


def test_other_seed_is_another_race(result):
    other = run_race(["heuristic", "ai", "ai", "random"], track="olivermath", seed=4, max_steps=400)
    assert [row.distance for row in other.agents] != [row.distance for row in result.agents]


def test_everybody_drives_all_laps():
    result = run_race(["ai", "ai"], track="olivermath", laps=2, seed=1)
    assert [row.laps for row in result.agents] == [2, 2]


def test_whoever_never_moves_does_not_hang_the_race():
    def stand(_, action_space, __):
        action = {key: space.sample() * 0 for key, space in action_space.items()}
        return lambda _: action

    result = run_race([Driver("parked", stand)], track="olivermath")
    assert not result.is_finished


def test_listener_hears_of_every_step():
    heard = []
    result = run_race(["heuristic"], track="olivermath", max_steps=30, listener=heard.append)
    assert [progress.steps for progress in heard] == list(range(result.steps + 1))


def test_listener_hears_of_the_whole_way():
    heard = []
    result = run_race(["ai"], track="olivermath", listener=heard.append)
    assert heard[-1].leader_distance == result.race_length


def test_unknown_driver_is_refused_with_the_nearest_name():
    with pytest.raises(ConfigError, match="Did you mean 'heuristic'"):
        find_driver("heuristik")


def test_race_without_drivers_is_refused():
    with pytest.raises(ConfigError, match="name at least one"):
        run_race([])


@pytest.mark.parametrize("max_steps", [0, -1, 2.5, True])
def test_impossible_step_limit_is_refused(max_steps):
    with pytest.raises(ConfigError, match="max_steps"):
        run_race(["ai"], track="olivermath", max_steps=max_steps)


def test_failing_driver_is_named():
    with pytest.raises(AgentError, match=r"'clumsy' of kart_1 failed: ZeroDivisionError") as caught:
        run_race(["ai", failing_driver(5)], track="olivermath")
    assert caught.value.key == "kart_1"


def test_command_shows_the_race(capsys):
    assert main(["race", "heuristic", "ai", "--track", "olivermath", "--seed", "1"]) == 0
    shown = capsys.readouterr().out
    assert "olivermath: 1 lap" in shown
    assert [line.split()[0] for line in shown.splitlines()[2:4]] == ["1", "2"]


def test_demo_says_where_to_go_next(capsys):
    assert main(["race", "--demo", "--track", "olivermath"]) == 0
    assert "Where to go next" in capsys.readouterr().out


def test_command_writes_json(tmp_path):
    file = tmp_path / "result.json"
    assert main(["race", "ai", "--track", "olivermath", "--json", str(file)]) == 0
    assert RaceResult.from_json(file.read_text()).agents[0].driver == "ai"


def test_command_writes_only_json_to_stdout_on_request(capsys):
    assert main(["race", "ai", "--track", "olivermath", "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out)["track"] == "olivermath"


def test_command_fills_the_race_up(capsys):
    words = ["race", "heuristic", "--num-karts", "3", "--track", "olivermath", "--json", "-"]
    assert main(words) == 0
    drivers = [row["driver"] for row in json.loads(capsys.readouterr().out)["agents"]]
    assert sorted(drivers) == ["ai", "ai", "heuristic"]


@pytest.mark.parametrize(
    "words",
    [
        [],
        ["nobody"],
        ["--demo", "ai"],
        ["ai", "ai", "--num-karts", "1"],
        ["ai", "--track", "nowhere"],
        ["ai", "--difficulty", "7"],
        ["ai", "--laps", "0"],
        ["ai", "--seed", "-1"],
        ["ai", "--laps", "two"],
    ],
)
def test_bad_usage_exits_with_2(words, capsys):
    assert main(["race", *words]) == 2
    assert "stkzoo race: error:" in capsys.readouterr().err


def test_command_without_the_games_data_exits_with_1(monkeypatch, tmp_path, capsys):
    monkeypatch.setenv("SUPERTUXKART_DATADIR", str(tmp_path))
    assert main(["race", "ai"]) == 1
    assert "Traceback" not in capsys.readouterr().err


def test_result_that_cannot_be_written_exits_with_1(tmp_path, capsys):
    file = tmp_path / "missing" / "result.json"
    assert main(["race", "ai", "--track", "olivermath", "--json", str(file)]) == 1
    assert "could not be written" in capsys.readouterr().err
