"""The environments: the parallel environment, and the Gymnasium and vector environments on top."""

from stkzoo._imports import lazy_names

__getattr__ = lazy_names(__name__)
