"""Programs that close all file descriptors, as daemons do, or the standard streams."""

import subprocess
import sys
import textwrap

import pytest

from tests.support.paths import ROOT

PREPARED = """
    import os, socket, sys
    from stkzoo import EngineCrashed, race_v0
    options = dict(num_kart=2, track="lighthouse", view="flattened_discrete")

    def step():
        env.step(dict.fromkeys(env.agents, 0))

    def drive():
        env.reset(seed=1)
        step()

    def close_all():
        os.closerange(3, 64)
"""
MADE = "env = race_v0.parallel_env(**options)"


def run(*code):
    program = "\n".join(map(textwrap.dedent, [PREPARED, *code]))
    return subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=60, cwd=ROOT
    )


def assert_prints(code, *lines):
    program = run(MADE, code)
    assert (program.stdout.split("\n")[:-1], program.stderr) == ([*lines], "")
    assert program.returncode == 0


@pytest.mark.slow
def test_a_step_after_all_descriptors_were_closed_names_the_cause():
    code = """
        drive()
        close_all()
        try:
            step()
        except EngineCrashed as error:
            print(error.message)
    """
    assert_prints(
        code,
        "the game's process was lost: this program closed a file descriptor of stkzoo, as "
        "os.closerange and daemon libraries do; call reset() to start a new one",
    )


@pytest.mark.slow
def test_a_reset_works_after_all_descriptors_were_closed():
    assert_prints(
        """
        for _ in range(3):
            drive()
            close_all()
        drive()
        print("goes on")
        """,
        "goes on",
    )


@pytest.mark.slow
def test_descriptors_of_other_files_are_not_touched():
    assert_prints(
        """
        env.reset()
        state = env.save_state()
        step()
        close_all()
        ends = [end for _ in range(8) for end in socket.socketpair()]
        for end in ends:
            end.setblocking(False)
        env.close()
        state.close()
        drive()
        env.close()
        for end in ends[::2]:
            end.send(b"mine")
        print({end.recv(100) for end in ends[1::2]})
        """,
        "{b'mine'}",
    )


@pytest.mark.slow
def test_a_step_on_a_foreign_socket_does_not_hang():
    assert_prints(
        """
        env = race_v0.parallel_env(**options, engine_timeout=0.5)
        env.reset()
        close_all()
        ends = [end for _ in range(8) for end in socket.socketpair()]
        try:
            step()
        except EngineCrashed as error:
            print("was lost" in error.message)
        env.reset()
        """,
        "True",
    )


@pytest.mark.slow
def test_a_state_saved_before_all_descriptors_were_closed_is_lost_with_a_clear_error():
    assert_prints(
        """
        env.reset()
        state = env.save_state()
        close_all()
        env.reset()
        try:
            env.restore_state(state)
        except EngineCrashed as error:
            print("closed a file descriptor of stkzoo" in error.message)
        step()
        """,
        "True",
    )


@pytest.mark.slow
@pytest.mark.parametrize("streams", ["0, 1, 2", "0", "1, 2"])
@pytest.mark.parametrize("use_subprocess", [True, False])
def test_a_race_runs_with_closed_standard_streams(streams, use_subprocess):
    program = run(f"""
        for stream in ({streams},):
            os.close(stream)
        env = race_v0.parallel_env(**options, use_subprocess={use_subprocess})
        drive()
        drive()
        env.close()
        os._exit(7)
    """)
    assert program.returncode == 7, program.stderr
