"""Runs each library's example in ``examples/ecosystem``, in separate virtual environments.

    python -m benchmarks.ecosystem                      # all: some minutes, 15 GB of disk
    python -m benchmarks.ecosystem --only torchrl       # one of them
    python -m benchmarks.ecosystem --folder /big/disk   # another folder; environments are reused

Without --yes, the command asks before it installs anything.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from benchmarks.common import parser

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "examples" / "ecosystem"
_TORCH = "torch==2.13.0"
#: Packages of each environment besides stkzoo. Some libraries conflict with others.
SETS = {
    "main": (
        _TORCH,
        "stable-baselines3==2.9.2",
        "sb3-contrib==2.9.2",
        "supersuit==3.11.0",
        "torchrl==0.14.1",
        "tianshou==2.0.1",
        "minari[create]==0.5.4",
    ),
    "rllib": (_TORCH, "ray[rllib]==2.60.0"),  # requires gymnasium 1.2.2
    "agilerl": (_TORCH, "agilerl==2.58.0", "peft==0.21.2"),  # requires pettingzoo < 1.27
    "pufferlib": ("pufferlib-core==3.0.23",),  # requires torch 2.9.0
    # requires torchvision, which fits one version of torch, and PyAV < 14
    "benchmarl": ("torch==2.14.1", "torchvision==0.29.1", "benchmarl==1.5.2"),
}
#: Environment of each example that does not run in ``main``.
_PLACES = {
    "rllib_ppo": "rllib",
    "agilerl_ippo": "agilerl",
    "pufferlib_emulation": "pufferlib",
    "benchmarl_vdn": "benchmarl",
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    words = parser("ecosystem", __doc__)
    names = sorted(path.stem for path in EXAMPLES.glob("*.py"))
    words.add_argument("--only", nargs="+", metavar="NAME", help="parts of the examples' names")
    words.add_argument("--folder", type=Path, default=Path(".ecosystem"), help="environments")
    words.add_argument("--timeout", type=float, default=900.0, help="of an example [s]")
    words.add_argument("--yes", action="store_true", help="install without a question")
    options = words.parse_args(arguments)
    chosen = [n for n in names if not options.only or any(part in n for part in options.only)]
    if not chosen:
        words.error(f"no example has {options.only} in its name; they are {', '.join(names)}")
    places = {name: _PLACES.get(name, "main") for name in chosen}
    if not options.yes and not _agrees(len({*places.values()}), options.folder):
        print("nothing was installed; add --yes to install without the question")
        return 1
    failed = [
        name
        for name, place in places.items()
        if not _run(name, environment(options.folder, place), options.timeout)
    ]
    print(f"failed: {', '.join(failed)}" if failed else f"all {len(chosen)} passed")
    return int(bool(failed))


def _agrees(number: int, folder: Path) -> bool:
    """Asks before installing gigabytes; returns ``False`` without a terminal."""
    print(f"This installs up to {3 * number} GB of libraries below {folder}.")  # mostly torch
    return sys.stdin.isatty() and input("Continue? [y/N] ").strip().lower() in ("y", "yes")


def environment(folder: Path, name: str) -> Path:
    """Makes one of the environments in :data:`SETS`, or updates stkzoo in it.

    Args:
        folder: folder of all environments.
        name: name of the environment.

    Returns:
        Its Python.
    """
    packages = SETS[name]
    python, stamp = folder / name / "bin" / "python", folder / name / "stkzoo-packages.txt"
    if not python.exists():
        subprocess.run([sys.executable, "-m", "venv", folder / name], check=True)
    if not stamp.exists() or stamp.read_text().split("\n") != list(packages):
        for package in packages:
            print(f"installing {package} in {folder / name}")
            _install(python, package)
        stamp.write_text("\n".join(packages))
    _install(python, str(ROOT))
    return python


def _install(python: Path, package: str) -> None:
    quiet = ["--quiet", "--disable-pip-version-check"]
    subprocess.run([python, "-m", "pip", "install", *quiet, package], check=True)


def _run(name: str, python: Path, timeout: float) -> bool:
    """Runs an example; prints and returns whether it passed."""
    command, begin = [python, EXAMPLES / f"{name}.py"], time.monotonic()
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=timeout, check=False)
        passed, output = done.returncode == 0, done.stderr
    except subprocess.TimeoutExpired:
        passed, output = False, f"not over after {timeout:g} s"
    print(f"{'passed' if passed else 'FAILED'} {name}, {time.monotonic() - begin:.0f} s")
    if not passed:
        print(output[-2000:])
    return passed


if __name__ == "__main__":
    sys.exit(main())
