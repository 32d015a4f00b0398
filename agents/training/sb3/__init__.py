"""Self-play with Stable-Baselines3."""

import stkzoo.sb3  # noqa: F401 - says how to install it
