"""Command-line options: a dataclass declares them, and its docstring provides their help."""

from __future__ import annotations

import argparse
import inspect
import re
import textwrap
import types
import typing
from collections.abc import Collection, Iterable, Sequence
from dataclasses import MISSING, Field, field, fields
from typing import Any, NoReturn

from stkzoo._checks import unknown_name
from stkzoo.errors import ConfigError

_ATTRIBUTE = re.compile(r"^    (\w+): (.*(?:\n {8}.*)*)", re.MULTILINE)


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

    def add_usage(
        self,
        usage: str | None,
        actions: Iterable[argparse.Action],
        groups: Iterable[argparse._MutuallyExclusiveGroup],
        prefix: str | None = None,
    ) -> None:
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
        arguments, unknown = super().parse_known_args(args, namespace)
        if unknown:
            name = unknown[0].partition("=")[0]
            if name.startswith("-"):
                known = self._option_string_actions
                if longer := next((flag for flag in known if flag.startswith(name)), None):
                    self.error(f"unknown option {name!r}. Did you mean {longer!r}?")
                self.error(_unknown("option", name, known))
            self.error(f"unexpected argument {name!r}")
        return arguments, unknown

    def _check_value(self, action: argparse.Action, value: object) -> None:
        if action.choices is not None and value not in action.choices:
            if isinstance(action, argparse._SubParsersAction):
                self.error(_unknown(str(action.metavar).lower(), value, action.choices))
            known = ", ".join(map(str, action.choices))
            raise argparse.ArgumentError(action, f"{value!r} is not one of {known}")


def _whole(text: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number") from None


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number") from None


def _unknown(kind: str, name: object, known: Collection[str]) -> str:
    """Returns the error text for an unknown name, without the list of known names."""
    text = str(unknown_name(kind, name, known))
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


def options_of(kind: type, **choice: Any) -> Any:
    """Returns a field that contains the options of another dataclass.

    Its value is an instance of the dataclass. If fields are left out, it is a dict of the others.

    Args:
        kind: the dataclass.
        **choice: ``without``, ``only`` and ``group``, as for :func:`add_options`.
    """
    is_whole = not choice.keys() & {"without", "only"}
    make = kind if is_whole else dict
    return field(default_factory=make, metadata={"part": {"kind": kind, **choice}, "make": make})


def add_options(
    parser: CommandParser,
    kind: type,
    *,
    without: Collection[str] = (),
    only: Collection[str] | None = None,
    group: str | None = None,
) -> None:
    """Adds an option for each field of a dataclass: ``--max-steps`` for ``max_steps``.

    The help text is the field's entry under ``Attributes:`` in the docstring, unless the field's
    metadata has a ``help``. Fields can be numbers, texts, booleans, paths, or tuples of these, and
    other dataclasses (:func:`options_of`).

    Args:
        parser: parser of the command.
        kind: the dataclass.
        without: names of fields to leave out.
        only: names of fields to add; ``None`` for all.
        group: title of the group for fields without their own group; ``None`` for the parser's
            default group.
    """
    kinds, texts = typing.get_type_hints(kind), _texts(kind)
    rivals: dict[str, argparse._ActionsContainer] = {}
    for entry in _fields(kind, without, only):
        if part := entry.metadata.get("part"):
            add_options(parser, **part)
            continue
        metadata = {"help": texts.get(entry.name, ""), **_metadata(kind, entry.name)}
        flags = _flags(metadata, entry.name)
        title = metadata.pop("group", group)
        container: argparse._ActionsContainer = parser.group(title) if title else parser
        if rival := metadata.pop("rivals", None):
            if rival not in rivals:
                rivals[rival] = container.add_mutually_exclusive_group()
            container = rivals[rival]
        kept: dict[str, Any] = {"dest": entry.name} if flags else {}
        keywords = _keywords(entry, metadata, kinds[entry.name], is_positional=not flags)
        container.add_argument(*(flags or [entry.name]), **kept, **keywords)


def values_of(
    arguments: argparse.Namespace,
    kind: type,
    *,
    without: Collection[str] = (),
    only: Collection[str] | None = None,
    group: str | None = None,  # noqa: ARG001 - as for add_options
) -> dict[str, Any]:
    """Returns the values of the options that :func:`add_options` added, by field.

    Lists become tuples.

    Args:
        arguments: the parsed arguments.
        kind: the dataclass.
        without: names of fields to leave out.
        only: names of fields to return; ``None`` for all.
        group: ignored.
    """
    values = {}
    for entry in _fields(kind, without, only):
        if part := entry.metadata.get("part"):
            value = entry.metadata["make"](**values_of(arguments, **part))
        else:
            value = getattr(arguments, entry.name)
        values[entry.name] = tuple(value) if isinstance(value, list) else value
    return values


def changed_options(
    values: Any,
    kind: type | None = None,
    *,
    without: Collection[str] = (),
    only: Collection[str] | None = None,
) -> list[str]:
    """Returns the options whose values are not their defaults, such as ``--max-steps``.

    Args:
        values: an instance of a dataclass of options, or a dict of its values.
        kind: the dataclass; only needed for a dict.
        without: names of fields to leave out.
        only: names of fields to compare; ``None`` for all.
    """
    kind = kind or type(values)
    values = values if isinstance(values, dict) else vars(values)
    changed = []
    for entry in _fields(kind, without, only):
        if part := entry.metadata.get("part"):
            changed += changed_options(values[entry.name], part["kind"])
        elif entry.name in values and values[entry.name] != entry.default:
            changed += _flags(_metadata(kind, entry.name), entry.name)[:1]
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


def _fields(kind: Any, without: Collection[str], only: Collection[str] | None) -> list[Field[Any]]:
    return [
        entry
        for entry in fields(kind)
        if entry.name not in without and (only is None or entry.name in only)
    ]


def _texts(kind: type) -> dict[str, str]:
    """Returns the entries under ``Attributes:`` of a dataclass and its bases, by field."""
    docs = "\n".join(inspect.cleandoc(base.__doc__ or "") for base in reversed(kind.__mro__))
    docs = docs.replace("%", "%%")  # argparse formats help texts with %
    return {
        name: " ".join(re.sub(r"(?<!\.)\.$", "", text).split())
        for name, text in _ATTRIBUTE.findall(docs)
    }


def _metadata(kind: type, name: str) -> dict[str, Any]:
    """Returns the metadata of a field. A field with a new default keeps its base's metadata."""
    metadata: dict[str, Any] = {}
    for base in reversed(kind.__mro__):
        if name in (entries := getattr(base, "__dataclass_fields__", {})):
            metadata |= entries[name].metadata
    return metadata


def _keywords(
    entry: Field[Any], metadata: dict[str, Any], kind: Any, *, is_positional: bool
) -> dict[str, Any]:
    """Returns the keyword arguments of ``add_argument`` for a field."""
    default, keywords = entry.default, metadata
    if typing.get_origin(kind) in (types.UnionType, typing.Union):  # a union with None
        kind = next(part for part in typing.get_args(kind) if part is not types.NoneType)
        keywords |= {"nargs": "?"} if is_positional else {}
    if default is not MISSING:
        keywords["default"] = default
    if kind is bool:
        return {**keywords, "action": "store_true"}
    if typing.get_origin(kind) is tuple:
        kind = typing.get_args(kind)[0]
        if keywords.get("action") != "append":
            keywords["nargs"] = "*" if is_positional and default is not MISSING else "+"
    keywords.setdefault("type", {int: _whole, float: _number}.get(kind, kind))
    if "choices" not in keywords:
        keywords.setdefault("metavar", "N" if kind is int else entry.name.upper())
    shown = " ".join(map(str, default)) if isinstance(default, tuple) else default
    if shown not in (None, MISSING, "") and "default" not in keywords["help"]:
        keywords["help"] += f" (default: {shown})"
    return keywords
