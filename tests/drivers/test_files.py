"""Agents from folders, zips, files and modules (D20, D29), and malicious zips."""

import importlib
import os
import shutil
import stat
import struct
import sys
import tracemalloc
import zipfile
from contextlib import ExitStack, suppress
from pathlib import Path

import pytest

from stkzoo.drivers import files
from stkzoo.drivers.code import load_agent
from stkzoo.drivers.files import find_files
from stkzoo.errors import ConfigError
from stkzoo.evaluation import plan_tournament
from stkzoo.race import find_driver, run_race
from tests.support.paths import AGENTS

FORMS = ("plain", "alpha", "beta", "wrapped", "weights", "reference")


def zip_of(folder, target, inside=""):
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in sorted(folder.rglob("*")):
            if "__pycache__" not in file.parts and file.is_file():
                archive.write(file, inside + str(file.relative_to(folder)))
    return str(target)


def names_of(result):
    return {row.driver for row in result.agents}


def load(source):
    with ExitStack() as life:
        return load_agent(find_files(str(source)).place(life))


@pytest.mark.slow
def test_agents_of_all_forms_race_to_the_finish(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(AGENTS / "module_home")
    drivers = [str(AGENTS / name) for name in FORMS]
    drivers += [
        zip_of(AGENTS / "weights", tmp_path / "zipped.zip") + "@:Zipped",
        "bare_module_agent@:Module",
    ]
    result = run_race(drivers, track="lighthouse", seed=1)
    assert [row.errors for row in result.agents if row.errors] == []
    assert result.is_finished
    assert names_of(result) == {name.title() for name in FORMS} | {"Zipped", "Module"}


@pytest.mark.slow
@pytest.mark.parametrize("inline", [True, False])
def test_agents_with_modules_of_the_same_name_do_not_collide(inline, tmp_path):
    """D20: both agents are a package ``stk_actor`` with a module ``driving``."""
    drivers = [
        str(AGENTS / "alpha"),
        str(AGENTS / "beta"),
        zip_of(AGENTS / "beta", tmp_path / "b.zip"),
    ]
    result = run_race(drivers, track="lighthouse", seed=1, max_steps=60, inline=inline)
    assert [row.driver for row in sorted(result.agents, key=lambda row: row.agent)] == [
        "Alpha",
        "Beta",
        "Beta-2",
    ]
    assert not result.has_errors


def test_inline_agents_leave_no_modules_behind():
    before = set(sys.modules), list(sys.path)
    run_race(
        [str(AGENTS / "alpha"), str(AGENTS / "plain")], track="lighthouse", max_steps=3, inline=True
    )
    left = {name for name in set(sys.modules) - before[0] if "actor" in name or "helper" in name}
    assert (left, sys.path) == (set(), before[1])


@pytest.mark.parametrize("inside", ["", "repository/", "stk_actor/", "repository/stk_actor/"])
def test_the_agent_can_be_in_several_places_in_a_zip(inside, tmp_path):
    path = zip_of(AGENTS / "alpha" / "stk_actor", tmp_path / "agent.zip", inside)
    assert load(path).name == "Alpha"


@pytest.mark.parametrize("name", ["numpy", "json", "stkzoo"])
def test_a_package_can_have_the_name_of_a_library(name, tmp_path):
    shutil.copytree(AGENTS / "alpha" / "stk_actor", tmp_path / name)
    (tmp_path / name / "uses.py").write_text(f"import {name}\nplace = {name}.__file__\n")
    with (tmp_path / name / "__init__.py").open("a") as file:
        file.write("from .uses import place\nplayer_name = place\n")
    with (tmp_path / name / "pystk_actor.py").open("a") as file:
        file.write("from . import player_name\n")
    library = importlib.import_module(name)
    assert load(tmp_path / name).name == library.__file__
    assert sys.modules[name] is library


@pytest.mark.parametrize("inside", ["team/agent/", "agent/"])
def test_an_agent_in_an_inner_folder_of_a_zip_is_named(inside, tmp_path):
    path = zip_of(AGENTS / "alpha" / "stk_actor", tmp_path / "agent.zip", inside)
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("README.md", "")
    message = f"has its pystk_actor.py in the inner folder '{inside[:-1]}'; zip that folder alone"
    with pytest.raises(ConfigError, match=message):
        load(path)


def test_an_agent_in_a_folder_imports_the_modules_beside_it():
    """D29."""
    assert load(AGENTS / "plain").name == "Plain"


@pytest.mark.slow
def test_an_adapter_creates_the_actors(tmp_path):
    adapter = tmp_path / "adapter.py"
    adapter.write_text(
        "def prepare_module_dir(folder):\n"
        "    (folder / 'helper.py').write_text('def chase(points): return None')\n"
        "def create_actor(get_actor, module_dir, observation_space, action_space):\n"
        "    actor = get_actor(module_dir, observation_space, action_space)\n"
        "    def act(state, observation):\n"
        "        assert actor(state, observation) is None\n"
        "        return {**action_space.sample(), 'brake': 0}\n"
        "    return act\n"
    )
    folder = shutil.copytree(AGENTS / "plain", tmp_path / "plain")
    result = run_race([str(folder)], track="lighthouse", max_steps=3, adapter=str(adapter))
    assert result.agents[0].errors == ()


@pytest.mark.slow
def test_unpacked_files_are_removed_after_the_race(tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    path = zip_of(AGENTS / "weights", tmp_path / "agent.zip")
    assert not run_race([path], track="lighthouse", max_steps=3).has_errors
    assert not list(tmp_path.glob("*/agent-*"))


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("{}/missing", "there is no agent"),
        ("{}/missing.zip", "there is no agent"),
        ("{}/note.txt", "another kind of file"),
        ("{}/empty", "has no pystk_actor.py"),
        ("{}/empty.zip", "has no pystk_actor.py in it"),
        ("{}/broken.zip", "not a readable zip"),
        ("{}/empty@:", "has no name after @:"),
        ("heuristik", "Did you mean 'heuristic'"),
        ("no.such.module", "unknown driver"),
    ],
)
def test_an_invalid_agent_is_refused_before_the_race(source, message, tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "note.txt").write_text("hello")
    (tmp_path / "broken.zip").write_bytes(b"PK\x03\x04 but not really")
    zip_of(tmp_path / "empty", tmp_path / "empty.zip")
    with pytest.raises(ConfigError, match=message):
        find_driver(source.format(tmp_path))


@pytest.mark.slow
def test_an_agent_does_not_run_when_it_is_named_or_planned(tmp_path):
    mark, folder = tmp_path / "mark", tmp_path / "stranger"
    folder.mkdir()
    (folder / "pystk_actor.py").write_text(
        f"open({str(mark)!r}, 'w').close()\n"
        "def get_actor(*_):\n"
        "    return lambda state, observation: None\n"
    )
    packed = zip_of(folder, tmp_path / "packed.zip")
    single = shutil.copy(folder / "pystk_actor.py", tmp_path / "single.py")
    for source in map(str, (folder, packed, single)):
        find_driver(source)
        plan_tournament([source, "ai"])
        assert not mark.exists()
        run_race([source], track="lighthouse", max_steps=1, sandbox="off")
        mark.unlink()  # a race runs it


@pytest.mark.parametrize(
    ("code", "message"),
    [
        (
            "env_name = 'supertuxkart/ful-v0'\ndef get_actor(*_): ...",
            "Did you mean 'supertuxkart/full-v0'",
        ),
        ("env_name = 3\ndef get_actor(*_): ...", "expected text such as"),
        (
            "env_name = ('simple', {'state_itmes': 3})\ndef get_actor(*_): ...",
            "Did you mean 'state_items'",
        ),
    ],
)
def test_errors_in_an_agents_module_are_reported(code, message, tmp_path):
    (tmp_path / "pystk_actor.py").write_text(code)
    result = run_race([str(tmp_path)], track="lighthouse", max_steps=2, inline=True)
    assert message in result.agents[0].errors[0].message


@pytest.mark.slow
@pytest.mark.parametrize("inline", [True, False])
def test_an_agent_can_set_options_of_its_environment(inline, tmp_path):
    (tmp_path / "pystk_actor.py").write_text(
        "env_name = ['supertuxkart/flattened_discrete-v0', {'state_items': 1, 'steer_steps': 3}]\n"
        "def get_actor(module_dir, observation_space, action_space):\n"
        "    assert observation_space['continuous'].shape == (80,), observation_space\n"
        "    assert action_space.n == 480, action_space\n"
        "    return lambda state, observation: 0 * len(observation['continuous'][79:]) + 4\n"
    )
    result = run_race([str(tmp_path)], track="lighthouse", max_steps=5, inline=inline, seed=1)
    assert result.agents[0].errors == ()


# ---------------------------------------------------------------------- zips


def written(path, *members):
    """Writes a zip with a valid agent and additional members ``(name, mode, content)``."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("pystk_actor.py", "def get_actor(*_): ...")
        for name, mode, content in members:
            member = zipfile.ZipInfo(name)
            member.external_attr = mode << 16
            member.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(member, content)
    return str(path)


@pytest.mark.parametrize(
    "name",
    ["../out.py", "a/../../out.py", "/tmp/out.py", "..\\out.py", "."],
)
def test_a_path_outside_the_zips_folder_is_refused(name, tmp_path):
    with pytest.raises(ConfigError, match=r"leads out of it|has backslashes"):
        find_driver(written(tmp_path / "a.zip", (name, stat.S_IFREG | 0o644, "x")))


@pytest.mark.parametrize("kind", [stat.S_IFLNK, stat.S_IFIFO, stat.S_IFCHR])
def test_a_link_or_device_in_a_zip_becomes_a_plain_file(kind, tmp_path):
    path = written(tmp_path / "a.zip", ("weights", kind | 0o777, "/etc/passwd"))
    files.unpack(Path(path), tmp_path / "out")
    weights = tmp_path / "out" / "weights"
    assert stat.S_ISREG(weights.lstat().st_mode)
    assert weights.read_text() == "/etc/passwd"


def test_a_zip_bomb_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(files, "MAX_BYTES", 1 << 20)
    with pytest.raises(ConfigError, match="unpacked it is larger than 1,048,576 bytes"):
        find_driver(written(tmp_path / "a.zip", ("big", stat.S_IFREG, bytes(2 << 20))))


def test_a_zip_of_too_many_files_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(files, "MAX_FILES", 3)
    members = [(f"{number}", stat.S_IFREG, "") for number in range(3)]
    with pytest.raises(ConfigError, match="it has more than 3 files"):
        find_driver(written(tmp_path / "a.zip", *members))


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_a_zip_with_unbounded_compression_is_refused(tmp_path, method):
    """64 kB of bzip2 can unpack to a gigabyte before the size is compared with the directory."""
    with zipfile.ZipFile(tmp_path / "a.zip", "w", method) as archive:
        archive.writestr("pystk_actor.py", "def get_actor(*_): ...")
    with pytest.raises(ConfigError, match="has an unusual compression, expected deflate"):
        find_driver(str(tmp_path / "a.zip"))


def test_a_zip_with_a_long_directory_is_refused_with_little_memory(tmp_path):
    """Python would create an object for each of the 200,000 entries in the zip's directory."""
    count, entry = 200_000, b"PK\1\2" + bytes(42)
    end = struct.pack("<4s4H2LH", b"PK\5\6", 0, 0, 1, 1, count * len(entry), 0, 0)
    (tmp_path / "a.zip").write_bytes(count * entry + end)
    tracemalloc.start()
    with pytest.raises(ConfigError, match="more than 4000 files"):
        find_driver(str(tmp_path / "a.zip"))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 16 << 20


@pytest.mark.parametrize("source", ["~nobody_of_this_name/a", "a" * 5000, "a\0b"])
def test_an_invalid_path_is_refused(source):
    with pytest.raises(ConfigError):
        find_driver(source)


@pytest.mark.parametrize("name", [b"caf\xe9", b"a\x1b[2J"])
def test_a_path_that_cannot_be_shown_is_refused(name, tmp_path):
    folder = tmp_path / os.fsdecode(name)
    shutil.copytree(AGENTS / "plain", folder)
    with pytest.raises(ConfigError, match=r"\?.* has control codes or letters .*; rename it"):
        find_driver(str(folder))


def test_a_zip_that_lies_about_its_size_is_refused(tmp_path, monkeypatch):
    """The sizes in the zip's directory are used for early refusal only."""
    path = Path(written(tmp_path / "a.zip", ("big", stat.S_IFREG, b"ab" * 4000)))
    data = path.read_bytes().replace((8000).to_bytes(4, "little"), (80).to_bytes(4, "little"))
    path.write_bytes(data)
    monkeypatch.setattr(files, "MAX_BYTES", 1000)
    with pytest.raises(ConfigError, match=r"larger than|cannot be|not a readable zip"):
        files.unpack(path, tmp_path / "out")
    assert sum(file.stat().st_size for file in (tmp_path / "out").rglob("*")) < 2000


def test_two_files_with_the_same_name_are_refused(tmp_path):
    with pytest.warns(UserWarning, match="Duplicate name"):
        path = written(tmp_path / "a.zip", *[("twice", stat.S_IFREG, "x")] * 2)
    with pytest.raises(ConfigError, match="the file 'twice' more than once"):
        files.unpack(Path(path), tmp_path / "out")


@pytest.mark.parametrize(
    "names", [["a", "a/b"], ["a/b", "a"], ["a/b", "a//b"], ["C:/a", "./a"]], ids=str
)
def test_a_zip_with_strange_names_is_refused_or_stays_in_its_folder(names, tmp_path):
    path = written(tmp_path / "a.zip", *((name, stat.S_IFREG, "x") for name in names))
    with suppress(ConfigError):
        files.unpack(Path(path), tmp_path / "out")
    assert {entry.name for entry in tmp_path.iterdir()} == {"a.zip", "out"}


def test_unpacked_files_have_no_special_mode(tmp_path):
    path = written(tmp_path / "a.zip", ("run", stat.S_IFREG | 0o6777, "x"))
    files.unpack(Path(path), tmp_path / "out")
    assert (tmp_path / "out" / "run").stat().st_mode & 0o7133 == 0


def names_of_folders(count, depth):
    return ["/".join(f"{chain}_{level}" for level in range(depth)) for chain in range(count)]


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ([f"{folder}/x" for folder in names_of_folders(50, 11)], "more than 500 folders"),
        ([f"{number}/x" for number in range(501)], "more than 500 folders"),
        (["a/" * 40 + "x"], "is in too many folders or has a long name"),
        (["a/" * 2040 + "x"], "is in too many folders or has a long name"),
        (["a" * 300], "is in too many folders or has a long name"),
        (["\N{SNOWMAN}" * 90], "is in too many folders or has a long name"),
    ],
    ids=lambda value: value if isinstance(value, str) else value[0][:12],
)
def test_a_zip_that_makes_a_bad_folder_is_refused_before_it_is_unpacked(tmp_path, names, message):
    path = written(tmp_path / "a.zip", *((name, stat.S_IFREG, "") for name in names))
    with pytest.raises(ConfigError, match=message):
        find_driver(path)


def test_a_zip_with_long_names_is_refused_with_little_memory(tmp_path):
    """1,000 names of 60 kB each."""
    entry = b"PK\1\2" + bytes(24) + struct.pack("<H", 60_000) + bytes(16) + b"a" * 60_000
    end = struct.pack("<4s4H2LH", b"PK\5\6", 0, 0, 1000, 1000, 1000 * len(entry), 0, 0)
    (tmp_path / "a.zip").write_bytes(1000 * entry + end)
    tracemalloc.start()
    with pytest.raises(ConfigError, match="its list of files is too long"):
        find_driver(str(tmp_path / "a.zip"))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 16 << 20
