"""A course: its starter kit, and the hand-ins of its participants."""

import json
import os
import subprocess
import sys
import zipfile

import pytest

from stkzoo.cli import main
from stkzoo.cli.tournament import collect_agents
from stkzoo.errors import ConfigError

#: A wheel of this name and content prints what it would run.
WHEEL = "stkzoo-9.0-py3-none-any.whl"
FILES = {
    "stkzoo/__main__.py": "import sys; print('ran', *sys.argv[1:])",
    "stkzoo-9.0.dist-info/METADATA": "Metadata-Version: 2.1\nName: stkzoo\nVersion: 9.0\n",
    "stkzoo-9.0.dist-info/WHEEL": "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
    "stkzoo-9.0.dist-info/RECORD": "",
}


def write_zip(file, members, time=0):
    file.parent.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(file, "w") as archive:
        for name, text in members.items():
            archive.writestr(name, text)
    os.utime(file, (time, time))
    return str(file)


@pytest.fixture
def kit(tmp_path, monkeypatch):
    wheel = write_zip(tmp_path / WHEEL, FILES)
    monkeypatch.setattr("stkzoo.cli.course.pack", lambda output, **_: output.touch())
    assert main(["course", str(tmp_path / "kit"), "--wheel", wheel]) == 0
    return tmp_path / "kit"


@pytest.mark.slow
def test_students_start_without_an_index_and_install_once(kit):
    offline = {**os.environ, "PYTHON": sys.executable, "PIP_NO_INDEX": "1"}
    outputs = [
        subprocess.run(
            ["sh", "start"], cwd=kit, env=offline, capture_output=True, text=True, check=True
        ).stdout.splitlines()
        for _ in range(2)
    ]
    race, install = "ran race my_agent ai ai --track", "ran assets install --from stk.tar.xz"
    assert [line.startswith(race) for line in outputs[1]] == [True, False, False]
    assert outputs[0][-4:] == [install, *outputs[1]]


@pytest.mark.matrix
def test_the_notebook_of_the_kit_runs(kit):
    cells = json.loads((kit / "race.ipynb").read_text())["cells"]
    code = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
    program = "\n".join(text for text in code if not text.startswith("!"))
    variables = {**os.environ, "MPLBACKEND": "Agg", "PYTHONPATH": str(kit)}
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=kit, env=variables, capture_output=True, text=True
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert "seed 2: rank" in done.stdout


def test_a_kit_needs_a_wheel_of_stkzoo(tmp_path, capsys):
    other = write_zip(tmp_path / "numpy-2.0-py3-none-any.whl", {})
    assert main(["course", str(tmp_path / "kit"), "--wheel", other]) == 2
    assert "wheels of the versions (none) of stkzoo" in capsys.readouterr().err
    assert not [*(tmp_path / "kit").iterdir()]


def test_the_newest_valid_hand_in_before_the_deadline_races(tmp_path, capsys):
    home, cup = tmp_path / "hand-ins", tmp_path / "cup"
    for time, version in enumerate("abc", 1):
        write_zip(home / "ada" / f"{version}.zip", {"a/pystk_actor.py": version}, time)
    write_zip(home / "ada" / "broken.zip", {"a/other.py": ""}, 2.5)
    write_zip(home / "bob@:x.zip", {"pystk_actor.py": "b"}, 1)
    write_zip(home / "eve.zip", {"pystk_actor.py": ""}, 9)
    (home / "fay").mkdir()
    link = home / "fay" / "theirs.zip"
    link.symlink_to(home / "bob@:x.zip")
    os.utime(link, (1, 1), follow_symlinks=False)
    first = collect_agents(home, "1970-01-01T00:00:02.700+00:00", cup)
    copies = [str(cup / "hand-ins" / name) for name in ("ada.zip", "bob@-x.zip")]
    assert first == tuple(copies)
    with zipfile.ZipFile(copies[0]) as archive:
        assert archive.read("a/pystk_actor.py") == b"b"
    said = capsys.readouterr().err
    for text in ("c.zip is late", "has no pystk_actor.py", "eve.zip is late", "theirs.zip is not"):
        assert text in said
    os.utime(home / "bob@:x.zip", (4e9, 4e9))
    assert collect_agents(home, None, cup) == (*copies, str(cup / "hand-ins" / "eve.zip"))
    assert "bob@:x.zip is newer than" in capsys.readouterr().err


def test_invalid_deadlines_are_refused(tmp_path):
    for deadline in ("2020-01-01", "tomorrow 18:00"):
        with pytest.raises(ConfigError, match="expected a time such as"):
            collect_agents(tmp_path, deadline, tmp_path / "cup")
    with pytest.raises(ConfigError, match="is in the future"):
        collect_agents(tmp_path, "9000-01-01T18:00", tmp_path / "cup")
    with pytest.raises(ConfigError, match="--hand-ins is None, expected the folder"):
        collect_agents(None, "2020-01-01T18:00", tmp_path / "cup")
    assert not (tmp_path / "cup").exists()
