"""The report of a tournament: a page and tables that are safe to publish."""

import csv
import io
import json
import shutil
from html.parser import HTMLParser

import pytest

from stkzoo.cli import main
from stkzoo.errors import ConfigError
from stkzoo.evaluation import load_tournament, run_tournament, write_report
from stkzoo.evaluation.tournament.film import FilmRecorder
from stkzoo.evaluation.tournament.report import _csv
from stkzoo.race import run_race
from stkzoo.race.replay import load_replay
from tests.support.remote_race import write_agent

NAME = "=<script>alert(1)</script>"
SECRET = "</td><script>alert(2)</script> the key is 4711"


class PageParser(HTMLParser):
    """Collects the tags, links and text of a page."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.links, self.text = [], [], ""
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.links += [value for name, value in attrs if name in ("href", "src")]

    def handle_data(self, data):
        self.text += data


@pytest.fixture(scope="module")
def cup(tmp_path_factory):
    """Runs a tournament with an agent whose name and error are HTML, and publishes its page."""
    home = tmp_path_factory.mktemp("report")
    module = home / "hidden_folder"
    module.mkdir()
    bad = write_agent(module, "bad", act=f"raise ValueError({SECRET!r})")
    file = module / "bad" / "pystk_actor.py"
    file.write_text(file.read_text().replace('"bad"', repr(NAME)))
    run_tournament(
        ["ai", "heuristic", bad],
        output=home / "cup",
        tracks=["lighthouse"],
        races=2,
        per_race=3,
        max_steps=12,
        jobs=2,
    )
    write_report(home / "cup", publish=home / "public", title="Course <1>")
    return home


FULL_WIDTH = ["＝1", "＋1", "－1", "＠A1", "﹢1", "﹣1", "﹫A1", "⁺1"]  # noqa: RUF001


@pytest.mark.parametrize(
    "text", ["=1", "+1", "-1", "@A1", "\t=1", "\r=1", "\n=1", " =1", "\u3000=1", *FULL_WIDTH]
)
def test_a_spreadsheet_runs_no_text_as_a_formula(text):
    rows = csv.reader(io.StringIO(_csv([[text, -1.5], ["b\r=1", "c\n=1"]]), newline=""))
    assert [*rows] == [[f"'{text.strip()}", "-1.5"], ["b =1", "c =1"]]


@pytest.mark.slow
def test_the_folder_of_somebody_else_changes_none_of_your_files(cup, tmp_path, capsys):
    received, profile = tmp_path / "received", tmp_path / "profile"
    shutil.copytree(cup / "cup", received)
    outputs = [received / n for n in ("standings.csv", "report.html", "result.json", "lock")]
    for words in (["report"], ["tournament", "--resume"]):
        profile.write_text("mine")
        for file in outputs[: 2 if words == ["report"] else None]:
            file.unlink()
            file.symlink_to(profile)
        (received / "races.csv").unlink()
        (received / "races.csv").symlink_to(tmp_path / "new")
        assert main([*words, str(received)]) in (0, 3)  # 3: an agent failed
        assert not [file for file in received.rglob("*") if file.is_symlink()]
    for name in ("replays", "films", "races"):
        (received / name).rename(tmp_path / name)
        (received / name).symlink_to(tmp_path / name)
        (tmp_path / name / ".stkzoo-notes.part").write_text("mine")
        assert main(["tournament", "--resume", str(received)]) == 2
        assert f"{name} is a link to a folder" in capsys.readouterr().err
        assert (tmp_path / name / ".stkzoo-notes.part").exists()
        (received / name).unlink()
    assert profile.read_text() == "mine"
    assert not (tmp_path / "new").exists()


@pytest.mark.slow
@pytest.mark.parametrize("file", ["cup/report.html", "public/index.html"])
def test_text_from_agents_is_never_markup(cup, file):
    page = PageParser((cup / file).read_text())
    assert "script" not in page.tags
    assert NAME in page.text


@pytest.mark.slow
def test_the_private_page_shows_why_an_agent_failed_and_links_replays(cup):
    page = PageParser((cup / "cup" / "report.html").read_text())
    assert SECRET in page.text
    replays = [link for link in page.links if link.endswith(".stkz")]
    assert replays
    assert load_replay(cup / "cup" / replays[0]).track == "lighthouse"


@pytest.mark.slow
@pytest.mark.parametrize("file", ["index.html", "standings.csv", "races.csv"])
def test_the_published_files_leave_private_details_out(cup, file):
    text = (cup / "public" / file).read_text()
    assert "4711" not in text
    assert "hidden_folder" not in text
    assert ".stkz" not in text
    assert "raised an error" in text


@pytest.mark.slow
def test_the_page_loads_no_other_files(cup):
    text = (cup / "public" / "index.html").read_text()
    assert "default-src 'none'" in text
    assert all(link.startswith("#") for link in PageParser(text).links)


@pytest.mark.slow
def test_the_tables_have_a_row_for_each_agent_and_no_formulas(cup):
    with (cup / "cup" / "standings.csv").open() as file:
        standings = list(csv.DictReader(file))
    with (cup / "cup" / "races.csv").open() as file:
        races = list(csv.DictReader(file))
    assert len(standings) == 3
    assert len(races) == 6
    assert standings[-1]["agent"] == f"'{NAME}"
    assert "4711" in standings[-1]["reason"]
    assert [row["group"] for row in standings] == [*map(str, load_tournament(cup / "cup").groups)]
    assert standings[-1]["source"].endswith("hidden_folder/bad")
    assert {row["status"] for row in races if row["agent"] == f"'{NAME}"} == {"retired"}


@pytest.mark.slow
def test_an_animation_has_each_kart_at_each_step(cup):
    film = json.loads((cup / "cup" / "films" / "00000.json").read_text())
    assert sorted(film["karts"]) == sorted(["ai", "heuristic", NAME])
    assert {len(way) for way in film["karts"].values()} == {2 * (1 + 12 // 5)}


def test_an_animation_shows_a_long_race_to_its_end(monkeypatch):
    monkeypatch.setattr("stkzoo.evaluation.tournament.film._MAX_MOMENTS", 10)
    recorder = FilmRecorder()
    result = run_race(["ai"], track="olivermath", max_steps=118, listeners=[recorder])
    film = recorder.film()
    (way,) = film.karts.values()
    moments = len(way) // 2
    assert (film.interval, moments) == (2.0, 6)
    assert result.race_time - (moments - 1) * film.interval < film.interval


@pytest.mark.slow
def test_the_command_writes_a_report_with_a_title(cup, capsys):
    folder = str(cup / "cup")
    assert main(["report", folder, "--title", "The <cup>"]) == 0
    page = PageParser((cup / "cup" / "report.html").read_text())
    assert page.tags.count("figure") == 2
    assert page.tags.count("animate") == 2 * 3 * 2
    for text in ("The <cup>", "Standings", "Group", "2 of 2 races of 3"):
        assert text in page.text
    assert "report.html" in capsys.readouterr().out


@pytest.mark.slow
def test_the_public_report_never_replaces_the_tables_of_the_tournament(cup):
    table = (cup / "cup" / "races.csv").read_text()
    with pytest.raises(ConfigError, match="choose another folder to publish"):
        write_report(cup / "cup", publish=cup / "public" / ".." / "cup")
    assert (cup / "cup" / "races.csv").read_text() == table


def test_a_folder_without_a_tournament_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="has no tournament plan"):
        write_report(tmp_path)
