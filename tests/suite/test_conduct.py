"""Conduct: contacts and other events of recorded races are those of the environment."""

import json

import numpy as np
import pytest

from stkzoo.cli import main
from stkzoo.errors import ConfigError
from stkzoo.mdp.events import EVENTS
from stkzoo.race import run_race
from stkzoo.race.listeners import RaceListener
from stkzoo.race.replay import ReplayError, ReplayWriter, load_replay, play_replay, save_replay
from stkzoo.suite import measure_conduct
from stkzoo.suite.conduct import _closing_speeds, event_sums, find_replays


def record(file, drivers, **settings):
    run_race(
        drivers,
        start_positions=range(1, len(drivers) + 1),
        listeners=[ReplayWriter(file)],
        **{"track": "lighthouse", "difficulty": 3, "max_steps": 50, "seed": 1, **settings},
    )
    return file


@pytest.fixture(scope="module")
def crowded(tmp_path_factory):
    """Records the start of a race in which karts touch."""
    file = tmp_path_factory.mktemp("conduct") / "crowded.stkz"
    return record(file, ["random", "heuristic", "heuristic", "ai", "ai"], track="minigolf")


@pytest.fixture(scope="module")
def sums(crowded):
    return event_sums(load_replay(crowded))


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    return record(tmp_path_factory.mktemp("conduct") / "alone.stkz", ["heuristic"])


class EventReader(RaceListener):
    """Records the environment's own event counts."""

    def env_options(self):
        return {"events": True}

    def stepped(self, race):
        self.infos = race.infos


def test_counts_equal_those_of_the_environment(crowded, sums):
    reader = EventReader()
    play_replay(load_replay(crowded), listeners=[reader])
    for number, (contacts, off_road, overtakes, _) in enumerate(sums.tolist()):
        info = reader.infos[f"kart_{number}"]
        counts = {name: info[f"episode/event/{name}"] for name in EVENTS}
        assert (contacts, overtakes) == (counts["kart_contact"], counts["overtake"])
        assert off_road == pytest.approx(counts["off_road"])
    assert sums[:, 0].sum() > 0


def test_the_closing_speed_is_toward_the_nearest_kart():
    karts = np.zeros(3, [("location", "f4", 3), ("velocity", "f4", 3)])
    karts["location"][:, 2] = 0, 10, 100
    karts["velocity"][:, 2] = 5, -2, 3
    assert _closing_speeds(karts).tolist() == [5, 2, -3]


def test_karts_that_touch_drive_toward_each_other(sums):
    assert not sums[sums[:, 0] == 0, 3].any()
    assert sums[:, 3].max() > 0


@pytest.mark.slow
def test_a_folder_is_read_as_its_replays(alone, tmp_path):
    replays = tmp_path / "entry" / "replays"
    replays.mkdir(parents=True)
    for name in ("00001.stkz", "00000.stkz"):
        (replays / name).write_bytes(alone.read_bytes())
    names = [file.name for file in find_replays([tmp_path / "entry", alone, alone])]
    assert names == ["00000.stkz", "00001.stkz", "alone.stkz"]
    (mean,) = measure_conduct([tmp_path / "entry", alone])
    assert (mean.driver, mean.races, mean.contacts, mean.closing) == ("heuristic", 3, 0.0, None)


def test_a_folder_without_replays_is_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"has no replays \(\*\.stkz\); give a file"):
        find_replays([tmp_path])


def test_damaged_replays_are_refused(alone, tmp_path, capsys):
    damaged = tmp_path / "damaged.stkz"
    damaged.write_bytes(alone.read_bytes()[:200])
    assert main(["suite", "conduct", str(alone), str(damaged)]) == 1
    assert f"the replay {damaged} cannot be read" in capsys.readouterr().err


def test_a_race_that_differs_from_its_recording_is_refused(alone, tmp_path):
    replay = load_replay(alone)
    controls = np.array(replay.controls)
    controls[40, 0] = 0
    changed = tmp_path / "changed.stkz"
    object.__setattr__(replay, "controls", controls)
    save_replay(replay, changed)
    with pytest.raises(ReplayError, match=r"in step 4[1-9], and only exact replays show"):
        measure_conduct([changed])


@pytest.mark.slow
def test_the_command_shows_drivers_and_writes_json(crowded, capsys):
    assert main(["suite", "conduct", str(crowded)]) == 0
    shown = capsys.readouterr().out
    assert "closing" in shown
    assert all(name in shown for name in ("random", "heuristic", "ai"))
    assert main(["suite", "conduct", str(crowded), "--json"]) == 0
    assert [mean["races"] for mean in json.loads(capsys.readouterr().out)] == [1, 2, 2]
