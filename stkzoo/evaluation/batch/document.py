"""What plans and results of batches share: a JSON file of a named type and version."""

from __future__ import annotations

import json
from abc import ABC
from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import asdict
from pathlib import Path
from typing import Any, ClassVar, TypeVar, cast

from stkzoo.errors import ConfigError
from stkzoo.race.result import json_with_rows, read_document, reading, typed

AnyDocument = TypeVar("AnyDocument", bound="Document")


class Document(ABC):
    """A dataclass that is kept as a JSON file."""

    __slots__ = ()

    #: The ``type`` and ``schema_version`` of the file.
    kind: ClassVar[str]
    version: ClassVar[int] = 1
    #: Where such a file comes from, for errors.
    origin: ClassVar[str]
    #: A list to write last, with one entry per line.
    rows: ClassVar[str] = ""

    def to_dict(self) -> dict[str, Any]:
        """The document as JSON values, without its type and version."""
        return asdict(self)  # type: ignore[call-overload, no-any-return]  # a dataclass

    def to_json(self) -> str:
        """The document as JSON."""
        values = {"type": self.kind, "schema_version": self.version, **self.to_dict()}
        if not self.rows:
            return json.dumps(values, indent=2, allow_nan=False)
        return json_with_rows(values, self.rows, values.pop(self.rows))

    @classmethod
    def from_json(cls: type[AnyDocument], text: str, place: str = "the text") -> AnyDocument:
        """Reads the output of :meth:`to_json`.

        Args:
            text: the JSON.
            place: where it was found, for errors.

        Raises:
            ConfigError: the text is something else, or has another version.
        """
        with cls._reading(place):
            values = read_document(text, cls.kind, cls.version)
            return cls._decode(values)

    @classmethod
    def from_dict(
        cls: type[AnyDocument], values: Mapping[str, Any], place: str = "the text"
    ) -> AnyDocument:
        """Reads the output of :meth:`to_dict`; entries that are no fields do not count.

        Raises:
            ConfigError: the values are no such document.
        """
        with cls._reading(place):
            return cls._decode(values)

    @classmethod
    def load(cls: type[AnyDocument], file: Path) -> AnyDocument:
        """Reads a file.

        Raises:
            ConfigError: there is none, or it cannot be read.
        """
        try:
            text = file.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise ConfigError(
                f"{file} has no {cls._name()} ({error}); expected {cls.origin}"
            ) from error
        return cls.from_json(text, str(file))

    @classmethod
    def _decode(cls: type[AnyDocument], values: Mapping[str, Any]) -> AnyDocument:
        return cast("AnyDocument", typed(cls, values))

    @classmethod
    def _reading(cls, place: str) -> AbstractContextManager[None]:
        return reading(f"{place} has no {cls._name()}", cls.origin)

    @classmethod
    def _name(cls) -> str:
        return cls.kind.replace("-", " ")
