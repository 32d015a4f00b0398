"""The pystk2-gymnasium side of the parity check: records races step by step.

The reference and stkzoo register the same ids, so the reference runs in a separate interpreter
(:class:`ReferenceProcess`). With the game's bots, only the first race of a process is reproducible,
so that interpreter forks a child process per race. The child runs the engine itself, or in the
subprocess that the reference starts by default.
"""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

#: Probabilities of accepting a random action with low throttle, brake or rescue. With all such
#: actions, karts would hardly move.
_KEEP_SLOW, _KEEP_BRAKE, _KEEP_RESCUE = 0.2, 0.1, 0.01
#: Number of steps for which an action is held.
_HOLD_STEPS = 4


@dataclass(frozen=True)
class Job:
    """A race to run. All values are plain, so that it can be sent to a process as JSON.

    Attributes:
        env_id: Gymnasium id.
        track: the track.
        steps: maximum number of steps, after which the episode is truncated.
        num_kart: number of karts.
        use_ai: whether the game drives each agent.
        engine_seed: seed of the engine.
        kart_indices: kart index of each agent, in grid order.
        use_subprocess: whether the reference runs the engine in a subprocess.
    """

    env_id: str
    track: str
    steps: int
    num_kart: int
    use_ai: tuple[bool, ...]
    engine_seed: int = 0
    kart_indices: tuple[int, ...] = ()
    use_subprocess: bool = False

    @property
    def is_multi(self) -> bool:
        """Whether the id is the multi-agent id."""
        return "multi-full" in self.env_id

    @property
    def is_polar(self) -> bool:
        """Whether positions are two angles and a distance."""
        return "full" not in self.env_id


class Leaf(NamedTuple):
    """One entry of a nested value.

    Attributes:
        kind: name of its type; for a tuple, also the types of its entries.
        values: the value; a tuple's entries are stacked.
    """

    kind: str
    values: npt.NDArray[Any]


class Moment(NamedTuple):
    """The result of ``step``, or of ``reset`` with reward 0 and no end."""

    observation: dict[str, Leaf]
    reward: float
    terminated: bool
    truncated: bool
    info: dict[str, Leaf]


@dataclass
class Recording:
    """A race as recorded by one side.

    Attributes:
        moments: results of the reset and of each step.
        observation_space: leaves of the observation space as text, by path.
        action_space: leaves of the action space as text, by path.
        actions: action of each step.
        layout: name and shape of the inner entries of flattened vectors, by vector.
    """

    moments: list[Moment]
    observation_space: dict[str, str]
    action_space: dict[str, str]
    actions: list[Any] = field(default_factory=list)
    layout: dict[str, list[tuple[str, tuple[int, ...]]]] = field(default_factory=dict)


def flatten(value: Any, path: str = "") -> dict[str, Leaf]:
    """Returns the entries of nested dicts by path, such as ``"a/b"``."""
    if isinstance(value, Mapping):
        leaves: dict[str, Leaf] = {}
        for key, part in value.items():
            leaves.update(flatten(part, f"{path}/{key}" if path else str(key)))
        return leaves
    if isinstance(value, tuple):
        kinds = sorted({_kind(part) for part in value})
        return {path: Leaf(f"tuple of {' and '.join(kinds)}", np.array(value))}
    return {path: Leaf(_kind(value), np.array(value))}


def _kind(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"array {value.dtype} {value.shape}"
    return type(value).__name__


def inner_spaces(space: Any, path: str = "") -> dict[str, str]:
    """Returns the leaves of nested ``Dict`` spaces as text, by path."""
    if hasattr(space, "spaces") and isinstance(space.spaces, Mapping):
        leaves: dict[str, str] = {}
        for key, part in space.spaces.items():
            leaves.update(inner_spaces(part, f"{path}/{key}" if path else str(key)))
        return leaves
    return {path: str(space)}


class ReferenceProcess:
    """An interpreter in which pystk2-gymnasium runs and records races.

    Args:
        data: folder of the game data, for ``SUPERTUXKART_DATADIR``.
    """

    def __init__(self, data: Path) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="parity-")
        self._log = Path(self._folder.name, "log")
        environment = {
            **os.environ,
            "SUPERTUXKART_DATADIR": str(data),
            "HOME": self._folder.name,
            "OPENBLAS_NUM_THREADS": "1",
            "OMP_NUM_THREADS": "1",
        }
        with self._log.open("wb") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-W", "ignore", "-c", f"from {__name__} import serve; serve()"],
                cwd=Path(__file__).parents[2],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
                env=environment,
            )

    def run(self, job: Job) -> Recording:
        """Runs one race with actions drawn from the reference's own action space.

        Raises:
            RuntimeError: the reference failed; the message ends with its output.
        """
        output = Path(self._folder.name, "recording")
        output.unlink(missing_ok=True)
        process = self._process
        if process.stdin is None or process.stdout is None:
            raise RuntimeError("the reference was closed; make a new ReferenceProcess")
        process.stdin.write(json.dumps({"output": str(output), "job": asdict(job)}) + "\n")
        process.stdin.flush()
        if process.stdout.readline().strip() != "0":
            raise RuntimeError(f"the reference failed on {job}:\n{self._log.read_text()[-3000:]}")
        recording: Recording = pickle.loads(output.read_bytes())  # noqa: S301 - our own child's
        return recording

    def close(self) -> None:
        """Ends the interpreter."""
        self._process.communicate()
        self._folder.cleanup()

    def __enter__(self) -> ReferenceProcess:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()


# ---------------------------------------------------------- in the other interpreter


def serve() -> None:
    """Runs jobs, one line of JSON each; the main function of the other interpreter."""
    replies = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # the engine prints to stdout
    _compile_rotations()
    for line in sys.stdin:
        request = json.loads(line)
        child = os.fork()
        if child == 0:
            _run_child(Job(**request["job"]), Path(request["output"]))
        _, status = os.waitpid(child, 0)
        replies.write(f"{status}\n")


def _compile_rotations() -> None:
    """Compiles the reference's functions once for all children."""
    from pystk2_gymnasium.utils import rotate, rotate_batch

    quaternion = np.zeros(4, np.float32)
    rotate(np.zeros(3, np.float32), quaternion)
    rotate_batch(np.zeros((2, 3), np.float32), quaternion)


def _run_child(job: Job, output: Path) -> None:
    status = 1
    try:
        env = _make(job)
        output.write_bytes(pickle.dumps(_record(env, job)))
        env.close()
        status = 0
    except BaseException:  # noqa: BLE001 - the child must not continue as the parent
        import traceback

        traceback.print_exc()
    finally:
        sys.stderr.flush()
        os._exit(status)


def _record(env: Any, job: Job) -> Recording:
    observation, info = env.reset(seed=0)
    recording = Recording(
        moments=[Moment(flatten(observation), 0.0, False, False, flatten(info))],
        observation_space=inner_spaces(env.observation_space),
        action_space=inner_spaces(env.action_space),
        layout=_layout(env),
    )
    env.action_space.seed(job.engine_seed)
    random = np.random.default_rng(job.engine_seed)
    action: Any = None
    for step in range(job.steps):
        if step % _HOLD_STEPS == 0:
            action = _draw(env, random, job.is_multi)
        recording.actions.append(action)
        observation, reward, terminated, truncated, info = env.step(action)
        recording.moments.append(
            Moment(flatten(observation), float(reward), bool(terminated), truncated, flatten(info))
        )
        if terminated:
            break
    return recording


def _make(job: Job) -> Any:
    import gymnasium
    import pystk2
    from pystk2_gymnasium import AgentSpec, envs

    kinds = pystk2.PlayerConfig.Controller
    original = envs.BaseSTKRaceEnv.warmup_race

    def warmup_race(self: Any) -> None:
        self.config.seed = job.engine_seed
        for kart in range(job.num_kart):
            self.config.players[kart].controller = kinds.AI_CONTROL
        for kart, is_ai in zip(job.kart_indices, job.use_ai, strict=True):
            if not is_ai:
                self.config.players[kart].controller = kinds.PLAYER_CONTROL
        if job.is_multi:
            self.kart_indices = list(job.kart_indices)
            order = sorted(range(len(job.kart_indices)), key=self.kart_indices.__getitem__)
            self.kart_m_indices = order
        else:
            (self.kart_ix,) = job.kart_indices
        original(self)

    envs.BaseSTKRaceEnv.warmup_race = warmup_race
    specs = [AgentSpec(use_ai=is_ai) for is_ai in job.use_ai]
    return gymnasium.make(
        job.env_id,
        disable_env_checker=True,
        max_episode_steps=job.steps,
        track=job.track,
        num_kart=job.num_kart,
        use_subprocess=job.use_subprocess,
        **({"agents": specs} if job.is_multi else {"agent": specs[0]}),
    )


def _layout(env: Any) -> dict[str, list[tuple[str, tuple[int, ...]]]]:
    """Returns the entries of the two vectors of flattened observations, in order."""
    while not hasattr(env, "observation_flattener"):
        if not hasattr(env, "env"):
            return {}
        env = env.env
    flattener, space = env.observation_flattener, env.env.observation_space
    return {
        "continuous": [(key, space[key].shape) for key in flattener.continuous_keys],
        "discrete": [(key, space[key].shape) for key in flattener.discrete_keys],
    }


def _draw(env: Any, random: np.random.Generator, is_multi: bool) -> Any:
    """Draws an action from the space, mostly with throttle and without brake and rescue."""
    if is_multi:
        return {key: _accepted(space, [], random) for key, space in env.action_space.items()}
    wrappers = []
    inner = env
    while hasattr(inner, "env"):
        wrappers.append(inner)
        inner = inner.env
    return _accepted(env.action_space, [w.action for w in wrappers if hasattr(w, "action")], random)


def _accepted(space: Any, changes: list[Any], random: np.random.Generator) -> Any:
    while True:
        base = action = space.sample()
        for change in changes:
            base = change(base)
        is_slow = np.ravel(base["acceleration"])[0] < 0.5
        if (
            (not is_slow or random.random() < _KEEP_SLOW)
            and (not base["brake"] or random.random() < _KEEP_BRAKE)
            and (not base["rescue"] or random.random() < _KEEP_RESCUE)
        ):
            return action
