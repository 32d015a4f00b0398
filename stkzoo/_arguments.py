"""Command-line options: a dataclass declares them, and its docstring provides their help."""

from __future__ import annotations

import argparse
import inspect
import re
import textwrap
import types
import typing
from collections.abc import Collection, Mapping, Sequence
from dataclasses import MISSING, Field, field, fields
from typing import Any, NoReturn

from stkzoo._checks import unknown_name
from stkzoo.errors import ConfigError

_ATTRIBUTE = re.compile(r"^    (\w+): (.*(?:\n {8}.*)*)", re.MULTILINE)


_NO_DEFAULTS: Mapping[str, Any] = types.MappingProxyType({})
#: Maximum number of options that the usage line of a command lists.
_MAX_LISTED = 6


class _HelpFormatter(argparse.HelpFormatter):
    """A help formatter that fills paragraphs, keeps indented lists and shortens long usages."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        """Fills paragraphs to the terminal's width. Paragraphs with indented lines are kept."""
        plain = re.sub(r":\w+:`~?([^`]+)`", r"`\1`", text).replace("``", "`")
        filled = "\n\n".join(
            part
            if re.search("^ ", part, re.MULTILINE)
            else "\n".join(self._split_lines(part, width))
            for part in plain.split("\n\n")
        )
        return textwrap.indent(filled, indent)

    def _split_lines(self, text: str, width: int) -> list[str]:
        return textwrap.wrap(" ".join(text.split()), width, break_on_hyphens=False)

    def _format_action(self, action: argparse.Action) -> str:
        """Lists subcommands without a line for their metavar, such as COMMAND."""
        if isinstance(action, argparse._SubParsersAction):
            return "".join(map(self._format_action, action._get_subactions()))
        return super()._format_action(action)

    def add_usage(self, usage: Any, actions: Any, groups: Any, prefix: Any = None) -> None:
        """Adds the usage line. A long list of options becomes ``[OPTION ...]``."""
        listed = list(actions)
        free = [action for action in listed if action.option_strings and not action.required]
        if len(free) > _MAX_LISTED:
            options = argparse.Action((), "options", nargs="*", metavar="OPTION")
            listed, groups = [options, *(a for a in listed if a not in free)], ()
        super().add_usage(usage, listed, groups, prefix)


class CommandParser(argparse.ArgumentParser):
    """A parser whose errors are one line, with a suggestion for an unknown name.

    Options have no abbreviations: ``--karts`` would mean ``--karts-finished``.
    """

    def __init__(self, **options: Any) -> None:
        defaults = {"formatter_class": _HelpFormatter, "allow_abbrev": False}
        super().__init__(**{**defaults, **options})

    def group(self, title: str) -> argparse._ArgumentGroup:
        """Returns the group of options with a title, which is created if needed.

        The help shows groups in the order of their creation.

        Args:
            title: title of the group.
        """
        for group in self._action_groups:
            if group.title == title:
                return group
        return self.add_argument_group(title)

    def fail(self, message: str) -> NoReturn:
        """Prints an error and ends the program with exit code 2.

        Args:
            message: text of the error.
        """
        self.exit(2, f"{self.prog}: {message}\n")

    def error(self, message: str) -> NoReturn:
        """Ends the program because of an invalid command line. ``argparse`` calls this.

        Args:
            message: text of the error.
        """
        joint = " See" if message.endswith("?") else "; see"
        self.fail(f"{message.rstrip('.')}{joint} `{self.prog} --help`")

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        """Parses a command line. The subcommand reports its unknown arguments as errors."""
        values, unknown = super().parse_known_args(args, namespace)
        if unknown:
            name = unknown[0].partition("=")[0]
            if not name.startswith("-"):
                self.error(f"unexpected argument {name!r}")
            known = self._option_string_actions
            if longer := next((flag for flag in known if flag.startswith(name)), None):
                self.error(f"unknown option {name!r}. Did you mean {longer!r}?")
            self.error(_unknown("option", name, known))
        return values, unknown

    def _check_value(self, action: argparse.Action, value: object) -> None:
        choices = action.choices or ()
        if isinstance(action, argparse._SubParsersAction) and value not in choices:
            self.error(_unknown(str(action.metavar).lower(), value, action.choices))
        super()._check_value(action, value)


def _unknown(what: str, name: object, known: Collection[str]) -> str:
    """Returns the error text for an unknown name, without the list of known names."""
    text = str(unknown_name(what, name, known))
    return re.split(r"(?: Choose a name from the list:)?\sKnown: ", text)[0]


def option(default: Any = None, **keywords: Any) -> Any:
    """Returns a dataclass field for :func:`add_options` with additional settings.

    Args:
        default: default of the field.
        **keywords: arguments of ``ArgumentParser.add_argument``; and also ``flag``, the option's
            name if it differs from the field's; ``aliases``, further names; ``group``, the title
            of its group in the help; and ``rivals``, a name of mutually exclusive options.
    """
    return field(default=default, metadata=keywords)


def positional(default: Any = MISSING, **keywords: Any) -> Any:
    """Returns a field as :func:`option` does, for a positional argument.

    Args:
        default: default of the field.
        **keywords: as for :func:`option`.
    """
    return option(default, flag="", **keywords)


def options_of(owner: type, **choice: Any) -> Any:
    """Returns a field that contains the options of another dataclass.

    Its value is an instance of the dataclass. If fields are left out, it is a dict of the others.

    Args:
        owner: the dataclass.
        **choice: ``without``, ``only`` and ``group``, as for :func:`add_options`.
    """
    is_whole = not choice.keys() & {"without", "only"}
    make = owner if is_whole else dict
    return field(default_factory=make, metadata={"part": {"owner": owner, **choice}, "make": make})


def add_options(
    parser: CommandParser,
    owner: type,
    *,
    group: str | None = None,
    defaults: Mapping[str, Any] = _NO_DEFAULTS,
    **choice: Any,
) -> None:
    """Adds an option for each field of a dataclass: ``--max-steps`` for ``max_steps``.

    The help text is the field's entry under ``Attributes:`` in the docstring, unless the field's
    metadata has a ``help``. Fields can be numbers, texts, booleans, paths, or tuples of these, and
    other dataclasses (:func:`options_of`).

    Args:
        parser: parser of the command.
        owner: the dataclass.
        group: title of the group for fields without their own group; ``None`` for the parser's
            default group.
        defaults: defaults that replace those of fields, by name of the field.
        **choice: ``without``, names of fields to leave out, or ``only``, names of fields to add.
    """
    value_types, texts = typing.get_type_hints(owner), _texts(owner)
    rivals: dict[str, argparse._ActionsContainer] = {}
    for entry in _fields(owner, **choice):
        if part := entry.metadata.get("part"):
            add_options(parser, **part, defaults=defaults)
            continue
        metadata = {"help": texts.get(entry.name, ""), **_metadata(owner, entry.name)}
        metadata["default"] = defaults.get(entry.name, entry.default)
        flags = _flags(metadata, entry.name)
        title = metadata.pop("group", group)
        container: argparse._ActionsContainer = parser.group(title) if title else parser
        if rival := metadata.pop("rivals", None):
            if rival not in rivals:
                rivals[rival] = container.add_mutually_exclusive_group()
            container = rivals[rival]
        kept: dict[str, Any] = {"dest": entry.name} if flags else {}
        keywords = _keywords(entry, metadata, value_types[entry.name], is_positional=not flags)
        container.add_argument(*(flags or [entry.name]), **kept, **keywords)


def values_of(arguments: argparse.Namespace, owner: type, **choice: Any) -> dict[str, Any]:
    """Returns the values of the options that :func:`add_options` added, by field.

    Lists become tuples.

    Args:
        arguments: the parsed arguments.
        owner: the dataclass.
        **choice: as for :func:`add_options`.
    """
    values = {}
    for entry in _fields(owner, **choice):
        if part := entry.metadata.get("part"):
            value = entry.metadata["make"](**values_of(arguments, **part))
        else:
            value = getattr(arguments, entry.name)
        values[entry.name] = tuple(value) if isinstance(value, list) else value
    return values


def changed_options(
    values: Any,
    owner: type | None = None,
    *,
    defaults: Mapping[str, Any] = _NO_DEFAULTS,
    **choice: Any,
) -> list[str]:
    """Returns the options whose values are not their defaults, such as ``--max-steps``.

    Args:
        values: an instance of a dataclass of options, or a dict of its values.
        owner: the dataclass; only needed for a dict.
        defaults: as for :func:`add_options`.
        **choice: as for :func:`add_options`.
    """
    owner = owner or type(values)
    values = values if isinstance(values, dict) else vars(values)
    changed = []
    for entry in _fields(owner, **choice):
        if part := entry.metadata.get("part"):
            changed += changed_options(values[entry.name], part["owner"])
        elif entry.name in values and values[entry.name] != defaults.get(entry.name, entry.default):
            changed += _flags(_metadata(owner, entry.name), entry.name)[:1]
    return changed


def refuse_options(why: str, options: Collection[str]) -> None:
    """Refuses options that have no effect.

    Args:
        why: why they have none.
        options: the options that the user chose.

    Raises:
        ConfigError: there are any.
    """
    if options:
        raise ConfigError(f"{why}; leave out {', '.join(options)}")


def _flags(metadata: dict[str, Any], name: str) -> list[str]:
    """Removes the names of an option from a field's metadata, and returns them.

    A positional argument has none.
    """
    flag = metadata.pop("flag", "--" + name.replace("_", "-"))
    return [*([flag] if flag else []), *metadata.pop("aliases", ())]


def _fields(
    owner: Any, without: Collection[str] = (), only: Collection[str] | None = None, **_: Any
) -> list[Field[Any]]:
    return [
        entry
        for entry in fields(owner)
        if entry.name not in without and (only is None or entry.name in only)
    ]


def _texts(owner: type) -> dict[str, str]:
    """Returns the entries under ``Attributes:`` of a dataclass and its bases, by field."""
    docs = "\n".join(inspect.cleandoc(base.__doc__ or "") for base in reversed(owner.__mro__))
    docs = docs.replace("%", "%%")  # argparse formats help texts with %
    return {
        name: " ".join(re.sub(r"(?<!\.)\.$", "", text).split())
        for name, text in _ATTRIBUTE.findall(docs)
    }


def _metadata(owner: type, name: str) -> dict[str, Any]:
    """Returns the metadata of a field. A field with a new default keeps its base's metadata."""
    metadata: dict[str, Any] = {}
    for base in reversed(owner.__mro__):
        if name in (entries := getattr(base, "__dataclass_fields__", {})):
            metadata |= entries[name].metadata
    return metadata


def _keywords(
    entry: Field[Any], metadata: dict[str, Any], value_type: Any, *, is_positional: bool
) -> dict[str, Any]:
    """Returns the keyword arguments of ``add_argument`` for a field."""
    default, keywords = metadata["default"], metadata
    if typing.get_origin(value_type) in (types.UnionType, typing.Union):  # a union with None
        value_type = next(
            part for part in typing.get_args(value_type) if part is not types.NoneType
        )
        keywords |= {"nargs": "?"} if is_positional else {}
    if default is MISSING:
        del keywords["default"]
    if value_type is bool:
        return {**keywords, "action": "store_true"}
    if typing.get_origin(value_type) is tuple:
        value_type = typing.get_args(value_type)[0]
        if keywords.get("action") != "append":
            keywords["nargs"] = "*" if is_positional and default is not MISSING else "+"
    keywords.setdefault("type", value_type)
    if "choices" not in keywords:
        keywords.setdefault("metavar", "N" if value_type is int else entry.name.upper())
    shown = " ".join(map(str, default)) if isinstance(default, tuple) else default
    if shown not in (None, MISSING, "") and "default" not in keywords["help"]:
        keywords["help"] += f" (default: {shown})"
    return keywords
