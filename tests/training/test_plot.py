"""The plot of training runs reads logs of any content."""

import json

import pytest

from stkzoo.agents.training.plot import read_figures
from stkzoo.errors import ConfigError


def test_the_log_of_another_program_is_an_error(tmp_path):
    (tmp_path / "log.jsonl").write_text('{"generation": 1}\n')
    with pytest.raises(ConfigError, match=r"log\.jsonl' cannot be drawn .*has neither"):
        read_figures(tmp_path)


def test_figures_that_were_not_measured_are_accepted(tmp_path):
    line = {"round": 1, "time_ratio": None, "error": None, "loss": None}
    (tmp_path / "log.jsonl").write_text(json.dumps(line) + "\n")
    assert read_figures(tmp_path) == [line]
