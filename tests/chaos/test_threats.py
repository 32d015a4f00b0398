"""What untrusted files and machines can and cannot do, where no other test covers it.

The complete list is in ``docs/explanation/threat-model.md``.
"""

import ast
import json
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

import stkzoo
from stkzoo.race import RaceResult, run_race
from stkzoo.race.replay import ReplayWriter, load_replay, play_replay

pytestmark = pytest.mark.slow

ROOT = Path(stkzoo.__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "explanation" / "threat-model.md"
CODES = "\x1b[2Jgone\x1b]0;title\x07\r"

AGENT = """
player_name = {name!r}
env_name = "supertuxkart/flattened_discrete-v0"

def get_actor(module_dir, observation_space, action_space):
    def act(state, observation):
        {act}
        return 700
    return act
"""


def agent(folder, act="pass", name="a stranger"):
    folder.mkdir()
    (folder / "pystk_actor.py").write_text(AGENT.format(name=name, act=act))
    return str(folder)


def race(*drivers, **settings):
    return run_race(list(drivers), track="olivermath", seed=1, max_steps=12, **settings)


def test_an_agent_without_a_sandbox_reads_and_writes_the_users_files(tmp_path):
    """Without a sandbox, an agent has the user's permissions, as the page says."""
    (tmp_path / "diary.txt").write_text("dear diary")
    act = "open('diary.txt.copy', 'w').write(open('diary.txt').read())"
    stranger = agent(tmp_path / "a", f"import os; os.chdir({str(tmp_path)!r}); {act}")
    assert not race(stranger, "ai", sandbox="off").has_errors
    assert (tmp_path / "diary.txt.copy").read_text() == "dear diary"


def test_an_agent_cannot_drive_or_affect_another_kart(tmp_path):
    """Whatever an agent does in its own process, the other karts' race is bit for bit the same."""
    quiet = agent(tmp_path / "quiet")
    mean = (
        "import gc, os, random, signal, numpy; random.seed(); numpy.random.seed(); "
        "signal.signal(signal.SIGTERM, signal.SIG_IGN); os.nice(5); "
        "[o.fill(0) for o in gc.get_objects() if isinstance(o, numpy.ndarray) and "
        "o.flags.writeable and o.size > 99]"
    )
    loud = agent(tmp_path / "loud", mean)
    with_quiet = race(quiet, "heuristic", "ai")
    with_loud = race(loud, "heuristic", "ai")
    for one, other in zip(with_quiet.agents, with_loud.agents, strict=True):
        assert (one.agent, one.distance, one.reward) == (other.agent, other.distance, other.reward)
    assert not with_loud.has_errors


def test_text_from_an_agent_cannot_control_the_terminal(tmp_path):
    stranger = agent(tmp_path / "a", f"raise RuntimeError({CODES!r})", name=CODES)
    command = [sys.executable, "-m", "stkzoo", "race", stranger, "ai", "--track", "olivermath"]
    done = subprocess.run([*command, "--max-steps", "5"], capture_output=True, text=True)
    assert done.returncode == 3
    assert "gone" in done.stdout
    assert "\x1b" not in done.stdout + done.stderr
    with pytest.raises(stkzoo.AgentError) as caught:
        race(stranger, error_handling="raise")
    assert "\x1b" not in str(caught.value) + caught.value.trace


def test_text_from_a_file_cannot_control_the_terminal(tmp_path):
    file, changed = tmp_path / "race.stkz", tmp_path / "changed.stkz"
    race("heuristic", "ai", listeners=[ReplayWriter(file)])
    with zipfile.ZipFile(file) as old, zipfile.ZipFile(changed, "w") as new:
        for name in old.namelist():
            data = old.read(name)
            if name == "race.json":
                form = json.loads(data)
                form["agents"][0]["name"] = form["versions"]["python"] = CODES
                form["result"]["agents"][0]["driver"] = CODES
                data = json.dumps(form).encode()
            new.writestr(name, data)
    command = [sys.executable, "-m", "stkzoo", "replay", str(changed), "--info"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert "gone" in done.stdout
    assert "\x1b" not in done.stdout
    text = json.dumps(json.loads(load_replay(file).result.to_json()) | {"track": "olivermath"})
    told = RaceResult.from_json(text.replace("heuristic", r"\u001b[2J"))
    assert "\x1b" not in repr(told.agents) + told.to_json()


def test_a_forged_result_in_a_replay_is_detected(tmp_path):
    """A forged result in the replay is detected."""
    file = tmp_path / "race.stkz"
    race("heuristic", "ai", listeners=[ReplayWriter(file)])
    assert play_replay(load_replay(file)).is_exact
    with zipfile.ZipFile(file) as old:
        members = {name: old.read(name) for name in old.namelist()}
    form = json.loads(members["race.json"])
    for row in form["result"]["agents"]:
        row["reward"] += 100.0
    members["race.json"] = json.dumps(form).encode()
    with zipfile.ZipFile(file, "w") as new:
        for name, data in members.items():
            new.writestr(name, data)
    assert not play_replay(load_replay(file)).is_exact


#: Modules that unpickle bytes. Both ends belong to the same program.
UNPICKLING = {
    "stkzoo/drivers/driver.py",  # copies a policy of this program, in memory
}
RUNNING = {"eval", "exec", "compile"}
READERS = {"pickle", "cloudpickle", "dill", "joblib", "marshal", "shelve", "yaml"}
#: Folders of the shipped packages. ``stkzoo/agents`` and ``stkzoo/wrappers`` are links.
SHIPPED = ("stkzoo", "agents", "wrappers")


def test_only_listed_modules_unpickle_or_run_code():
    found, packages = set(), set()
    for package in SHIPPED:
        for file in (ROOT / package).rglob("*.py"):
            packages.add(package)
            if any(map(_unpickles_or_runs, ast.walk(ast.parse(file.read_text())))):
                found.add(str(file.relative_to(ROOT)))
    assert packages == {*SHIPPED}
    assert found == UNPICKLING


def _unpickles_or_runs(node):
    if isinstance(node, ast.ImportFrom):
        return node.module in READERS
    if not isinstance(node, ast.Call):
        return False
    called, options = ast.unparse(node.func), {option.arg for option in node.keywords}
    if called.endswith("load") and "torch" in called:
        return "weights_only" not in options
    module, _, function = called.rpartition(".")
    is_reader = module in READERS and function.startswith(("load", "open", "Unpickler"))
    return called in RUNNING or is_reader or "allow_pickle" in options


@pytest.mark.parametrize(
    ("line", "is_found"),
    [
        *(("pickle.load(file)", True), ("cloudpickle.loads(data)", True), ("eval(text)", True)),
        *(("from pickle import loads", True), ("numpy.load(file, allow_pickle=True)", True)),
        *(("torch.load(file)", True), ("torch.load(file, weights_only=True)", False)),
        *(("re.compile(text)", False), ("pickle.dumps(data)", False), ("json.loads(text)", False)),
    ],
)
def test_the_search_finds_code_that_unpickles_or_runs(line, is_found):
    assert any(map(_unpickles_or_runs, ast.walk(ast.parse(line)))) == is_found


def test_a_changed_result_file_is_read_as_it_is():
    """Results have no checksum; only a replay shows that a result is wrong."""
    text = race("heuristic", "ai").to_json()
    changed = json.loads(text)
    changed["agents"][0]["reward"] += 100.0
    assert RaceResult.from_json(json.dumps(changed)) != RaceResult.from_json(text)


def test_every_test_that_the_page_names_exists():
    named = set(re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", PAGE.read_text()))
    assert len(named) > 40
    for file, name in sorted(named):
        code = (ROOT / file).read_text()
        assert re.search(rf"def {name}\(", code), f"{file} has no {name}"


def test_every_row_of_the_page_names_a_test():
    rows = re.findall(r"^- .*(?:\n  .*)*", PAGE.read_text(), re.MULTILINE)
    assert len(rows) > 40
    assert [row for row in rows if "::" not in row] == []


def test_the_page_can_be_read_in_ten_minutes():
    assert len(PAGE.read_text().split()) <= 1500
