"""The game's data: how stkzoo finds and installs it, and the small headless pack.

This package does not load the engine. :func:`find_assets` only searches. :func:`install`
downloads data and :func:`pack` builds the headless pack; the command line calls both.
"""

from stkzoo.engine.assets.find import (
    DATADIR_VARIABLE,
    PlaceReport,
    cache_folder,
    find_assets,
    survey,
)
from stkzoo.engine.assets.installer import install, pack
from stkzoo.engine.assets.staging import Progress
from stkzoo.engine.assets.tree import Assets

__all__ = [
    "DATADIR_VARIABLE",
    "Assets",
    "PlaceReport",
    "Progress",
    "cache_folder",
    "find_assets",
    "install",
    "pack",
    "survey",
]
__dir__ = __all__.copy
