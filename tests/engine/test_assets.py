import errno
import hashlib
import io
import json
import lzma
import os
import shutil
import signal
import subprocess
import sys
import tarfile
import tracemalloc
from pathlib import Path

import pytest

from stkzoo.cli import main
from stkzoo.engine.assets import Progress, find, find_assets, install, pack, survey
from stkzoo.engine.assets.headless import (
    PLACEHOLDER_JPEG,
    PLACEHOLDER_PNG,
)
from stkzoo.engine.assets.tree import MARKER
from stkzoo.errors import AssetError, ConfigError

ENGINE_NAMES = """
import json, pystk2
pystk2.init(pystk2.GraphicsConfig.none())
tracks = pystk2.list_tracks(pystk2.RaceConfig.RaceMode.NORMAL_RACE)
print(json.dumps([sorted(tracks), sorted(pystk2.list_karts())]))
"""

CRASHING_INSTALL = """
import sys, time
from stkzoo.engine.assets.find import cache_folder
from stkzoo.engine.assets.staging import Progress, fresh_folder, lock
with lock(cache_folder(), Progress()), fresh_folder(cache_folder()) as folder:
    (folder / "half").write_text("half")
    print(folder, flush=True)
    time.sleep(float(sys.argv[1]))
"""


def run_python(program, *arguments, **variables):
    """Runs a program in a fresh interpreter; returns its last line of output."""
    process = subprocess.run(
        [sys.executable, "-c", program, *arguments],
        env={**os.environ, "PYTHONUNBUFFERED": "1", **variables},
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    )
    return process.stdout.strip().splitlines()[-1]


def write(path, content=b"<x/>"):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)


def make_data(data, version="1.4"):
    """Writes a data folder like Debian's, with two race tracks, an arena and two karts."""
    write(data / "stk_config.xml")
    write(data / f"supertuxkart.{version}", b"")
    write(data / "skins" / "peach" / "stkskin.xml")
    write(data / "ttf" / "SigmarOne.otf", b"a font")
    (data / "ttf" / "Cantarell-Regular.otf").symlink_to("../../nowhere.otf")
    for name, attributes in (("alps", "reverse='Y'"), ("beach", ""), ("pit", "arena='Y'")):
        write(data / "tracks" / name / "track.xml", f"<track {attributes}/>".encode())
        for file in ("graph.xml", "quads.xml", "scene.xml"):
            write(data / "tracks" / name / file)
        write(data / "tracks" / name / "road.PNG", b"a picture" * 1000)
        write(data / "tracks" / name / "sky.jpg", b"a picture" * 1000)
        write(data / "tracks" / name / "hum.ogg", b"a sound " + name.encode())
        write(data / "tracks" / name / "road.spm", b"a model of " + name.encode())
    for name in ("gnu", "tux"):
        write(data / "karts" / name / "kart.xml")
        write(data / "karts" / name / "kart.spm", b"the same model")
    return data


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """Sets up a machine without any data and with an empty cache; returns the cache folder."""
    folder = tmp_path / "cache"
    monkeypatch.setenv("STKZOO_CACHE", str(folder))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "other caches"))
    monkeypatch.delenv("SUPERTUXKART_DATADIR", raising=False)
    return folder


def make_download():
    """Writes a finished download of pystk2 to its cache; returns its data folder."""
    root = find.pystk2_cache_folder() / "1.5"
    data = make_data(root / "data", version="1.5")
    (data / "ttf" / "Cantarell-Regular.otf").unlink()
    write(data / "skins" / "classic" / "stkskin.xml")
    write(root / "__downloaded__.txt")
    return data


@pytest.fixture
def full(cache):  # noqa: ARG001 - needs the fixture
    """Adds pystk2's download to the machine without data; returns its data folder."""
    return make_download()


@pytest.fixture
def headless(full):  # noqa: ARG001 - needs the fixture
    """Installs a headless pack of the download; returns its root."""
    install()
    return find.own_folder("headless")


def visible(folder):
    return sorted(path.name for path in folder.iterdir() if path.name != ".stkzoo-lock")


def content(root):
    return {
        str(path.relative_to(root)): path.read_bytes() for path in root.rglob("*") if path.is_file()
    }


class TestOnThisMachine:
    def test_names_match_the_engine(self):
        assets = find_assets()
        names = run_python(ENGINE_NAMES, SUPERTUXKART_DATADIR=str(assets.root))
        assert [list(assets.tracks), list(assets.karts)] == json.loads(names)


class TestFinding:
    @pytest.mark.usefixtures("cache")
    def test_missing_data_names_the_command_that_installs_it(self):
        with pytest.raises(AssetError, match="`stkzoo assets install`"):
            find_assets()

    @pytest.mark.usefixtures("headless")
    def test_environment_comes_first(self, monkeypatch):
        monkeypatch.setenv("SUPERTUXKART_DATADIR", str(find.pystk2_cache_folder() / "1.5"))
        assert find_assets().source == "environment"

    @pytest.mark.usefixtures("headless")
    def test_environment_with_a_bad_folder_raises_an_error(self, monkeypatch, tmp_path):
        monkeypatch.setenv("SUPERTUXKART_DATADIR", str(tmp_path))
        with pytest.raises(AssetError, match=r"SUPERTUXKART_DATADIR is .* has no folder 'data'"):
            find_assets()

    def test_environment_with_a_headless_pack_cannot_render(self, headless, monkeypatch):
        monkeypatch.setenv("SUPERTUXKART_DATADIR", str(headless))
        with pytest.raises(AssetError, match=r"SUPERTUXKART_DATADIR .* headless pack"):
            find_assets(graphics=True)

    def test_headless_pack_is_preferred_for_racing(self, headless):
        assert find_assets().root == headless

    @pytest.mark.usefixtures("headless")
    def test_full_data_is_used_for_rendering(self):
        assert not find_assets(graphics=True).headless

    def test_headless_pack_alone_cannot_render(self, headless, full):
        shutil.rmtree(full)
        assert find_assets().root == headless
        with pytest.raises(AssetError, match="full data, which drawing needs"):
            find_assets(graphics=True)

    @pytest.mark.usefixtures("full")
    def test_arenas_are_not_race_tracks(self):
        assert find_assets().tracks == ("alps", "beach")

    @pytest.mark.usefixtures("full")
    def test_incomplete_download_of_pystk2_is_not_used(self):
        (find.pystk2_cache_folder() / "1.5" / "__downloaded__.txt").unlink()
        with pytest.raises(AssetError, match=r"download of pystk2 .* is incomplete"):
            find_assets()

    def test_pack_without_a_track_is_skipped(self, headless):
        (headless / "data" / "tracks" / "alps" / "track.xml").unlink()
        assert find_assets().source == "pystk2 cache"

    def test_survey_reports_the_problem_of_each_place(self, headless):
        (headless / MARKER).write_text("{")
        assert "damaged" in next(survey()).problem


class TestInstalling:
    @pytest.mark.usefixtures("full")
    def test_builds_the_pack_from_existing_data(self):
        assert install().source == "headless pack"

    def test_unknown_source_is_refused(self):
        with pytest.raises(ConfigError, match="Did you mean 'debian'"):
            install(source="debain")

    def test_without_apt_debian_is_refused_and_nothing_is_left(self, cache, monkeypatch):
        monkeypatch.setenv("PATH", "")
        with pytest.raises(AssetError, match="no apt-get"):
            install(source="debian")
        assert visible(cache) == []

    @pytest.mark.usefixtures("full")
    def test_next_install_removes_the_files_of_a_killed_one(self):
        folder = self.kill_an_install()
        assert (folder / "half").exists()
        install()
        assert not folder.exists()

    @pytest.mark.slow
    @pytest.mark.usefixtures("full")
    def test_install_waits_for_another_one(self):
        other = self.start_an_install("1")
        notes = []
        progress = Progress()
        progress.note = notes.append
        install(progress=progress)
        assert other.wait(10) == 0
        assert "waiting" in notes[0]

    @pytest.mark.usefixtures("full")
    def test_folder_of_another_program_is_not_replaced(self, cache):
        write(cache / "headless" / "thesis.txt")
        with pytest.raises(AssetError, match="did not make"):
            install()
        assert (cache / "headless" / "thesis.txt").exists()

    @pytest.mark.usefixtures("full")
    def test_unwritable_cache_names_the_variable_that_moves_it(self, tmp_path, monkeypatch):
        write(tmp_path / "file")
        monkeypatch.setenv("STKZOO_CACHE", str(tmp_path / "file" / "cache"))
        with pytest.raises(AssetError, match="STKZOO_CACHE"):
            install()

    def test_a_full_disk_during_the_installation_names_the_remedy(self, full, monkeypatch):
        def fill(*_):
            raise OSError(errno.EDQUOT, "Disk quota exceeded", str(full))

        monkeypatch.setattr("stkzoo.engine.assets.installer.build_headless", fill)
        for build in (install, pack):
            with pytest.raises(AssetError, match=r"Disk quota exceeded.*STKZOO_CACHE"):
                build()

    @staticmethod
    def start_an_install(seconds):
        process = subprocess.Popen(
            [sys.executable, "-c", CRASHING_INSTALL, seconds], stdout=subprocess.PIPE, text=True
        )
        process.folder = Path(process.stdout.readline().strip())
        process.stdout.close()
        return process

    def kill_an_install(self):
        process = self.start_an_install("60")
        process.send_signal(signal.SIGKILL)
        process.wait(10)
        return process.folder


@pytest.fixture
def package(tmp_path):
    """Builds a small ``supertuxkart-data`` package."""
    return make_package(tmp_path / "package")


def make_package(folder, version="1.4"):
    tree = folder / "tree"
    make_data(tree / "usr" / "share" / "games" / "supertuxkart" / "data", version)
    control = (
        "Package: supertuxkart-data\nVersion: 1.4\nArchitecture: all\n"
        "Maintainer: Nobody <nobody@example.org>\nInstalled-Size: 100\nDescription: data\n"
    )
    write(tree / "DEBIAN" / "control", control.encode())
    file = folder / "supertuxkart-data_1.4_all.deb"
    subprocess.run(["dpkg-deb", "--build", str(tree), str(file)], check=True, stdout=-3)
    return file


class TestDebianPackage:
    def test_apt_download_can_be_used(self, cache, package, tmp_path, monkeypatch):
        self.serve(package, tmp_path / "apt", monkeypatch)
        assert install(source="debian").tracks == ("alps", "beach")
        assert visible(cache) == ["full", "headless"]

    @pytest.mark.usefixtures("cache")
    def test_package_is_completed_for_the_engine(self, package, tmp_path, monkeypatch):
        self.serve(package, tmp_path / "apt", monkeypatch)
        install(source="debian")
        data = find.own_folder("full") / "data"
        assert (data / "supertuxkart.1.5").is_file()
        assert (data / "skins" / "classic" / "stkskin.xml").is_file()
        assert (data / "ttf" / "Cantarell-Regular.otf").read_bytes() == b"a font"

    def test_package_of_another_version_is_refused(self, cache, tmp_path, monkeypatch):
        self.serve(make_package(tmp_path / "old", "1.2"), tmp_path / "apt", monkeypatch)
        with pytest.raises(AssetError, match=r"another version .*supertuxkart\.1\.2"):
            install(source="debian")
        assert visible(cache) == []

    def test_damaged_package_leaves_nothing(self, cache, package, tmp_path, monkeypatch):
        self.serve(package, tmp_path / "apt", monkeypatch)
        package.write_bytes(package.read_bytes()[:-10] + b"0123456789")
        with pytest.raises(AssetError, match="could not be downloaded"):
            install(source="debian")
        assert visible(cache) == []

    @staticmethod
    def serve(package, folder, monkeypatch):
        """Makes this package the only one that apt knows."""
        data = package.read_bytes()
        fields = subprocess.run(
            ["dpkg-deb", "--field", str(package)], check=True, capture_output=True, text=True
        ).stdout
        stanza = (
            f"{fields}Filename: ./{package.name}\nSize: {len(data)}\n"
            f"SHA256: {hashlib.sha256(data).hexdigest()}\n"
        )
        write(package.parent / "Packages", stanza.encode())
        sources = f"deb [trusted=yes] copy:{package.parent} ./\n"
        write(folder / "sources.list", sources.encode())
        (folder / "lists" / "partial").mkdir(parents=True)
        settings = {
            "Dir::Etc::sourcelist": folder / "sources.list",
            "Dir::Etc::sourceparts": "-",
            "Dir::State::lists": folder / "lists",
        }
        text = "".join(f'{name} "{value}";\n' for name, value in settings.items())
        write(folder / "apt.conf", text.encode())
        monkeypatch.setenv("APT_CONFIG", str(folder / "apt.conf"))


class TestHeadlessPack:
    def test_has_every_file_name_of_the_full_data(self, headless, full):
        names = {str(p.relative_to(headless / "data")) for p in (headless / "data").rglob("*")}
        assert {str(p.relative_to(full)) for p in full.rglob("*")} <= names

    def test_images_become_placeholders_of_their_format(self, headless):
        track = headless / "data" / "tracks" / "alps"
        assert (track / "road.PNG").read_bytes() == PLACEHOLDER_PNG
        assert (track / "sky.jpg").read_bytes() == PLACEHOLDER_JPEG

    @pytest.mark.usefixtures("headless")
    def test_pack_of_another_version_is_built_again(self, monkeypatch):
        monkeypatch.setattr("stkzoo.engine.assets.tree._LAYOUT", 2)
        assert find_assets().source == "pystk2 cache"
        assert install().source == "headless pack"

    def test_full_data_with_a_broken_scene_is_refused(self, full, cache):
        write(full / "models" / "banana-low.spm")
        write(full / "tracks" / "beach" / "scene.xml", b"<scene>")
        with pytest.raises(AssetError, match=r"beach/scene\.xml cannot be read"):
            pack()
        assert "headless" not in visible(cache)


@pytest.fixture
def archive(headless, tmp_path):  # noqa: ARG001 - needs the fixture
    return pack(output=tmp_path / "pack.tar.xz")


def rebuild(archive, change):
    """Rewrites the archive with ``change`` applied to its list of (member, content)."""
    with tarfile.open(archive) as old:
        members = [(member, old.extractfile(member).read()) for member in old]
    with tarfile.open(archive, "w:xz") as new:
        for member, data in change(members):
            member.size = len(data)
            new.addfile(member, io.BytesIO(data))


def named(name, kind=tarfile.REGTYPE, target=""):
    member = tarfile.TarInfo(name)
    member.type, member.linkname = kind, target
    return member


def header(name, size=0, kind=tarfile.REGTYPE):
    """Returns an archive header with any size; the content need not follow."""
    member = named(name, kind)
    member.size = size
    return member.tobuf(tarfile.GNU_FORMAT)


def sparse_member():
    """Returns a sparse member of 1.9 GB in 512 bytes, as GNU tar writes it."""
    member = named("data/big")
    member.size = 512
    member.pax_headers = {
        "GNU.sparse.major": "1",
        "GNU.sparse.minor": "0",
        "GNU.sparse.name": "data/big",
        "GNU.sparse.realsize": "1900000000",
    }
    return member.tobuf(tarfile.PAX_FORMAT) + b"0\n".ljust(512, b"\0")


#: Contents of archives that take unbounded memory or disk space, and the errors that refuse them.
BOMBS = {
    "pax header": (lambda: header("x", 1 << 30, tarfile.XHDTYPE), "a header of 1,073,741,824"),
    "one file": (
        lambda: header("data/big", 1_800_000_000) + bytes(9 << 20),
        "more than a headless pack of its size",
    ),
    "sparse file": (sparse_member, "not a regular file"),
}


class TestArchive:
    def test_has_the_same_bytes_each_time(self, archive, tmp_path):
        again = pack(output=tmp_path / "again.tar.xz")
        assert again.read_bytes() == archive.read_bytes()

    def test_installs_the_same_pack_elsewhere(self, archive, headless, tmp_path, monkeypatch):
        monkeypatch.setenv("STKZOO_CACHE", str(tmp_path / "elsewhere"))
        assert install(archive=archive).root == tmp_path / "elsewhere" / "headless"
        assert content(tmp_path / "elsewhere" / "headless") == content(headless)

    @pytest.mark.usefixtures("headless")
    def test_cannot_be_written_into_a_missing_folder(self, tmp_path):
        with pytest.raises(AssetError, match="cannot be written"):
            pack(output=tmp_path / "missing" / "pack.tar.xz")

    def test_damaged_archive_is_reported(self, archive, cache):
        data = bytearray(archive.read_bytes())
        data[len(data) // 2] ^= 1
        archive.write_bytes(data)
        self.refused(archive, "is damaged", cache)

    def test_missing_track_is_reported(self, archive, cache):
        name = "data/tracks/alps/track.xml"
        rebuild(archive, lambda members: [m for m in members if m[0].name != name])
        self.refused(archive, "'tracks/alps/track.xml' is missing from", cache)

    def test_duplicate_member_is_reported(self, archive, cache):
        rebuild(archive, lambda members: [*members, members[-1]])
        self.refused(archive, "File exists", cache)

    @pytest.mark.parametrize("name", ["data/../../evil", "/tmp/evil"])
    def test_member_outside_the_pack_is_reported(self, archive, cache, tmp_path, name):
        rebuild(archive, lambda members: [*members, (named(name), b"!")])
        self.refused(archive, "outside the pack", cache)
        assert not (tmp_path / "evil").exists()

    @pytest.mark.parametrize("kind", [tarfile.SYMTYPE, tarfile.FIFOTYPE])
    def test_member_that_is_not_a_regular_file_is_reported(self, archive, cache, kind):
        link = named("data/link", kind, "/etc/passwd")
        rebuild(archive, lambda members: [*members, (link, b"")])
        self.refused(archive, "not a regular file", cache)

    @pytest.mark.parametrize("name", BOMBS)
    def test_archive_bomb_is_refused_with_little_memory(self, cache, tmp_path, name):
        make, problem = BOMBS[name]
        (tmp_path / "bomb").write_bytes(lzma.compress(make(), preset=0))
        tracemalloc.start()
        try:
            self.refused(tmp_path / "bomb", problem, cache)
            assert tracemalloc.get_traced_memory()[1] < 16 << 20
        finally:
            tracemalloc.stop()

    def test_archive_of_too_many_files_is_refused(self, cache, tmp_path, monkeypatch):
        monkeypatch.setattr("stkzoo.engine.assets.headless._MAX_MEMBERS", 9)
        content = b"".join(header(f"data/{number}") for number in range(10))
        (tmp_path / "bomb").write_bytes(lzma.compress(content))
        self.refused(tmp_path / "bomb", "more than 9 files", cache)

    @staticmethod
    def refused(archive, match, cache):
        shutil.rmtree(cache, ignore_errors=True)
        with pytest.raises(AssetError, match=match):
            install(archive=archive)
        assert visible(cache) == [] if cache.exists() else True


class TestCommandLine:
    @pytest.mark.usefixtures("full")
    def test_status_succeeds_with_data(self, capsys):
        assert main(["assets", "status"]) == 0
        assert "2 tracks" in capsys.readouterr().out

    @pytest.mark.usefixtures("full")
    def test_install_says_where_the_data_is(self, capsys):
        assert main(["assets", "install"]) == 0
        assert str(find.own_folder("headless")) in capsys.readouterr().out

    @pytest.mark.parametrize("words", [["assets"], ["asets"], ["assets", "install", "-x"]])
    def test_invalid_usage_exits_with_2(self, words, capsys):
        assert main(words) == 2
        said = capsys.readouterr().err
        assert said.startswith("stkzoo")
        assert "--help`" in said

    @pytest.mark.usefixtures("cache")
    def test_error_is_one_message_without_a_traceback(self):
        command = [sys.executable, "-m", "stkzoo", "assets", "install", "--from", "missing"]
        process = subprocess.run(command, capture_output=True, text=True, check=False)
        assert (process.returncode, process.stdout) == (1, "")
        assert process.stderr == "stkzoo: there is no file 'missing'.\n"
