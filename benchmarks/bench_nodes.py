"""Measures self-play with RLlib on clusters of one, two and four nodes.

    python -m benchmarks.bench_nodes                    some minutes, 2 GB of disk for Ray
    python -m benchmarks.bench_nodes --nodes 1 2 --folder /big

Each node is a Ray node of its own on this machine, with one CPU and one env runner, which drives
several races. Nodes beyond the number of cores share the cores. The learner runs on the first node,
and the env runners wait while it learns. Past selves and the game's AI do not race.
"""

from __future__ import annotations

import importlib.util
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.bench_common import Table, parser, print_tables, save
from benchmarks.ecosystem import ROOT, run_in_environment


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    words = parser(__doc__, "nodes", steps=8, karts=[10])
    words.add_argument("--nodes", type=int, nargs="+", default=[1, 2, 4], help="numbers of nodes")
    words.add_argument("--races", type=int, default=4, help="races of each node (default: 4)")
    words.add_argument(
        "--folder", type=Path, default=ROOT / ".ecosystem", help="folder of Ray's environment"
    )
    options = words.parse_args(arguments)
    if importlib.util.find_spec("ray") is None:
        own = sys.argv[1:] if arguments is None else arguments
        return run_in_environment("rllib", options.folder, "benchmarks.bench_nodes", own)
    results = [
        {
            "nodes": nodes,
            "karts": karts,
            "races": options.races,
            "kart_steps_per_second": round(_measure(nodes, karts, options), 1),
        }
        for karts in options.karts
        for nodes in options.nodes
    ]
    print_tables(tables(results))
    save(options.output, "nodes", options, results)
    return 0


def _measure(nodes: int, karts: int, options: Any) -> float:
    os.environ["RAY_AUTH_MODE"] = "disabled"  # the cluster is only for this measurement
    import ray
    from ray.cluster_utils import Cluster

    from benchmarks.bench_libraries import rllib_rate

    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    try:
        for _ in range(nodes - 1):
            cluster.add_node(num_cpus=1)
        ray.init(address=cluster.address, log_to_driver=False)
        return rllib_rate(nodes, options.races, karts, options.track, options.steps)
    finally:
        ray.shutdown()
        cluster.shutdown()


def tables(results: Sequence[Mapping[str, Any]]) -> list[Table]:
    """Returns the results as one table."""
    rows = []
    for result in results:
        rate, nodes = result["kart_steps_per_second"], result["nodes"]
        minutes = nodes * 1e6 / rate / 60
        cells = (nodes, result["karts"], result["races"], f"{rate:,.0f}", f"{rate / nodes:,.0f}")
        rows.append((*map(str, cells), f"{minutes:.1f}"))
    columns = ("nodes", "karts", "races per node", "kart-steps/s", "per node")
    return [
        Table("RLlib on several nodes", (*columns, "node-minutes per million kart-steps"), rows)
    ]


if __name__ == "__main__":
    sys.exit(main())
