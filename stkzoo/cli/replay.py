"""``stkzoo replay``: run a recorded race again."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any

from stkzoo.cli.race import EXTRAS

if TYPE_CHECKING:
    from stkzoo.race import RaceListener
    from stkzoo.race.replay import Playback, Replay

__all__ = ["add_parser"]

_ABOUT = """\
Runs a race again that `stkzoo race --replay FILE` kept, on the real engine, and checks after
every step that each kart is where it was, to the last bit. The drivers are not needed.
"""

_EXAMPLES = """\
examples:
  stkzoo race heuristic ai ai --seed 1 --replay race.stkz
  stkzoo replay race.stkz                      run it again and check it
  stkzoo replay race.stkz --video race.mp4     make a video of it
  stkzoo replay race.stkz --info               what is in the file, without the engine

exit codes:
  0 all is as recorded, 1 it is not, or the file cannot be played, 2 the command cannot be
  understood, 130 interrupted
"""

_OWN_EXTRA = "race_replay"


def add_parser(subparsers: argparse._SubParsersAction[Any]) -> None:
    """Adds the command."""
    parser = subparsers.add_parser(
        "replay",
        help="run a recorded race again, check it, film it",
        description=_ABOUT,
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("file", metavar="FILE", help="what `stkzoo race --replay` wrote")
    parser.add_argument("--info", action="store_true", help="show what is in it, run nothing")
    parser.add_argument("--json", action="store_true", help="write JSON to stdout")
    parser.add_argument(
        "--to-the-end", action="store_true", help="go on after the first difference"
    )
    parser.add_argument(
        "--any-engine",
        action="store_true",
        help="play it with another version of the engine, which may drive differently",
    )
    parser.add_argument(
        "--video", dest="record", metavar="FILE", help="make a video; the same as --record"
    )
    for name in _extras():
        import_module(f"stkzoo.cli.{name}").add_flags(parser)
    parser.set_defaults(run=_run, fail=parser.error, races=1)


def _extras() -> Sequence[str]:
    """What can watch a race can watch a replay."""
    return [name for name in EXTRAS if name != _OWN_EXTRA]


def _run(arguments: argparse.Namespace) -> int:
    from stkzoo.race.replay import load_replay

    replay = load_replay(arguments.file)
    if arguments.info:
        _show_info(replay, as_json=arguments.json)
        return 0
    playback = _play(replay, arguments)
    _show(replay, playback, as_json=arguments.json)
    return 0 if playback.is_exact else 1


def _play(replay: Replay, arguments: argparse.Namespace) -> Playback:
    from stkzoo.cli.race_report import RaceBar
    from stkzoo.errors import ConfigError
    from stkzoo.race.replay import play_replay

    with RaceBar() as bar:
        listeners: list[RaceListener] = [bar]
        try:
            for name in _extras():
                listeners += import_module(f"stkzoo.cli.{name}").listeners(arguments)
        except ConfigError as error:
            arguments.fail(str(error))
        return play_replay(
            replay,
            listeners=listeners,
            to_the_end=arguments.to_the_end,
            any_engine=arguments.any_engine,
        )


def _show(replay: Replay, playback: Playback, *, as_json: bool) -> None:
    if as_json:
        form = {
            "type": "replay-check",
            "is_exact": playback.is_exact,
            "first_difference": playback.first_difference,
            "result_differences": playback.result_differences,
            "steps": playback.steps,
            "recorded_steps": replay.steps,
            "result": json.loads(playback.result.to_json()),
        }
        print(json.dumps(form, indent=2))
    else:
        from stkzoo.cli.race_report import show_race

        show_race(playback.result)
    if playback.is_exact:
        text = f"All {playback.steps} steps are as recorded, to the last bit."
        print(text, file=sys.stderr if as_json else sys.stdout)
        return
    if playback.first_difference is None:
        print(
            f"stkzoo: all {playback.steps} steps are as recorded, but not the result in the file; "
            f"somebody has changed it: {'; '.join(playback.result_differences)}",
            file=sys.stderr,
        )
        return
    where = (
        f"after step {playback.first_difference}"
        if playback.first_difference
        else ("on the grid already")
    )
    print(
        f"stkzoo: the race is another one: {where} a kart is not where it was (the recorded race "
        f"has {replay.steps} steps). The game's data or the machine may be another; versions "
        f"then: {_versions(replay)}",
        file=sys.stderr,
    )


def _show_info(replay: Replay, *, as_json: bool) -> None:
    if as_json:
        from dataclasses import asdict

        form = asdict(replay)
        del form["controls"], form["digests"]
        form["result"] = json.loads(replay.result.to_json()) if replay.result else None
        print(json.dumps({**form, "steps": replay.steps}, indent=2))
        return
    way = ", reversed" if replay.reverse else ""
    seconds = replay.steps * replay.step_size
    print(
        f"{replay.track}{way}: laps {replay.laps}, AI difficulty {replay.difficulty}, "
        f"seed {replay.seed}"
    )
    print(f"{replay.steps} steps, {seconds:.1f} s of game time; it ended: {replay.status}")
    if replay.is_partial:
        print("partial: the race was cut off; this is how far it had come")
    rows = {row.agent: row for row in replay.result.agents} if replay.result else {}
    for number, agent in enumerate(replay.agents):
        row = rows.get(f"kart_{number}")
        ended = f", rank {row.rank}, {row.status}" if row else ""
        print(f"  kart_{number}  {agent.name} from place {replay.start_positions[number]}{ended}")
    print(f"recorded with {_versions(replay)}")


def _versions(replay: Replay) -> str:
    return ", ".join(f"{name} {value}" for name, value in replay.versions.items())
