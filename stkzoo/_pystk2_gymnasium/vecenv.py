"""Names of ``pystk2_gymnasium.vecenv``."""

from stkzoo.env.vector import make_stkrace_vec

__all__ = ["make_stkrace_vec"]
