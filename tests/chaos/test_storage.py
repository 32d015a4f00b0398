"""Full and read-only disks, interrupted downloads, and installs that are killed."""

import os
import random
import shutil
import signal
import subprocess
import sys
import time

import pytest

from stkzoo._os import check_writable, write_whole
from stkzoo.engine.assets import find, find_assets, install, pack
from stkzoo.errors import AssetError, ConfigError
from tests.chaos.disks import CuttingServer, can_mount, on_disk
from tests.engine import test_assets as assets

pytestmark = pytest.mark.slow

mounts = pytest.mark.skipif(not can_mount(), reason="this user may not mount a disk of its own")


# ---------------------------------------------------------------------- full disks

RACE = """
    import sys
    from stkzoo.errors import StkzooError
    from stkzoo.race import run_race

    def race(*listeners, steps=40):
        drivers = ["heuristic", "ai"]
        return run_race(drivers, track="olivermath", max_steps=steps, listeners=listeners)
"""


@mounts
def test_a_replay_that_does_not_fit_leaves_only_the_previous_one(tmp_path):
    code = """
        from stkzoo.race.replay import ReplayWriter, load_replay
        race(ReplayWriter(PLACE / "race.stkz"), steps=5)
        fill()
        try:
            race(ReplayWriter(PLACE / "race.stkz"), steps=60)
        except StkzooError as error:
            print(type(error).__name__, "No space left" in str(error))
        print(names(), load_replay(PLACE / "race.stkz").steps)
    """
    done = on_disk("full", tmp_path, join(RACE, code))
    assert done.stdout.splitlines() == ["ReplayError True", "['race.stkz'] 5"], done.stderr


@mounts
def test_a_video_that_does_not_fit_raises_an_error_and_leaves_nothing(tmp_path):
    code = """
        from stkzoo.race import RaceVideo
        fill()
        try:
            race(RaceVideo(PLACE / "race.mp4", backend="map", size=(160, 120), card_seconds=0.2))
        except StkzooError as error:
            print(type(error).__name__, "0 MB are free" in str(error))
        print(names())
    """
    done = on_disk("full", tmp_path, join(RACE, code))
    assert done.stdout.splitlines() == ["VideoError True", "[]"], done.stderr


@mounts
def test_a_result_that_does_not_fit_is_still_shown(tmp_path):
    code = """
        import sys
        from stkzoo.cli import main
        fill()
        words = ["race", "heuristic", "ai", "--track", "olivermath", "--max-steps", "5"]
        code = main([*words, "--output", str(PLACE / "race.json")])
        print(code, names())
    """
    done = on_disk("full", tmp_path, code)
    assert done.stdout.splitlines()[-1] == "1 []", done.stderr
    assert "heuristic" in done.stdout
    assert "the result" in done.stderr
    assert "cannot be written" in done.stderr


@mounts
def test_a_tournament_can_be_resumed_after_a_full_disk(tmp_path):
    code = """
        from stkzoo.errors import ConfigError
        from stkzoo.evaluation import run_tournament
        def league(**more):
            how = {"tracks": ["olivermath"], "races": 4, "max_steps": 10, "plot": False, **more}
            return run_tournament(["heuristic", "ai"], output=PLACE / "cup", jobs=1, **how)
        try:
            league(on_race=lambda progress: progress.done == 2 and fill())
        except ConfigError as error:
            print("No space left" in str(error))
        print(len(list((PLACE / "cup" / "races").iterdir())))
        free()
        print(league().is_complete, len(list((PLACE / "cup" / "races").iterdir())))
    """
    done = on_disk("full", tmp_path, code, size="1m")
    assert done.stdout.splitlines() == ["True", "2", "True 4"], done.stderr


@mounts
@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_a_full_temporary_disk_stops_no_race_or_raises_a_clear_error(tmp_path, method):
    code = """
        from stkzoo import race_v0
        fill()
        for attempt in range(2):
            try:
                with race_v0.parallel_env(num_kart=2, track="olivermath") as env:
                    env.reset(seed=1)
                    env.step({a: env.action_space(a).sample() for a in env.agents})
                print("raced")
            except StkzooError as error:
                print(type(error).__name__, str(PLACE) in str(error))
            free()
    """
    variables = {"TMPDIR": str(tmp_path), "STKZOO_START_METHOD": method}
    done = on_disk("full", tmp_path, join(RACE, code), size="128k", **variables)
    first, second = done.stdout.splitlines()
    assert first in ("raced", "EngineError True"), done.stderr
    assert second == "raced"


# ---------------------------------------------------------------------- the game's data


@pytest.fixture
def machine(tmp_path, monkeypatch):
    """Sets up a machine with a download of pystk2 and an empty cache."""
    monkeypatch.setenv("STKZOO_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "other caches"))
    monkeypatch.delenv("SUPERTUXKART_DATADIR", raising=False)
    data = assets.make_download()
    for name in ("alps", "beach"):  # larger than their packed size
        (data / "tracks" / name / "more.xml").write_bytes(b"<x/>" * 20_000 + name.encode())
    return tmp_path


@pytest.fixture
def archive(machine):
    install()
    return pack(output=machine / "pack.tar.xz")


@mounts
def test_an_archive_that_does_not_fit_is_reported_and_leaves_nothing(archive, tmp_path):
    code = """
        import sys
        from stkzoo.engine.assets import install
        from stkzoo.errors import AssetError
        try:
            install(archive=Path(sys.argv[1]))
        except AssetError as error:
            print("No space left" in str(error))
        print([name for name in names() if name != ".stkzoo-lock"])
    """
    cache = tmp_path / "small"
    cache.mkdir()
    variables = {"STKZOO_CACHE": str(cache)}
    done = on_disk("full", cache, code, str(archive), size="100k", **variables)
    assert done.stdout.splitlines() == ["True", "[]"], done.stderr


@mounts
def test_a_read_only_cache_can_be_used_but_not_installed_into(archive, tmp_path):
    code = """
        import sys
        from stkzoo.engine.assets import find_assets, install
        from stkzoo.errors import AssetError
        print(find_assets().source)
        try:
            install(archive=Path(sys.argv[1]))
        except AssetError as error:
            print("STKZOO_CACHE" in str(error))
        print(find_assets().source)
    """
    cache = tmp_path / "cache"
    done = on_disk("read-only", cache, code, str(archive))
    assert done.stdout.splitlines() == ["headless pack", "True", "headless pack"], done.stderr


# ---------------------------------------------------------------------- downloads


def serve(package, folder, server, monkeypatch):
    """Makes this package, from a web server, the only one that apt knows."""
    assets.TestDebianPackage.serve(package, folder, monkeypatch)
    (folder / "sources.list").write_text(f"deb [trusted=yes] {server.address} ./\n")
    with (folder / "apt.conf").open("a") as settings:
        settings.write('Acquire::http::Proxy "DIRECT";\nAcquire::Retries "0";\n')


def test_an_interrupted_download_leaves_nothing_and_can_be_repeated(machine, monkeypatch):
    shutil.rmtree(find.pystk2_cache_folder())
    package = assets.make_package(machine / "package")
    with CuttingServer(package.parent, cuts=3).serving() as server:
        serve(package, machine / "apt", server, monkeypatch)
        with pytest.raises(AssetError, match="could not be downloaded"):
            install(source="debian")
        assert server.num_cuts >= 1
        assert assets.visible(machine / "cache") == []
        server.num_cuts = 3
        assert install(source="debian").tracks == ("alps", "beach")


# ---------------------------------------------------------------------- installs


def test_the_next_install_repairs_a_killed_one(archive):
    cache = archive.parent / "cache"
    subprocess.run(["rm", "-rf", str(cache)], check=True)
    chance = random.Random(1)
    words = [sys.executable, "-m", "stkzoo", "assets", "install", "--from", str(archive)]
    for _ in range(6):
        program = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        time.sleep(chance.uniform(0.2, 0.8))
        program.send_signal(signal.SIGKILL)
        program.wait(10)
        assert not cache.exists() or assets.visible(cache) in ([], ["headless"]) or leftovers(cache)
    both = [subprocess.Popen(words, stdout=subprocess.DEVNULL) for _ in range(2)]
    assert [program.wait(60) for program in both] == [0, 0]
    assert assets.visible(cache) == ["headless"]
    assert find_assets().source == "headless pack"


def leftovers(cache):
    return all(name == "headless" or name.startswith(".stkzoo-") for name in assets.visible(cache))


@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_no_writer_replaces_a_pipe_or_a_device(kind, tmp_path):
    place = tmp_path / "place"
    if kind == "pipe":
        os.mkfifo(place)
    else:
        place.symlink_to(os.devnull)
    with pytest.raises(ConfigError, match="not a regular file"), write_whole(place):
        pytest.fail("it must not be written")
    with pytest.raises(ConfigError, match="not a regular file"):
        check_writable(place, "the result")
    assert [*tmp_path.iterdir()] == [place]
    assert place.is_fifo() if kind == "pipe" else place.is_char_device()


def join(*parts):
    import textwrap

    return "\n".join(map(textwrap.dedent, parts))
