"""Runs the command ``stkzoo`` as ``python -m stkzoo``."""

import sys

from stkzoo.cli import main

if __name__ == "__main__":
    sys.exit(main())
