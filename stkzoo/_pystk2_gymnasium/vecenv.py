"""Names of ``pystk2_gymnasium.vecenv``, and those that the package itself has of Gymnasium."""

from gymnasium.envs.registration import WrapperSpec as WrapperSpec
from gymnasium.envs.registration import register as register

from stkzoo.env.vector import make_stkrace_vec as make_stkrace_vec
