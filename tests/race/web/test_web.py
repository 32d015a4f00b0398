"""The live page: its files, its messages and its controls (D30)."""

import asyncio
import signal
import socket
import subprocess
import sys
import threading
import urllib.request
from types import SimpleNamespace

import aiohttp
import numpy as np
import pytest
from aiohttp import web
from multidict import CIMultiDict

from stkzoo._installation import install_command
from stkzoo.cli import main
from stkzoo.errors import ConfigError
from stkzoo.race import RaceResult, run_race
from stkzoo.race.web import SPEEDS, LivePage
from stkzoo.race.web.control import RaceControl
from stkzoo.race.web.messages import COLUMNS, TraceLog, encoded, plain
from stkzoo.race.web.server import RequestGuard
from tests.support.floods import upgrade_request
from tests.support.processes import run_program, wait_until
from tests.support.web_race import WatchedRace, viewer


@pytest.fixture
def page():
    page = LivePage(port=0)
    yield page
    page.closed()


def fetch(url):
    with urllib.request.urlopen(url, timeout=10) as answer:
        return answer.headers, answer.read().decode()


# ---------------------------------------------------------------- the page


def test_the_package_serves_all_files_of_the_page(page):
    headers, text = fetch(page.url)
    assert "frame-ancestors 'none'" in headers["Content-Security-Policy"]
    assert headers["Cache-Control"] == "no-store"
    for file in ("page.js", "page.css", "map.js", "charts.js", "standings.js", "tree.js"):
        headers, content = fetch(page.url + file)
        assert headers["X-Content-Type-Options"] == "nosniff"
        assert "http://" not in content
        assert "https://" not in content
    assert 'src="page.js"' in text


@pytest.mark.parametrize("path", ["nothing", "..%2fserver.py", "static/page.js", "__init__.py"])
def test_no_other_files_are_served(page, path):
    with pytest.raises(urllib.error.HTTPError, match="404") as caught:
        fetch(page.url + path)
    caught.value.close()


def test_page_is_served_only_to_this_machine_by_default(page):
    """D30: the reference listens on all addresses."""
    assert page.url == f"http://127.0.0.1:{page.port}/"
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.2", page.port), timeout=5)


def test_a_port_in_use_is_an_error(page):
    with pytest.raises(ConfigError, match=f"port {page.port}.*another port"):
        LivePage(port=page.port)


@pytest.mark.parametrize("port", [-1, 65536, "8000", True])
def test_an_invalid_port_is_refused(port):
    with pytest.raises(ConfigError, match="port is"):
        LivePage(port=port)


@pytest.mark.parametrize("speed", [0, 3, "max", True])
def test_an_invalid_speed_is_refused(speed):
    with pytest.raises(ConfigError, match="the speed is"):
        LivePage(port=0, speed=speed)


def test_the_error_without_aiohttp_names_the_extra():
    program = run_program("""
        import sys
        sys.modules["aiohttp"] = None
        from stkzoo.race.web import LivePage
        LivePage(port=0)
    """)
    assert install_command("races") in program.stderr


def test_closing_frees_the_port_and_the_thread():
    page = LivePage(port=0)
    page.closed()
    page.closed()
    again = LivePage(port=page.port)
    again.closed()
    assert "stkzoo-live-page" not in [thread.name for thread in threading.enumerate()]


# ---------------------------------------------------------------- the race


def test_page_does_not_change_the_race():
    """It runs to its end without viewers. The reference waits for a click (D30)."""
    settings = {"track": "olivermath", "max_steps": 60, "seed": 5}
    alone = run_race(["heuristic", "ai"], **settings)
    page = LivePage(port=0, speed=None)
    assert run_race(["heuristic", "ai"], listeners=[page], **settings) == alone


def test_a_viewer_gets_the_race_then_its_past_then_its_present():
    async def scenario(one):
        race = await one.next("race")
        moment = await one.next("moment")
        assert one.kinds == ["hello", "race", "state", "traces", "moment"]
        return race, moment

    async def until_there(one):
        await one.next("moment")

    with WatchedRace(["ai", "random", "random@:Rolf"]) as race:
        race.watch(until_there)
        form, moment = race.watch(scenario)
    assert (form["title"], form["laps"], form["seed"]) == ("olivermath", 1, 3)
    assert {kart["agent"]: kart["name"] for kart in form["karts"]} == {
        "kart_0": "ai",
        "kart_1": "random",
        "kart_2": "Rolf",
    }
    assert len({kart["color"] for kart in form["karts"]}) == 3
    assert moment["steps"] == 0
    assert sorted(moment["karts"]["rank"]) == [1, 2, 3]
    assert {len(column) for column in moment["karts"].values()} == {3}


@pytest.mark.slow
def test_pause_step_and_run_work():
    async def scenario(one):
        await one.send("speed", value=None)
        await one.send("run")
        await one.moment(10)
        await one.send("pause")
        await one.mode("paused")
        steps = [await race.still()]
        for _ in range(2):
            await one.send("step")
            await one.moment(steps[-1] + 1)
            steps.append(await race.still())
        await one.send("run")
        await one.moment(steps[-1] + 20)
        return steps

    with WatchedRace() as race:
        paused, first, second = race.watch(scenario)
    assert (first, second) == (paused + 1, paused + 2)


def test_stop_ends_the_race_with_a_result():
    async def scenario(one):
        await one.send("run")
        await one.moment(3)
        await one.send("stop")
        result = await one.next("result")
        await one.next("bye")
        return result["result"]

    with WatchedRace() as race:
        told = race.watch(scenario)
        result = race.join()
    assert result.status == "stopped"
    assert 3 <= result.steps < 100_000
    assert {row["agent"]: row["rank"] for row in told["agents"]} == {
        row.agent: row.rank for row in result.agents
    }


def test_an_agents_observation_is_sent_to_viewers_that_request_it():
    async def scenario(one, other):
        await one.next("moment")
        await one.send("watch", agent="kart_1")
        first = await one.next("observation")
        await one.send("step")
        later = await one.next("observation", lambda form: form["steps"] == 1)
        await other.moment(1)
        assert "observation" not in other.kinds
        return first, later

    with WatchedRace() as race:
        first, later = race.watch(scenario, viewers=2)
    seen = first["parts"]["observation"]
    assert first["agent"] == "kart_1"
    assert seen["phase"].endswith(("ready", "set", "go", "race"))
    assert seen["paths_start"]["of"] > len(seen["paths_start"]["first"])
    assert set(later["parts"]["action"]) == {
        *("acceleration", "steer", "brake", "drift", "fire", "nitro", "rescue")
    }
    assert "reward/advance" in later["parts"]["info"]


def test_a_late_viewer_gets_the_past():
    async def scenario(one):
        await one.send("speed", value=None)
        await one.send("run")
        await one.moment(40)

    async def late(one):
        traces = await one.next("traces")
        moment = await one.next("moment")
        return traces, moment

    with WatchedRace() as race:
        race.watch(scenario)
        race.page.control.pause()
        traces, moment = race.watch(late)
    assert traces["steps"] == list(range(traces["steps"][-1] + 1))
    assert moment["steps"] >= 40
    assert set(traces["values"]) == set(COLUMNS)
    assert {len(rows) for rows in traces["values"].values()} == {len(traces["steps"])}


def test_all_viewers_watch_and_control_the_same_race():
    async def scenario(*viewers):
        one, two, _ = viewers
        await one.send("step")
        seen = [await each.moment(1) for each in viewers]
        await two.send("speed", value=4)
        states = [await v.next("state", lambda form: form["speed"] == 4) for v in viewers]
        return seen, states

    with WatchedRace() as race:
        seen, states = race.watch(scenario, viewers=3)
    assert seen[0] == seen[1] == seen[2]
    assert states[0] == {"type": "state", "mode": "paused", "speed": 4.0}


def test_a_race_continues_when_its_viewers_leave():
    async def scenario(one):
        await one.send("speed", value=None)
        await one.send("run")
        await one.moment(2)

    with WatchedRace(steps=400) as race:
        race.watch(scenario)
        assert race.join().steps == 400


@pytest.mark.slow
def test_a_viewer_that_reads_nothing_delays_nobody_and_is_disconnected(monkeypatch):
    monkeypatch.setattr("stkzoo.race.web.viewer._PATIENCE", 0.5)

    async def scenario(one):
        await one.send("speed", value=None)
        await one.send("run")
        await one.moment(50)
        while len(race.page._server.viewers) > 1:
            await one.next("moment")

    with WatchedRace() as race:
        race.page._server._listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
        with socket.create_connection(("127.0.0.1", race.page.port), timeout=10) as sleeper:
            sleeper.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            sleeper.sendall(upgrade_request())
            assert sleeper.recv(12) == b"HTTP/1.1 101"
            assert wait_until(lambda: len(race.page._server.viewers) == 1)
            race.watch(scenario)


def test_a_failing_agent_is_reported(tmp_path):
    (tmp_path / "pystk_actor.py").write_text("def get_actor(*_):\n    raise OSError('no way')\n")

    async def scenario(one):
        await one.send("step")
        return (await one.moment(1))["failures"]

    with WatchedRace(["ai", str(tmp_path)]) as race:
        assert "no way" in race.watch(scenario)["kart_1"]


# ---------------------------------------------------------------- strangers


@pytest.mark.parametrize(
    ("headers", "text"),
    [
        ({"Host": "race.example"}, "unknown host name"),
        ({"Host": "user@127.0.0.1"}, "unknown host name"),
        ({"Host": "127.0.0.1:x"}, "unknown host name"),
        ({"Origin": "http://race.example"}, "from itself only"),
        ({"Origin": "null"}, "from itself only"),
    ],
)
@pytest.mark.parametrize("path", ["", "live?version=1"])
def test_requests_from_other_sites_are_refused(page, headers, text, path):
    request = urllib.request.Request(page.url + path, headers=headers)
    with pytest.raises(urllib.error.HTTPError, match="403") as caught:
        urllib.request.urlopen(request, timeout=10)
    with caught.value as answer:
        assert text in answer.read().decode()


@pytest.mark.parametrize("served", ["127.0.0.1", "::1", "mylab", ""])
def test_the_host_is_compared_as_a_whole(served):
    guard = RequestGuard(served, 8000)
    own = f"[{served}]" if ":" in served else served or "localhost"
    for host in (own, f"{own}:8000", "LOCALHOST", "localhost:9", "[::1]:80", "[::ffff:7f00:1]"):
        guard.check(CIMultiDict(Host=host))
    strange = ("", ":80", "@", "[]", "::1", "evil", "localhost.evil", "evil.localhost", "mylab.")
    parts = ("localhost@evil", "evil@localhost", "localhost:80@evil", "evil#localhost")
    lists = ("localhost,evil", "localhost, evil", "evil localhost", "127.0.0.1/evil", "127.1")
    ports = ("localhost:", "localhost:80:80", "localhost:x", "[::1]x", "[::1", "localhost:123456")
    digits = ("localhost\n", "\uff11\uff12\uff17.0.0.1", "127.0.0.1.", "0x7f.1", "[::1%25lo]")
    for host in (*strange, *parts, *lists, *ports, *digits):
        with pytest.raises(web.HTTPForbidden):
            guard.check(CIMultiDict(Host=host))


@pytest.mark.parametrize("second", ["Host: evil", "Host: 127.0.0.1", "Origin: http://evil"])
def test_a_request_with_two_hosts_is_refused(page, second):
    own = "Host: 127.0.0.1\r\nOrigin: http://127.0.0.1"
    request = f"GET / HTTP/1.1\r\n{own}\r\n{second}\r\n\r\n"
    with socket.create_connection(("127.0.0.1", page.port), 10) as connection:
        connection.sendall(request.encode())
        assert b" 40" in connection.recv(100)[8:12]


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "[::1]"])
def test_the_page_itself_is_accepted_even_through_a_tunnel(page, host):
    own = {"Host": f"{host}:9", "Origin": f"http://{host}:9"}
    with urllib.request.urlopen(urllib.request.Request(page.url, headers=own)) as answer:
        assert answer.status == 200


def test_another_version_of_the_page_is_refused(page):
    with pytest.raises(urllib.error.HTTPError, match="400") as caught:
        fetch(page.url + "live?version=0")
    caught.value.close()


BAD_MESSAGES = [
    "",
    "run",
    "[]",
    "[" * 900,
    '{"type": "explode"}',
    '{"type": "speed", "value": 3}',
    '{"type": "speed", "value": NaN}',
    '{"type": "watch", "agent": "kart_99"}',
    b'{"type": "run"}',
    b"\x80\x04\x95",
    # Is not read, but sent completely before the page closes the connection.
    "x" * 2_000,
]


@pytest.mark.parametrize("message", BAD_MESSAGES, ids=lambda message: repr(message)[:40])
def test_an_invalid_message_affects_only_its_sender(message):
    async def scenario(bad, good):
        await good.next("moment")
        send = bad.socket.send_bytes if isinstance(message, bytes) else bad.socket.send_str
        await send(message)
        is_read = len(message) < 1000
        if is_read:
            assert "expected" in (await bad.next("error"))["text"]
        while not bad.socket.closed:
            await bad.socket.receive(timeout=10)
        assert bad.socket.close_code == (1008 if is_read else 1009)
        await good.send("step")
        await good.moment(1)

    with WatchedRace() as race:
        race.watch(scenario, viewers=2)


def test_remote_viewers_need_the_key_to_control_the_race():
    async def scenario(stranger):
        assert not (await stranger.next("hello"))["may_steer"]
        await stranger.next("moment")
        await stranger.send("run")
        return (await stranger.next("error"))["text"]

    async def friendly(key, url):
        async with (
            aiohttp.ClientSession() as session,
            viewer(session, url, key=key) as friend,
        ):
            await friend.send("step")
            await friend.moment(1)

    with WatchedRace(host="0.0.0.0") as race:
        url, key = race.page.url.split("#key=")
        assert "0.0.0.0" not in url
        asyncio.run(friendly(key, url))
        assert "may only watch" in race.watch(scenario)


def key_of(page):
    return page.url.partition("#key=")[2]


def test_the_next_race_on_a_port_has_the_same_key():
    other, page = LivePage(host="0.0.0.0", port=0), LivePage(host="0.0.0.0", port=0)
    page.closed()
    next_page = LivePage(host="0.0.0.0", port=page.port)
    next_page.closed()
    other.closed()
    assert key_of(page) == key_of(next_page) != key_of(other)


# ---------------------------------------------------------------- parts of the page


def test_real_time_is_not_faster_than_the_clock(monkeypatch):
    now = [100.0]
    clock = SimpleNamespace(monotonic=lambda: now[0])
    monkeypatch.setattr("stkzoo.race.web.control.time", clock)
    control = RaceControl(speed=2.0)

    def wait(seconds):
        now[0] += seconds

    monkeypatch.setattr(control._changed, "wait", wait)
    control.begin()
    assert all(control.wait_turn(0.1) for _ in range(6))
    assert now[0] == pytest.approx(100.3)


def test_speeds_are_those_of_the_page(page):
    _, text = fetch(page.url)
    for speed in SPEEDS:
        name = "max" if speed is None else f"{speed:.0f}"
        assert f'data-speed="{name}"' in text


def test_traces_stay_within_bounds_and_keep_the_start():
    log = TraceLog(most=100)
    for step in range(5000):
        log.add(step, np.full((len(COLUMNS), 2), step, np.float32))
    past = log.since(-1)
    assert 50 <= len(past["steps"]) <= 100
    assert past["steps"][0] == 0
    assert past["steps"][-1] > 4800
    assert past["values"]["speed"] == [[step, step] for step in past["steps"]]
    assert log.since(past["steps"][-1]) == {"steps": []}


def test_observations_of_all_types_become_json():
    deep = []
    for _ in range(50):
        deep = [deep]
    values = {
        "nan": np.float32(np.nan),
        "inf": float("inf"),
        "array": np.arange(40).reshape(20, 2),
        "text": "x" * 1000,
        "nothing": None,
        "flag": np.True_,
        "deep": deep,
        "phase": 3,
        "thing": object(),
        7: (),
    }
    form = plain(values)
    encoded(form)
    assert form["nan"] == "nan"
    assert form["array"] == {"first": [[2 * n, 2 * n + 1] for n in range(12)], "of": 20}
    assert form["phase"] == "3 race"
    assert form["flag"] is True
    assert form["7"] == []


# ---------------------------------------------------------------- the command


@pytest.mark.slow
def test_the_command_stays_until_ctrl_c_and_still_reports_the_result(tmp_path):
    file = tmp_path / "result.json"
    words = ["race", "ai", "--track", "olivermath", "--max-steps", "5", "--output", str(file)]
    words += ["--web", "--web-port", "0", "--web-speed", "max", "--web-stay"]
    with subprocess.Popen(
        [sys.executable, "-m", "stkzoo", *words], stderr=subprocess.PIPE, text=True
    ) as program:
        url = program.stderr.readline().split()[-1]

        async def until_over():
            async with aiohttp.ClientSession() as session, viewer(session, url) as one:
                await one.next("result")

        asyncio.run(until_over())
        program.send_signal(signal.SIGINT)
        assert program.wait(30) == 0
    assert RaceResult.from_json(file.read_text()).steps == 5


def test_the_command_refuses_invalid_arguments(capsys):
    assert main(["race", "ai", "--web", "--web-port", "99999"]) == 2
    assert "port is 99999" in capsys.readouterr().err
