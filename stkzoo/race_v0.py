"""PettingZoo's module for the race: ``parallel_env``, and ``env``/``raw_env`` in AEC form.

All take the keywords of :class:`stkzoo.env.parallel.RaceParallelEnv`.
"""

from __future__ import annotations

from stkzoo.env.aec import raw_aec_env as raw_env
from stkzoo.env.aec import wrapped_aec_env as env
from stkzoo.env.parallel import RaceParallelEnv as parallel_env  # noqa: N813 - PettingZoo's name

__all__ = ["env", "parallel_env", "raw_env"]
