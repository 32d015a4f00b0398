"""The environments: the parallel environment, and the Gymnasium and vector environments on top."""

import gymnasium

from stkzoo._imports import lazy_names

if not hasattr(gymnasium.vector, "AutoresetMode"):
    from stkzoo._installation import pip_install, unusable

    update = pip_install("--upgrade gymnasium")
    raise unusable(f"Gymnasium {gymnasium.__version__} is too old for stkzoo: {update}")

__getattr__ = lazy_names(__name__)
