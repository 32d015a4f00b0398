"""The game: its data, its processes, and its state as arrays.

Only this package imports ``pystk2``, and only in processes that run or draw a race:
:mod:`~stkzoo.engine.race` and :mod:`~stkzoo.engine.render_process` do. It needs numpy, the
kernel and the modules directly in ``stkzoo``, so that an engine process starts quickly.
"""
