"""``stkzoo demos``: demonstrations to learn from."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stkzoo.cli.batch_bar import BatchBar
from stkzoo.cli.flags import add_flags, flags_given

if TYPE_CHECKING:
    from stkzoo.evaluation import Demonstrations, DemoPlan

__all__ = ["add_parser"]

_ABOUT = """\
Records what a driver sees and what it does then, in the view of your choice, as one file to
learn from: behaviour cloning, offline learning, a start for reinforcement learning.

The driver is the game's AI (ai), one that comes with stkzoo (heuristic, pretrained:ace), or an
agent of yours (a folder, a zip, a module), whatever view it sees itself. All its karts are
recorded. Each race is kept as soon as it is over; after an interruption the same command goes on.

Read the file with stkzoo.evaluation.load_demonstrations(path), or with numpy.load (no pickles).
"""

_EXAMPLES = """\
examples:
  stkzoo demos heuristic                              15 training tracks, in demos.npz
  stkzoo demos ai --difficulty 3 --seeds 5 --directions forward reversed --output ai.npz
  stkzoo demos heuristic --rivals ai ai ai ai --karts 1 --view flattened_discrete
  stkzoo demos my_agent/ --tracks lighthouse hacienda --check
  stkzoo demos heuristic --format minari --output supertuxkart/heuristic-v0

exit codes:
  0 all is well, 1 a race could not be recorded or is not the same when driven again, 2 the
  command cannot be understood, 130 interrupted
"""

_INTERRUPTED = 130
_DIRECTIONS = {"forward": False, "reversed": True}


def add_parser(subparsers: argparse._SubParsersAction[Any]) -> None:
    """Adds the command."""
    from stkzoo.evaluation.demonstrations.plan import DECIDED
    from stkzoo.race import RaceSettings

    parser = subparsers.add_parser(
        "demos",
        help="record demonstrations to learn from",
        description=_ABOUT,
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("agent", metavar="AGENT", help="who is recorded; see above")
    _add_races(parser)
    parser.add_argument(
        "--output",
        metavar="FILE",
        help="the data set (default: demos.npz); with --format minari its name there (default: "
        "supertuxkart/AGENT-v0)",
    )
    parser.add_argument(
        "--format", choices=("npz", "minari"), default="npz", help="default: %(default)s"
    )
    parser.add_argument(
        "--check",
        action="store_true",
        help="drive the first race again by what was recorded, and compare what is seen (not "
        "with ai, which has boosts that agents do not get)",
    )
    parser.add_argument(
        "--jobs", type=int, metavar="N", help="races at a time (default: as many as processors)"
    )
    parser.add_argument(
        "--race-timeout",
        type=float,
        default=3600.0,
        metavar="SECONDS",
        help="for one race (default: %(default)s)",
    )
    add_flags(parser.add_argument_group("each race"), RaceSettings, leave_out=DECIDED)
    parser.set_defaults(run=_run, fail=parser.error)


def _add_races(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--view",
        default="racing",
        metavar="NAME",
        help="in which it is recorded: racing, simple, flattened_discrete, ... (default: racing)",
    )
    parser.add_argument(
        "--tracks",
        nargs="+",
        default=["train"],
        metavar="TRACK",
        help="names of tracks, or train, test or all (default: train)",
    )
    parser.add_argument(
        "--directions",
        nargs="+",
        default=["forward"],
        choices=list(_DIRECTIONS),
        help="default: forward",
    )
    parser.add_argument(
        "--seeds",
        type=int,
        default=1,
        metavar="N",
        help="races of each track and direction (default: %(default)s)",
    )
    parser.add_argument(
        "--first-seed", type=int, default=0, metavar="N", help="theirs count from here (default: 0)"
    )
    parser.add_argument(
        "--karts",
        type=int,
        default=4,
        metavar="N",
        help="how many karts of a race it drives (default: %(default)s)",
    )
    parser.add_argument(
        "--rivals", nargs="+", default=[], metavar="DRIVER", help="who drives beside them"
    )
    parser.add_argument(
        "--substeps",
        type=int,
        metavar="N",
        help="how often the AI's controls are read in a step, 1 to 12: it decides 12 times, and "
        "each reading takes time (default: 4; for agents 1)",
    )


def _run(arguments: argparse.Namespace) -> int:
    from stkzoo.errors import ConfigError
    from stkzoo.evaluation import BatchError
    from stkzoo.evaluation.demonstrations.minari import require_minari

    with BatchBar() as bar:
        try:
            plan = _plan(arguments)
            if arguments.format == "minari":
                require_minari()
            file = _file(arguments, plan)
            demos = _record(arguments, plan, file, bar)
            bar.stop()
            return _finish(arguments, demos, file)
        except ConfigError as error:
            bar.stop()
            arguments.fail(str(error))
            raise  # not reached: fail() leaves
        except BatchError as error:
            print(f"stkzoo: {error}", file=sys.stderr)
            return 1
        except KeyboardInterrupt:
            print(
                f"stkzoo: interrupted after {bar.done} of {bar.total} races, which are kept; to "
                "go on, give the same command again",
                file=sys.stderr,
            )
            return _INTERRUPTED


def _plan(arguments: argparse.Namespace) -> DemoPlan:
    from stkzoo.errors import ConfigError, check_whole
    from stkzoo.evaluation import plan_demonstrations
    from stkzoo.evaluation.demonstrations.plan import DECIDED
    from stkzoo.race import RaceSettings, find_driver

    check_whole("seeds", arguments.seeds, 1)
    check_whole("first-seed", arguments.first_seed, 0)
    if arguments.check and find_driver(arguments.agent, inline=True).is_game_ai:
        raise ConfigError(
            "--check cannot drive the game's AI again, which has boosts that agents do not get; "
            "leave it out"
        )
    return plan_demonstrations(
        arguments.agent,
        view=arguments.view,
        tracks=arguments.tracks,
        reverse=[_DIRECTIONS[name] for name in arguments.directions],
        seeds=range(arguments.first_seed, arguments.first_seed + arguments.seeds),
        karts=arguments.karts,
        rivals=arguments.rivals,
        substeps=arguments.substeps,
        settings=RaceSettings(**flags_given(arguments, RaceSettings, leave_out=DECIDED)),
    )


def _file(arguments: argparse.Namespace, plan: DemoPlan) -> Path:
    """The data set's file; for Minari one that is there until its own is."""
    if arguments.format == "npz":
        return Path(arguments.output or "demos.npz")
    arguments.output = arguments.output or f"supertuxkart/{plan.agent.label.replace(':', '-')}-v0"
    return Path(f"{arguments.output.replace('/', '-')}.npz")


def _record(
    arguments: argparse.Namespace, plan: DemoPlan, file: Path, bar: BatchBar
) -> Demonstrations:
    from stkzoo.evaluation import RunOptions
    from stkzoo.evaluation.demonstrations.run import record_plan

    options = RunOptions(arguments.jobs, arguments.race_timeout, bar.tell)
    return record_plan(plan, file, options)


def _finish(arguments: argparse.Namespace, demos: Demonstrations, file: Path) -> int:
    from stkzoo.evaluation import check_demonstrations, to_minari

    where, how = str(file), f"stkzoo.evaluation.load_demonstrations({str(file)!r})"
    if arguments.format == "minari":
        to_minari(demos, arguments.output)
        file.unlink()
        where, how = arguments.output, f"minari.load_dataset({arguments.output!r})"
    finished = sum(facts.finish_time is not None for facts in demos.facts)
    print(
        f"{where}: {len(demos)} drives ({finished} finished), {demos.num_steps:,} steps, view "
        f"{demos.view}\nread it with {how}"
    )
    if not arguments.check:
        return 0
    found = check_demonstrations(demos)
    if found.is_exact:
        print(f"driven again, the first race is the same: {found.steps:,} steps, to the last bit")
        return 0
    print(
        f"stkzoo: driven again, it differs from step {found.first_difference} on", file=sys.stderr
    )
    return 1
