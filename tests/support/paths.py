"""Where the files are that tests read."""

import os
import subprocess
from pathlib import Path

#: The project's root folder.
ROOT = Path(__file__).parents[2]
#: Agents as users write them, good and hostile.
AGENTS = ROOT / "tests" / "data" / "agents"
#: The published JSON schemas.
SCHEMAS = ROOT / "docs" / "schemas"


def copy_checkout(folder):
    """Copies what a clone has, with changes that are not committed, and returns the folder."""
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
