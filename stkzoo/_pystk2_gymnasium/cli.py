"""Refuses ``pystk2_gymnasium.cli`` and its modules."""

raise ImportError(
    "stkzoo has no module pystk2_gymnasium.cli: run `stkzoo pystk2`, which has its commands, or "
    "use stkzoo.race.run_race"
)
