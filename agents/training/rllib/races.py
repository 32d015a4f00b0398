"""Parts that RLlib's env runners need on every node: arguments, game data and races.

Only the methods of :class:`PackSender` need Ray.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stkzoo import RaceVectorEnv
from stkzoo._arguments import option
from stkzoo._schema import Level, Share
from stkzoo.engine.assets import cache_folder, find_assets, install, pack
from stkzoo.errors import AssetError, ConfigError

from ..common.arguments import Coefficient, Natural, PPOArguments, RunArguments

#: Name of the module that learns.
MAIN = "main"
#: Key of the arguments in RLlib's configuration of the environment.
ARGUMENTS = "arguments"
_NAMESPACE = "stkzoo"
#: Time limit for making and sending the pack [s].
_PATIENCE = 1800.0


@dataclass(frozen=True, slots=True)
class RLlibArguments(PPOArguments):
    """Arguments of a run.

    Attributes:
        iterations: total iterations.
        env_runners: processes that run races; 0 runs them in the main process.
        envs_per_runner: parallel races in each env runner.
        cpus_per_runner: processors that Ray reserves for each env runner.
        address: address of a Ray cluster, or auto; empty starts Ray on this machine.
        pack: headless pack for nodes without the game's data; empty makes one.
        tracks: names of tracks, or train, train_only, validation, test or all.
        difficulty: difficulty of the game's AI, 0 to 3.
        learners: karts of the policy that learns.
        frozen: karts of its past selves.
        bots: karts of the game's AI.
        slots: number of past selves to keep.
        promote_at: fraction of duels won at which a snapshot is saved.
        least_races: minimum races between two snapshots.
        max_cycles: steps after which a race is truncated.
        train_batch_size: kart-steps of the learner's karts per iteration.
        checkpoint_every: iterations between two checkpoints.
        sample_timeout: seconds that an iteration waits for env runners.
    """

    n_epochs: int = 6
    gae_lambda: Share = 0.9
    ent_coef: Coefficient = 0.003
    iterations: int = 200
    env_runners: Natural = 2
    envs_per_runner: int = 1
    cpus_per_runner: Coefficient = 1.0
    address: str = ""
    pack: str = ""
    tracks: tuple[str, ...] = option(("train",), flag="--track", metavar="TRACK")
    difficulty: Level = 2
    learners: int = 2
    frozen: Natural = 2
    bots: Natural = 1
    slots: int = 5
    promote_at: Share = 0.6
    least_races: int = 20
    max_cycles: int = 1500
    train_batch_size: int = 8000
    checkpoint_every: int = 5
    sample_timeout: float = 600.0

    def __post_init__(self) -> None:
        RunArguments.__post_init__(self)
        if self.pack and not Path(self.pack).is_file():
            raise ConfigError(
                f"there is no pack {self.pack!r}; stkzoo assets pack --output writes one"
            )
        if self.learners + self.frozen + self.bots > 20:
            raise ConfigError("more than 20 karts in a race; give fewer learners, frozen or bots")
        if self.batch_size > self.train_batch_size:
            raise ConfigError(
                f"batch_size is {self.batch_size}, expected at most {self.train_batch_size}, the "
                "kart-steps of an iteration; give a smaller --batch-size or a larger "
                "--train-batch-size"
            )

    @property
    def modules(self) -> list[str]:
        """Returns the names of all modules; the first one learns."""
        return [MAIN, *(self.slot(number) for number in range(self.slots if self.frozen else 0))]

    def slot(self, number: int) -> str:
        """Returns the module of a snapshot; a new one replaces the oldest."""
        return f"past_{number % self.slots}"

    def modules_of(self, race: int) -> list[str]:
        """Returns the module that drives each agent's kart; the learner's karts come first.

        Args:
            race: any number, which selects the past selves.
        """
        past = [self.slot(race + number) for number in range(self.frozen)]
        return [MAIN] * self.learners + past


def win_share(own: Sequence[int], others: Sequence[int]) -> float | None:
    """Returns the fraction of pairs of a learner and a past self in which the learner is ahead.

    Args:
        own: final ranks of the learner's karts, 1 is first.
        others: final ranks of its past selves.

    Returns:
        0 to 1; ``None`` if there is no such pair.
    """
    if not own or not others:
        return None
    return sum(a < b for a in own for b in others) / (len(own) * len(others))


class PackSender:
    """A Ray actor on the driver's node that sends the headless pack to other nodes.

    Args:
        archive: the pack, as `stkzoo assets pack --output` writes it; empty makes one on first use.
    """

    def __init__(self, archive: str = "") -> None:
        self._bytes = Path(archive).read_bytes() if archive else b""

    @classmethod
    def start(cls, archive: str = "") -> Any:
        """Starts the actor of this run, and returns it."""
        import ray

        node = ray.get_runtime_context().get_node_id()
        place = ray.util.scheduling_strategies.NodeAffinitySchedulingStrategy(node, soft=False)
        options = {"name": _sender_name(), "namespace": _NAMESPACE, "scheduling_strategy": place}
        return ray.remote(num_cpus=0)(cls).options(**options).remote(archive)

    def pack(self) -> bytes:
        """Returns the content of the archive."""
        if not self._bytes:
            with tempfile.TemporaryDirectory() as folder:
                archive = Path(folder) / "stk.tar.xz"
                pack(output=archive)
                self._bytes = archive.read_bytes()
        return self._bytes


def _sender_name() -> str:
    """Returns the name of the run's :class:`PackSender`; a cluster may have several runs."""
    import ray

    return f"pack-{ray.get_runtime_context().get_job_id()}"


def ensure_assets(archive: str = "") -> None:
    """Installs the headless pack if the game's data is missing.

    Args:
        archive: the pack, as `stkzoo assets pack --output` writes it; empty requests it from the
            :class:`PackSender`.

    Raises:
        AssetError: the pack is not available.
    """
    if _have_assets():
        return
    from filelock import FileLock

    cache_folder().mkdir(parents=True, exist_ok=True)
    with FileLock(cache_folder() / "rllib.lock"):  # one process per node at a time
        if _have_assets():  # another env runner on this node installed it
            return
        with tempfile.TemporaryDirectory() as folder:
            file = Path(archive) if archive else Path(folder) / "stk.tar.xz"
            if not archive:
                file.write_bytes(_received_pack())
            install(archive=file)


def _have_assets() -> bool:
    try:
        find_assets()
    except AssetError:
        return False
    return True


def _received_pack() -> bytes:
    try:
        import ray

        sender = ray.get_actor(_sender_name(), namespace=_NAMESPACE)
        data: bytes = ray.get(sender.pack.remote(), timeout=_PATIENCE)
    except Exception as error:  # Ray's errors have no common base, and Ray may be missing
        raise AssetError(
            f"the game's data is missing on this node, and the driver does not send it ({error}); "
            "give --pack FILE, or run `stkzoo assets install` on it"
        ) from error
    return data


def make_races(arguments: RLlibArguments) -> RaceVectorEnv:
    """Returns the races of one env runner."""
    ensure_assets()
    agents, tracks = arguments.learners + arguments.frozen, arguments.tracks
    return RaceVectorEnv(
        arguments.envs_per_runner,
        agents=agents,
        num_kart=agents + arguments.bots,
        track=tracks[0] if len(tracks) == 1 else tracks,
        difficulty=arguments.difficulty,
        view="racing",
        max_cycles=arguments.max_cycles,
    )
