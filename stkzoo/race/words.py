"""The words that drivers say in a race."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from stkzoo.drivers.driver import Driver
from stkzoo.wrappers.marl import WordChannel
from stkzoo.wrappers.marl.messages import Message, heard_messages, message_of


class TeamWords:
    """Carries the words of a race, each to the other karts of the same team.

    A team consists of the karts of one agent: of drivers that talk and that were selected by the
    same text. As with :class:`~stkzoo.wrappers.marl.MessageChannel`, a word is heard one step
    later, and karts that have finished or failed are not heard.

    Args:
        drivers: the driver of each kart, by agent, in the order of the karts.
    """

    def __init__(self, drivers: Mapping[str, Driver]) -> None:
        self._agents = tuple(drivers)
        self._channels = {
            agent: WordChannel(driver.words, len(drivers) - 1)
            for agent, driver in drivers.items()
            if driver.words
        }
        self._teams = {
            agent: (drivers[agent].source, drivers[agent].name, drivers[agent].words)
            for agent in self._channels
        }
        self._said: dict[str, Message] = {}

    def channel(self, agent: str) -> WordChannel | None:
        """Returns the form of the words of a kart; ``None`` if its driver does not talk."""
        return self._channels.get(agent)

    def add_to(self, observation: Any, agent: str) -> Any:
        """Returns a kart's observation with the words that it hears, if its driver talks.

        Args:
            observation: observation of the ``full`` view.
            agent: the kart.
        """
        channel = self._channels.get(agent)
        if channel is None:
            return observation
        others = [other for other in self._agents if other != agent]
        said = [self._said.get(other) if self._hears(agent, other) else None for other in others]
        return {**observation, **heard_messages(said, channel.words)}

    def carry(self, words: Mapping[str, int | None]) -> None:
        """Replaces the words of the last step.

        Args:
            words: the words of the karts that are still racing; ``None`` for no word.
        """
        self._said = {
            agent: message_of(word, self._channels[agent].words)
            for agent, word in words.items()
            if word is not None
        }

    def _hears(self, agent: str, other: str) -> bool:
        return self._teams[agent] == self._teams.get(other)
