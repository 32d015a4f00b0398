"""Race results that no race had."""

from stkzoo.race import AgentResult, RaceResult


def agent_result(place, time, **fields):
    """Makes the result of the agent at a start position, with a finish time or ``None``."""
    return AgentResult(
        agent=f"kart_{place - 1}",
        driver="x",
        source="x",
        start_position=place,
        finish_time=time,
        **{"laps": 1, "distance": 100.0, "reward": 0.0, "rescues": 0, **fields},
    )


def race_result(agents, **fields):
    """Makes the result of a forward race of 10 s."""
    return RaceResult(
        status="awaited_finished",
        reverse=False,
        difficulty=3,
        race_length=100.0,
        steps=100,
        race_time=10.0,
        agents=tuple(agents),
        **{"laps": 1, **fields},
    )
