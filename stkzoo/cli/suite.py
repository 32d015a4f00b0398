"""Tasks with fixed rules, for comparisons in papers and courses.

stkzoo-suite-1 has four tasks: what to learn, on which tracks, in how many kart-steps, and in which
races the result is evaluated. An evaluated agent is an entry: a folder with its scores and a
replay of each race. `verify` runs all races of an entry again and compares every number.

Examples:
  stkzoo suite list                             the tasks and the population
  stkzoo suite train versus ippo                train an agent
  stkzoo suite evaluate versus heuristic        120 races on the test tracks
  stkzoo suite verify suite/versus-heuristic    run all races again
  stkzoo suite conduct suite/versus-heuristic   contacts, time off the road
  stkzoo suite report runs/                     compare trained algorithms
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from rich.console import Console

from stkzoo import suite
from stkzoo._arguments import option, options_of, positional
from stkzoo._checks import check_name
from stkzoo.cli._batch import RUN_OPTIONS, file_name, run_and_show, run_batch
from stkzoo.cli._console import counted, say, show, show_facts, show_table
from stkzoo.cli.benchmark import show_results
from stkzoo.evaluation import RunOptions
from stkzoo.race import RaceSettings
from stkzoo.suite.about import TRAINING_LOG
from stkzoo.suite.entry import ENTRIES
from stkzoo.suite.tasks import DIFFICULTY

#: Packages of training programs, which are imported by name, because the package must not depend on
#: its agents.
_TRAINING = "stkzoo.agents.training.suite"


@dataclass
class ListArguments:
    """Options of ``stkzoo suite list``.

    Attributes:
        task: show all rules of one task
        json: write JSON instead of tables
    """

    task: str | None = positional(None)
    json: bool = False


@dataclass
class TrainArguments:
    """Options of ``stkzoo suite train``.

    Attributes:
        task: the task, as listed by `stkzoo suite list`
        algorithm: the algorithm; see above
        kart_steps: number of kart-steps to learn from (default: the task's budget)
        seed: seed of all random numbers
        output: folder of the run (default: runs/TASK-ALGORITHM-SEED)
    """

    task: str = positional()
    algorithm: str = positional()
    kart_steps: int | None = None
    seed: int = 0
    output: Path | None = option(metavar="FOLDER")


@dataclass
class PlannedEntryArguments:
    """Options of the races of an entry.

    Attributes:
        task: the task, as listed by `stkzoo suite list`
        agent: the agent: a driver's name, a folder, a zip or a module; append @:Name to rename it
        split: test for an entry; train for fewer races on the training tracks (default: test)
        fresh: draw other seeds from a text, such as one that a leaderboard publishes
    """

    task: str = positional()
    agent: str = positional()
    split: str = option("test", choices=("test", "train"), group="entry")
    fresh: str = option("", metavar="TEXT", group="entry")
    about: suite.About = options_of(suite.About, group="entry")


@dataclass
class EvaluateArguments:
    """Options of ``stkzoo suite evaluate``.

    Attributes:
        output: folder of the entry (default: suite/TASK-AGENT, or entry in the run that trained
            the agent)
        json: write only the entry's JSON to stdout
    """

    plan: PlannedEntryArguments = options_of(PlannedEntryArguments)
    output: Path | None = option(metavar="FOLDER", group="entry")
    json: bool = option(False, group="entry")
    batch: dict[str, Any] = options_of(RunOptions, only=RUN_OPTIONS)
    settings: dict[str, Any] = options_of(
        RaceSettings, without=suite.EntryPlan.decided, group="each race"
    )


@dataclass
class VerifyArguments:
    """Options of ``stkzoo suite verify``.

    Attributes:
        entry: folder of the entry
        agent: the agent itself, which drives again (default: it repeats its recorded controls)
        json: write JSON to stdout
    """

    entry: Path = positional(metavar="ENTRY")
    agent: str | None = None
    json: bool = False
    batch: dict[str, Any] = options_of(RunOptions, only=RUN_OPTIONS)


@dataclass
class ConductArguments:
    """Options of ``stkzoo suite conduct``.

    Attributes:
        replays: replays, or folders of entries or other batches with replays
        json: write JSON to stdout
    """

    replays: tuple[str, ...] = positional(metavar="ENTRY_OR_REPLAY")
    json: bool = False


@dataclass
class SuiteReportArguments:
    """Options of ``stkzoo suite report``.

    Attributes:
        runs: folders of training runs or entries, or folders of them
        output: folder of the report
    """

    runs: tuple[Path, ...] = positional(metavar="RUN")
    output: Path = option(Path("suite", "report"), metavar="FOLDER")


def _list(arguments: ListArguments) -> None:
    """List the tasks and the population.

    Shows for each task what is learned from how many kart-steps, and the races of its evaluation:
    P is a kart of the agent, A one of the game's hardest AI, B one of the population. Tracks are
    driven in both directions, with other karts from both ends of the grid.

    Examples:
      stkzoo suite list
      stkzoo suite list versus          all rules of one task
      stkzoo suite list --json
    """
    tasks = [suite.find_task(arguments.task)] if arguments.task else [*suite.TASKS.values()]
    content = {
        "suite": suite.SUITE,
        "tasks": [{**asdict(task), "digest": task.digest} for task in tasks],
        "population": suite.POPULATION,
    }
    as_text = _show_task if arguments.task else _show_tasks
    show(content, lambda _: as_text(tasks), as_json=arguments.json)


def _train(arguments: TrainArguments) -> None:
    """Train an agent in a task with a reference algorithm.

    Trains an agent with as many kart-steps as the task allows, on all cores. The folder contains
    checkpoints, a log, TensorBoard files, policies and at the end the agent. To continue a run,
    also after a kill, repeat the command.

    Algorithms:
      ippo       independent PPO: learns from each kart's own view and reward
      mappo      the same with a value network that also sees the other learners
      pfsp       ippo that also meets past policies, above all those that beat it
      recurrent  ippo whose policy has a memory
      blind      ippo that does not see which karts are mates

    Examples:
      stkzoo suite train solo-general ippo
      stkzoo suite train versus ippo --seed 2 --output runs/second
      stkzoo suite train versus ippo --kart-steps 10000000       the long tier
    """
    task, name = suite.find_task(arguments.task), arguments.algorithm
    check_name("algorithm", name, suite.ALGORITHMS)
    kart_steps = task.budget if arguments.kart_steps is None else arguments.kart_steps
    folder = arguments.output or Path("runs", f"{task.name}-{name}-{arguments.seed}")
    algorithms = import_module(f"{_TRAINING}.algorithms")
    agent = algorithms.run(name, folder, task.name, kart_steps, arguments.seed)
    say(f"Trained {agent}. Evaluate it: stkzoo suite evaluate {task.name} {agent}")


def _evaluate(arguments: EvaluateArguments) -> int:
    """Evaluate an agent in a task.

    Drives the races of the task and writes an entry: entry.json with the scores, and a replay of
    each race. Each race is stored as soon as it ends. After an interruption, the same command
    resumes. An agent from files needs its --class, unless stkzoo trained it.

    Examples:
      stkzoo suite evaluate solo-general heuristic
      stkzoo suite evaluate versus runs/versus-ippo-0/agent
      stkzoo suite evaluate versus my_agent.zip@:Nova --class learned
      stkzoo suite evaluate versus my_agent/ --class learned --split train
      stkzoo suite evaluate versus heuristic --fresh "2026-12-24"

    exit codes:
      0 success, 1 a race could not be run, 2 invalid command line, 3 the agent
      failed in some race, 130 interrupted
    """
    plan = suite.plan_entry(**vars(arguments.plan), **arguments.settings)
    folder = arguments.output or _entry_folder(plan)
    return run_and_show(arguments, ENTRIES, plan, folder, _show_entry)


def _entry_folder(plan: suite.EntryPlan) -> Path:
    """Returns the default folder of an entry: in the run of its agent, or in ``suite``."""
    ends = ("train" if plan.is_on_training_tracks else "", plan.about.variant, plan.fresh)
    end = "".join(f"-{file_name(text)}" for text in ends if text)
    run = Path(plan.agent.source).parent
    if (run / TRAINING_LOG).is_file():
        return run / f"entry{end}"
    return Path("suite", f"{plan.task}-{file_name(plan.agent.label)}{end}")


def _verify(arguments: VerifyArguments) -> int:
    """Run all races of an entry again, and compare every number.

    Every position, rotation and velocity must be equal to the last bit, and every number of
    entry.json must follow from the races. The rivals drive again, and so do drivers that come with
    stkzoo. The karts of other agents repeat their recorded controls, so that their code is not
    needed; with --agent, the agent drives again.

    The last line says what is proven. Nothing proves what the entry says about its training.

    Examples:
      stkzoo suite verify suite/versus-my_agent
      stkzoo suite verify suite/versus-my_agent --agent my_agent/

    exit codes:
      0 verified, 1 refused, 2 invalid command line, 130 interrupted
    """
    verify = partial(suite.verify_entry, arguments.entry, agent=arguments.agent)
    entry, code = run_batch(arguments.batch, verify, is_saved=False)
    if entry is None:
        return code
    show(entry, _show_entry, as_json=arguments.json)
    if not arguments.json:
        say(f"Verified: {counted(len(entry.races), 'race')} as recorded, to the last bit.")
        say(suite.proof_of(entry, arguments.agent))
    return code


def _conduct(arguments: ConductArguments) -> None:
    """Show how karts behave: contacts, time off the road, overtakes.

    Runs recorded races again, bit for bit, and counts the environment's events of each kart. The
    closing speed is the speed of a kart toward the nearest one before they touch. All other numbers
    are means per race.

    Examples:
      stkzoo race heuristic ai ai --seed 1 --replay race.stkz
      stkzoo suite conduct race.stkz
      stkzoo suite conduct suite/versus-my_agent

    exit codes:
      0 success, 1 a replay is damaged or not reproducible, 2 invalid command
      line, 130 interrupted
    """
    with Console(stderr=True).status("The races run again"):
        means = suite.measure_conduct(arguments.replays)
    show(
        [asdict(mean) for mean in means],
        partial(show_facts, title="per race"),
        as_json=arguments.json,
    )


def _report(arguments: SuiteReportArguments) -> None:
    """Write a report of trained algorithms: scores, intervals, figures.

    Compares trained algorithms and writes report.json (all numbers), report.md (tables), figures as
    SVG, and marl_eval.json for the tools of MARL-eval. The same entries make the same files.

    It reads all entries in the folders, and log.jsonl beside them for the learning curves. Entries
    with the same algorithm in a task are runs of it. All numbers must follow from the replays; the
    races do not run again, so verify entries of others first.

    Examples:
      stkzoo suite report runs/
      stkzoo suite report runs/versus-* suite/versus-heuristic --output report
    """
    report = suite.write_suite_report(arguments.runs, arguments.output)
    runs = sum(result.runs for task in report.tasks for result in task.algorithms)
    say(f"Wrote the report of {counted(runs, 'run')} to {arguments.output / 'report.md'}")


ACTIONS = (_list, _train, _evaluate, _verify, _conduct, _report)


def _show_tasks(tasks: Sequence[suite.Task]) -> None:
    """Prints tables of tasks and of the population."""
    rows = [
        (task.name, task.goal, task.budget, " ".join(task.forms), task.num_races, task.metric)
        for task in tasks
    ]
    columns = ("task", "goal", "kart-steps", "forms", "races", "metric")
    show_table(columns, rows, title=suite.SUITE)
    show_facts([asdict(member) for member in suite.POPULATION])
    say("`stkzoo suite list TASK` shows all rules of a task.")


def _show_task(tasks: Sequence[suite.Task]) -> None:
    """Prints all rules of one task."""
    (task,) = tasks
    rows = []
    for name, value in {**asdict(task), "races": task.num_races, "digest": task.digest}.items():
        texts = map(str, value if isinstance(value, tuple) else (value,))
        rows.append((name.replace("_", " "), ", ".join(texts)))
    show_table(("rule", task.name), rows)


def _show_entry(entry: suite.Entry) -> None:
    """Prints the scores of an entry."""
    show_results([entry])
    score, task = entry.score, entry.task
    if score is None:
        return
    if task.has_population:
        say(f"The time ratio divides by the AI's time at difficulty {DIFFICULTY} in all races.")
    say("A kart that does not finish has a time ratio of 3.")
    metric, count = task.metric.replace("_", " "), len(entry.plan.races())
    races = f"{len(entry.races)} of {counted(count, 'race')}"
    races += f", fresh from {entry.plan.fresh!r}" if entry.plan.fresh else ""
    name = f"{entry.label} ({entry.plan.about.summary})"
    say(f"{name} in {task.name}: {metric} {score} in {races}.")
    if entry.normalized_score is not None:
        say(
            f"Normalized: {entry.normalized_score:.2f}; in the same races, random has 0 and "
            "pretrained:zenith 1."
        )
