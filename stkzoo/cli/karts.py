"""List the karts.

Shows the game's karts. Heavy karts have stronger engines and a higher top speed. Light karts have
a smaller turning circle and use less nitro. AgentSpec(kart="gnu") selects a kart for an agent.

Examples:
  stkzoo karts           a table
  stkzoo karts --json    JSON output for programs
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass

from stkzoo.cli._console import show_table
from stkzoo.engine.assets import find_assets
from stkzoo.engine.assets.tree import parse_xml
from stkzoo.wrappers.control.kart import KARTS


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
        about = parse_xml(file).attrib if file.exists() else {}
        title, weight = about.get("name", "?"), about.get("type", "?")
        facts.append(KartFacts(kart, title, weight, *KARTS.get(kart, (None, None))))
    return facts


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
