"""Run a recorded race again, check it, or make a video of it.

Replays a race recorded with `stkzoo race --replay FILE` on the real engine. After every step, it
checks that the locations, rotations and velocities of all karts are identical to the recorded
ones, bit for bit. The drivers are not needed.

Examples:
  stkzoo race heuristic ai ai --seed 1 --replay race.stkz
  stkzoo replay race.stkz                      run it again and check it
  stkzoo replay race.stkz --video race.mp4     make a video of it
  stkzoo replay race.stkz --info               describe the file, run nothing

exit codes:
  0 the race is as recorded (as far as it ran, if stopped on its page), 1 it
  differs, or the file is not playable, 2 invalid command line, 130
  interrupted
"""

from __future__ import annotations

import sys
from dataclasses import asdict, dataclass

from stkzoo._arguments import changed_options, options_of, positional, refuse_options
from stkzoo.cli._console import counted, show
from stkzoo.cli._race_options import ViewingArguments
from stkzoo.cli._race_report import RaceBar, described, show_race
from stkzoo.errors import ConfigError, StkzooError
from stkzoo.race.replay import Playback, Replay, load_replay, other_versions, play_replay


@dataclass
class ReplayArguments:
    """Options of ``stkzoo replay``.

    Attributes:
        file: the output of `stkzoo race --replay`
        info: describe the file, run nothing
        json: write JSON to stdout
        to_the_end: continue after the first difference
        any_engine: also play races of another engine version, which may behave differently
    """

    file: str = positional()
    info: bool = False
    json: bool = False
    to_the_end: bool = False
    any_engine: bool = False
    viewing: ViewingArguments = options_of(ViewingArguments)


def run(arguments: ReplayArguments) -> int:
    """Plays or describes a replay."""
    if arguments.info:
        options = changed_options(arguments, only=("to_the_end", "any_engine", "viewing"))
        refuse_options("--info runs nothing", options)
    replay = load_replay(arguments.file)
    if arguments.info:
        show(replay.to_dict(), lambda _: _show_info(replay), as_json=arguments.json)
        return 0
    with RaceBar() as bar:
        listeners = [bar, *arguments.viewing.listeners()]
        try:
            playback = play_replay(
                replay,
                listeners=listeners,
                to_the_end=arguments.to_the_end,
                any_engine=arguments.any_engine,
            )
        except ConfigError as error:  # a failure, not an invalid command line
            raise StkzooError(str(error)) from error
    values = {
        "type": "replay-check",
        "is_exact": playback.is_exact,
        **asdict(playback),
        "recorded_steps": replay.steps,
        "result": playback.result,
    }
    show(values, lambda _: show_race(playback.result), as_json=arguments.json)
    is_result = playback.is_exact and not arguments.json
    print(_verdict(replay, playback), file=sys.stdout if is_result else sys.stderr)
    return 0 if playback.is_exact else 1


def _verdict(replay: Replay, playback: Playback) -> str:
    """Returns whether the race was as recorded, and if not, where it differed."""
    if playback.is_exact:
        some = f"All {replay.steps} steps"
        if playback.steps < replay.steps:  # the viewer of a page stopped the race
            some = f"Stopped: the first {playback.steps} of {replay.steps} steps"
        return f"{some} are as recorded, to the last bit."
    step = playback.first_difference
    if step is None:
        return (
            f"stkzoo: all {playback.steps} steps are as recorded, but not the result in the file; "
            f"the file was changed: {'; '.join(playback.result_differences)}"
        )
    where = f"after step {step}" if step else "on the grid already"
    others = other_versions(replay)
    return (
        f"stkzoo: the race differs: {where} a kart is not where it was (the recorded race "
        f"has {replay.steps} steps). The game's data or the machine may differ; recorded with "
        f"{_versions(replay)}" + (f"; here: {others}" if others else "")
    )


def _show_info(replay: Replay) -> None:
    print(
        f"{described(replay)}: {counted(replay.laps, 'lap')}, difficulty {replay.difficulty}, "
        f"seed {replay.seed}"
    )
    print(f"{counted(replay.steps, 'step')}, countdown included; it ended: {replay.status}")
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
