"""Vectorized races for Stable-Baselines3, in which one policy controls every agent.

>>> from stkzoo.sb3 import ActiveDictRolloutBuffer, RaceVecEnv
>>> from stable_baselines3 import PPO
>>> envs = RaceVecEnv(2, num_kart=3, track="lighthouse", view="flattened_discrete")
>>> model = PPO(
...     "MultiInputPolicy", envs, rollout_buffer_class=ActiveDictRolloutBuffer, device="cpu"
... )
>>> envs.close()

This package needs the ``sb3`` extra (``pip install "stkzoo[sb3]"``). ``import stkzoo``
does not import it.
"""

from stkzoo._installation import install_command

try:
    import stable_baselines3  # noqa: F401
    import torch  # noqa: F401
except ImportError as error:
    raise ImportError(
        f"stkzoo.sb3 needs Stable-Baselines3 (extra sb3), which does not load ({error}): "
        f"{install_command('sb3')}"
    ) from error

from stkzoo.sb3.buffers import ActiveDictRolloutBuffer, ActiveRolloutBuffer
from stkzoo.sb3.saving import save_agent
from stkzoo.sb3.vec import RaceVecEnv

__all__ = ["ActiveDictRolloutBuffer", "ActiveRolloutBuffer", "RaceVecEnv", "save_agent"]
__dir__ = __all__.copy
