"""Contacts are those of the environment, and the kart that causes them is at fault."""

import json
from pathlib import Path

import numpy as np
import pytest

from stkzoo.cli import main
from stkzoo.errors import ConfigError
from stkzoo.mdp.events import EVENTS
from stkzoo.race import run_race
from stkzoo.race.listeners import RaceListener
from stkzoo.race.replay import ReplayError, ReplayWriter, load_replay, play_replay, save_replay
from stkzoo.suite import JudgedContact, mean_conduct, measure_conduct, race_conduct
from stkzoo.suite.conduct.contacts import Contact, merge_touches
from stkzoo.suite.conduct.races import find_replays

DRIVERS = ["benchmarks.rammer", "heuristic", "heuristic", "ai", "ai"]


def record(file, drivers, **settings):
    settings = {"track": "lighthouse", "difficulty": 3, "inline": True, **settings}
    run_race(
        drivers,
        start_positions=range(1, len(drivers) + 1),
        listeners=[ReplayWriter(file)],
        **settings,
    )
    return file


@pytest.fixture(scope="module")
def rammed(tmp_path_factory):
    """Records a race in which a rammer hits two heuristic karts and karts of the AI touch."""
    file = tmp_path_factory.mktemp("conduct") / "rammed.stkz"
    return record(file, DRIVERS, track="minigolf", seed=1, max_steps=50)


@pytest.fixture(scope="module")
def judged(rammed):
    return race_conduct(rammed)


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    file = tmp_path_factory.mktemp("conduct") / "alone.stkz"
    return record(file, ["heuristic"], seed=1, max_steps=50)


class EventReader(RaceListener):
    """Records the environment's own event counts."""

    def env_options(self):
        return {"events": True}

    def stepped(self, race):
        self.infos = race.infos


def test_the_rammer_is_at_fault_and_its_victim_is_not(judged):
    (contact,) = [contact for contact in judged.contacts if contact.karts == (0, 2)]
    assert contact.closing[0] > 0 > contact.closing[1]
    assert contact.at_fault == 0
    assert judged.karts[2].at_fault == 0


def test_a_kart_that_runs_into_the_rammer_is_at_fault(judged):
    (contact,) = [contact for contact in judged.contacts if contact.karts == (0, 1)]
    assert contact.closing[1] > 0 > contact.closing[0]
    assert contact.at_fault == 1
    assert [kart.at_fault for kart in judged.karts] == [1, 1, 0, None, None]


def test_the_games_ai_is_not_judged(judged):
    assert [kart.contacts for kart in judged.karts[3:]] == [2, 2]
    assert [contact.at_fault for contact in judged.contacts if contact.karts == (3, 4)] == [None]
    assert judged.karts[3].at_fault is None


def test_counts_equal_those_of_the_environment(rammed, judged):
    reader = EventReader()
    play_replay(load_replay(rammed), listeners=[reader])
    for number, kart in enumerate(judged.karts):
        info = reader.infos[f"kart_{number}"]
        counts = {name: info[f"episode/event/{name}"] for name in EVENTS}
        assert kart.contacts == counts["kart_contact"]
        assert kart.overtakes == counts["overtake"]
        assert kart.off_road == pytest.approx(counts["off_road"])
    assert sum(kart.contacts for kart in judged.karts) > 0


def test_each_counted_contact_belongs_to_a_judged_contact(judged):
    for number, kart in enumerate(judged.karts):
        own = [contact for contact in judged.contacts if number in contact.karts]
        assert sum(c.counts[c.karts.index(number)] for c in own) == kart.contacts


def test_the_same_race_gets_the_same_verdict(rammed, judged):
    assert race_conduct(rammed) == judged


def test_a_race_without_contacts_has_only_counts(alone):
    race = race_conduct(alone)
    assert race.contacts == ()
    assert (race.karts[0].contacts, race.karts[0].at_fault, race.not_judged) == (0, 0, 0)


@pytest.mark.parametrize(
    ("latest", "closing", "at_fault"),
    [
        ((None, None), (9.0, -1.0), None),
        ((0.5, None), (-9.0, 1.0), 3),
        ((None, 2.0), (9.0, -1.0), 5),
        ((0.3, 1.0), (-9.0, 1.0), 3),
        ((1.0, 0.3), (9.0, 1.0), 5),
        ((0.5, 0.3), (9.0, -1.0), 3),
        ((0.5, 0.5), (1.0, 2.0), 5),
    ],
)
def test_the_kart_that_started_later_or_else_closes_the_gap_is_at_fault(latest, closing, at_fault):
    assert JudgedContact(10, (3, 5), (1, 1), latest, closing).at_fault == at_fault


def test_a_kart_that_hits_a_slow_kart_from_behind_is_at_fault_because_it_could_brake(tmp_path):
    drivers = ["heuristic", "pursuit", "heuristic", "pursuit", "benchmarks.rammer"]
    file = record(tmp_path / "lighthouse.stkz", drivers, seed=3006, max_steps=75)
    (contact,) = [c for c in race_conduct(file, [4]).contacts if c.karts == (1, 4)]
    assert contact.closing[1] > 20 > 0 > contact.closing[0]
    assert contact.latest == (0.3, 0.5)  # without brakes, only the slow kart avoids it
    assert contact.at_fault == 4


def test_nobody_is_at_fault_for_a_contact_toward_which_the_games_ai_moves_faster(tmp_path):
    drivers = ["benchmarks.rammer", "heuristic", "heuristic", "pretrained:ace", "ai", "ai"]
    file = record(tmp_path / "mines.stkz", drivers, track="mines", seed=1082, max_steps=32)
    first, *_ = race_conduct(file, [0]).contacts
    assert first.karts == (0, 4)
    assert first.closing[1] > 0 > first.closing[0]
    assert first.at_fault is None


def test_only_the_contacts_of_the_chosen_agents_are_judged(rammed, judged):
    race = race_conduct(rammed, [0])
    assert [contact for contact in judged.contacts if 0 in contact.karts] == [*race.contacts]
    assert race.not_judged == len(judged.contacts) - len(race.contacts) > 0
    assert race.karts[0] == judged.karts[0]


def test_touches_within_a_second_are_one_contact():
    touches = [
        Contact(20, (0, 1), (1, 1)),
        Contact(21, (0, 1), (0, 0)),
        Contact(22, (0, 2), (1, 1)),
        Contact(31, (0, 1), (1, 1)),
        Contact(42, (0, 1), (1, 0)),
    ]
    assert merge_touches(touches, 10) == [
        Contact(20, (0, 1), (2, 2)),
        Contact(22, (0, 2), (1, 1)),
        Contact(42, (0, 1), (1, 0), apart_since=31),
    ]


def test_a_folder_is_read_as_its_replays(alone, tmp_path):
    replays = tmp_path / "entry" / "replays"
    replays.mkdir(parents=True)
    for name in ("00001.stkz", "00000.stkz"):
        (replays / name).write_bytes(alone.read_bytes())
    races = measure_conduct([tmp_path / "entry", alone], jobs=1)
    assert [race.replay.rsplit("/", 1)[-1] for race in races] == [
        *("00000.stkz", "00001.stkz", "alone.stkz")
    ]
    (mean,) = mean_conduct(races)
    assert (mean.driver, mean.races, mean.contacts) == ("heuristic", 3, 0.0)


def test_a_replay_that_is_named_in_two_ways_counts_once(alone, tmp_path, monkeypatch):
    monkeypatch.chdir(alone.parent)
    (tmp_path / "link.stkz").symlink_to(alone)
    places = [alone.name, alone, tmp_path / "link.stkz", Path("..", alone.parent.name, alone.name)]
    assert find_replays(places) == [Path(alone.name)]


def test_a_folder_without_replays_is_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"has no replays \(\*\.stkz\); give a file"):
        find_replays([tmp_path])


def test_an_invalid_number_of_jobs_is_refused(alone):
    with pytest.raises(ConfigError, match="jobs is 0, expected a whole number of 1 or more"):
        measure_conduct([alone], jobs=0)


def test_damaged_and_missing_replays_are_refused_before_any_race(alone, tmp_path, capsys):
    damaged = tmp_path / "damaged.stkz"
    damaged.write_bytes(alone.read_bytes()[:200])
    assert main(["suite", "conduct", str(alone), str(damaged)]) == 1
    assert f"the replay {damaged} cannot be read" in capsys.readouterr().err
    with pytest.raises(ReplayError, match="cannot be read"):
        find_replays([tmp_path / "nothing.stkz"])


def test_a_race_that_differs_from_its_recording_is_refused(alone, tmp_path):
    replay = load_replay(alone)
    controls = np.array(replay.controls)
    controls[40, 0] = 0
    changed = tmp_path / "changed.stkz"
    object.__setattr__(replay, "controls", controls)
    save_replay(replay, changed)
    with pytest.raises(ReplayError, match=r"in step 4[1-9], and only exact replays can be judged"):
        race_conduct(changed)


def test_the_command_shows_drivers_and_writes_json(rammed, judged, capsys):
    assert main(["suite", "conduct", str(rammed), "--jobs", "1"]) == 0
    shown = capsys.readouterr().out
    assert "at fault" in shown
    assert all(kart.driver in shown for kart in judged.karts)
    assert main(["suite", "conduct", str(rammed), "--jobs", "1", "--json"]) == 0
    (race,) = json.loads(capsys.readouterr().out)
    assert race["type"] == "race-conduct"
    assert len(race["contacts"]) == len(judged.contacts)
