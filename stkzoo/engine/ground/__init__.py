"""What karts drive on and run into, read from the track's own meshes.

The road of an observation is the driving line with a width. What is really there differs: walls
stand in it, it goes on beside it, grass slows, zippers throw ahead.
"""

from stkzoo.engine.ground.columns import GROUND, SLOWED, VOID, WALL, ZIPPER, Ground, Spots
from stkzoo.engine.ground.mesh import Part, read_mesh
from stkzoo.engine.ground.scenery import Faces, read_scenery
from stkzoo.engine.ground.survey import ground_of

__all__ = [
    "GROUND",
    "SLOWED",
    "VOID",
    "WALL",
    "ZIPPER",
    "Faces",
    "Ground",
    "Part",
    "Spots",
    "ground_of",
    "read_mesh",
    "read_scenery",
]
