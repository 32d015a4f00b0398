"""Where the files are that tests read."""

from pathlib import Path

#: The project's root folder.
ROOT = Path(__file__).parents[2]
#: Agents as users write them, good and hostile.
AGENTS = ROOT / "tests" / "data" / "agents"
#: The published JSON schemas.
SCHEMAS = ROOT / "docs" / "schemas"
