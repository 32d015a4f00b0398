"""Locations of files that tests read."""

import os
import subprocess
from pathlib import Path

#: Root folder of the project.
ROOT = Path(__file__).parents[2]
#: Agents for tests, valid and hostile.
AGENTS = ROOT / "tests" / "data" / "agents"
#: Published JSON schemas.
SCHEMAS = ROOT / "docs" / "schemas"


def copy_checkout(folder):
    """Copies the files of a clone, including uncommitted changes; returns the folder."""
    tracked = ["git", "ls-files", "-co", "--exclude-standard", "-z"]
    names = subprocess.run(tracked, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for name in filter(None, names.split("\0")):
        path = ROOT / name
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        if path.is_symlink():
            (folder / name).symlink_to(os.readlink(path))
        elif path.exists():
            (folder / name).write_bytes(path.read_bytes())
    return folder
