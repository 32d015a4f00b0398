r"""Trains a policy by self-play with Ray RLlib, on one machine or a cluster.

    python -m stkzoo.agents.training.rllib.selfplay --output runs/rllib --iterations 200
    python -m stkzoo.agents.training.rllib.selfplay --output runs/rllib --iterations 200 \
        --address auto --env-runners 30

The script uses PPO on RLlib's new API stack. Its env runners drive all their races in one batch
(``RaceVectorEnv``) and evaluate the networks in C. In every race, the policy that
learns (``main``) drives some karts, frozen snapshots of it drive others, and the game's AI drives
the rest. Every few iterations, a snapshot of ``main`` replaces the oldest one. All policies see the
view ``racing``.

Env runners may be on many nodes. With ``--address``, Ray copies the headless pack (32 MB) to each
node, and a node without the game's data installs it before its first race. If env runners or nodes
die, RLlib restarts them, there or elsewhere, and training continues with the others.

The folder contains ``log.jsonl`` (one line per iteration), ``checkpoint-ITERATION`` (RLlib's; each
replaces the one before) and ``policy.safetensors``, which ``sb3.selfplay --init`` accepts. To
continue a run, also after a kill, run the same command again, perhaps with more ``--iterations``.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from stkzoo._imports import import_extra
from stkzoo._locks import locked_folder
from stkzoo._temporary import make_marked_folder, remove_stale_folders, remove_tree
from stkzoo.agents.pretrained.weights import save_weights
from stkzoo.engine.assets import find_assets, pack
from stkzoo.errors import ConfigError

from ..common.arguments import ScriptOptions
from ..common.command import run_command
from ..common.run_folder import TrainingLog, keep_arguments
from .races import ARGUMENTS, MAIN, PACK, RLlibArguments, sb3_names

_POLICY = "policy.safetensors"
#: Name of a checkpoint, with the number of iterations; folders with other names are the user's.
_CHECKPOINT, _CHECKPOINTS = "checkpoint-{:06}", f"checkpoint-{'[0-9]' * 6}"
#: Start of the name of the folder of a checkpoint while it is written.
_UNFINISHED = ".checkpoint-"
#: Arguments that may change when a run continues.
_FREE = ("iterations", "address", "env_runners", "checkpoint_every")


def build_config(arguments: RLlibArguments) -> Any:
    """Returns RLlib's configuration of a run."""
    from ray.rllib.algorithms.ppo import PPOConfig
    from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig
    from ray.rllib.core.rl_module.multi_rl_module import MultiRLModuleSpec
    from ray.rllib.core.rl_module.rl_module import RLModuleSpec

    from .runner import RaceEnvRunner

    model = DefaultModelConfig(
        fcnet_hiddens=list(arguments.hidden), fcnet_activation="tanh", vf_share_layers=False
    )
    return (
        PPOConfig()
        .environment(env_config={ARGUMENTS: arguments})
        .env_runners(
            env_runner_cls=RaceEnvRunner,
            add_default_connectors_to_env_to_module_pipeline=False,  # the sampler needs none
            add_default_connectors_to_module_to_env_pipeline=False,
            num_env_runners=arguments.env_runners,
            sample_timeout_s=600.0,
        )
        .fault_tolerance(
            restart_failed_env_runners=True,
            num_consecutive_env_runner_failures_tolerance=1000,
            env_runner_health_probe_timeout_s=30.0,
            env_runner_restore_timeout_s=300.0,
        )
        .multi_agent(
            policies=set(arguments.modules),
            policy_mapping_fn=lambda *_, **__: MAIN,  # the learner gets only karts of main
            policies_to_train=[MAIN],
        )
        .rl_module(
            rl_module_spec=MultiRLModuleSpec(
                rl_module_specs={
                    name: RLModuleSpec(model_config=model) for name in arguments.modules
                }
            )
        )
        .training(
            train_batch_size_per_learner=arguments.train_batch_size,
            minibatch_size=arguments.batch_size,
            num_epochs=arguments.n_epochs,
            lr=arguments.learning_rate,
            gamma=arguments.gamma,
            lambda_=arguments.gae_lambda,
            entropy_coeff=arguments.ent_coef,
            use_kl_loss=False,
            clip_param=arguments.clip_range,
            vf_clip_param=1e3,
            grad_clip=0.5,
        )
        .debugging(seed=arguments.seed, log_level="ERROR")
    )


def train(options: ScriptOptions, arguments: RLlibArguments) -> None:
    """Starts or continues a run.

    Args:
        options: folder of the run.
        arguments: arguments of the run.

    Raises:
        ConfigError: Ray is not installed or does not start, or the folder contains another run or
            is used by another program.
        AssetError: the game's data is missing on this machine.
    """
    folder = options.output
    ray = _ray()
    find_assets()
    with locked_folder(folder, "run"):
        keep_arguments(folder, arguments, _FREE)
        with _started(ray, arguments):
            algorithm = _algorithm(arguments, folder)
            try:
                _iterations(algorithm, arguments, folder)
            finally:
                algorithm.stop()
    print(f"{folder / _POLICY} is the policy; the same command with more --iterations continues")


def _ray() -> Any:
    note = "in an environment of its own, because Ray RLlib needs an older Gymnasium"
    import_extra("ray.rllib", "this program needs", "rllib", note)
    return import_extra("ray", "this program needs", "rllib", note)


@contextmanager
def _started(ray: Any, arguments: RLlibArguments) -> Iterator[None]:
    """Connects to a cluster and sends it the pack, or starts Ray on this machine."""
    address = arguments.address
    with tempfile.TemporaryDirectory() as files:
        if address:
            pack(output=Path(files, PACK))
        try:
            ray.init(
                address=address or "local",
                runtime_env={"working_dir": files} if address else {},
                log_to_driver=False,
                include_dashboard=False,
            )
        except (ConnectionError, RuntimeError, ValueError) as error:
            raise ConfigError(
                f"Ray does not start with the address {address!r} ({error}); give the address of a "
                "running cluster (`ray start --head` starts one), or leave --address out"
            ) from error
        try:
            yield
        finally:
            ray.shutdown()


def _algorithm(arguments: RLlibArguments, folder: Path) -> Any:
    """Returns the algorithm at its last checkpoint, or else with its first past selves."""
    algorithm = build_config(arguments).build_algo()
    if checkpoints := _checkpoints(folder):
        algorithm.restore_from_path(str(checkpoints[-1].resolve()))
        algorithm.env_runner_group.sync_weights(
            from_worker_or_learner_group=algorithm.learner_group, inference_only=True
        )
        return algorithm
    from .runner import copy_main

    for module in arguments.modules[1:]:
        copy_main(algorithm, module)
    return algorithm


def _checkpoints(folder: Path) -> list[Path]:
    """Returns the complete checkpoints, the newest last."""
    return sorted(folder.glob(_CHECKPOINTS))


def _iterations(algorithm: Any, arguments: RLlibArguments, folder: Path) -> None:
    from .runner import copy_main

    with TrainingLog(folder, algorithm.iteration) as log:
        while algorithm.iteration < arguments.iterations:
            begun = time.monotonic()
            result = algorithm.train()
            done = algorithm.iteration
            line = _figures(algorithm, result["env_runners"], time.monotonic() - begun)
            log.write(line)
            print(", ".join(f"{n.replace('_', ' ')} {v}" for n, v in line.items()), flush=True)
            number, is_between = divmod(done, arguments.snapshot_every)
            if arguments.frozen and not is_between:
                copy_main(algorithm, arguments.slot(number - 1))
            if done % arguments.checkpoint_every == 0 or done == arguments.iterations:
                _save(algorithm, folder)


def _figures(algorithm: Any, result: Mapping[str, Any], seconds: float) -> dict[str, Any]:
    mean = float(result.get("episode_return_mean", np.nan))
    return {
        "iteration": algorithm.iteration,
        "kart_steps": int(result["num_module_steps_sampled_lifetime"][MAIN]),
        "episodes": int(result.get("num_episodes_lifetime", 0)),
        "return": None if np.isnan(mean) else round(mean, 4),
        "env_runners": algorithm.env_runner_group.num_healthy_remote_workers(),
        "restarted": algorithm.env_runner_group.num_remote_worker_restarts(),
        "seconds": round(seconds, 2),
    }


def _save(algorithm: Any, folder: Path) -> None:
    """Writes the policy and the checkpoint, and then removes older checkpoints.

    The policy is first: a run that is killed between the two repeats the last iterations, and
    writes both again.
    """
    state = algorithm.learner_group.foreach_learner(
        lambda learner: {k: v.cpu().numpy() for k, v in learner.module[MAIN].state_dict().items()}
    )
    save_weights(folder / _POLICY, sb3_names(next(r.get() for r in state)))
    before = _checkpoints(folder)
    remove_stale_folders(folder, _UNFINISHED)
    marked = make_marked_folder(folder, _UNFINISHED)
    algorithm.save_to_path(str((marked / "checkpoint").resolve()))
    (marked / "checkpoint").rename(folder / _CHECKPOINT.format(algorithm.iteration))
    for old in (*before, marked):
        remove_tree(old)


def main(words: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    kinds = ScriptOptions, RLlibArguments
    remedy = "the same command continues from the last checkpoint"
    return run_command("rllib.selfplay", __doc__, train, kinds, words, remedy)


if __name__ == "__main__":
    sys.exit(main())
