"""PettingZoo's module for the race: ``parallel_env``, and ``env``/``raw_env`` in AEC form.

All take the keywords of :class:`stkzoo.env.parallel.RaceParallelEnv`.
"""

from __future__ import annotations

from typing import Any

from pettingzoo.utils.conversions import parallel_to_aec
from pettingzoo.utils.env import AECEnv
from pettingzoo.utils.wrappers import OrderEnforcingWrapper

from stkzoo.env.parallel import RaceParallelEnv as parallel_env  # noqa: N813 - PettingZoo's name

__all__ = ["env", "parallel_env", "raw_env"]


def raw_env(**options: Any) -> AECEnv[str, Any, Any]:
    """The race in AEC form: agents act in turn, the race moves when all have acted."""
    return parallel_to_aec(parallel_env(**options))


def env(**options: Any) -> AECEnv[str, Any, Any]:
    """:func:`raw_env` with PettingZoo's guard against calls in the wrong order.

    Actions need no clipping or bounds wrapper: the race refuses what is out of bounds.
    """
    return OrderEnforcingWrapper(raw_env(**options))
