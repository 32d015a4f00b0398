"""Counterfactuals of recorded races: what if a reference driver had driven one of the karts?

The engine's exact state some time before a contact is restored. A reference driver drives one kart,
all others repeat their recorded controls, and the game's AI drives on. If this decides nothing, the
reference drivers brake.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

import numpy as np

from stkzoo._schema import Count, Seconds
from stkzoo.drivers import Actor, find_driver
from stkzoo.drivers.code import AgentCode
from stkzoo.env.state import RaceState
from stkzoo.mdp.events import RaceEvents
from stkzoo.race.listeners import RaceListener, RaceProgress
from stkzoo.race.replay import Replay, action_of
from stkzoo.suite.conduct.contacts import Contact, new_events

#: The reference drivers. Both avoid other karts, read the ``full`` view, and decide from
#: observations alone.
REFERENCES = ("pretrained:ace", "pretrained:scout")
#: How long before a contact the reference drivers may begin [s], in the order of the trials.
STARTS = (0.3, 0.5, 0.7, 1.0, 1.5, 2.0)
#: Starts up to this factor apart count as equally late.
CLOSE_STARTS = 2.0
#: How long after the contact the karts must not touch [s].
CLEARANCE = 0.5
#: Reference drivers that brake do so above this speed [m/s]. Slower karts would reverse.
_STANDSTILL = 1.0

#: Latest starts of two karts [s before the contact].
_Latest = tuple[Seconds | None, Seconds | None]


@dataclass(frozen=True, slots=True)
class _KeptMoment:
    """A moment of the race from which trials start.

    Attributes:
        step: step of the race.
        state: the race.
        actors: the reference drivers of each agent, before they see the observations.
        events: the event counter.
        observations: the observations by agent.
    """

    step: int
    state: RaceState
    actors: dict[tuple[str, str], Actor]
    events: RaceEvents
    observations: dict[str, Any]


@dataclass(frozen=True, slots=True)
class JudgedContact:
    """Touches of two karts within a second of each other, and who is at fault.

    Attributes:
        step: step of the race in which the karts first touch, from 1.
        karts: numbers of the two agents.
        counts: number of contacts that the environment counts for each of them.
        latest: latest start from which the reference drivers in either kart avoid the contact [s
            before it]; ``None`` if there is none, or if it is earlier than :data:`CLOSE_STARTS`
            times that of the other kart.
        closing: speed of either kart toward the other before they touch [m/s].
    """

    step: Count
    karts: tuple[Count, Count]
    counts: tuple[Count, Count]
    latest: _Latest
    closing: tuple[float, float]

    @property
    def at_fault(self) -> int | None:
        """Number of the agent at fault; ``None`` if nobody is.

        It is the one in whose place the reference drivers avoid the contact from a later start. If
        both starts are about as late, it is the one that moves toward the other one faster.
        """
        (one, other), (first, second) = self.latest, self.karts
        if one is None or other is None:
            return first if one is not None else second if other is not None else None
        if max(one, other) > CLOSE_STARTS * min(one, other):
            return first if one < other else second
        return (first, second)[_faster(self.closing)]


class CounterfactualJudge(RaceListener):
    """Finds for each contact how late a reference driver in either kart still avoids it.

    The reference drivers see the race as each kart does from the start, so they know what its
    driver could know.

    Args:
        replay: the race, which is played.
        contacts: the contacts to judge.

    Attributes:
        judged: the contacts that are judged, in the order of the race.
    """

    def __init__(self, replay: Replay, contacts: Sequence[Contact]) -> None:
        self._replay = replay
        self._contacts = sorted(contacts, key=lambda contact: contact.step)
        self._starts = {start: round(start / replay.step_size) for start in STARTS}
        self._needed = {
            contact.step - steps for contact in contacts for steps in self._starts.values()
        }
        self._kept: dict[int, _KeptMoment] = {}
        self._resources = ExitStack()
        self.judged: list[JudgedContact] = []

    def env_options(self) -> dict[str, Any]:
        """See :class:`~stkzoo.race.listeners.RaceListener`."""
        return {"max_snapshots": len(self._needed)}

    def started(self, race: RaceProgress) -> None:
        """See :class:`~stkzoo.race.listeners.RaceListener`."""
        env = race.env
        self._resources.callback(self._forget, self._replay.steps)
        self._copy = self._resources.enter_context(env.lookahead())
        self._karts = race.race_info.kart_indices
        self._events = new_events(race)
        self._codes = {name: _loaded(name, self._resources) for name in REFERENCES}
        self._actors = {
            (name, agent): code.make_actor(env.observation_space(agent), env.action_space(agent), 0)
            for name, code in self._codes.items()
            for agent, row in zip(env.possible_agents, self._replay.agents, strict=True)
            if not row.is_game_ai
        }
        self._before = race.snapshot
        self._pass_step(race)

    def stepped(self, race: RaceProgress) -> None:
        """See :class:`~stkzoo.race.listeners.RaceListener`."""
        if not self._contacts:
            return
        while self._contacts and self._contacts[0].step == race.steps:
            self.judged.append(self._judge(self._contacts.pop(0)))
        self._events.count(self._before, race.snapshot)
        self._before = race.snapshot
        self._forget(race.steps - max(self._starts.values()))
        self._pass_step(race)

    def closed(self) -> None:
        """See :class:`~stkzoo.race.listeners.RaceListener`."""
        self._resources.close()

    def _pass_step(self, race: RaceProgress) -> None:
        """Keeps the moment if trials start there, and shows it to the reference drivers."""
        if race.steps in self._needed:
            self._kept[race.steps] = _KeptMoment(
                race.steps,
                race.env.save_state(),
                copy.deepcopy(self._actors),
                copy.deepcopy(self._events),
                dict(race.observations),
            )
        for name, code in self._codes.items():
            seen = [a for own, a in self._actors if own == name and a in race.observations]
            if seen and code.act_together is not None:
                actors = [self._actors[name, agent] for agent in seen]
                code.act_together(actors, [race.observations[agent] for agent in seen])

    def _forget(self, until: int) -> None:
        """Frees the moments before a step, and that of the step."""
        for step in [step for step in self._kept if step <= until]:
            self._kept.pop(step).state.close()

    def _closing(self, contact: Contact) -> tuple[float, float]:
        """Returns the speed of either kart toward the other before they touch [m/s]."""
        karts = self._before.karts[[self._karts[number] for number in contact.karts]]
        way = karts["location"][1].astype(float) - karts["location"][0]
        speeds = karts["velocity"].astype(float) @ way / max(float(np.linalg.norm(way)), 1e-6)
        return round(float(speeds[0]), 3), round(-float(speeds[1]), 3)

    def _judge(self, contact: Contact) -> JudgedContact:
        """Finds out whether, and how late, a reference driver in either kart avoids a contact.

        The kart that moves toward the other one faster can always brake: a kart that hits another
        one from behind is at fault even if that one could have been faster. The other kart brakes
        only if nothing else avoids the contact. If the game's AI moves faster, nothing is tried.
        """
        closing = self._closing(contact)
        faster = _faster(closing)
        latest: _Latest = (None, None)
        if (REFERENCES[0], f"kart_{contact.karts[faster]}") in self._actors:
            latest = self._latest(contact, ((0, False), (1, False), (faster, True)))
            if latest == (None, None):
                latest = self._latest(contact, ((1 - faster, True),))
        return JudgedContact(contact.step, contact.karts, contact.counts, latest, closing)

    def _latest(self, contact: Contact, ways: Sequence[tuple[int, bool]]) -> _Latest:
        """Tries earlier and earlier starts until it is clear which kart avoids a contact later.

        Args:
            contact: the contact.
            ways: what to try: in which of the two karts, and whether it brakes.
        """
        latest: list[float | None] = [None, None]
        limit = max(STARTS)
        for start, steps in self._starts.items():
            kept = self._kept.get(contact.step - steps)
            if kept is None or kept.step <= contact.apart_since or start > limit:
                break
            for place, is_braking in ways:
                number = contact.karts[place]
                if latest[place] is None and self._is_avoided(contact, kept, number, is_braking):
                    latest[place] = start
                    limit = min(limit, CLOSE_STARTS * start)
        return latest[0], latest[1]

    def _is_avoided(
        self, contact: Contact, kept: _KeptMoment, number: int, is_braking: bool
    ) -> bool:
        """Returns whether a contact is avoided: by all reference drivers, or by any with brakes."""
        agent = f"kart_{number}"
        if agent not in kept.observations or (REFERENCES[0], agent) not in kept.actors:
            return False
        touches = (self._touch(contact, kept, agent, name, is_braking) for name in REFERENCES)
        return not all(touches) if is_braking else not any(touches)

    def _touch(
        self, contact: Contact, kept: _KeptMoment, agent: str, reference: str, is_braking: bool
    ) -> bool:
        """Drives a copy of the race; returns whether the karts of a contact touch."""
        env, events, seen = self._copy, copy.deepcopy(kept.events), kept.observations
        env.restore_state(kept.state)
        actor = copy.deepcopy(kept.actors[reference, agent])
        one, other = (self._karts[number] for number in contact.karts)
        end = contact.step + round(CLEARANCE / self._replay.step_size)
        before = kept.state.snapshot
        for step in range(kept.step, min(end, self._replay.steps)):
            actions = self._recorded(step, env.agents)
            if agent in actions:
                action = actor(seen[agent])
                actions[agent] = _braked(action, seen[agent]) if is_braking else action
            seen, *_ = env.step(actions)
            after = env.snapshot
            assert after is not None  # noqa: S101 - the race runs
            events.count(before, after)
            if events.contacts[one, other]:
                return True
            before = after
        return False

    def _recorded(self, step: int, agents: Sequence[str]) -> dict[str, Any]:
        """Returns the recorded actions of some agents."""
        rows = self._replay.controls[step]
        return {agent: action_of(rows[int(agent.removeprefix("kart_"))]) for agent in agents}


def _faster(closing: tuple[float, float]) -> int:
    """Returns which of two karts moves toward the other one faster: 0 or 1."""
    return int(closing[1] > closing[0])


def _braked(action: Mapping[str, Any], observation: Mapping[str, Any]) -> dict[str, Any]:
    """Returns an action with the brake on, until the kart stands still."""
    brake = int(float(observation["velocity"][2]) > _STANDSTILL)
    coast = {"acceleration": np.zeros(1, np.float32), "nitro": 0, "drift": 0}
    return {**action, **coast, "brake": brake}


def _loaded(name: str, resources: ExitStack) -> AgentCode:
    """Loads a reference driver."""
    load = find_driver(name).load
    assert load is not None  # noqa: S101 - it is not an agent from files
    return load(resources)
