"""List the karts.

Shows the game's karts. Heavy karts have stronger engines and a higher top speed. Light karts have
a smaller turning circle and use less nitro. AgentSpec(kart="gnu") selects a kart for an agent.

Examples:
  stkzoo karts           a table
  stkzoo karts --json    JSON output for programs
"""

from __future__ import annotations

import json
import re
from dataclasses import asdict, dataclass

from stkzoo.cli._console import show_table
from stkzoo.engine.assets import find_assets
from stkzoo.wrappers.control.kart import KARTS

_ATTRIBUTE = r"<kart\b[^>]*?\b{}\s*=\s*\"([^\"]*)\""


@dataclass
class KartsArguments:
    """Options of ``stkzoo karts``.

    Attributes:
        json: write JSON instead of a table
    """

    json: bool = False


@dataclass(frozen=True)
class KartFacts:
    """Facts about one kart.

    Attributes:
        kart: model name for ``AgentSpec``.
        title: name in the game.
        weight: ``light``, ``medium`` or ``heavy``; ``?`` if unknown.
        wheel_base: distance between the axles [m]; ``None`` if not measured.
        max_steer_angle: maximum angle of the wheels at rest [rad]; ``None`` if not measured.
    """

    kart: str
    title: str
    weight: str
    wheel_base: float | None
    max_steer_angle: float | None


def kart_facts() -> list[KartFacts]:
    """Returns facts about all karts in the game's data, sorted by name."""
    assets = find_assets()
    facts = []
    for kart in sorted(assets.karts):
        file = assets.root / "data" / "karts" / kart / "kart.xml"
        text = file.read_text("utf-8", errors="replace") if file.exists() else ""
        wheel_base, angle = KARTS.get(kart, (None, None))
        facts.append(KartFacts(kart, _read(text, "name"), _read(text, "type"), wheel_base, angle))
    return facts


def _read(text: str, attribute: str) -> str:
    found = re.search(_ATTRIBUTE.format(attribute), text)
    return found[1] if found else "?"


def run(arguments: KartsArguments) -> int:
    """Prints a table or JSON."""
    facts = kart_facts()
    if arguments.json:
        print(json.dumps([asdict(fact) for fact in facts], indent=2))
        return 0
    columns = ("kart", "name", "weight", "wheel base [m]", "full lock [rad]")
    rows = []
    for fact in facts:
        sizes = (fact.wheel_base, fact.max_steer_angle)
        numbers = ("-" if size is None else f"{size:.3f}" for size in sizes)
        rows.append((fact.kart, fact.title, fact.weight, *numbers))
    show_table(columns, rows, left=columns[:3])
    return 0
