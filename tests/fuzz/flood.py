"""Floods a server with invalid messages: ``python -m tests.fuzz.flood 100000``."""

from __future__ import annotations

import random
import sys
import time

from stkzoo.race import run_race
from stkzoo.race.remote import RemoteDriverGroup
from tests.fuzz.messages import bad_messages, flood, resident_memory
from tests.support.remote_race import raw_client, server_process

#: Number of messages per connection.
_AT_ONCE = 1000


def main(count: int) -> None:
    """Sends ``count`` messages in ten parts, with a race after each part."""
    messages = bad_messages(random.Random(0))
    with server_process("heuristic", "--quiet") as (process, address):
        _race(address)
        begin = time.monotonic()
        for tenth in range(11):
            memory = resident_memory(process.pid) / 1e6
            print(f"{tenth * count // 10:7d} messages: {memory:.1f} MB")  # noqa: T201
            if tenth < 10:
                for _ in range(0, count // 10, _AT_ONCE):
                    with raw_client(address) as socket:
                        flood(socket, messages, min(_AT_ONCE, count // 10))
                _race(address)
        print(f"{time.monotonic() - begin:.0f} s; the last race was served as the first")  # noqa: T201


def _race(address):
    with RemoteDriverGroup([address]) as group:
        result = run_race([*group.drivers, "ai"], track="lighthouse", seed=1, max_steps=20)
    assert not any(row.errors for row in result.agents), result


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 10_000)
