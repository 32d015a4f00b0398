"""Documents: JSON files with a type and a version, such as race results and batch plans."""

from __future__ import annotations

import json
from abc import ABC
from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import asdict
from pathlib import Path
from typing import Any, ClassVar

from typing_extensions import Self  # a dependency of gymnasium

from stkzoo._reading import MAX_BYTES, Unreadable, read_json, read_text, reading
from stkzoo._schema import typed
from stkzoo.errors import ConfigError, shortened
from stkzoo.race.json_values import json_value


class Document(ABC):
    """A dataclass that is stored as a JSON file; :mod:`stkzoo._schema` validates it."""

    __slots__ = ()

    #: ``type`` and ``schema_version`` of the file.
    kind: ClassVar[str]
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
        """Returns the document as JSON text.

        Any field value is accepted; see :func:`~stkzoo.race.json_values.json_value`.
        """
        document = {"type": self.kind, "schema_version": self.version, **self.to_dict()}
        values = json_value(document)
        if not self.rows:
            return json.dumps(values, indent=2, allow_nan=False)
        rows = ",\n    ".join(map(json.dumps, values.pop(self.rows)))
        text = json.dumps(values, indent=2, allow_nan=False)[:-2]
        return f'{text},\n  "{self.rows}": [\n    {rows}\n  ]\n}}'

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
            values = read_json(text, cls.max_bytes)
            check_document(values, cls.kind, cls.version)
            return typed(cls, values)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """Reads the output of :meth:`to_dict` and ignores unknown entries.

        Raises:
            ConfigError: a field is missing or invalid.
        """
        with cls._reading("the text"):
            return typed(cls, values)

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
        return reading(f"{place} has no {cls.kind.replace('-', ' ')}", cls.origin)


def check_document(document: Any, kind: str, version: int) -> None:
    """Checks the type and version of a document.

    Raises:
        Unreadable: the document has no type or version.
        ConfigError: the document has another type or version.
    """
    if not isinstance(document, dict):
        raise Unreadable(f"it is {shortened(document)}, expected an object")
    found, number = document.get("type"), document.get("schema_version")
    if not isinstance(found, str) or type(number) is not int:
        raise Unreadable("it has no type and schema_version")
    if (found, number) != (kind, version):
        raise ConfigError(
            f"the file is a {found[:40]} of version {shortened(number)}, expected a {kind} of "
            f"version {version}; "
            + (
                "another version of stkzoo wrote it"
                if found == kind
                else f"choose the file or folder of a {kind.rpartition('-')[0]}"
            )
        )
