"""List the karts.

Shows the game's karts. Heavy karts have stronger engines and a higher top speed. Light karts have
a smaller turning circle and use less nitro. AgentSpec(kart="gnu") selects a kart for an agent.

Examples:
  stkzoo karts           a table
  stkzoo karts --json    JSON output for programs
"""

from __future__ import annotations

from stkzoo.cli._console import JsonArguments, show, show_facts
from stkzoo.engine.assets import find_assets
from stkzoo.engine.assets.tree import parse_xml
from stkzoo.wrappers.control.kart import KARTS


def kart_facts() -> list[dict[str, object]]:
    """Returns facts about all karts in the game's data, sorted by name.

    Returns:
        For each kart: ``kart``, the model name for ``AgentSpec``; ``title``, its name in the game;
        ``weight``, ``light``, ``medium`` or ``heavy``; ``wheel_base``, the distance between the
        axles [m]; and ``max_steer_angle``, the maximum angle of the wheels at rest [rad]. Unknown
        texts are ``?``, unknown numbers ``None``.
    """
    assets = find_assets()
    facts: list[dict[str, object]] = []
    for kart in sorted(assets.karts):
        file = assets.root / "data" / "karts" / kart / "kart.xml"
        about = parse_xml(file).attrib if file.exists() else {}
        texts = {"kart": kart, "title": about.get("name", "?"), "weight": about.get("type", "?")}
        wheel_base, angle = KARTS.get(kart, (None, None))
        facts.append({**texts, "wheel_base": wheel_base, "max_steer_angle": angle})
    return facts


def run(arguments: JsonArguments) -> None:
    """Prints a table or JSON."""
    show(kart_facts(), show_facts, as_json=arguments.json)
