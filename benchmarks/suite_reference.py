"""Trains the reference runs of the suite, evaluates their agents, and packs them.

    python -m benchmarks.suite_reference                          # days; continues if interrupted
    python -m benchmarks.suite_reference --only "versus-ippo-*" "selfplay-5-*-0" --evaluations test
    python -m benchmarks.suite_reference --archive suite-1.zip    # packs the runs that are complete

Each run has a folder, such as ``runs/suite/versus-ippo-0``: what ``stkzoo suite train`` writes, the
entry of its agent (``entry``) and the evaluation on the training tracks (``entry-train``). Agents
of ``selfplay-5`` are also evaluated in ``versus`` (``entry-versus``). Agents of ``ippo`` are also
evaluated with the most likely choices (``entry-argmax``), and without recovery of stuck karts
(``entry-unrecovered``). ``sb3`` is the library baseline
(:mod:`benchmarks.suite_sb3`). One run is trained at a time, with all cores; all tasks and
algorithms of a seed come before the next seed. ``stkzoo suite report runs/suite`` reads these
folders.

``--archive`` trains nothing. It packs agents, entries, logs and arguments into a zip for a release,
and adds what the repository holds of these runs to ``benchmarks/results/suite``: a zip for each,
with its entries, race results and log, and ``digests.json`` with the SHA-256 of the archives and of
their files, except the replays, whose SHA-256 are in the entries. From the zips of all runs, which
can come from several machines, it writes ``report.json``, the source of the documentation's page.
Runs of the long tier need ``--kart-steps 10000000 --folder runs/suite-long``, and with
``--archive`` also ``--output benchmarks/results/suite-long``.
"""

from __future__ import annotations

import itertools
import json
import sys
import tempfile
import zipfile
from collections.abc import Sequence
from fnmatch import fnmatch
from pathlib import Path

from rich.console import Console

from benchmarks import suite_sb3
from benchmarks.common import RESULTS, parser
from stkzoo._os import file_digest, write_text, write_whole
from stkzoo.agents.training.evaluate import newest_policy
from stkzoo.agents.training.export import export_policy
from stkzoo.agents.training.suite import algorithms
from stkzoo.errors import ConfigError
from stkzoo.evaluation.batch.order import load_orders
from stkzoo.suite import ALGORITHMS, About, can_learn, evaluate, find_task, load_runs, make_report
from stkzoo.suite.entry import ENTRY_FILE, Entry
from stkzoo.suite.report.runs import Evaluation

#: Tasks with reference runs, and the seeds of the runs.
REFERENCE_TASKS = ("solo-general", "versus", "selfplay-5", "team-2v2")
SEEDS = (0, 1, 2, 3, 4)
#: Folder of what the repository holds.
OUTPUT = RESULTS / "suite"
#: Evaluations of all agents: on the tracks of the test and on those of the training.
_SPLITS = "test", "train"
#: Evaluation of the agents of selfplay-5 in another task.
_TRANSFER = "versus"
#: Evaluations of the agents of ippo, and what is different in each.
_VARIANTS = {"argmax": {"samples": False}, "unrecovered": {"recovers": False}}
_EVALUATIONS = (*_SPLITS, _TRANSFER, *_VARIANTS)
#: What the archive holds of a run.
_PACKED = (
    *("agent/*", "log.jsonl", "arguments.json"),
    *(f"entry*/{file}" for file in ("entry.json", "replays/*")),
)
#: What the repository holds of a run, in a zip of its own.
_KEPT = "log.jsonl", "entry*/entry.json", "entry*/races/*.json"


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    words = parser("suite_reference", __doc__)
    words.add_argument(
        "--only", nargs="+", default=["*"], metavar="RUN", help="names of runs, or patterns of them"
    )
    words.add_argument("--kart-steps", type=int, help="instead of the task's budget")
    words.add_argument("--folder", type=Path, default=Path("runs/suite"), help="folder of the runs")
    words.add_argument("--jobs", type=int, help="races at the same time (default: all cores)")
    words.add_argument(
        "--only-evaluate", action="store_true", help="skip runs that are not trained"
    )
    words.add_argument(
        "--evaluations",
        nargs="+",
        choices=_EVALUATIONS,
        default=_EVALUATIONS,
        metavar="NAME",
        help="some of: %(choices)s",
    )
    words.add_argument("--archive", type=Path, help="zip to write")
    words.add_argument("--output", type=Path, default=OUTPUT, help="folder of digests and report")
    options = words.parse_args(arguments)
    runs = reference_runs()
    names = [name for name in runs if any(fnmatch(name, shape) for shape in options.only)]
    if not names:
        words.error(f"no run is called {' or '.join(options.only)}; expected {', '.join(runs)}")
    console = Console(stderr=True)
    if options.archive:
        packed = pack(options.folder, names, options.archive, options.output)
        console.print(f"{options.archive} has {packed} of {len(names)} runs")
        return 0
    for name in names:
        folder, (task, algorithm, seed) = options.folder / name, runs[name]
        run = task, algorithm, seed, options.kart_steps or find_task(task).budget
        if options.only_evaluate and not (folder / "agent").is_dir():
            console.print(f"{name}: is not trained")
            continue
        if not options.only_evaluate:
            _train(folder, *run)
        console.print(f"{name}: {_evaluate(folder, *run, options.jobs, options.evaluations)}")
    return 0


def reference_runs() -> dict[str, tuple[str, str, int]]:
    """Returns task, algorithm and seed of all runs by name, in the order of their training."""
    runs = itertools.product(SEEDS, (*ALGORITHMS, suite_sb3.ALGORITHM), REFERENCE_TASKS)
    return {
        f"{task}-{algorithm}-{seed}": (task, algorithm, seed)
        for seed, algorithm, task in runs
        if can_learn(algorithm, find_task(task))
        and (algorithm in ALGORITHMS or task == suite_sb3.TASK)
    }


def _train(folder: Path, task: str, algorithm: str, seed: int, kart_steps: int) -> None:
    """Trains a run, or continues its training."""
    if algorithm in ALGORITHMS:
        algorithms.run(algorithm, folder, task, kart_steps, seed)
    elif not (folder / "agent").is_dir():
        suite_sb3.train(folder, kart_steps, seed)


def _evaluate(
    folder: Path,
    task: str,
    algorithm: str,
    seed: int,
    kart_steps: int,
    jobs: int | None,
    kinds: Sequence[str],
) -> str:
    """Evaluates the agent of a run, or continues its evaluations; returns the scores."""
    about = About()  # the agent's card says the rest
    if algorithm not in ALGORITHMS:
        about = About(
            agent_class="learned", algorithm=algorithm, training_seed=seed, kart_steps=kart_steps
        )
    scores = []
    for kind in kinds:
        agent, of_task, of_kind = folder / "agent", task, about
        if kind in _VARIANTS:
            if algorithm != "ippo":
                continue
            policy, changes = newest_policy(str(folder)), {"samples": True, **_VARIANTS[kind]}
            agent = export_policy(
                policy, f"{algorithm}_{kind}", folder / f"agent-{kind}", **changes
            )
            of_kind = About(variant=kind)
        elif kind == _TRANSFER:
            if task != "selfplay-5":
                continue
            of_task, of_kind = kind, About(variant=f"trained in {task}")
        split = kind if kind in _SPLITS else "test"
        output = folder / ("entry" if kind == "test" else f"entry-{kind}")
        options = {"split": split, "about": of_kind, "jobs": jobs, "plot": False}
        entry = evaluate(of_task, str(agent), output=output, **options)
        scores.append(f"{entry.score} ({kind})")
    return ", ".join(scores)


def pack(folder: Path, names: Sequence[str], archive: Path, output: Path) -> int:
    """Packs the runs that have an entry, and adds them to the results in the repository.

    Args:
        folder: folder of the runs.
        names: names of the runs.
        archive: zip to write. Equal runs give equal archives.
        output: folder of ``runs``, ``digests.json`` and ``report.json``.

    Returns:
        The number of runs in the archive.

    Raises:
        ConfigError: no run is complete, or a file cannot be written.
        EntryRefused: a number in an entry does not follow from its replays.
    """
    folders = [folder / name for name in names if (folder / name / "entry/entry.json").is_file()]
    if not folders:
        raise ConfigError(f"{folder} has no complete run; run this program without --archive")
    load_runs(folders)  # refuses numbers that do not follow from the replays
    packed = _write_zip(archive, folder, folders, _PACKED)
    (output / "runs").mkdir(parents=True, exist_ok=True)
    for run in folders:
        _write_zip(output / "runs" / f"{run.name}.zip", folder, [run], _KEPT)
    digests: dict[str, dict[str, str]] = {"archives": {}, "files": {}}
    if (output / "digests.json").exists():
        digests = json.loads((output / "digests.json").read_text())
    digests["archives"][archive.name] = file_digest(archive)
    digests["files"] |= {
        path.relative_to(folder).as_posix(): file_digest(path)
        for path in packed
        if path.suffix != ".stkz"
    }
    with tempfile.TemporaryDirectory() as place:
        for file in (output / "runs").glob("*.zip"):
            zipfile.ZipFile(file).extractall(place)
        report = make_report(load_runs([place], _kept_evaluation))
    write_text(output / "digests.json", json.dumps(digests, indent=1) + "\n")
    write_text(output / "report.json", report.to_json() + "\n")
    return len(folders)


def _write_zip(
    archive: Path, root: Path, folders: Sequence[Path], patterns: Sequence[str]
) -> list[Path]:
    """Writes files of some folders to a zip, with names relative to a root; returns the files."""
    places = itertools.product(folders, patterns)
    files = [path for place, pattern in places for path in sorted(place.glob(pattern))]
    files = [path for path in files if path.is_file()]
    with write_whole(archive, "the archive") as part, zipfile.ZipFile(part, "w") as target:
        for path in files:
            member = zipfile.ZipInfo(path.relative_to(root).as_posix(), (1980, 1, 1, 0, 0, 0))
            member.compress_type = zipfile.ZIP_DEFLATED
            target.writestr(member, path.read_bytes())
    return files


def _kept_evaluation(folder: Path) -> Evaluation:
    """Reads what the repository holds of an evaluation, which has no replays."""
    entry = Entry.load(folder / ENTRY_FILE)
    results = load_orders(entry.plan.orders(), folder)
    return Evaluation(folder, entry, tuple(results.values()))


if __name__ == "__main__":
    sys.exit(main())
