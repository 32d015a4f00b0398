"""Ghosts of replays on maps."""

from dataclasses import replace

import numpy as np
import pytest

from stkzoo.cli import main
from stkzoo.errors import ConfigError
from stkzoo.race import RaceVideo, run_race
from stkzoo.race.listeners import RaceListener
from stkzoo.race.replay import ReplayError, ReplayWriter, ghost_of, load_replay
from stkzoo.render.map import _GHOST, MapView


class Watcher(RaceListener):
    """Records the scene and all snapshots of a race."""

    def __init__(self):
        self.snapshots = []

    def started(self, race):
        self.scene = race.scene
        self.snapshots.append(race.snapshot)

    def stepped(self, race):
        self.snapshots.append(race.snapshot)


@pytest.fixture(scope="module")
def race(tmp_path_factory):
    """Records a race; returns its file, scene and snapshots."""
    path = tmp_path_factory.mktemp("ghost") / "race.stkz"
    watcher = Watcher()
    run_race(
        ["heuristic", "ai"],
        track="lighthouse",
        seed=1,
        max_steps=90,
        listeners=[ReplayWriter(path), watcher],
    )
    return path, watcher


def test_a_ghost_follows_the_winner(race):
    path, watcher = race
    ghost = ghost_of(load_replay(path))
    last = watcher.snapshots[-1].karts
    winner = last["position"].argmin()
    assert (ghost.track, ghost.reverse) == ("lighthouse", False)
    assert ghost.name == watcher.scene.names[winner]
    for snapshot in watcher.snapshots[40::10]:
        place = snapshot.karts["location"][winner, ::2]
        np.testing.assert_allclose(ghost.place_at(float(snapshot.header["time"])), place)
    assert ghost.place_at(ghost.times[-1] + 0.1) is None


def test_the_map_shows_a_ring_where_the_ghost_is(race):
    path, watcher = race
    ghost = ghost_of(load_replay(path))
    snapshot = watcher.snapshots[-1]
    shown = MapView(watcher.scene, panel=False, ghost=ghost).draw(snapshot)
    plain = MapView(watcher.scene, panel=False).draw(snapshot)
    changed = shown[(shown != plain).any(axis=2)]
    assert len(changed) > 20
    assert (np.abs(changed.astype(int) - np.array(_GHOST)).max(axis=1) < 40).any()


def test_a_ghost_of_another_track_is_refused(race, tmp_path):
    video = RaceVideo(tmp_path / "map.mp4", ghost=ghost_of(load_replay(race[0])))
    with pytest.raises(ConfigError, match=r"drives on lighthouse .* and this race is on zengarden"):
        run_race(["heuristic"], track="zengarden", max_steps=5, listeners=[video])
    assert not (tmp_path / "map.mp4").exists()


def test_a_replay_that_differs_has_no_ghost(race):
    replay = load_replay(race[0])
    controls = replay.controls.copy()
    controls[60:, 0, 1] = 1.0
    with pytest.raises(ReplayError, match="no ghost: its race differs after step 6"):
        ghost_of(replace(replay, controls=controls))


@pytest.mark.slow
def test_a_video_with_a_ghost_can_be_made(race, tmp_path):
    words = ["replay", str(race[0]), "--video", str(tmp_path / "race.mp4")]
    assert main([*words, "--ghost", str(race[0]), "--width", "320", "--height", "240"]) == 0
    assert (tmp_path / "race.mp4").stat().st_size > 5000


def test_a_replay_that_ends_before_the_start_has_no_ghost(tmp_path):
    path = tmp_path / "short.stkz"
    run_race(["heuristic"], track="lighthouse", max_steps=5, listeners=[ReplayWriter(path)])
    with pytest.raises(ConfigError, match="ends before the race begins"):
        ghost_of(load_replay(path))
