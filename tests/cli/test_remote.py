"""``stkzoo race-server`` and ``stkzoo race-client``."""

import json
import signal
import subprocess
import time

import pytest

from stkzoo.cli import main
from stkzoo.race.remote import new_key_files
from tests.support.remote_race import server_process, write_agent

RACE = ["--track", "lighthouse", "--seed", "3", "--max-steps", "12"]


@pytest.mark.slow
def test_a_race_with_keys_can_mix_remote_and_local_drivers(tmp_path, capsys):
    agent = write_agent(tmp_path, "ada")
    (server, server_public), (course, course_public) = (
        new_key_files(name, tmp_path) for name in ("server", "course")
    )
    keys = ("--secret", str(server), "--allow", str(course_public))
    with server_process(agent, *keys, address="*:*") as (_, address):
        where = address.replace("0.0.0.0", "127.0.0.1")
        client = ["race-client", "--server", where, "--server-key", str(server_public)]
        output = ["--output", str(tmp_path / "result.json"), "--num-karts", "3"]
        assert main([*client, "--secret", str(course), "heuristic", *RACE, *output]) == 0
        assert main([*client, "--connect-timeout", "3", *RACE]) == 1
    assert "refuses the connection" in capsys.readouterr().err
    agents = json.loads((tmp_path / "result.json").read_text())["agents"]
    names = {row["agent"]: row["driver"] for row in agents}
    assert names == {"kart_0": "ada", "kart_1": "heuristic", "kart_2": "ai"}


@pytest.mark.slow
def test_an_agents_failure_on_its_server_sets_the_exit_code(tmp_path, capsys):
    agent = write_agent(tmp_path, "bad", act="raise KeyError('oops')")
    with server_process(agent) as (_, address):
        assert main(["race-client", "--server", address, "ai", *RACE]) == 3
    assert "oops" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["race-server", "heuristic", "--address", "*:5998"], "give the server a key of its own"),
        (["race-server", "ai"], "name it on the client"),
        (["race-server", "heuristic", "--threads", "0"], "expected a whole number of 1 or more"),
        (["race-server"], "AGENT"),
        (["race-client"], "--server"),
        (["race-client", "--server", "no port:x"], "expected one such as"),
        (["race-client", "--server", "a", "--secret", "nowhere"], "nowhere cannot be read"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_bad_usage_is_reported(words, text, capsys):
    assert main(words) == 2
    assert text in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_a_server_ends_on_a_signal(tmp_path, how):
    agent = write_agent(tmp_path, "ada")
    with server_process(agent) as (process, address):
        time.sleep(0.2)
        process.send_signal(how)
        try:
            assert process.wait(20) == 0
        except subprocess.TimeoutExpired:
            pytest.fail(f"the server at {address} did not end")
