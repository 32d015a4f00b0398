"""Tables of ``stkzoo suite``: tasks, the population, entries and conduct."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from stkzoo.suite import Entry, RaceConduct, Task


def print_tasks(tasks: Sequence[Task]) -> None:
    """Prints tasks and the population as JSON."""
    import json
    from dataclasses import asdict

    from stkzoo.suite import POPULATION, SUITE

    content = {
        "suite": SUITE,
        "tasks": [{**asdict(task), "digest": task.digest} for task in tasks],
        "population": [asdict(member) for member in POPULATION],
    }
    print(json.dumps(content, indent=2))


def show_tasks(tasks: Sequence[Task]) -> None:
    """Prints tables of tasks and of the population."""
    from stkzoo.cli._console import say, show_table
    from stkzoo.suite import POPULATION, SUITE

    rows = [
        (
            task.name,
            task.goal,
            f"{task.budget / 1e6:g} M",
            " ".join(task.forms),
            str(task.num_races),
            task.metric.replace("_", " "),
        )
        for task in tasks
    ]
    columns = ("task", "goal", "kart-steps", "forms", "races", "metric")
    show_table(columns, rows, left=("task", "goal", "forms", "metric"), title=SUITE)
    members = [
        (member.driver, "held out" if member.is_held_out else "", member.digest)
        for member in POPULATION
    ]
    show_table(("population", "in training", "digest"), members, left=("population", "in training"))
    say("`stkzoo suite list TASK` shows all rules of a task.")


def show_task(task: Task) -> None:
    """Prints all rules of a task."""
    from dataclasses import asdict

    from stkzoo.cli._console import show_table

    values = {**asdict(task), "races": task.num_races, "digest": task.digest}
    rows = [
        (name.replace("_", " "), _text(value))
        for name, value in values.items()
        if value not in ((), None)
    ]
    show_table(("rule", task.name), rows, left=("rule", task.name))


def _text(value: object) -> str:
    if isinstance(value, tuple):
        return ", ".join(map(str, value))
    return f"{value:,}" if isinstance(value, int) else str(value)


def show_entry(entry: Entry) -> None:
    """Prints the scores of an entry."""
    from stkzoo.cli._console import say
    from stkzoo.cli.benchmark import show_results
    from stkzoo.suite.tasks import DIFFICULTY

    show_results([entry])
    score, task = entry.score, entry.task
    if score is None:
        return
    if task.has_population:
        say(f"The time ratio divides by the AI's time at difficulty {DIFFICULTY} in all races.")
    metric, count = task.metric.replace("_", " "), len(entry.plan.races())
    forms = [group for group in entry.groups if group.by == "form"]
    for group in forms if len(task.forms) > 1 else ():
        say(f"{group.name}: {metric} {group.figures[task.metric]} in {group.races} races.")
    say(f"{entry.label} in {task.name}: {metric} {score} in {len(entry.races)} of {count} races.")
    if entry.normalized_score is not None:
        say(
            f"Normalized: {entry.normalized_score:.2f}; 0 is the weakest and 1 the strongest "
            "driver that comes with stkzoo."
        )


def show_conduct(races: Sequence[RaceConduct]) -> None:
    """Prints the mean conduct of each driver."""
    from stkzoo.cli._console import show_table
    from stkzoo.suite import mean_conduct

    rows = [
        (
            mean.driver,
            str(mean.races),
            f"{mean.contacts:.2f}",
            "-" if mean.closing is None else f"{mean.closing:.1f}",
            f"{mean.off_road:.1f}",
            f"{mean.overtakes:.2f}",
        )
        for mean in mean_conduct(races)
    ]
    columns = ("driver", "races", "contacts", "closing [m/s]", "off road [s]", "overtakes")
    show_table(columns, rows, left=("driver",), title="per race")
