"""The engine's block of memory, compared with its attributes in whole races."""

import subprocess
import sys
import textwrap

import numpy as np
import pytest

from stkzoo import race_v0
from stkzoo.config import AgentSpec
from stkzoo.engine.assets import find_assets
from stkzoo.engine.snapshot import CONTROLS, Snapshot

PROGRAM = """
    import sys
    import numpy as np
    from pathlib import Path
    from stkzoo.engine.session import LocalSession
    from stkzoo.engine.setup import KartSetup, RaceSetup

    track, num_kart = sys.argv[2], int(sys.argv[3])
    karts = tuple(KartSetup(name="n" * i, kart=["", "gnu"][i % 2]) for i in range(num_kart))
    session = LocalSession(Path(sys.argv[1]))
    session.start(RaceSetup(track, karts, seed=3, difficulty=3))
    controls = np.zeros((0, 7), np.float32)
    steps, numbers_of_items, finished = 0, set(), 0
    while (snapshot := session.step(controls)).running and steps < 700:
        if snapshot != session._race.read_attributes():
            raise SystemExit(f"step {steps}: they differ")
        steps += 1
        numbers_of_items.add(len(snapshot.items))
        finished = int(snapshot.karts["has_finished_race"].sum())
    print(steps > 100, len(numbers_of_items) > 1, finished > 0)
"""

OTHER_LAYOUT = """
    import sys
    from pathlib import Path
    from stkzoo.engine.session import LocalSession
    from stkzoo.engine.setup import KartSetup, RaceSetup

    class Shifted:
        def __init__(self, world):
            self.karts, self.items = world.karts, world.items
            self.time, self.aux_ticks, self.phase = world.time, world.aux_ticks, world.phase
            self.update = world.update
            self.block = world.__getstate__()[0]
        def __getstate__(self):
            return (self.block[:90] + b"x" + self.block[90:],)

    session = LocalSession(Path(sys.argv[1]))
    session.start(RaceSetup("olivermath", (KartSetup(), KartSetup())))
    session._race._world = Shifted(session._race._world)
    session._race._new_stepper()
"""


def run(*arguments, program=PROGRAM):
    return subprocess.run(
        [sys.executable, "-c", textwrap.dedent(program), str(find_assets().root), *arguments],
        capture_output=True,
        text=True,
        timeout=120,
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("track", "num_kart", "items_change"), [("olivermath", 6, "True"), ("zengarden", 3, "")]
)
def test_the_block_matches_the_attributes_in_a_whole_race(track, num_kart, items_change):
    program = run(track, str(num_kart))
    drives, changes, finishes = program.stdout.split()[-3:] or [program.stderr] * 3
    assert (drives, finishes) == ("True", "True")
    assert items_change in changes


@pytest.mark.slow
def test_an_engine_with_another_block_layout_is_refused():
    assert (
        "lays out its state differently; install PySuperTuxKart2"
        in run(program=OTHER_LAYOUT).stderr
    )


def test_the_block_matches_the_attributes_in_all_phases_and_for_bots():
    agents = [AgentSpec(use_ai=True), AgentSpec(), AgentSpec()]
    env = race_v0.parallel_env(agents=agents, num_kart=4, track="lighthouse", use_subprocess=False)
    env.reset(seed=0)
    race = env.live_race.session._race
    for _ in range(45):
        actions = {agent: env.action_space(agent).sample() for agent in env.agents}
        env.step(actions)
        karts, seen = env.snapshot.karts.copy(), race.read_attributes()
        for number in (1, 2):  # the engine does not tell the controls of players
            controls = karts[env.race.kart_indices[number]]["control"]
            sent = [float(np.ravel(actions[f"kart_{number}"][name])[0]) for name in CONTROLS]
            assert controls.tolist() == sent
            controls[:] = 0.0
        assert seen == Snapshot.of(env.snapshot.header, karts, env.snapshot.items)
    with pytest.raises(ValueError, match="bytes of controls"):
        race._stepper.step(b"1234")
    env.close()
