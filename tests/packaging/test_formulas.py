"""A formula that is changed at the place that the documentation names changes a real race."""

import json
import os
import subprocess
import sys

import pytest

from tests.support.paths import ROOT, copy_checkout

#: For each source file, a line that the test changes.
CHANGES = {
    "stkzoo/kernel/step_scorer.c": ("    return -0.1;\n", "    return -100.0;\n"),
    "stkzoo/kernel/kart_observer.c": (
        '{"paths_end", NUMBER, PATHS, 3, NODES, 3 * sizeof(float), IS_POINT | IS_PLACE}',
        '{"paths_end", NUMBER, PATHS, 3, NODES, 0, IS_POINT | IS_PLACE}',
    ),
}

PROGRAM = """
import json
import numpy as np
from stkzoo import race_v0

found = {}
with race_v0.parallel_env(num_kart=2, track="lighthouse", view="simple", reward="reference") as env:
    env.reset(seed=1)
    observations, *_, infos = env.step({a: env.action_space(a).sample() for a in env.agents})
    seen = observations["kart_0"]
    found["time"] = infos["kart_0"]["reward/time"]
    found["is_end_start"] = bool((seen["paths_end"] == seen["paths_start"]).all())
print(json.dumps(found))
"""


def race(checkout):
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        env={**os.environ, "PYTHONPATH": str(checkout)},
        cwd=checkout,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.slow
@pytest.mark.parametrize("words", [["-m", "stkzoo", "doctor"], ["-c", "import stkzoo"]])
def test_a_checkout_without_extensions_says_how_to_build_them(tmp_path, words):
    checkout = copy_checkout(tmp_path / "stkzoo")
    done = subprocess.run(
        [sys.executable, *words],
        env={**os.environ, "PYTHONPATH": str(checkout)},
        cwd=checkout,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 1
    *_, last = done.stderr.splitlines()
    assert last.startswith("ImportError: stkzoo's C extension is not built for this code")
    assert last.endswith(f'pip install -e "{checkout}"')


@pytest.mark.slow
def test_a_changed_reward_term_and_a_changed_observation_take_effect(tmp_path):
    checkout = copy_checkout(tmp_path / "stkzoo")
    for name, (old, new) in CHANGES.items():
        text = (checkout / name).read_text()
        assert text.count(old) == 1, name
        (checkout / name).write_text(text.replace(old, new))
    subprocess.run(
        [sys.executable, "setup.py", "-q", "build_ext", "--inplace"],
        env={**os.environ, "CFLAGS": "-O0"},  # builds in half of the time
        cwd=checkout,
        check=True,
        capture_output=True,
    )
    assert race(ROOT) == {"time": -0.1, "is_end_start": False}
    assert race(checkout) == {"time": -100.0, "is_end_start": True}


def test_the_documentation_names_these_files():
    (table,) = (
        part
        for part in (ROOT / "docs" / "architecture.md").read_text().split("\n## ")
        if part.startswith("Where to make a change")
    )
    for name in CHANGES:
        assert f"`{name}`" in table
