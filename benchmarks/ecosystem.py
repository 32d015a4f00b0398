"""Runs each library's example in a separate virtual environment.

python -m benchmarks.ecosystem                    all of them: some minutes, 12 GB of disk
python -m benchmarks.ecosystem --only torchrl     one of them
python -m benchmarks.ecosystem --folder /big/disk other folder; reuses existing environments
python -m benchmarks.ecosystem --record           write the results and the table of works-with.md

Without --yes, the command asks before it installs anything. Without --record, it writes the results
only to the folder of the environments.
"""

from __future__ import annotations

import json
import platform
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from stkzoo._arguments import CommandParser
from stkzoo._os import write_text

ROOT = Path(__file__).parent.parent
EXAMPLES = ROOT / "examples" / "ecosystem"
RESULTS = ROOT / "benchmarks" / "results" / "ecosystem.json"
PAGE = ROOT / "docs" / "how-to" / "works-with.md"
MARK = "<!-- written by python -m benchmarks.ecosystem -->"

TORCH = "torch==2.13.0"
#: Packages of each environment besides stkzoo. Some libraries conflict with others.
SETS = {
    "main": (
        TORCH,
        "stable-baselines3==2.9.2",
        "sb3-contrib==2.9.2",
        "supersuit==3.11.0",
        "torchrl==0.14.1",
        "tianshou==2.0.1",
        "minari[create]==0.5.4",
    ),
    "rllib": (TORCH, "ray[rllib]==2.60.0"),  # requires gymnasium 1.2.2
    "agilerl": (TORCH, "agilerl==2.58.0", "peft==0.21.2"),  # requires pettingzoo < 1.27
    "pufferlib": ("pufferlib-core==3.0.23",),  # requires torch 2.9.0
    # requires torchvision, which fits one version of torch, and PyAV < 14
    "benchmarl": ("torch==2.14.1", "torchvision==0.29.1", "benchmarl==1.5.2"),
}


@dataclass(frozen=True)
class Example:
    """A library and the example script that uses it.

    Attributes:
        library: name of the library.
        package: name of its Python package.
        script: name of the script.
        where: environment of the script, a key of ``SETS``.
        view: view that the script uses.
        shows: what the script demonstrates.
    """

    library: str
    package: str
    script: str
    where: str
    view: str
    shows: str


LIBRARIES = (
    Example("Gymnasium", "gymnasium", "gymnasium_vector", "main", "box_discrete", "vector API"),
    Example("SuperSuit", "supersuit", "supersuit_sb3", "main", "box_discrete", "its wrappers, PPO"),
    Example("Stable-Baselines3", "stable-baselines3", "sb3_ppo", "main", "box_continuous", "PPO"),
    Example(
        "sb3-contrib",
        "sb3-contrib",
        "sb3_contrib_maskable",
        "main",
        "masked_discrete",
        "MaskablePPO",
    ),
    Example(
        "CleanRL style (torch)",
        "torch",
        "cleanrl_ppo",
        "main",
        "masked_discrete",
        "PPO in one file",
    ),
    Example(
        "TorchRL", "torchrl", "torchrl_mappo", "main", "box_discrete", "check_env_specs, MAPPO"
    ),
    Example(
        "Tianshou",
        "tianshou",
        "tianshou_dqn",
        "main",
        "masked_discrete",
        "DQN against a random agent, AEC",
    ),
    Example(
        "Minari",
        "minari",
        "minari_dataset",
        "main",
        "flattened_continuous_actions",
        "a dataset of the game's AI",
    ),
    Example("Ray RLlib", "ray", "rllib_ppo", "rllib", "box_discrete", "PPO, new API stack"),
    Example("BenchMARL", "benchmarl", "benchmarl_vdn", "benchmarl", "racing", "VDN in teams"),
    Example("AgileRL", "agilerl", "agilerl_ippo", "agilerl", "box_continuous", "IPPO"),
    Example(
        "PufferLib",
        "pufferlib-core",
        "pufferlib_emulation",
        "pufferlib",
        "box_discrete",
        "emulation of any view",
    ),
)


@dataclass(frozen=True)
class Outcome:
    """Outcome of an example: versions, last lines of output, and duration [s]."""

    library: str
    version: str
    gymnasium: str
    pettingzoo: str
    passed: bool
    seconds: float
    said: str


def main() -> int:
    """Makes the environments, runs the examples, and writes the results and the page's table."""
    parser = CommandParser(prog="python -m benchmarks.ecosystem", description=__doc__)
    names = [example.script for example in LIBRARIES]
    parser.add_argument("--only", nargs="+", metavar="NAME", help=f"some of {', '.join(names)}")
    parser.add_argument(
        "--folder", type=Path, default=ROOT / ".ecosystem", help="folder of the environments"
    )
    parser.add_argument("--timeout", type=float, default=600.0, help="seconds for one example")
    parser.add_argument("--yes", action="store_true", help="install without asking")
    parser.add_argument(
        "--record", action="store_true", help="update the saved results and the page"
    )
    args = parser.parse_args()
    chosen = [e for e in LIBRARIES if not args.only or any(o in e.script for o in args.only)]
    if not chosen:
        parser.error(f"no example has {args.only} in its name; they are {', '.join(names)}")
    if not args.yes and not _agrees({example.where for example in chosen}, args.folder):
        print("nothing was installed; add --yes to install without the question")
        return 1
    outcomes = {o["library"]: o for o in _known()}
    pythons: dict[str, Path] = {}
    for example in chosen:
        if example.where not in pythons:
            pythons[example.where] = environment(args.folder / example.where, SETS[example.where])
        outcome = _run(example, pythons[example.where], args.timeout)
        outcomes[example.library] = asdict(outcome)
        print(f"{'passed' if outcome.passed else 'FAILED':8}{example.library} {outcome.version}")
        if not outcome.passed:
            print(outcome.said)
    ordered = [outcomes[e.library] for e in LIBRARIES if e.library in outcomes]
    results = RESULTS if args.record else args.folder / "ecosystem.json"
    write_text(results, json.dumps(ordered, indent=1) + "\n")
    print(f"written to {results}")
    if args.record:
        _write_table(ordered)
    return 0 if all(outcomes[e.library]["passed"] for e in chosen) else 1


def _agrees(places: set[str], folder: Path) -> bool:
    """Asks before installing gigabytes; returns ``False`` without a terminal."""
    gigabytes = 3 * len(places)  # most of it is torch
    print(f"This installs up to {gigabytes} GB of libraries below {folder}.")
    return sys.stdin.isatty() and input("Continue? [y/N] ").strip().lower() in ("y", "yes")


def _known() -> list[dict[str, object]]:
    return json.loads(RESULTS.read_text()) if RESULTS.exists() else []


def environment(folder: Path, packages: tuple[str, ...]) -> Path:
    """Makes an environment and installs its packages one by one; returns its Python."""
    python = folder / "bin" / "python"
    if not python.exists():
        subprocess.run([sys.executable, "-m", "venv", folder], check=True)
    stamp = folder / "stkzoo-packages.txt"
    if not stamp.exists() or stamp.read_text().split("\n") != list(packages):
        for package in packages:
            print(f"installing {package} in {folder}")
            _install(python, package)
        stamp.write_text("\n".join(packages))
    _install(python, str(ROOT))
    return python


def run_in_environment(name: str, folder: Path, module: str, arguments: Sequence[str]) -> int:
    """Runs a module in an environment with other libraries; returns its exit code.

    Args:
        name: key of the environment in :data:`SETS`.
        folder: folder of all environments.
        module: name of the module.
        arguments: its arguments.
    """
    python = environment(folder / name, SETS[name])
    return subprocess.run([python, "-m", module, *arguments], check=False).returncode


def _install(python: Path, package: str) -> None:
    quiet = ["--quiet", "--disable-pip-version-check"]
    subprocess.run([python, "-m", "pip", "install", *quiet, package], check=True)


_VERSIONS = """\
import sys
from importlib.metadata import version
print(*(version(name) for name in sys.argv[1:]))
"""


def _run(example: Example, python: Path, timeout: float) -> Outcome:
    names = (example.package, "gymnasium", "pettingzoo")
    found = subprocess.run(
        [python, "-c", _VERSIONS, *names], check=True, capture_output=True, text=True
    )
    begun = time.monotonic()
    try:
        done = subprocess.run(
            [python, EXAMPLES / f"{example.script}.py"],
            capture_output=True,
            text=True,
            timeout=timeout,
            check=False,
        )
        passed, said = done.returncode == 0, done.stdout if not done.returncode else done.stderr
    except subprocess.TimeoutExpired:
        passed, said = False, f"not over after {timeout:g} s"
    last = "\n".join(said.strip().splitlines()[-8:])
    seconds = round(time.monotonic() - begun, 1)
    return Outcome(example.library, *found.stdout.split(), passed, seconds, last)


def _write_table(outcomes: list[dict[str, object]]) -> None:
    by_library = {example.library: example for example in LIBRARIES}
    lines = [
        "| library | version | view | example | shows | result |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for outcome in outcomes:
        example = by_library[str(outcome["library"])]
        script = f"[`{example.script}.py`](../../examples/ecosystem/{example.script}.py)"
        result = f"passed, {outcome['seconds']:.0f} s" if outcome["passed"] else "**failed**"
        lines.append(
            f"| {example.library} | {str(outcome['version']).partition('+')[0]} "
            f"| `{example.view}` | {script} | {example.shows} | {result} |"
        )
    system = f"Python {platform.python_version()}, {platform.system()} {platform.machine()}"
    lines += ["", f"With {_versions(outcomes)}; {system}."]
    before, _, after = PAGE.read_text().partition(MARK)
    rest = after.partition(MARK)[2]
    page = f"{before}{MARK}\n\n" + "\n".join(lines) + f"\n\n{MARK}{rest}"
    write_text(PAGE, page)


def _versions(outcomes: list[dict[str, object]]) -> str:
    """Returns the versions of Gymnasium and PettingZoo: the most common, and those that differ."""
    words = []
    for package, title in (("gymnasium", "Gymnasium"), ("pettingzoo", "PettingZoo")):
        found = [str(outcome[package]) for outcome in outcomes]
        usual = max(set(found), key=found.count)
        others = [f"{o['library']}: {o[package]}" for o in outcomes if o[package] != usual]
        words.append(f"{title} {usual}" + (f" ({', '.join(others)})" if others else ""))
    return " and ".join(words)


if __name__ == "__main__":
    sys.exit(main())
