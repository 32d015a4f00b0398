"""The league and the reference algorithms learn for 100,000 kart-steps, killed once on the way."""

import json
import os

import pytest

from stkzoo.agents.training.league.league import main as league
from stkzoo.agents.training.suite.algorithms import TaskArguments
from stkzoo.cli import main
from tests.support.training import log_of, run_and_kill, words_of

pytestmark = [
    pytest.mark.slow,
    pytest.mark.matrix,
    pytest.mark.timeout(1800),
    pytest.mark.skipif(os.name != "posix", reason="kills by signal"),
]
KART_STEPS = 100_000


@pytest.mark.parametrize(
    ("algorithm", "task"),
    [("ippo", "solo-general"), ("mappo", "team-2v2"), ("pfsp", "team-2v2")],
)
def test_a_reference_algorithm_resumes_after_a_kill(tmp_path, monkeypatch, algorithm, task):
    monkeypatch.setattr(
        "stkzoo.agents.training.suite.algorithms.TaskArguments",
        lambda **given: TaskArguments(**{"checkpoint_every": 4, "num_starts": 8, **given}),
    )
    words = ["suite", "train", task, algorithm, f"--kart-steps={KART_STEPS}"]
    words.append(f"--output={tmp_path}")
    run_and_kill(main, words, tmp_path / "log.jsonl", lines=5, seconds=900)
    checkpoint = (tmp_path / "checkpoint.pt").stat().st_mtime
    assert main(words) == 0
    log = log_of(tmp_path)
    assert [line["iteration"] for line in log] == list(range(1, len(log) + 1))
    assert log[-1]["kart_steps"] >= KART_STEPS
    assert (tmp_path / "checkpoint.pt").stat().st_mtime > checkpoint
    assert (tmp_path / "agent" / "card.json").exists()


def test_a_league_resumes_after_a_kill(tmp_path):
    small = {"turn": 30_000, "matches": 2}
    words = words_of(tmp_path, small, total_timesteps=KART_STEPS)
    run_and_kill(league, words, tmp_path / "exploiter-g0" / "log.jsonl", lines=2, seconds=900)
    assert league(words) == 0
    state = json.loads((tmp_path / "league.json").read_text())
    assert state["kart_steps"] >= KART_STEPS
    names = [member["name"] for member in state["members"]]
    assert names[:4] == ["start", "main-001", "exploiter-001", "league-exploiter-001"]
    assert set(state["ratings"]) >= set(names)
