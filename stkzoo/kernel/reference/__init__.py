"""NumPy reference implementations of the kernel: a module per C file, a class per type.

Import their names from :mod:`stkzoo.kernel`, which chooses between them and the extension.
"""

__all__: list[str] = []
