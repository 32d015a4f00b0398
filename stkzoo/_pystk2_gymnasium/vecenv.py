"""Names of ``pystk2_gymnasium.vecenv``."""

from stkzoo.env.vector import make_stkrace_vec as make_stkrace_vec
