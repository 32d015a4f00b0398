"""What is left of a step in the caller's process, function by function.

    python -m benchmarks.bench_profile
    python -m benchmarks.bench_profile --karts 10 --view full --steps 300

Runs stkzoo under cProfile, in process and with the default worker, and prints and saves
the functions that take the most time by themselves. The profiler makes Python's own calls
look dearer than they are; ``bench_steps`` says what a step costs without it.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from benchmarks.bench_common import VIEWS, cores, parser, progress_bar, save
from benchmarks.bench_driver import WARMUP, Contender, Spec, record_controls


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    words = parser(__doc__, "profile", steps=300, karts=(3, 10))
    words.add_argument("--view", nargs="+", choices=VIEWS, default=["full", "flattened"])
    words.add_argument("--top", type=int, default=25, help="functions listed (default: 25)")
    options = words.parse_args(arguments)
    specs = [
        Spec("stkzoo", "parallel", view, karts, karts, is_worker, cores(options.cores))
        for view in options.view
        for karts in options.karts
        for is_worker in (False, True)
    ]
    results = []
    with progress_bar(len(specs)) as (bar, task):
        for spec in specs:
            bar.update(task, description=_title(spec))
            results.append(profile(spec, options))
            bar.advance(task)
    text = "\n".join(
        f"== {_title(spec)}\n{r['text']}" for spec, r in zip(specs, results, strict=True)
    )
    print(text)
    save(options.output, "profile", options, results)
    _save_text(options.output.with_suffix(".txt"), text)
    return 0


def profile(spec: Spec, options: Any) -> dict[str, Any]:
    """Profiles one contender."""
    count = WARMUP + options.steps
    controls = record_controls(options.track, spec.num_kart, spec.num_agents, 1, count)
    with Contender(spec) as contender:
        contender.ask("load")
        contender.ask("make")
        contender.ask("reset", track=options.track, seed=1, controls=controls)
        contender.ask("steps", count=WARMUP)
        text = contender.ask("profile", count=options.steps, top=options.top)
    return {
        "view": spec.view,
        "karts": spec.num_kart,
        "transport": "worker" if spec.subprocess else "in process",
        "text": text,
    }


def _title(spec: Spec) -> str:
    where = "worker" if spec.subprocess else "in process"
    return f"{spec.view}, {spec.num_kart} karts, {where}"


def _save_text(path: Path, text: str) -> None:
    path.write_text("\n".join(line.rstrip() for line in text.splitlines()) + "\n")


if __name__ == "__main__":
    sys.exit(main())
