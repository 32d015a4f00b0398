"""Training programs leave no processes behind when they are killed."""

import os
import subprocess
import sys
import uuid

import pytest

from tests.chaos.family import family, marked
from tests.support.processes import wait_until

pytestmark = pytest.mark.slow

SMALL = ["--track=olivermath", "--n-epochs=1", "--hidden", "16", "16"]
TRAINERS = {
    "imitation.imitate": ["--teacher=pursuit", "--karts=1", "--jobs=2", *SMALL],
    "ppo.selfplay": ["--total-timesteps=99999", "--races=2x1", "--n-steps=16", *SMALL],
    "sb3.selfplay": ["--total-timesteps=99999", "--races=2x1", *SMALL],
    "league.league": ["--total-timesteps=99999", "--races=2x1", "--n-steps=16", *SMALL],
}


@pytest.mark.parametrize(
    "name",
    [
        "ppo.selfplay",
        *(pytest.param(n, marks=pytest.mark.matrix) for n in TRAINERS if n != "ppo.selfplay"),
    ],
)
def test_a_killed_trainer_leaves_no_processes(tmp_path, name):
    mark = uuid.uuid4().hex
    with (tmp_path / "said").open("w") as said:
        program = subprocess.Popen(
            [sys.executable, "-m", f"stkzoo.agents.training.{name}", f"--output={tmp_path / 'run'}"]
            + TRAINERS[name],
            stdout=said,
            stderr=said,
            env=os.environ | {"STKZOO_TEST_MARK": mark},
        )
    try:
        races = lambda: any(member.kind == "race" for member in family(program.pid))  # noqa: E731
        assert wait_until(lambda: program.poll() is not None or races(), 60)
        assert program.poll() is None, (tmp_path / "said").read_text()
        assert len(marked(mark)) > 2
    finally:
        program.kill()
        program.wait()
    assert wait_until(lambda: not marked(mark), 10), marked(mark)
