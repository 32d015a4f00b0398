"""Fast reading of the engine's world, compared with its attributes in whole races."""

import subprocess
import sys
import textwrap

import pytest

from stkzoo.engine.assets import find_assets

PROGRAM = """
    import os, sys
    import numpy as np
    from pathlib import Path
    from stkzoo.kernel.reference import game_stepper
    from stkzoo.engine.session import LocalSession
    from stkzoo.engine.setup import KartSetup, RaceSetup

    track, num_kart = sys.argv[2], int(sys.argv[3])
    karts = tuple(KartSetup(name="n" * i, kart=["", "gnu"][i % 2]) for i in range(num_kart))
    session = LocalSession(Path(sys.argv[1]))
    session.start(RaceSetup(track, karts, seed=3, difficulty=3))
    race = session._race
    twin = game_stepper.GameStepper(
        race._race, race._world, [], (), race._phases, 3, race._reporting
    )
    controls = np.zeros((0, 7), np.float32)
    steps, numbers_of_items, finished = 0, set(), 0
    while (snapshot := session.step(controls)).running and steps < 700:
        if snapshot.data != twin.read(True):
            raise SystemExit(f"step {steps}: they differ")
        steps += 1
        numbers_of_items.add(len(snapshot.items))
        finished = int(snapshot.karts["has_finished_race"].sum())
    is_fast = type(race._stepper) is not game_stepper.GameStepper
    print(is_fast, steps > 100, len(numbers_of_items) > 1, finished > 0)
"""


def run(*arguments, program=PROGRAM):
    return subprocess.run(
        [sys.executable, "-c", textwrap.dedent(program), str(find_assets().root), *arguments],
        capture_output=True,
        text=True,
        timeout=120,
    )


@pytest.mark.slow
@pytest.mark.parametrize(("track", "num_kart"), [("olivermath", 6), ("zengarden", 3)])
def test_the_block_matches_the_attributes_in_a_whole_race(track, num_kart):
    program = run(track, str(num_kart))
    assert program.stdout.split()[:2] == ["True", "True"], program.stderr
    assert program.stdout.split()[3] == "True"


@pytest.mark.slow
def test_a_changing_number_of_items_is_read():
    assert run("olivermath", "6").stdout.split()[2] == "True"


@pytest.mark.slow
def test_an_engine_with_another_block_layout_is_read_by_attribute():
    program = """
        import sys
        from pathlib import Path
        from stkzoo.engine.session import LocalSession
        from stkzoo.engine.setup import KartSetup, RaceSetup
        from stkzoo.engine.snapshot import Snapshot

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
        race = session._race
        race._world = Shifted(race._world)
        by_attribute = race._new_stepper()
        snapshot = Snapshot(by_attribute.read(True))
        print(type(by_attribute).__module__, len(snapshot.karts), len(snapshot.items) > 10)
    """
    assert run(program=program).stdout.split() == [
        "stkzoo.kernel.reference.game_stepper",
        "2",
        "True",
    ]
