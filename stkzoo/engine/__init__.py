"""The interface to the game: its data, its processes, and its state as arrays.

Only this package imports ``pystk2``: :mod:`~stkzoo.engine.race` and
:mod:`~stkzoo.engine.render_process` import it when they run or draw a race. To start quickly, an
engine process imports only numpy, the kernel and modules directly in ``stkzoo`` besides this
package.
"""

from stkzoo._imports import lazy_names

__getattr__ = lazy_names(__name__)
