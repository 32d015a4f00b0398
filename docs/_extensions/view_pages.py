"""Builds the reference pages of the views from the layouts in the code.

The units and meanings of the game's own entries come from ``docs/reference/environment.md``.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces

from stkzoo import race_v0
from stkzoo.mdp.spaces import STANDING, kart_action_space, kart_observation_space
from stkzoo.views.shipped import SHIPPED
from stkzoo.views.split_step import MonoAgentEnv
from stkzoo.wrappers import DiscreteActionsWrapper
from stkzoo.wrappers.flattening import SpaceFlattener
from stkzoo.wrappers.observations import POSITIONS
from stkzoo.wrappers.racing import (
    CHOICE_NAMES,
    CHOICES,
    MEANINGS,
    PARTS,
    PEDALS,
    PLACES,
    SIZE,
    STEERS,
)

_VIEWS = "reference/views"
_ENTRIES = (Path(__file__).parents[1] / "reference" / "environment.md").read_text("utf-8")
_LINES = [line.strip().strip("|") for line in _ENTRIES.splitlines() if line.startswith("| `")]
_ROWS = [[cell.strip() for cell in line.split("|")] for line in _LINES]
#: Unit and meaning of the game's own observations, and meaning of its actions, by key.
_OBSERVED = {row[0].strip("`"): (row[3], row[4]) for row in _ROWS if len(row) == 5}
_ACTED = {row[0].strip("`"): row[3] for row in _ROWS if len(row) == 4}

Rows = Iterator[tuple[object, ...]]


def pages() -> dict[str, str]:
    """Returns the text of each page by its path in ``docs``."""
    views = {f"{_VIEWS}/{view.name}.md": _page(view.name, view.description) for view in SHIPPED}
    lines = [
        "# Views entry by entry",
        "",
        "One page for each view: what each number of the observation means, and what actions do.",
        "[Choose a view](../../how-to/views.md) compares them and shows their options.",
        "",
        *_table(
            ("view", "what it is"), ((f"[`{v.name}`]({v.name}.md)", _text(v)) for v in SHIPPED)
        ),
        "",
        "```{toctree}",
        ":hidden:",
        "",
        *(view.name for view in SHIPPED),
        "```",
    ]
    return {f"{_VIEWS}/index.md": "\n".join(lines) + "\n", **views}


def _text(view: Any) -> str:
    return str(view.description).replace("``", "`")


def _page(name: str, description: str) -> str:
    env = race_v0.parallel_env(num_kart=2, track="lighthouse", view=name)
    observed, acted = env.observation_space("kart_0"), env.action_space("kart_0")
    env.close()
    simple = race_v0.parallel_env(num_kart=2, track="lighthouse", view="simple")
    flat = SpaceFlattener(simple.observation_space("kart_0"))
    simple.close()
    text = description.replace("``", "`")
    lines = [
        f"# View: {name}",
        "",
        f"{text} The Gymnasium id is `supertuxkart/{name}-v0`.",
        "",
        "Positions, directions and velocities are in the kart's frame: x right, y up, z ahead.",
        "",
        "## Observation",
        "",
        *_observation(name, observed, flat),
        "## Action",
        "",
        *_action(acted),
    ]
    return "\n".join(lines).rstrip() + "\n"


# ---------------------------------------------------------------------- observations


def _observation(name: str, space: spaces.Space[Any], flat: SpaceFlattener) -> Iterator[str]:
    columns = ("index", "entry", "range", "unit", "meaning")
    if name in ("racing", "contest"):
        yield f"One `Box` of {space.shape} float32. Each number is divided by its unit, then"
        yield f"clipped to {space.low.min():g} to {space.high.max():g}."  # type: ignore[attr-defined]
        names = ("index", "entry", "unit", "meaning")
        standing = _standing() if name == "contest" else ()
        yield from ("", *_table(names, [*_racing(), *standing]), "")
        return
    if isinstance(space, spaces.Box):
        yield from (f"One `Box` of {space.shape} {space.dtype}.", "")
        yield from (*_table(columns, _joined(flat)), "")
        return
    assert isinstance(space, spaces.Dict)  # noqa: S101 - of all other views
    if "attachment" in space.spaces:
        yield from ("A dict of these entries.", "")
        keys = ("entry", "shape and type", "range", "unit", "meaning")
        yield from (*_table(keys, _entries(space)), "")
        return
    yield from ("A dict:", "")
    for key, part in space.spaces.items():
        yield f"- `{key}`: `{part.shape}` {part.dtype}, {_PARTS[key]}."
    yield ""
    for key in space.spaces:
        if key in flat.parts:
            rows = _slices(flat.parts[key])
            yield from (f"### `{key}`", "", *_table(columns, rows), "")
        elif key == "observation":
            yield from ("### `observation`", "", *_table(columns, _joined(flat)), "")


#: Descriptions of the entries of views with vectors.
_PARTS = {
    "continuous": "the numbers, in the alphabetical order of their entries",
    "discrete": "the choices, in the alphabetical order of their entries",
    "observation": "all entries as one vector",
    "action_mask": "1 for each action that has an effect now, by its number",
    "image": "the picture of the kart's camera, red, green and blue",
}


def _entries(space: spaces.Dict) -> Rows:
    has_lists = isinstance(space["paths_start"], spaces.Sequence)
    for key, part in space.spaces.items():
        words = _OBSERVED[key] if has_lists else _polar(key, *_OBSERVED[key])
        inner = part.feature_space if isinstance(part, spaces.Sequence) else part
        shape = "text" if isinstance(inner, spaces.Text) else f"`{inner.shape}` {inner.dtype}"
        if isinstance(part, spaces.Sequence):
            shape = f"a list of {shape}"
        yield f"`{key}`", shape, _range(inner), *words


def _slices(parts: Mapping[str, spaces.Space[Any]]) -> Rows:
    start = 0
    for key, part in parts.items():
        size = int(np.prod(part.shape or (1,)))
        unit, meaning = _OBSERVED[key]
        yield _span(start, size), f"`{key}`", _range(part), *_polar(key, unit, meaning)
        start += size


def _joined(flat: SpaceFlattener) -> Rows:
    yield from _slices(flat.parts["continuous"])
    start = sum(int(np.prod(part.shape or (1,))) for part in flat.parts["continuous"].values())
    for key, part in flat.parts["discrete"].items():
        counts = part.nvec.ravel() if isinstance(part, spaces.MultiDiscrete) else np.array([part.n])  # type: ignore[attr-defined]
        each = f"{len(counts)} x {counts[0]}" if len(counts) > 1 else str(counts[0])
        meaning = f"{_OBSERVED[key][1]}; {each} places, 1 at the current value"
        yield _span(start, int(counts.sum())), f"`{key}`", "0, 1", "", meaning
        start += int(counts.sum())


def _racing() -> Rows:
    for name, (count, width) in PARTS.items():
        unit, meaning = MEANINGS[name]
        place = PLACES[name]
        rows = f"{count} x {width}: " if count > 1 and width > 1 else ""
        yield _span(place.start, count * width), f"`{name}`", unit, rows + meaning


def _standing() -> Rows:
    start = SIZE
    for name, size, unit, meaning in STANDING:
        yield _span(start, size), f"`{name}`", unit, meaning
        start += size


def _polar(key: str, unit: str, meaning: str) -> tuple[str, str]:
    if key not in POSITIONS:
        return unit, meaning
    return "rad, rad, m", f"{meaning}; polar: angle to the right, angle up, distance"


def _span(start: int, size: int) -> str:
    return str(start) if size == 1 else f"{start} to {start + size - 1}"


def _range(space: spaces.Space[Any]) -> str:
    if isinstance(space, spaces.MultiDiscrete):
        return f"0 to {space.nvec.max() - 1}"
    if isinstance(space, spaces.Discrete):
        return f"0 to {space.n - 1}"
    if not isinstance(space, spaces.Box):
        return ""
    low, high = float(space.low.min()), float(space.high.max())
    bounds = np.isfinite(low), np.isfinite(high)
    words = {(True, True): f"{low:g} to {high:g}", (True, False): f"{low:g} and up"}
    return words.get((bool(bounds[0]), bool(bounds[1])), "any")


# ---------------------------------------------------------------------- actions


def _action(space: spaces.Space[Any]) -> Iterator[str]:
    game = kart_action_space()
    steps = DiscreteActionsWrapper(MonoAgentEnv(kart_observation_space(), game, None)).action_space
    assert isinstance(steps, spaces.Dict)  # noqa: S101 - as the game's own
    names = sorted(steps.spaces)
    counts = [int(steps[name].n) for name in names]  # type: ignore[attr-defined]
    if isinstance(space, spaces.Discrete):
        strides = np.cumprod([1, *counts])[:-1].tolist()
        yield f"`Discrete({space.n})`: one number for the whole action, the sum of these terms:"
        table = zip(names, strides, counts, strict=True)
        rows = ((f"`{n}` x {s}", f"0 to {c - 1}", _values(n, c)) for n, s, c in table)
        yield from ("", *_table(("term", "choice", "value of the choice"), rows), "")
        example = [0] * len(names)
        example[names.index("acceleration")], example[names.index("steer")] = counts[0] - 1, 3
        number = int(np.ravel_multi_index(example, counts, order="F"))
        yield f"`{number}` is full throttle, straight on. To decode a number:"
        yield from ("", "```python", "import numpy as np", "")
        yield f"choices = np.unravel_index({number}, {tuple(counts)}, order='F')".replace("'", '"')
        yield f"names = {names!r}".replace("'", '"')
        yield "print(dict(zip(names, map(int, choices))))"
        yield "```"
    elif isinstance(space, spaces.MultiDiscrete) and tuple(space.nvec) == CHOICES:
        yield from ("`MultiDiscrete`, one choice in each place:", "")
        values = (", ".join(f"{s:g}" for s in STEERS), ", ".join(PEDALS), *["off, on"] * 3)
        rows3 = zip(range(len(CHOICES)), CHOICE_NAMES, CHOICES, values, strict=True)
        rows = ((i, f"`{n}`", f"0 to {c - 1}", v) for i, n, c, v in rows3)
        yield from _table(("index", "action", "choice", "value of the choice"), rows)
    elif isinstance(space, spaces.MultiDiscrete):
        yield from ("`MultiDiscrete`, one choice in each place:", "")
        rows4 = enumerate(zip(names, counts, strict=True))
        rows = ((i, f"`{n}`", f"0 to {c - 1}", _values(n, c)) for i, (n, c) in rows4)
        yield from _table(("index", "action", "choice", "value of the choice"), rows)
    elif isinstance(space, spaces.Box):
        yield from (f"`Box` of {space.shape} {space.dtype}:", "")
        yield from _table(("index", "action", "range"), _numbers(space))
    elif "control" in space.spaces:  # type: ignore[attr-defined]
        yield from ("A dict with `control`:", "")
        yield from _table(("index", "action", "range"), _numbers(space["control"]))  # type: ignore[index]
        yield from ("", "[Actions in physical units](../control.md) describes the other controls.")
    elif set(space.spaces) == set(game.spaces):  # type: ignore[attr-defined]
        yield from ("A dict:", "")
        rows5 = space.spaces.items()  # type: ignore[attr-defined]
        yield from _table(
            ("action", "shape and type", "range", "meaning"),
            ((f"`{k}`", f"`{s.shape}` {s.dtype}", _range(s), _ACTED[k]) for k, s in rows5),
        )
    else:
        yield from ("A dict of two vectors:", "")
        parts = SpaceFlattener(game).parts
        rows6 = [(v, i, k) for v, keys in parts.items() for i, k in enumerate(keys)]
        rows = ((f"`{v}`", i, f"`{k}`", _range(game[k]), _ACTED[k]) for v, i, k in rows6)
        yield from _table(("vector", "index", "action", "range", "meaning"), rows)


def _numbers(space: spaces.Space[Any]) -> Rows:
    assert isinstance(space, spaces.Box)  # noqa: S101 - the caller's check
    low, high = space.low.tolist(), space.high.tolist()
    if low == [0.0, -1.0]:
        names = ("`acceleration`: throttle", "`steer`: share of full lock, positive to the right")
    else:
        scaled = " (the range is scaled to -1 to 1)" if low == [-1.0, -1.0] else ""
        names = (f"steering angle [rad]{scaled}", f"speed [m/s]{scaled}")
    for index, name in enumerate(names):
        yield index, name, f"{low[index]:g} to {high[index]:g}"


def _values(name: str, count: int) -> str:
    space = kart_action_space()[name]
    if not isinstance(space, spaces.Box):
        return "off, on"
    values = np.linspace(space.low.item(), space.high.item(), count)
    return ", ".join(f"{value:.3g}" for value in values)


def _table(columns: tuple[str, ...], rows: Any) -> list[str]:
    head = ["| " + " | ".join(columns) + " |", "| " + " | ".join("---" for _ in columns) + " |"]
    lines = ["| " + " | ".join(map(str, row)) + " |" for row in rows]
    # The links of environment.md are relative to the parent folder.
    there = [re.sub(r"\]\(#", "](../environment.md#", line) for line in lines]
    return head + [re.sub(r"\]\(\.\./how-to", "](../../how-to", line) for line in there]
