"""The benchmark on the real engine: short races, interruptions and the command."""

import json
import shutil

import jsonschema
import numpy as np
import pytest

from benchmarks.ai_times import main as measure_ai_times
from stkzoo import race_v0
from stkzoo.cli import main
from stkzoo.errors import ConfigError
from stkzoo.evaluation import AiTimes, load_ai_times, load_benchmark, run_benchmark
from stkzoo.race import RaceResult, run_race
from stkzoo.records import HUMAN_RECORDS
from stkzoo.tracks import SPLITS
from tests.support.paths import AGENTS, ROOT

DOCS = ROOT / "docs"
SMALL = {"split": ["lighthouse"], "forms": ["PA", "P"], "seeds": 2, "reverse": [False]}


def schema(name):
    return json.loads((DOCS / "schemas" / f"{name}.schema.json").read_text())


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    folder = tmp_path_factory.mktemp("benchmark") / "heuristic"
    heard = []
    result = run_benchmark("heuristic", output=folder, on_race=heard.append, jobs=2, **SMALL)
    return folder, result, heard


# ------------------------------------------------------------------ results


@pytest.mark.slow
def test_the_agent_drives_the_planned_races(small):
    folder, result, heard = small
    assert [progress.done for progress in heard] == list(range(7))
    for race, order in zip(result.plan.races(), result.plan.orders(), strict=True):
        kept = RaceResult.from_json((folder / "races" / f"{race.number:05d}.json").read_text())
        rows = sorted(kept.agents, key=lambda row: row.start_position)
        assert [row.driver for row in rows] == [text.rpartition("@:")[2] for text in order.drivers]
        assert (kept.track, kept.reverse, kept.difficulty) == ("lighthouse", False, 3)
        assert kept.seed == race.seed
        assert kept.status in ("awaited_finished", "finished")


@pytest.mark.slow
def test_figures_match_the_races(small):
    folder, result, _ = small
    files = sorted((folder / "races").glob("*.json"))
    rows = [row for file in files for row in RaceResult.from_json(file.read_text()).agents]
    times = [row.finish_time for row in rows if row.driver == "heuristic"]
    figures = result.group().figures
    median = load_ai_times().of("lighthouse", False, 3).median
    assert figures["time_ratio"].value == pytest.approx(np.mean(times) / median, abs=1e-4)
    assert figures["unfinished"].value == 0.0
    assert result.group("form", "P").figures["win_rate"] is None
    assert result.group("form", "PA").chance == 0.5


@pytest.mark.slow
def test_the_result_follows_its_schema_and_can_be_loaded(small):
    folder, result, _ = small
    written = json.loads((folder / "result.json").read_text())
    jsonschema.validate(written, schema("benchmark-result"))
    from_races, from_file = load_benchmark(folder), load_benchmark(folder / "result.json")
    assert from_races == result
    assert from_file.races == result.races
    assert from_file.groups == result.groups


# ------------------------------------------------------------------ race ends


@pytest.mark.slow
def test_a_race_ends_when_all_awaited_karts_have_finished():
    options = {"track": "olivermath", "difficulty": 3, "start_positions": [1, 2, 3]}
    result = run_race(["ai", "random", "ai"], wait_for=[2], **options)
    assert result.status == "awaited_finished"
    by_agent = {row.agent: row for row in result.agents}
    assert by_agent["kart_2"].finish_time == pytest.approx(result.race_time - 2.0, abs=0.3)
    assert by_agent["kart_1"].finish_time is None


@pytest.mark.parametrize("numbers", [[], [2], [-1], [0, 5]])
def test_invalid_awaited_karts_are_refused(numbers):
    with pytest.raises(ConfigError, match="expected some of the drivers' numbers, 0 to 1"):
        run_race(["ai", "random"], wait_for=numbers, track="lighthouse")


# ------------------------------------------------------------------ the AI's times


def test_the_shipped_times_cover_all_tracks_directions_and_difficulties():
    times = load_ai_times()
    keys = {(t, way, d) for t in SPLITS["all"] for way in (False, True) for d in range(4)}
    assert set(times.by_race) == keys
    for time in times.by_race.values():
        assert time.best <= time.median <= time.worst
        assert time.karts == 25
    jsonschema.validate(json.loads(times.to_json()), schema("ai-times"))
    assert AiTimes.from_json(times.to_json()) == times


@pytest.mark.slow
def test_new_measurements_reproduce_the_shipped_times(tmp_path):
    file, folder = tmp_path / "times.json", ["--folder", str(tmp_path / "ai")]
    words = ["--tracks", "olivermath", "--difficulties", "2", "--output", str(file), *folder]
    assert measure_ai_times([*words, "--seeds", "1"]) == 0
    times = AiTimes.load(file)
    assert set(times.by_race) == {("olivermath", False, 2), ("olivermath", True, 2)}
    for key, time in times.by_race.items():
        shipped = load_ai_times().by_race[key]  # the same race, possibly from another processor
        assert time.median == pytest.approx(shipped.median, rel=0.2)
    with pytest.raises(ConfigError, match=r"has no time on lighthouse .* at difficulty 3"):
        times.of("lighthouse", False, 3)
    with pytest.raises(ConfigError, match="has another measurement: seeds is 2 and was 1"):
        measure_ai_times([*words, "--seeds", "2"])


# ------------------------------------------------------------------ the command


@pytest.mark.slow
def test_the_command_shows_the_figures_and_compares(small, tmp_path, capsys):
    folder, result, _ = small
    again = str(tmp_path / "again")
    shutil.copytree(folder, again)
    assert main(["benchmark", "--compare", str(folder), f"{again}/result.json"]) == 0
    shown = capsys.readouterr().out
    value = result.group().figures["time_ratio"].value
    assert f"{value:.3f} (" in shown
    assert "heuristic minus heuristic, in the same races:" in shown
    picture = tmp_path / "both.png"
    words = ["--compare", str(folder), again, "--json", "--output", str(picture)]
    assert main(["benchmark", *words]) == 0
    parts = json.loads(capsys.readouterr().out)
    kinds = ["benchmark-result", "benchmark-result", "benchmark-comparison"]
    assert [part["type"] for part in parts] == kinds
    assert picture.read_bytes()[:4] == b"\x89PNG"


@pytest.mark.slow
def test_the_command_exits_with_3_when_the_agent_failed(tmp_path, capsys):
    words = ["--track", "lighthouse", "--forms", "PA", "--seeds", "1", "--directions", "forward"]
    agent = str(AGENTS / "hostile" / "unloadable.py")
    output = ["--output", str(tmp_path / "one"), "--json", "--no-plot"]
    assert main(["benchmark", agent, *words, *output]) == 3
    form = json.loads(capsys.readouterr().out)
    assert form["groups"][0]["figures"]["unfinished"]["value"] == 1.0
    output.remove("--json")  # the races are stored
    assert main(["benchmark", agent, *words, *output]) == 3
    shown = " ".join(capsys.readouterr().out.split())
    assert "failed before the start in race 0 on lighthouse: RuntimeError: not today" in shown


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "no agent; name one"),
        (["nobody"], "unknown driver 'nobody'"),
        (["ai", "--compare", "x"], "--compare takes no agent; leave out ai"),
        (["--compare", "nowhere"], "nowhere has no benchmark"),
        (["ai", "--jobs", "0"], "jobs is 0"),
        (["ai", "--time-trial", "--forms", "P"], "leave out --forms"),
    ],
)
def test_invalid_usage_exits_with_2(words, message, capsys):
    assert main(["benchmark", *words]) == 2
    assert message in capsys.readouterr().err


# ------------------------------------------------------------------ the track atlas


def test_the_atlas_describes_every_track():
    page = (DOCS / "reference" / "tracks.md").read_text()
    times = load_ai_times()
    for track in SPLITS["all"]:
        row, record = [line for line in page.splitlines() if line.startswith(f"| {track} |")]
        human = HUMAN_RECORDS[track]
        assert record.startswith(f"| {track} | {human.laps} | {human.seconds:.2f} |")
        for reverse in (False, True):
            medians = [times.of(track, reverse, level).median for level in range(4)]
            assert " / ".join(f"{median:.1f}" for median in medians) in row
        assert ("**test**" in row) == (track in SPLITS["test"])
    names = [f"{track}{which}" for track in SPLITS["all"] for which in ("", "-ground")]
    assert all(f"](../images/tracks/{name}.png)" in page for name in names)
    pictures = list((DOCS / "images" / "tracks").glob("*.png"))
    assert sorted(picture.stem for picture in pictures) == sorted(names)
    assert sum(picture.stat().st_size for picture in pictures) < 600_000


def test_the_atlas_matches_the_track():
    env = race_v0.parallel_env(num_kart=1, track="xr591", max_paths=1)
    try:
        env.reset(seed=0)
        forks = sum(len(nodes) > 1 for nodes in env.track_map.successors)
        road, items = env.track_map, len(env.snapshot.items)
    finally:
        env.close()
    row = f"| xr591 | **test** | {road.length:.0f} | {road.num_nodes} | {forks} | {items} |"
    assert row in (DOCS / "reference" / "tracks.md").read_text()
