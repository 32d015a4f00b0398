"""The race as a PettingZoo module: ``parallel_env``, and ``env`` and ``raw_env`` for the AEC API.

All three take the keyword arguments of :class:`stkzoo.env.parallel.RaceParallelEnv`.
"""

from __future__ import annotations

from typing import Any

from pettingzoo.utils.conversions import parallel_to_aec
from pettingzoo.utils.env import AECEnv
from pettingzoo.utils.wrappers import OrderEnforcingWrapper

from stkzoo.env.parallel import RaceParallelEnv as parallel_env  # noqa: N813 - PettingZoo's name

__all__ = ["env", "parallel_env", "raw_env"]


def raw_env(**options: Any) -> AECEnv[str, Any, Any]:
    """Returns the race as an AEC environment, which advances after every agent has acted.

    Args:
        **options: keyword arguments of :class:`stkzoo.env.parallel.RaceParallelEnv`.

    Raises:
        ConfigError: an argument is invalid.
        AssetError: the game's data is missing.
    """
    return parallel_to_aec(parallel_env(**options))


def env(**options: Any) -> AECEnv[str, Any, Any]:
    """Returns :func:`raw_env` inside PettingZoo's ``OrderEnforcingWrapper``.

    The environment needs no wrapper that clips or checks actions, because the race rejects actions
    that are out of bounds.

    Args:
        **options: keyword arguments of :class:`stkzoo.env.parallel.RaceParallelEnv`.

    Raises:
        ConfigError: an argument is invalid.
        AssetError: the game's data is missing.
    """
    return OrderEnforcingWrapper(raw_env(**options))
