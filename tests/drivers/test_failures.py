"""Reports of agents that print and fail, in races of the real game."""

import pytest

from stkzoo.cli import main
from stkzoo.drivers.failures import bounded, fitted, json_size, printable
from stkzoo.race import run_race

ACT = "def get_actor(folder, seen, space):\n    def act(state, observation):\n{}\n    return act\n"

#: Failing agents by file name: their source, and parts of the message and the trace.
AGENTS = {
    "flood": (
        ACT.format("        print('\\x1b[31mred\\x1b[0m\\x07', flush=True)\n        1 / 0"),
        "ZeroDivisionError: division by zero",
        "last output:\nred?",
    ),
    "huge_value": (
        ACT.format("        return {'steer': 'x' * 1_000_000}"),
        "lacks acceleration",
        "xxx...\nits action space:   Dict(",
    ),
    "bad_repr": (
        "class Odd:\n    def __repr__(self): raise ValueError\n"
        + ACT.format("        return {'steer': Odd()}"),
        "lacks acceleration",
        "the agent returned: (dict: its __repr__ failed)\nits action space:   Dict(",
    ),
    "huge_message": (
        ACT.format("        raise ValueError('y' * 1_000_000)"),
        "characters left out",
        'File "huge_message.py", line 3, in act',
    ),
    "bad_str": (
        "class Odd(Exception):\n    def __str__(self): raise ValueError\n"
        + ACT.format("        raise Odd"),
        "Odd: (its __str__ failed)",
        'File "bad_str.py", line 5, in act',
    ),
    "ends": (
        ACT.format("        import os\n        print('bye')\n        os._exit(7)"),
        "its process exited with code 7",
        "bye",
    ),
    "syntax": ("def get_actor(\n", "SyntaxError", 'File "syntax.py", line 1'),
    "imports": ("import no_such_module\n", "No module named 'no_such_module'", ""),
    "chain": ("import neighbor\n", "ZeroDivisionError", 'File "neighbor.py", line 1'),
    "missing": ("x = 1\n", "has no function get_actor", ""),
    "signature": (
        "def get_actor():\n    pass\n",
        "get_actor takes (); expected (module_dir, observation_space, action_space)",
        "",
    ),
    "actor_signature": (
        "def get_actor(folder, seen, space):\n    return lambda observation: None\n",
        "the actor takes (observation); expected (state, observation)",
        "",
    ),
    "no_function": ("def get_actor(folder, seen, space):\n    pass\n", "returned None", ""),
}


@pytest.fixture(scope="module")
def failures(tmp_path_factory):
    """Returns the first failure of each agent by name, all from one race."""
    folder = tmp_path_factory.mktemp("agents")
    (folder / "neighbor.py").write_text("1 / 0\n")
    for name, (code, *_) in AGENTS.items():
        (folder / f"{name}.py").write_text(code)
    drivers = [str(folder / f"{name}.py") for name in AGENTS]
    result = run_race(drivers, track="lighthouse", max_steps=5, sandbox="off")
    return {row.driver: row.errors[0] for row in result.agents}


@pytest.mark.slow
@pytest.mark.parametrize("name", AGENTS)
def test_a_failure_says_what_went_wrong(name, failures):
    _, message, trace = AGENTS[name]
    failure = failures[name]
    assert message in failure.message
    assert trace in failure.trace
    assert len(failure.message) < 4200
    assert len(failure.trace) < 6000


@pytest.mark.slow
@pytest.mark.parametrize("name", AGENTS)
def test_a_trace_has_only_the_agents_own_frames(name, failures):
    trace = failures[name].trace
    assert "stkzoo" not in trace
    assert "importlib" not in trace
    assert "\x1b" not in trace


@pytest.mark.slow
@pytest.mark.parametrize("name", ["imports", "missing", "signature", "actor_signature"])
def test_an_error_with_a_sufficient_message_has_no_trace(name, failures):
    assert failures[name].trace == ""


def test_output_is_shown_with_the_agents_name(tmp_path, capfd):
    agent = tmp_path / "loud.py"
    agent.write_text(
        ACT.format(
            "        print('\\x1b[31mred\\x1b[0m\\x07')\n"
            "        print('x' * 10_000)\n"
            "        return space.sample()"
        )
    )
    run_race([str(agent)], track="lighthouse", max_steps=2, show_output=True)
    printed = capfd.readouterr()
    assert printed.out == ""
    lines = printed.err.splitlines()
    assert lines.count("loud (kart_0) | red?") == 2
    assert max(map(len, lines)) < 400


def test_long_output_is_cut_off(tmp_path, capfd):
    agent = tmp_path / "flood.py"
    agent.write_text(ACT.format("        print('y\\n' * 200_000)\n        return space.sample()"))
    run_race([str(agent)], track="lighthouse", max_steps=2, show_output=True)
    lines = capfd.readouterr().err.splitlines()
    assert len(lines) == 5001
    assert lines[-1] == "flood (kart_0) | (more output is not shown)"


@pytest.mark.slow
def test_all_load_errors_are_reported_before_the_race(tmp_path, capsys):
    names = ("syntax", "missing")
    for name in names:
        (tmp_path / f"{name}.py").write_text(AGENTS[name][0])
    words = ["race", *(str(tmp_path / f"{name}.py") for name in names), "--track", "lighthouse"]
    assert main(words) == 3
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.startswith("stkzoo: syntax (kart_0) could not be loaded: SyntaxError")
    assert "missing (kart_1) could not be loaded" in shown.err


def test_a_long_text_keeps_its_beginning_and_end():
    assert (
        bounded("a" * 30 + "b" * 30, 20)
        == f"{'a' * 10} ... (40 characters left out) ... {'b' * 10}"
    )
    assert bounded("short", 20) == "short"


@pytest.mark.parametrize("text", ["a" * 900, "\U0001f600" * 900, "a" * 500 + "," * 500])
def test_a_text_fits_a_size_in_a_json_file(text):
    assert fitted(text, json_size(text)) == text
    shorter = fitted(text, 600)
    assert "characters left out" in shorter
    assert (shorter[:9], shorter[-9:]) == (text[:9], text[-9:])
    assert json_size(shorter) <= 600
    assert fitted(text, 10) == ""


def test_escape_sequences_are_removed():
    assert printable("\x1b]0;title\x07\x1b[1;31mred\x1b[0m\x9b") == "red?"
