"""``python -m stkzoo`` is the command ``stkzoo``."""

import sys

from stkzoo.cli import main

if __name__ == "__main__":
    sys.exit(main())
