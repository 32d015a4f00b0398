"""The ground and walls of a track, read from its meshes.

Observations describe the road as a driving line with a width. The real track differs: walls block
it, ground continues beside it, grass slows karts and zippers accelerate them.
"""

from stkzoo.engine.ground.columns import Ground, Spots, ground_of
from stkzoo.engine.ground.scenery import Faces, read_scenery

__all__ = ["Faces", "Ground", "Spots", "ground_of", "read_scenery"]
__dir__ = __all__.copy
