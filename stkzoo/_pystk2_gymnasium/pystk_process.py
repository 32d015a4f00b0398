"""Refuses ``pystk2_gymnasium.pystk_process``."""

raise ImportError(
    "stkzoo has no module pystk2_gymnasium.pystk_process: environments start the game by themselves"
)
