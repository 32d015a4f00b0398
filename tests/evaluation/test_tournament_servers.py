"""Tournaments with agents on servers, and with agents that join later."""

import json

import pytest

from stkzoo.cli import main
from stkzoo.errors import ConfigError
from stkzoo.evaluation import load_tournament, run_tournament
from stkzoo.race.remote import new_key_files, read_servers
from tests.support.remote_race import server_process, write_agent

NAME = "<img src=x onerror=alert(1)>"
RACES = ("--races", "2", "--max-steps", "12", "--track", "lighthouse", "--jobs", "1")


@pytest.fixture(scope="module")
def course(tmp_path_factory):
    """Runs a tournament with two agents of a server with keys, then adds another agent."""
    home = tmp_path_factory.mktemp("course")
    agents = [write_agent(home, "ada"), write_agent(home, "bad", act="raise KeyError('oops')")]
    bad = home / "bad" / "pystk_actor.py"
    bad.write_text(bad.read_text().replace('"bad"', repr(NAME)))
    server, public = new_key_files("server", home)
    secret, allowed = new_key_files("course", home)
    keys = ("--secret", str(server), "--allow", str(allowed))
    folder = home / "cup"
    with server_process(*agents, *keys) as (_, address):
        (home / "servers.txt").write_text(f"# the course\n{address} {public.name}\n")
        words = ["--servers", str(home / "servers.txt"), "--secret", str(secret)]
        code = main(["tournament", "heuristic", *words, *RACES, "--output", str(folder)])
        first = {file.name: file.read_bytes() for file in (folder / "races").iterdir()}
        main(["tournament", "--resume", str(folder), "random@:late", "--jobs", "1"])
    return folder, code, first


@pytest.mark.slow
def test_agents_on_servers_race_under_their_own_names(course):
    folder, code, _ = course
    result = load_tournament(folder)
    assert {row.label for row in result.standings} == {"heuristic", "ada", NAME, "late"}
    assert code == 3
    assert result.is_complete


@pytest.mark.slow
def test_the_standings_show_why_an_agent_failed(course):
    rows = {row.label: row for row in load_tournament(course[0]).standings}
    assert "oops" in rows[NAME].reason
    assert rows["ada"].reason == ""


@pytest.mark.slow
def test_an_agent_that_joins_later_repeats_no_race(course):
    folder, _, first = course
    assert len(first) == 2
    assert all((folder / "races" / name).read_bytes() == text for name, text in first.items())
    rows = {row.label: row for row in load_tournament(folder).standings}
    assert rows["late"].races == 2
    assert json.loads((folder / "plan.json").read_text())["additions"] == [1]


@pytest.mark.slow
def test_the_same_command_with_more_agents_at_its_end_adds_them(tmp_path):
    """With fewer than four agents, all of them race in each race; this stays so."""
    agents, words = ["heuristic", "ai", "random"], [*RACES, "--output", str(tmp_path)]
    assert main(["tournament", *agents, *words]) == 0
    assert main(["tournament", *agents, "random@:dice", *words]) == 0
    settings = {"races": 2, "max_steps": 12, "tracks": ["lighthouse"], "plot": False, "jobs": 1}
    plan = run_tournament([*agents, "random@:dice", "ai@:rival"], output=tmp_path, **settings).plan
    assert (plan.grid_size, plan.additions) == (3, (1, 1))
    with pytest.raises(ConfigError, match="per_race is 4 and was None"):
        run_tournament([*agents, "random@:dice"], output=tmp_path, per_race=4, **settings)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "lists no servers"),
        ("a:1 key\nb:2\n", "a key for some servers only"),
        ("a:1 key more\n", "expected ADDRESS"),
    ],
)
def test_an_invalid_list_of_servers_is_refused(tmp_path, text, message):
    (tmp_path / "servers.txt").write_text(text)
    with pytest.raises(ConfigError, match=message):
        read_servers(tmp_path / "servers.txt")
