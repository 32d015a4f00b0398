"""Runs the command ``stkzoo`` as ``python -m stkzoo``."""

import sys

from stkzoo.cli import main

if __name__ == "__main__":
    code = main()
    # If an interrupt ended an exec(), such as that of a dataclass, Python would exit by SIGINT.
    exec("")  # noqa: S102
    sys.exit(code)
