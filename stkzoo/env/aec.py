"""The race through PettingZoo's turn-by-turn API."""

from __future__ import annotations

from typing import Any

from pettingzoo.utils.conversions import parallel_to_aec
from pettingzoo.utils.env import AECEnv
from pettingzoo.utils.wrappers import OrderEnforcingWrapper

from stkzoo.env.parallel import RaceParallelEnv


def raw_aec_env(**options: Any) -> AECEnv[str, Any, Any]:
    """The core in AEC form: agents act in turn, the race moves when all have acted."""
    return parallel_to_aec(RaceParallelEnv(**options))


def wrapped_aec_env(**options: Any) -> AECEnv[str, Any, Any]:
    """:func:`raw_aec_env` with PettingZoo's guard against calls in the wrong order.

    Actions need no clipping or bounds wrapper: the core refuses what is out of bounds.
    """
    return OrderEnforcingWrapper(raw_aec_env(**options))
