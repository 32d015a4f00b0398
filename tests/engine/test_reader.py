"""The quick way of reading the engine's world against the attributes, on whole races."""

import subprocess
import sys
import textwrap

import pytest

from stkzoo.engine.assets import find_assets

PROGRAM = """
    import os, sys
    import numpy as np
    from pathlib import Path
    from stkzoo.engine.reader import WorldReader
    from stkzoo.engine.session import LocalSession
    from stkzoo.engine.setup import KartSetup, RaceSetup

    track, num_kart = sys.argv[2], int(sys.argv[3])
    karts = tuple(KartSetup(name="n" * i, kart=["", "gnu"][i % 2]) for i in range(num_kart))
    session = LocalSession(Path(sys.argv[1]))
    session.start(RaceSetup(track, karts, seed=3, difficulty=3))
    reader = session._race._reader
    controls = np.zeros((0, 7), np.float32)
    steps, numbers_of_items, finished = 0, set(), 0
    while session.step(controls).running and steps < 700:
        block, attributes = reader._read_block(), reader._read_attributes()
        same = [a.tobytes() == b.tobytes() for a, b in zip(block, attributes)]
        if not all(same):
            raise SystemExit(f"step {steps}: {same}")
        steps += 1
        numbers_of_items.add(len(block[1]))
        finished = int(block[0]["has_finished_race"].sum())
    print(reader.is_fast, steps > 100, len(numbers_of_items) > 1, finished > 0)
"""


def run(*arguments, program=PROGRAM):
    return subprocess.run(
        [sys.executable, "-c", textwrap.dedent(program), str(find_assets().root), *arguments],
        capture_output=True,
        text=True,
        timeout=120,
    )


@pytest.mark.parametrize(("track", "num_kart"), [("olivermath", 6), ("zengarden", 3)])
def test_the_block_says_what_the_attributes_say_in_a_whole_race(track, num_kart):
    program = run(track, str(num_kart))
    assert program.stdout.split()[:2] == ["True", "True"], program.stderr
    assert program.stdout.split()[3] == "True"


def test_items_that_come_and_go_are_read():
    assert run("olivermath", "6").stdout.split()[2] == "True"


def test_an_engine_whose_block_is_laid_out_otherwise_is_read_by_attribute():
    program = """
        import sys
        from pathlib import Path
        from stkzoo.engine.reader import WorldReader
        from stkzoo.engine.session import LocalSession
        from stkzoo.engine.setup import KartSetup, RaceSetup

        class Shifted:
            def __init__(self, world):
                self.karts, self.items = world.karts, world.items
                self.block = world.__getstate__()[0]
            def __getstate__(self):
                return (self.block[:90] + b"x" + self.block[90:],)

        session = LocalSession(Path(sys.argv[1]))
        session.start(RaceSetup("olivermath", (KartSetup(), KartSetup())))
        reader = WorldReader(Shifted(session._race._world))
        karts, items = reader.read()
        print(reader.is_fast, len(karts), len(items) > 10)
    """
    assert run(program=program).stdout.split() == ["False", "2", "True"]
