"""The one door to the game: its data, its processes, and its state as arrays.

Nothing outside this package imports ``pystk2``, and this package imports it only in
the processes that run a race. It needs numpy and nothing else of ours but
:mod:`stkzoo.errors` and :mod:`stkzoo.names`, so that an engine process starts quickly.
"""
