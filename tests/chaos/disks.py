"""Full and read-only disks, and servers that close the connection."""

from __future__ import annotations

import http.server
import os
import subprocess
import sys
import textwrap
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

from tests.support.paths import ROOT

__all__ = ["CuttingServer", "can_mount", "on_disk"]

_OWN_MOUNTS = ("unshare", "--user", "--map-root-user", "--mount")
_MOUNT = {
    "full": "mount -t tmpfs -o size={size} chaos {place}",
    "read-only": "mount --bind {place} {place} && mount -o remount,bind,ro {place}",
}


@cache
def can_mount() -> bool:
    """Returns whether this user can mount disks in a separate mount namespace."""
    try:
        return (
            subprocess.run([*_OWN_MOUNTS, "true"], capture_output=True, check=False).returncode == 0
        )
    except FileNotFoundError:
        return False


def on_disk(
    kind: str, place: Path, code: str, *words: str, size: str = "64k", **variables: str
) -> subprocess.CompletedProcess[str]:
    """Runs a program with a disk mounted at a folder, visible only to the program.

    Args:
        kind: ``"full"`` for a small empty disk, which the program can fill with ``fill()`` and
            clear with ``free()``; ``"read-only"`` for the folder's own files, read-only.
        place: the folder.
        code: Python code of the program.
        words: command-line arguments of the program.
        size: size of a disk of kind ``"full"``.
        variables: additional environment variables.
    """
    mount = _MOUNT[kind].format(place=place, size=size)
    script = f'{mount} && exec "$0" -c "$@"'
    program = textwrap.dedent(_HELPERS).format(place=str(place)) + textwrap.dedent(code)
    return subprocess.run(
        [*_OWN_MOUNTS, "sh", "-c", script, sys.executable, program, *words],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        env={**os.environ, "PYTHONPATH": str(ROOT), **variables},
    )


_HELPERS = """
    from pathlib import Path
    PLACE = Path({place!r})

    def fill():
        with open(PLACE / "filler", "wb", buffering=0) as file:
            try:
                while True:
                    file.write(bytes(512))
            except OSError:
                pass

    def free():
        (PLACE / "filler").unlink()

    def names():
        return sorted(path.name for path in PLACE.rglob("*") if path.name != "filler")

"""


class CuttingServer:
    """A local web server that closes connections in the middle of a file.

    Args:
        folder: folder to serve.
        cuts: number of files to cut off; the server sends later files in full.

    Attributes:
        address: URL of the server.
        num_cuts: number of connections cut so far.
    """

    def __init__(self, folder: Path, cuts: int) -> None:
        outer = self

        class Handler(http.server.SimpleHTTPRequestHandler):
            def __init__(self, *arguments: object) -> None:
                super().__init__(*arguments, directory=str(folder))  # type: ignore[arg-type]

            def copyfile(self, source: object, outputfile: object) -> None:
                data = source.read()  # type: ignore[attr-defined]
                if self.path.endswith(".deb") and outer.num_cuts < cuts:
                    outer.num_cuts += 1
                    data = data[: len(data) // 2]
                    self.close_connection = True
                outputfile.write(data)  # type: ignore[attr-defined]

            def log_message(self, *_: object) -> None:
                pass

        self.num_cuts = 0
        self._server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.address = f"http://127.0.0.1:{self._server.server_port}"

    @contextmanager
    def serving(self) -> Iterator[CuttingServer]:
        """Runs the server in a thread."""
        thread = threading.Thread(target=self._server.serve_forever)
        thread.start()
        try:
            yield self
        finally:
            self._server.shutdown()
            thread.join()
            self._server.server_close()
