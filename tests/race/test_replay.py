"""Replays reproduce a race from a file, bit for bit."""

import hashlib
import json
import subprocess
import sys
import tracemalloc
import zipfile

import numpy as np
import pytest

from stkzoo.cli import main
from stkzoo.errors import ConfigError
from stkzoo.race import RaceListener, run_race
from stkzoo.race import replay as replay_module
from stkzoo.race.replay import DIGEST_SIZE, ReplayError, ReplayWriter, load_replay, play_replay
from tests.support.paths import AGENTS


class Positions(RaceListener):
    """Records the locations of all karts in each step."""

    def __init__(self):
        self.locations = []

    def started(self, race):
        self.stepped(race)

    def stepped(self, race):
        karts = race.env.snapshot.karts
        parts = (karts["location"], karts["rotation"], karts["velocity"])
        self.locations.append(b"".join(part.tobytes() for part in parts))


def record(path, *drivers, **settings):
    positions = Positions()
    result = run_race(drivers, listeners=[ReplayWriter(path), positions], **settings)
    return result, positions


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Records a race of 500 steps with karts of the game's AI, on a track drawn by the seed."""
    path = tmp_path_factory.mktemp("replay") / "race.stkz"
    settings = {"track": "train", "seed": 4, "laps": 3, "max_steps": 500}
    return path, *record(path, "heuristic", "ai", "random", "ai", **settings)


@pytest.fixture
def small(tmp_path):
    path = tmp_path / "small.stkz"
    record(path, "heuristic", "ai", track="lighthouse", seed=2, max_steps=30)
    return path


def repacked(path, **changes):
    """Rewrites members of the file with bytes, deletes those with ``None``, changes its JSON."""
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    about = changes.pop("about", {})
    members["race.json"] = json.dumps({**json.loads(members["race.json"]), **about}).encode()
    members |= {name.replace("_", "."): data for name, data in changes.items()}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members.items():
            if data is not None:
                archive.writestr(name, data)
    return path


# ------------------------------------------------------------------ the same race


@pytest.mark.slow
def test_all_positions_of_500_steps_are_the_same(recorded):
    path, result, positions = recorded
    again = Positions()
    playback = play_replay(load_replay(path), listeners=[again])
    assert len(again.locations) == 501
    assert again.locations == positions.locations
    assert playback.is_exact
    assert (playback.steps, playback.result) == (500, result)


@pytest.mark.slow
def test_a_new_process_reproduces_the_race(recorded):
    command = [sys.executable, "-m", "stkzoo", "replay", recorded[0]]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0
    assert "All 500 steps are as recorded, to the last bit." in done.stdout


@pytest.mark.slow
def test_a_replay_is_small(recorded):
    assert recorded[0].stat().st_size < 200_000


@pytest.mark.slow
def test_digests_are_computed_as_documented(recorded):
    path, _, positions = recorded
    digest, chain = b"", []
    for moment in positions.locations:
        digest = hashlib.blake2b(digest + moment, digest_size=DIGEST_SIZE).digest()
        chain.append(digest)
    assert b"".join(chain) == load_replay(path).digests.tobytes()


@pytest.mark.parametrize(
    "settings",
    [{"reverse": True, "difficulty": 3, "max_paths": 5}, {"mode": "time_trial", "kart": "pidgin"}],
    ids=["reverse", "time trial"],
)
def test_settings_and_grid_are_kept(tmp_path, settings):
    path, grid = tmp_path / "race.stkz", (3, 1, 2)
    race = {"track": "olivermath", "seed": 9, "max_steps": 40, "start_positions": grid, **settings}
    record(path, "ai", "heuristic", "ai", **race)
    replay = load_replay(path)
    assert replay.start_positions == grid
    assert {name: getattr(replay, name) for name in settings} == settings
    assert play_replay(replay).is_exact


def test_a_replay_without_a_mode_is_a_normal_race(small):
    with zipfile.ZipFile(small) as archive:
        values = json.loads(archive.read("race.json"))
    del values["mode"], values["kart"], values["result"]["mode"]
    replay = load_replay(repacked(small, race_json=json.dumps(values).encode()))
    assert (replay.mode, replay.kart) == ("normal", None)
    assert play_replay(replay).is_exact


@pytest.mark.slow
def test_random_actions_that_replace_a_failed_agent_are_kept(tmp_path):
    path = tmp_path / "race.stkz"
    agent = str(AGENTS / "hostile" / "shape.py")
    settings = {"track": "lighthouse", "seed": 1, "max_steps": 60, "error_handling": "catch"}
    record(path, agent, "ai", **settings)
    assert load_replay(path).controls[:, 0].any()
    assert play_replay(load_replay(path)).is_exact


@pytest.mark.slow
def test_a_finished_race_ends_the_same_way(tmp_path):
    path = tmp_path / "race.stkz"
    result, _ = record(path, "ai", "heuristic", track="olivermath", seed=3)
    playback = play_replay(load_replay(path))
    assert result.is_finished
    assert (playback.result, playback.result.status) == (result, "finished")


# ------------------------------------------------------------------ differences


def test_a_changed_action_is_found_at_its_step(small):
    with zipfile.ZipFile(small) as archive:
        controls = np.frombuffer(archive.read("controls.f4"), "<f4").reshape(30, 2, 7).copy()
    controls[24, 0, :2] = 1 - controls[24, 0, 0], -0.5
    playback = play_replay(load_replay(repacked(small, controls_f4=controls.tobytes())))
    assert playback.first_difference in range(25, 29)
    assert playback.result.status == "differs"
    assert playback.steps == playback.first_difference


def test_a_changed_seed_is_found_at_the_start(small, capsys):
    repacked(small, about={"seed": 3})
    assert main(["replay", str(small)]) == 1
    assert "on the grid already" in capsys.readouterr().err


def test_a_result_that_differs_from_the_race_is_reported(small, capsys):
    with zipfile.ZipFile(small) as archive:
        result = json.loads(archive.read("race.json"))["result"]
    first, second = result["agents"]
    first["rank"], second["rank"], first["finish_time"] = second["rank"], first["rank"], 12.5
    playback = play_replay(load_replay(repacked(small, about={"result": result})))
    assert not playback.is_exact
    assert playback.first_difference is None
    assert len(playback.result_differences) == 3
    expected = f"{first['agent']}'s finish_time is None, and 12.5 in the file"
    assert expected in playback.result_differences
    assert [row.rank for row in playback.result.agents] == [1, 2]
    assert main(["replay", str(small)]) == 1
    assert "the file was changed" in capsys.readouterr().err


def test_another_engine_version_is_an_error(small):
    repacked(small, about={"versions": {"pystk2": "0.7.1"}})
    with pytest.raises(ReplayError, match=r"pip install PySuperTuxKart2==0\.7\.1"):
        play_replay(load_replay(small))
    assert play_replay(load_replay(small), any_engine=True).is_exact


# ------------------------------------------------------------------ files


def test_a_later_file_format_is_refused(small):
    with pytest.raises(ReplayError, match="format 2, this stkzoo reads format 1"):
        load_replay(repacked(small, about={"format": 2}))


@pytest.mark.parametrize(
    "about",
    [
        *({"type": "other"}, {"steps": 29}, {"laps": 0}, {"step_size": 0.0}, {"agents": []}),
        *({"start_positions": [1, 1]}, {"kart_types": ["gnu"]}, {"result": {"a": 1}}),
    ],
    ids=str,
)
def test_invalid_fields_are_refused(small, about):
    with pytest.raises(ReplayError, match=r"small\.stkz"):
        load_replay(repacked(small, about=about))


@pytest.mark.parametrize(
    "members",
    [
        *({"controls_f4": None}, {"controls_f4": b"123"}, {"digests_u1": b""}),
        *({"controls_f4": np.full(420, x, "<f4").tobytes()} for x in (np.nan, 2, 0.5)),
        {"race_json": b"\xff\xfe"},
    ],
    ids=range(7),
)
def test_damaged_members_are_refused(small, members):
    with pytest.raises(ReplayError, match=r"small\.stkz cannot be read \("):
        load_replay(repacked(small, **members))


def test_a_replay_that_unpacks_beyond_its_limits_is_refused(small):
    with pytest.raises(ReplayError, match=r"digests\.u1 has more than"):
        load_replay(repacked(small, digests_u1=bytes(20 << 20)))
    assert small.stat().st_size < 100_000


def test_each_member_of_a_replay_has_a_size_limit(small, monkeypatch):
    monkeypatch.setitem(replay_module._MAX_MEMBER, "race.json", 20)
    with pytest.raises(ReplayError, match=r"race\.json has more than"):
        load_replay(small)


def test_a_replay_with_more_steps_than_its_race_stops_at_the_first_difference(small):
    """Only with ``to_the_end`` does it continue, for the number of steps in the file."""
    with zipfile.ZipFile(small) as archive:
        controls, digests = archive.read("controls.f4"), archive.read("digests.u1")
    repacked(small, controls_f4=controls * 2, digests_u1=digests + bytes(30 * DIGEST_SIZE))
    replay = load_replay(repacked(small, about={"steps": 60}))
    playback = play_replay(replay)
    assert (playback.steps, playback.first_difference) == (31, 31)
    assert play_replay(replay, to_the_end=True).steps == 60


def test_checking_the_controls_of_a_long_replay_takes_little_memory():
    data = bytes(28 * 400_000)
    tracemalloc.start()
    try:
        assert len(replay_module._controls(data, 1)) == 400_000
        assert tracemalloc.get_traced_memory()[1] < 4 << 20
    finally:
        tracemalloc.stop()


def test_a_replay_with_unusual_compression_is_refused(small):
    with zipfile.ZipFile(small) as archive:
        about = archive.read("race.json")
    with zipfile.ZipFile(small, "w", zipfile.ZIP_LZMA) as archive:
        archive.writestr("race.json", about)
        archive.writestr("controls.f4", bytes(10 << 20))
        archive.writestr("digests.u1", bytes(31 * 8))
    with pytest.raises(ReplayError, match="has an unusual compression"):
        load_replay(small)


def test_truncation_and_harmful_changes_are_detected(small):
    """A damaged file is either refused or has all its important data unchanged."""
    whole = small.read_bytes()
    good = load_replay(small)
    chance = np.random.default_rng(1)
    refused = 0
    for length in range(0, len(whole), 397):
        small.write_bytes(whole[:length])
        with pytest.raises(ReplayError):
            load_replay(small)
    for _ in range(150):
        data = bytearray(whole)
        data[chance.integers(len(data))] ^= 1 << chance.integers(8)
        small.write_bytes(data)
        try:
            read = load_replay(small)
        except ReplayError:
            refused += 1
            continue
        assert np.array_equal(read.controls, good.controls)
        assert np.array_equal(read.digests, good.digests)
        assert (read.seed, read.agents, read.result) == (good.seed, good.agents, good.result)
    assert refused > 75


@pytest.mark.parametrize("kind", ["missing", "text"])
def test_an_invalid_replay_gives_one_line_and_exit_code_1(tmp_path, capsys, kind):
    path = tmp_path / "x.stkz"
    if kind == "text":
        path.write_text("hello")
    assert main(["replay", str(path)]) == 1
    shown = capsys.readouterr().err
    assert shown.startswith("stkzoo: ")
    assert "expected a file from `stkzoo race --replay`" in shown
    assert shown.count("\n") == 1


def test_an_unwritable_path_is_an_error_before_the_race(tmp_path):
    with pytest.raises(ConfigError, match=r"there is no folder .*; make it first"):
        ReplayWriter(tmp_path / "nowhere" / "race.stkz")


def test_an_error_leaves_a_partial_replay(tmp_path):
    class Bomb(RaceListener):
        def stepped(self, race):
            if race.steps == 12:
                raise ZeroDivisionError

    path = tmp_path / "race.stkz"
    with pytest.raises(ZeroDivisionError):
        run_race(["ai", "heuristic"], track="lighthouse", listeners=[ReplayWriter(path), Bomb()])
    replay = load_replay(path)
    assert (replay.is_partial, replay.steps, replay.result) == (True, 12, None)
    assert play_replay(replay).is_exact
    assert [file.name for file in tmp_path.iterdir()] == ["race.stkz"]


def test_a_race_that_never_started_keeps_the_older_file(small):
    before = small.read_bytes()
    with pytest.raises(ConfigError):
        run_race(["ai"], track="atlantis", listeners=[ReplayWriter(small)])
    assert small.read_bytes() == before


# ------------------------------------------------------------------ the command


def test_race_replay_and_info(tmp_path, capsys):
    path = str(tmp_path / "race.stkz")
    words = ["--track", "lighthouse", "--max-steps", "20", "--seed", "1", "--replay", path]
    assert main(["race", "heuristic", "ai", *words]) == 0
    assert main(["replay", path, "--info"]) == 0
    shown = capsys.readouterr().out
    assert "20 steps, countdown included; it ended: max_steps" in shown
    assert main(["replay", path, "--json"]) == 0
    form = json.loads(capsys.readouterr().out)
    assert (form["is_exact"], form["result"]["seed"]) == (True, 1)


def test_one_replay_file_for_several_races_is_a_usage_error(tmp_path, capsys):
    words = ["race", "ai", "--races", "2", "--replay", str(tmp_path / "race.stkz")]
    assert main(words) == 2
    assert "leave out --replay" in capsys.readouterr().err


@pytest.mark.slow
def test_a_replay_becomes_a_map_video_without_the_render_process(small, tmp_path, monkeypatch):
    monkeypatch.delattr("stkzoo.render.game.RenderSession")  # the game cannot render
    video = tmp_path / "race.mp4"
    words = ["--video", str(video), "--render-backend", "map", "--render-sub-steps", "1"]
    assert main(["replay", str(small), *words]) == 0
    assert video.read_bytes()[4:8] == b"ftyp"
