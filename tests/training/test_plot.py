"""The plot of training runs reads logs of any content."""

import json

import pytest

from stkzoo.agents.training.plot import read_figures
from stkzoo.errors import ConfigError


@pytest.mark.parametrize(
    ("line", "match"),
    [
        ({"kart_steps": None, "reward": 1.0}, "kart_steps"),
        ({"round": 1, "time_ratio": 1.0, "error": None}, "has a time_ratio and no error"),
        ({"round": 1, "loss": "low"}, "loss"),
    ],
)
def test_a_damaged_line_of_a_log_is_an_error(tmp_path, line, match):
    (tmp_path / "log.jsonl").write_text(json.dumps(line) + "\n")
    with pytest.raises(ConfigError, match=rf"log\.jsonl' cannot be drawn .*{match}"):
        read_figures(tmp_path)


def test_figures_that_were_not_measured_are_accepted(tmp_path):
    line = {"round": 1, "time_ratio": None, "error": None, "loss": None}
    (tmp_path / "log.jsonl").write_text(json.dumps(line) + "\n")
    assert read_figures(tmp_path) == [line]
