"""Under floods, the live page bounds its connections and still answers."""

import asyncio
import socket

import aiohttp
import pytest

from stkzoo.race import RaceResult
from stkzoo.race.replay import load_replay
from stkzoo.race.web import LivePage
from tests.support.floods import (
    HALF_REQUEST,
    allow_descriptors,
    connect_all,
    num_descriptors,
    num_open,
    page_answers,
    race_with_page,
    reset_at_once,
    upgrade_request,
)
from tests.support.processes import wait_until
from tests.support.web_race import viewer


@pytest.fixture
def page():
    page = LivePage(port=0)
    yield page
    page.closed()


def talk(page, data):
    """Sends bytes to the page and returns its answer, until it closes the connection."""
    answer = b""
    with socket.create_connection(("127.0.0.1", page.port), timeout=10) as one:
        try:
            one.sendall(data)
            while part := one.recv(1 << 16):
                answer += part
        except ConnectionError:
            pass
    return answer


def request(path="/", more=""):
    return f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1\r\n{more}\r\n".encode()


@pytest.mark.slow
def test_a_flood_of_incomplete_requests_does_not_affect_a_race(tmp_path, held):
    files = [tmp_path / name for name in ("race.json", "race.stkz", "race.mp4")]
    json_file, replay, video = map(str, files)
    words = f"heuristic ai --track lighthouse --max-steps 20 --seed 1 --output {json_file} "
    words += f"--replay {replay} --video {video} --render-backend map --hide"
    allow_descriptors(2000)
    with race_with_page(*words.split(), descriptors=256) as (race, url):
        port = int(url.rsplit(":", 1)[1].strip("/"))
        connect_all(("127.0.0.1", port), 600, HALF_REQUEST, held)
        assert page_answers(url) is not None
        assert num_descriptors(race.pid) < 128
        assert race.wait(60) == 0
    assert RaceResult.from_json(files[0].read_text()).steps == 20
    assert len(load_replay(files[1]).controls) == 20
    assert files[2].stat().st_size > 1000


@pytest.mark.slow
def test_page_responds_while_others_hold_incomplete_requests(page, held):
    most = page._server.most
    connect_all(("127.0.0.1", page.port), 3 * most, HALF_REQUEST, held)
    assert wait_until(lambda: num_open(held) <= most)
    assert page_answers(page.url) is not None


def test_an_incomplete_request_times_out(page, held, monkeypatch):
    monkeypatch.setattr("stkzoo.race.web.server._LIFETIME", 0.2)
    connect_all(("127.0.0.1", page.port), 3, HALF_REQUEST, held)
    assert wait_until(lambda: num_open(held) == 0)


def test_a_connection_serves_one_request(page):
    answer = talk(page, request("/theme.js") * 20)
    assert answer.count(b"HTTP/1.1 200") == 1
    assert b"Connection: close" in answer


@pytest.mark.parametrize(
    "head",
    [
        "Content-Length: 5\r\nTransfer-Encoding: chunked\r\n",
        "Content-Length: 0\r\nContent-Length: 60\r\n",
        "Content-Length : 60\r\n",
        " folded: 1\r\n",
    ],
)
def test_a_second_request_cannot_be_smuggled_in_a_body(page, head):
    answer = talk(page, request("/theme.js", head) + request("/page.js"))
    assert answer.count(b"HTTP/1.") <= 1


@pytest.mark.parametrize(
    "data",
    [
        b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX: " + b"a" * 100_000,
        b"GET /" + b"a" * 100_000,
        request(more="X: 1\r\n" * 20_000),
        b"\x16\x03\x01\x02\x00\x01\x00" * 1000,
        b"\0" * 100_000,
    ],
    ids=["a long header", "a long line", "many headers", "TLS", "zeros"],
)
def test_a_malformed_request_is_refused_without_flooding_the_log(page, data, caplog):
    for _ in range(5):
        assert b"HTTP/1.0 400" in (answer := talk(page, data)) or answer == b""
    assert len(caplog.records) <= 1
    assert page_answers(page.url) is not None


@pytest.mark.slow
def test_clients_that_reset_immediately_leave_no_open_descriptors(page):
    before = num_descriptors("self")
    reset_at_once(("127.0.0.1", page.port), 300)
    assert page_answers(page.url) is not None
    assert wait_until(lambda: num_descriptors("self") <= before + 1, 15)


def test_a_viewer_that_floods_the_page_with_messages_is_disconnected(page):
    async def flood(send):
        async with aiohttp.ClientSession() as session, viewer(session, page.url) as one:
            for _ in range(200):
                await send(one.socket)
            while not one.socket.closed:
                await one.socket.receive(timeout=10)
            return one.socket.close_code

    assert asyncio.run(flood(lambda one: one.send_str('{"type": "pause"}'))) == 1008
    assert asyncio.run(flood(lambda one: one.ping())) == 1008


def test_too_many_viewers_are_refused(page, held):
    page._server.most = 1
    held.append(socket.create_connection(("127.0.0.1", page.port), timeout=10))
    held[0].sendall(upgrade_request())
    assert b"101" in held[0].recv(100)
    answer = talk(page, upgrade_request())
    assert b"503" in answer
    assert b"viewers are connected already; try again later" in answer


def test_a_request_without_websocket_is_not_a_viewer(page):
    assert b"this address is for WebSockets" in talk(page, request("/live?version=1"))
    assert not page._server.viewers
