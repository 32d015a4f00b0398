"""The live page in a real browser."""

import functools
import http.server
import threading

import pytest

from stkzoo.race.web import LivePage
from tests.support.browser import Reader, open_browser
from tests.support.web_race import WatchedRace


@pytest.fixture(scope="module")
def reader(tmp_path_factory):
    browser = open_browser(tmp_path_factory.mktemp("profile"))
    yield Reader(browser)
    browser.quit()


def step_of(reader):
    return int(reader.text("#steps").split()[1])


def standings(reader):
    """Returns the numbers of the karts in order of rank."""
    return reader.run(
        "return [...document.querySelectorAll('#standings li')].map((row) => row.dataset.kart)"
    )


def map_picture(reader):
    return reader.run("return document.getElementById('map').toDataURL()")


def is_mode(reader, mode):
    return lambda: reader.text("#mode") == mode


def open_on_the_grid(reader, race, **screen):
    reader.show(race.page.url, **screen)
    reader.until(is_mode(reader, "paused"))
    reader.until(lambda: standings(reader))


def stands_still(reader):
    """Returns whether the page keeps showing the same step."""
    step = step_of(reader)
    return all(step_of(reader) == step for _ in range(30))


@pytest.mark.slow
def test_step_run_and_pause_work_and_standings_change(reader, tmp_path):
    with WatchedRace(["ai", "random", "heuristic", "ai"], track="lighthouse") as race:
        open_on_the_grid(reader, race)
        grid, picture = standings(reader), map_picture(reader)
        assert reader.text("#title").lower() == "lighthouse"
        assert step_of(reader) == 0

        reader.click("#step")
        reader.until(lambda: step_of(reader) == 1)
        assert stands_still(reader)

        reader.click("[data-speed=max]")
        reader.click("#run")
        reader.until(lambda: standings(reader) != grid)
        reader.until(lambda: step_of(reader) > 60)
        assert reader.text("#run") == "Pause"

        reader.click("#run")
        reader.until(is_mode(reader, "paused"))
        reader.until(lambda: stands_still(reader))
        assert map_picture(reader) != picture
        file = tmp_path / "live-page.png"
        reader.browser.save_screenshot(str(file))
        assert file.stat().st_size > 20_000

        reader.click("#stop")
        reader.until(is_mode(reader, "over"))
        assert "was stopped" in reader.text("#notice")
        assert race.join().status == "stopped"
    assert [text for text in reader.errors() if "WebSocket" not in text] == []


@pytest.mark.slow
def test_keys_work_like_buttons(reader):
    with WatchedRace() as race:
        open_on_the_grid(reader, race)
        reader.press(".")
        reader.until(lambda: step_of(reader) == 1)
        reader.press("4")
        reader.until(lambda: reader.all("[data-speed='4'][aria-pressed=true]"))
        reader.press(" ")
        reader.until(lambda: step_of(reader) > 3)
        reader.press(" ")
        reader.until(is_mode(reader, "paused"))
        reader.press("m")
        assert reader.all("[data-map=follow][aria-pressed=true]")
        reader.press("t")
        assert reader.all("[data-span=all][aria-pressed=true]")
        chosen = reader.run("return document.getElementById('agent').value")
        reader.press("n")
        assert reader.run("return document.getElementById('agent').value") != chosen


@pytest.mark.slow
def test_an_agents_observation_is_a_tree_that_opens(reader):
    with WatchedRace(["ai", "random@:Rolf"]) as race:
        open_on_the_grid(reader, race)
        row = next(row for row in reader.all("#standings button") if "Rolf" in row.text)
        row.click()
        reader.until(lambda: "velocity" in reader.text("#tree"))
        closed = len(reader.all("#tree .leaf"))
        reader.run("document.querySelector('#tree details details').open = true")
        reader.until(lambda: len(reader.all("#tree .leaf")) > closed)
        reader.click("#step")
        reader.until(lambda: step_of(reader) == 1)
        assert len(reader.all("#tree details[open]")) == 2


@pytest.mark.slow
def test_the_page_reconnects_for_the_next_race(reader):
    with WatchedRace() as race:
        open_on_the_grid(reader, race)
        port = race.page.port
    reader.until(is_mode(reader, "over"))
    with WatchedRace(track="lighthouse", port=port):
        reader.until(lambda: reader.text("#title").lower() == "lighthouse")
        reader.until(is_mode(reader, "paused"))
        reader.click("#step")
        reader.until(lambda: step_of(reader) == 1)


@pytest.mark.slow
@pytest.mark.parametrize("is_dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize("width", [360, 768, 1600])
def test_the_page_fits_the_screen_and_all_elements_have_names(reader, width, is_dark):
    with WatchedRace() as race:
        open_on_the_grid(reader, race, width=width, is_dark=is_dark)
        assert reader.run("return document.documentElement.scrollWidth") <= width
        red, *_ = reader.run(
            "return getComputedStyle(document.body).backgroundColor.match(/\\d+/g).map(Number)"
        )
        assert (red < 60) is is_dark
        parts = reader.all("button, select, canvas, output")
        reader.until(lambda: all(part.accessible_name for part in parts))
        for button in reader.all(".controls button"):
            place = button.rect
            assert place["x"] >= 0
            assert place["x"] + place["width"] <= width
        assert reader.errors() == []


@pytest.mark.slow
def test_a_drivers_name_is_text(reader, tmp_path):
    name = "<img src=x onerror=document.title=1>"
    (tmp_path / "pystk_actor.py").write_text(
        f"player_name = {name!r}\ndef get_actor(*_):\n    return lambda _, __: None\n"
    )
    with WatchedRace(["ai", str(tmp_path)]) as race:
        open_on_the_grid(reader, race)
        assert name[:10] in reader.text("#standings")
        assert reader.all("#standings img, #agent img, #tree img") == []
        assert "olivermath" in reader.browser.title


class _Elsewhere(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_):
        pass


@pytest.fixture
def other_site(tmp_path):
    """Serves a page of another site that tries to stop the race."""
    handler = functools.partial(_Elsewhere, directory=tmp_path)
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
    thread.start()

    def make(port):
        (tmp_path / "index.html").write_text(f"""
            <title>waiting</title><p id="mode"></p><script>
            const link = new WebSocket("ws://127.0.0.1:{port}/live?version=1");
            link.onopen = () => {{ link.send('{{"type": "stop"}}'); document.title = "in"; }};
            link.onerror = () => document.title = "refused";
            </script>""")
        return f"http://127.0.0.1:{server.server_port}/"

    yield make
    server.shutdown()
    server.server_close()
    thread.join(10)


@pytest.mark.slow
def test_another_site_in_the_same_browser_cannot_control_the_race(reader, other_site):
    page = LivePage(port=0, paused=True)
    try:
        reader.show(other_site(page.port))
        reader.until(lambda: reader.browser.title != "waiting")
        assert reader.browser.title == "refused"
        assert page.control.mode == "paused"
    finally:
        page.closed()
