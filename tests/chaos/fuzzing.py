"""Coverage-guided fuzzing of a reader: ``python -m tests.chaos.fuzzing messages -runs=400000``.

Changes inputs with atheris (``pip install atheris``) to reach new lines of code, within limits on
memory and time. Accepts libFuzzer's arguments; an input that breaks the reader is saved in the
current folder, and ``python -m tests.chaos.fuzzing messages FILE`` feeds it again.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["stkzoo", "tarfile", "zipfile"]):
    from tests.chaos.cost import feed_measured
    from tests.chaos.targets import TARGETS

_LIMITS = ("-max_len=16384", "-timeout=30", "-rss_limit_mb=3000")


def main() -> None:
    """Runs the command."""
    program, name, *words = sys.argv
    target = TARGETS[name]
    with tempfile.TemporaryDirectory() as corpus:
        for number, data in enumerate(target.seeds()):
            Path(corpus, f"seed-{number}").write_bytes(data)
        if all(word.startswith("-") for word in words):
            words.append(corpus)
        atheris.Setup([program, *_LIMITS, *words], lambda data: feed_measured(target, data))
        atheris.Fuzz()


if __name__ == "__main__":
    main()
