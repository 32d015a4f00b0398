"""Documents: JSON files with a type and a version, such as race results and batch plans."""

from __future__ import annotations

import json
from abc import ABC
from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, ClassVar

import msgspec
from typing_extensions import Self  # a dependency of gymnasium

from stkzoo._checks import shortened
from stkzoo._reading import MAX_BYTES, read_json, read_text, reading
from stkzoo._schema import plain_json
from stkzoo.errors import ConfigError


class Document(ABC):
    """A dataclass that is stored as a JSON file; msgspec checks the types and bounds of fields."""

    __slots__ = ()

    #: ``type`` and ``schema_version`` of the file.
    type_name: ClassVar[str]
    version: ClassVar[int] = 1
    #: Description of such a file and its source, for errors.
    origin: ClassVar[str]
    #: Maximum size of the file [bytes].
    max_bytes: ClassVar[int] = MAX_BYTES
    #: Name of a list field that is written last, with one entry per line; empty for none.
    rows: ClassVar[str] = ""

    def to_dict(self) -> dict[str, Any]:
        """Returns the document as JSON values, without its type and version."""
        return asdict(self)  # type: ignore[call-overload, no-any-return]  # a dataclass

    def to_json(self) -> str:
        """Returns the document as JSON text."""
        values = {"type": self.type_name, "schema_version": self.version, **self.to_dict()}
        rows = ",\n    ".join(map(json.dumps, values.pop(self.rows))) if self.rows else ""
        text = json.dumps(values, indent=2, allow_nan=False)
        if self.rows:
            text = f'{text[:-2]},\n  "{self.rows}": [\n    {rows}\n  ]\n}}'
        return plain_json(text)

    @classmethod
    def from_json(cls, text: str, place: str = "the text") -> Self:
        """Reads the output of :meth:`to_json`.

        Args:
            text: the JSON text.
            place: source of the text, for errors.

        Raises:
            ConfigError: the text is not such a document or has another version, or a field is
                missing or invalid.
        """
        with cls._reading(place):
            check_document(text, cls.type_name, cls.version, cls.max_bytes)
            return read_json(text, cls, cls.max_bytes)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """Reads the output of :meth:`to_dict` and ignores unknown entries.

        Raises:
            ConfigError: a field is missing or invalid.
        """
        with cls._reading("the text"):
            return msgspec.convert(values, cls)

    @classmethod
    def load(cls, file: Path) -> Self:
        """Reads a file.

        Raises:
            ConfigError: the file does not exist, or is not such a document.
        """
        with cls._reading(str(file)):
            text = read_text(file, cls.max_bytes)
        return cls.from_json(text, str(file))

    @classmethod
    def _reading(cls, place: str) -> AbstractContextManager[None]:
        """Adds the document's kind and origin to errors of a block that reads it."""
        return reading(f"{place} has no {cls.type_name.replace('-', ' ')}", cls.origin)


@dataclass(frozen=True, slots=True)
class _DocumentHead:
    """What each document contains besides its fields."""

    type: str
    schema_version: int


def check_document(
    text: str | bytes, type_name: str, version: int, max_bytes: int = MAX_BYTES
) -> None:
    """Checks the type and version of a document.

    Args:
        text: the document as JSON text.
        type_name: the expected type.
        version: the expected version.
        max_bytes: maximum length of the text [characters].

    Raises:
        Unreadable: the document has no type or version.
        ConfigError: the document has another type or version.
    """
    head = read_json(text, _DocumentHead, max_bytes)
    if (head.type, head.schema_version) != (type_name, version):
        raise ConfigError(
            f"the file is a {head.type[:40]} of version {shortened(head.schema_version)}, expected "
            f"a {type_name} of version {version}; "
            + (
                "another version of stkzoo wrote it"
                if head.type == type_name
                else f"choose the file or folder of a {type_name.rpartition('-')[0]}"
            )
        )
