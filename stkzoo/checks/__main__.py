"""The command ``python -m stkzoo.checks module:callable``, which runs all checks."""

from __future__ import annotations

import json
import sys
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import asdict, dataclass

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeElapsedColumn

from stkzoo._arguments import CommandParser, add_options, option, positional
from stkzoo.checks import CHECKS
from stkzoo.checks.play import CheckResult, EnvFactory, bind, load_factory, run_check, takes
from stkzoo.errors import ConfigError, StkzooError, unknown_name
from stkzoo.views import VIEWS

_BAD_USAGE, _INTERRUPTED = 2, 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command.

    Args:
        arguments: the command line; ``None`` for that of the process.

    Returns:
        The exit code: 0 if no check failed, 1 if one failed, 2 for an invalid command line, 130
        after Ctrl-C.
    """
    options = _parser().parse_args(arguments)
    try:
        return _check(options)
    except KeyboardInterrupt:
        _console(stderr=True).print("interrupted")
        return _INTERRUPTED


def _check(options: Namespace) -> int:
    out = _console()
    try:
        variants = _variants(options.environment, options.view, options.track)
        names = _check_names(options.check)
        for make_env in variants.values():
            make_env().close()
    except StkzooError as error:
        _console(stderr=True).print(str(error))
        return _BAD_USAGE if isinstance(error, ConfigError) else 1
    outcomes = _run(variants, names, None if options.json else out)
    if options.json:
        out.print(json.dumps(outcomes, indent=2))
    return int(any(outcome["status"] == "failed" for outcome in outcomes))


def _console(*, stderr: bool = False) -> Console:
    """Returns a console that prints texts as they are."""
    return Console(stderr=stderr, soft_wrap=True, highlight=False, markup=False, emoji=False)


@dataclass
class ChecksArguments:
    """Options of ``python -m stkzoo.checks``.

    Attributes:
        environment: module:callable that makes the environment, such as stkzoo.race_v0:parallel_env
        view: views to check (default: all registered ones)
        track: tracks to check on (default: one short track)
        json: print the results as JSON
    """

    environment: str = positional(metavar="environment")
    view: tuple[str, ...] | None = option(metavar="NAME")
    track: tuple[str, ...] | None = option(metavar="NAME")
    check: tuple[str, ...] | None = option(
        metavar="NAME", help=f"checks to run, of: {', '.join(CHECKS)}"
    )
    json: bool = False


def _parser() -> CommandParser:
    parser = CommandParser(
        prog="python -m stkzoo.checks",
        description="Checks a ParallelEnv: spaces, ends, memory, determinism, API usage.",
        epilog="Exit code: 0 if nothing failed, 1 if something did, 2 for a bad command line.",
    )
    add_options(parser, ChecksArguments)
    return parser


def _variants(
    target: str, views: Sequence[str] | None, tracks: Sequence[str] | None
) -> dict[str, EnvFactory]:
    """Returns the factories to check by label; the label is ``""`` if there is only one."""
    make_env = load_factory(target)
    if views is None:
        views = list(VIEWS) if takes(make_env, "view") else []
    for view in views:
        if view not in VIEWS:
            raise unknown_name("view", view, VIEWS)
    variants = {"": make_env}
    for keyword, values in (("view", views), ("track", tracks or [])):
        if values:
            variants = {
                f"{name} {value}".strip(): bind(make, keyword, value)
                for name, make in variants.items()
                for value in values
            }
    return variants


def _check_names(chosen: Sequence[str] | None) -> list[str]:
    for name in chosen or ():
        if name not in CHECKS:
            raise unknown_name("check", name, CHECKS)
    return list(chosen or CHECKS)


def _run(
    variants: dict[str, EnvFactory], names: Sequence[str], out: Console | None
) -> list[dict[str, object]]:
    outcomes: list[dict[str, object]] = []
    console = out or _console(stderr=True)
    pairs = [(variant, name) for variant in variants for name in names]
    columns = ("{task.description}", BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    hidden = not console.is_terminal
    with Progress(
        *columns, console=console, transient=True, auto_refresh=False, disable=hidden
    ) as progress:
        task = progress.add_task("")
        for variant, name in progress.track(pairs, task_id=task):
            progress.update(task, description=f"{variant} {name}".strip(), refresh=True)
            outcome = run_check(CHECKS[name], variants[variant])
            outcomes.append({"variant": variant, "check": name, **asdict(outcome)})
            if out is not None:
                out.print(_line(variant, name, outcome))
    return outcomes


def _line(variant: str, name: str, outcome: CheckResult) -> str:
    verdict = outcome.status if outcome.status != "failed" else "FAILED"
    reason = f": {outcome.why}" if outcome.why else ""
    title = " ".join(filter(None, (f"[{variant}]" if variant else "", name.replace("_", " "))))
    return f"{title} ({outcome.seconds:.1f} s): {verdict}{reason}"


if __name__ == "__main__":
    sys.exit(main())
