"""Registration of the tasks with Gymnasium and PettingZoo: ``stkzoo-suite/TASK-v1``."""

from __future__ import annotations

import gymnasium
import pettingzoo

from stkzoo.env.ids import MAX_EPISODE_STEPS
from stkzoo.errors import unknown_name
from stkzoo.suite.tasks import TASKS, Task
from stkzoo.views import ViewFactory

_NAMESPACE = "stkzoo-suite"


def id_of(task: Task) -> str:
    """Returns the id of a task."""
    return f"{_NAMESPACE}/{task.name}-v1"


def view_of(env_id: str) -> ViewFactory:
    """Returns the view of the agents of the task with an id.

    Raises:
        ConfigError: no task has this id.
    """
    tasks = {id_of(task): task for task in TASKS.values()}
    if env_id not in tasks:
        raise unknown_name("env_name", env_id, tasks)
    return tasks[env_id].agent_view()


def register_tasks() -> None:
    """Registers all tasks; ``import stkzoo.suite`` calls it.

    Gymnasium gets those with one learner, and PettingZoo all, from its version 1.27.
    """
    for task in TASKS.values():
        if task.learners == 1:
            options = {name: value for name, value in task.options().items() if name != "agents"}
            gymnasium.register(
                id=id_of(task),
                entry_point="stkzoo.env.gymnasium_api:STKRaceEnv",
                vector_entry_point="stkzoo.env.vector:single_kart_races",
                kwargs=options,
                max_episode_steps=MAX_EPISODE_STEPS,
            )
        if hasattr(pettingzoo, "register"):
            pettingzoo.register("parallel", id_of(task), task.make)
