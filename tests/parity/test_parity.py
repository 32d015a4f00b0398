"""Races in stkzoo and in pystk2-gymnasium 0.10.0 are equal except for documented differences."""

import json
import subprocess
import sys

import pytest

from tests.support.paths import ROOT

pytestmark = pytest.mark.slow


def compare(output, *words, expected=0):
    """Compares races; returns the results and what the command says."""
    command = [sys.executable, "-m", "benchmarks.parity", "--output", output, *words]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=False)
    assert done.returncode == expected, done.stdout[-3000:] + done.stderr[-3000:]
    return json.loads(output.read_text())["results"], done.stdout


def intended(results):
    """Returns the codes of the differences in some results."""
    return {code for result in results for code in result["intended"]}


def test_races_match_the_reference_in_both_of_its_modes(tmp_path):
    views = ("multi-full", "simple", "flattened_multidiscrete", "flattened_continuous_actions")
    words = ["--ids", *(f"supertuxkart/{view}-v0" for view in views), "--steps", "40"]
    results, _ = compare(tmp_path / "races.json", *words, "--track", "olivermath")
    assert len(results) == 18
    assert all(result["steps"] == 40 for result in results)
    assert "D31" in intended(results)  # the reference's own process does not send the phase


@pytest.mark.matrix
def test_a_whole_race_matches_the_reference_except_for_repeated_bonuses(tmp_path):
    words = ["--ids", "supertuxkart/multi-full-v0", "--track", "olivermath", "--modes", "direct"]
    results, _ = compare(tmp_path / "races.json", *words)
    assert min(result["steps"] for result in results) < 300
    assert "D05" in intended(results)


def test_an_undocumented_difference_is_reported(tmp_path):
    """A documented difference counts as undocumented."""
    words = ["--ids", "supertuxkart/full-v0", "--track", "olivermath", "--modes", "process"]
    words += ["--steps", "20", "--show", "D31"]
    results, said = compare(tmp_path / "races.json", *words, expected=1)
    assert "undocumented: supertuxkart/full-v0 olivermath: observation/phase (value)" in said
    assert "D31" not in intended(results)


@pytest.mark.matrix
@pytest.mark.timeout(1800)
def test_races_on_all_tracks_of_the_comparison_match_the_reference(tmp_path):
    compare(tmp_path / "races.json")
