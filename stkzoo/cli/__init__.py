"""The command line, ``stkzoo``."""

from stkzoo.cli.main import main

__all__ = ["main"]
