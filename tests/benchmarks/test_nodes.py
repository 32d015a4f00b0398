"""The table of learners on several nodes."""

from __future__ import annotations

from benchmarks import bench_nodes


def test_the_cost_counts_all_nodes():
    results = [
        {"nodes": nodes, "karts": 10, "races": 4, "kart_steps_per_second": rate}
        for nodes, rate in ((1, 2000.0), (4, 4000.0))
    ]
    (table,) = bench_nodes.tables(results)
    assert table.rows == [
        ("1", "10", "4", "2,000", "2,000", "8.3"),
        ("4", "10", "4", "4,000", "1,000", "16.7"),
    ]
