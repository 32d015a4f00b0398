"""The examples in the documentation, and which of them do not run as written."""

import re
import shlex
from dataclasses import dataclass

from tests.support.paths import ROOT

#: Pages that are generated from docstrings or shown elsewhere.
WITHOUT_EXAMPLES = {
    "docs/changelog.md",
    "docs/contributing.md",
}
_BLOCK = re.compile(r"^```(python|sh)\n(.*?)^```", re.MULTILINE | re.DOTALL)
_FILE = re.compile(r"# ([\w/]+\.py)\n")


@dataclass(frozen=True)
class Block:
    """One example: its page, language, the line before its code, and the code."""

    page: str
    language: str
    line: int
    code: str

    @property
    def file(self):
        """Name of the file for this block, from its first line; ``None`` if it is not a file."""
        name = _FILE.match(self.code)
        return name and name[1]


def pages():
    found = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    names = [path.relative_to(ROOT).as_posix() for path in found]
    return [
        n for n in names if n not in WITHOUT_EXAMPLES and not n.startswith("docs/reference/api/")
    ]


def blocks(page, language):
    text = (ROOT / page).read_text("utf-8")
    return [
        Block(page, found[1], text[: found.start(2)].count("\n"), found[2])
        for found in _BLOCK.finditer(text)
        if found[1] == language
    ]


#: Replacements in blocks so that they run in seconds: the page, a part of the block, and its
#: replacement.
SHORTER = [
    ("README.md", '"flattened_discrete")\nobs', '"flattened_discrete", max_cycles=100)\nobs'),
    ("docs/how-to/live-page.md", 'listeners=[page]', 'max_steps=20, listeners=[page]'),
    ("README.md", "learn(200_000)", "learn(1)"),
    ("README.md", 'track="train"', 'track="lighthouse"'),
    ("README.md", "n_steps=128", "n_steps=16"),
    ("docs/how-to/stable-baselines3.md", "learn(1_000_000)", "learn(1)"),
    ("docs/how-to/stable-baselines3.md", "n_steps=128", "n_steps=16"),
    ("docs/how-to/stable-baselines3.md", 'track="train"', 'track="lighthouse"'),
    ("docs/how-to/stable-baselines3.md", "seed=1)\nfor", "seed=1, max_steps=20)\nfor"),
    ("docs/how-to/stable-baselines3.md", "learn(500_000", "learn(1"),
    ("docs/how-to/stable-baselines3.md", "RaceVecEnv(4, num", "RaceVecEnv(1, num"),
    ("docs/how-to/vector.md", "model.learn(1_000_000)", "model.learn(1)"),
    ("docs/how-to/vector.md", 'MultiInputPolicy", envs', 'MultiInputPolicy", envs, n_steps=32'),
    ("docs/how-to/vector.md", "range(1000)", "range(20)"),
    ("docs/how-to/pytorch.md", "STEPS, UPDATES = 64, 60", "STEPS, UPDATES = 16, 1"),
    ("docs/how-to/pytorch.md", "seed=1)\nfor", "seed=1, max_steps=20)\nfor"),
    ("docs/how-to/curriculum.md", "range(1000)", "range(1)"),
    ("docs/how-to/curriculum.md", "range(10_000)", "range(20)"),
    ("docs/how-to/curriculum.md", "max_cycles=300", "max_cycles=10"),
    ("docs/how-to/curriculum.md", "learn(1_000_000", "learn(64"),
    ("docs/how-to/curriculum.md", '("MlpPolicy", envs', '("MlpPolicy", envs, n_steps=16'),
    ("docs/how-to/rendering.md", "cameras=3", "cameras=1, backend='map'"),
    ("docs/how-to/rendering.md", "listeners=[video]", "listeners=[video], max_steps=5"),
    ("docs/how-to/demonstrations.md", "karts=2, seeds=3", "karts=2, max_steps=20"),
    ("docs/reference/replays.md", 'RaceVideo("race.mp4")', 'RaceVideo("race.mp4", backend="map")'),
    ("docs/reference/replays.md", "seed=1, listeners", "seed=1, max_steps=5, listeners"),
    ("docs/reference/agents.md", 'seed=1, listeners', 'seed=1, max_steps=120, listeners'),
    ("docs/how-to/tournaments.md", "races=30", "races=2"),
    ("docs/how-to/tournaments.md", "max_steps=450", "max_steps=30"),
]  # fmt: skip

#: Blocks that do not run: the page, a part of the block, and the reason.
NOT_RUN = [
    (
        "docs/how-to/rllib.md",
        "ray.rllib",
        "RLlib wants an older Gymnasium: benchmarks/ecosystem.py",
    ),
    ("docs/how-to/play.md", "play_race", "opens a window: tests/play/test_play.py"),
    ("docs/how-to/play.md", "play(env", "opens a window: tests/play/test_play.py"),
    (
        "docs/how-to/networked-races.md",
        "RemoteDriverGroup",
        "asks two servers: tests/race/remote/test_remote.py",
    ),
    (
        "docs/reference/benchmark-protocol.md",
        "run_benchmark",
        "long: tests/evaluation/test_benchmark.py",
    ),
    ("docs/how-to/planning.md", "planner.act", "a race of minutes: tests/agents/test_planner.py"),
]


def shortened(block):
    """Returns the block's code with the replacements."""
    code = block.code
    for page, old, new in SHORTER:
        if page == block.page:
            code = code.replace(old, new)
    return code


def reason_not_to_run(block):
    return next(
        (why for page, part, why in NOT_RUN if page == block.page and part in block.code), None
    )


def commands(block):
    """Returns the commands of a shell block as lists of words, without comments and variables."""
    joined = block.code.replace("\\\n", " ")
    lines = [line for text in joined.splitlines() for line in text.split(" && ")]
    words = [shlex.split(re.sub(r"^([A-Z_]+=\S+ )+", "", line), comments=True) for line in lines]
    return [each for each in words if each]
