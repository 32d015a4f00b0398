"""The kernel's twins in numpy: one module for each C file, one class for each of its types.

They are reached through :mod:`stkzoo.kernel`, which decides between them and the extension.
"""

__all__: list[str] = []
