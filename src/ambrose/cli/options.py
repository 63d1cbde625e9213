"""Options of the command line, made from the fields of the classes that the library takes.

A flag, its type, its unit and its help stand once, with the field (``ambrose.options``).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import Field, fields
from pathlib import Path
from typing import Any, TypeVar

import click
from click.core import ParameterSource

from ambrose.options import (
    Option,
    Options,
    check_option,
    either,
    kinds_with,
    option_of,
    refuse_foreign,
)
from ambrose.terminal import quantity_given

Kinds = Mapping[str, type[Options]]
Chosen = TypeVar("Chosen", bound=Options)
# of an annotation its first alternative -> what click makes of one word, and how many words
_TYPES: dict[str, tuple[Any, int]] = {
    "float": (float, 1),
    "int": (int, 1),
    "str": (str, 1),
    "Sequence[str]": (str, 1),
    "Mapping[str, float]": (str, 1),
    "Path": (click.Path(path_type=Path), 1),
    "LawLike": (click.Path(path_type=Path), 1),
    "tuple[float, float]": (float, 2),
}

# identification/one_axis/axis_record.py, which is not imported for --help
AXIS_COLUMNS = ("displacement", "drive", "reference", "current", "voltage", "time")
_AXIS_HELP = {
    "displacement": "Of the axis; default: y, y_<axis>.",
    "drive": "What the plant is driven by, a current best; default: u, u_<axis>.",
    "reference": "What drives the loop from outside; default: r, e, yd, e_<axis>, r_<axis>.",
    "current": "Of the coil; default: i, i_<axis>.",
    "voltage": "Of the coil, to see whether the current belongs to it.",
    "time": "Default: t, time.",
}


def options_from(kinds: Kinds | type[Options]) -> Callable[[Any], Any]:
    """Decorator of a command: a flag for every option that the class, or any of several, has."""
    several = {"": kinds} if isinstance(kinds, type) else kinds

    def decorate(command: Any) -> Any:
        for name in reversed(_names(several)):
            command = _flag(several, name)(command)
        return command

    return decorate


def groups_from(kinds: Kinds, every: str, word: str) -> dict[str, tuple[str, ...]]:
    """{title: options} for ``GroupedCommand``: those that all classes have under ``every``, others
    by what has them.
    """
    groups: dict[str, tuple[str, ...]] = {}
    for name in _names(kinds):
        having = kinds_with(kinds, name)
        title = every if len(having) == len(kinds) else f"With {word} {either(having)}"
        groups[title] = (*groups.get(title, ()), name)
    return groups


def chosen_from(
    kinds: Mapping[str, type[Chosen]], kind: str, asked: Mapping[str, Any], word: str
) -> Chosen:
    """The one of the classes that a command line chose, with the options given there.

    asked: what click gives for all options. Raises InvalidInput by the names of the flags.
    """
    refuse_foreign(kinds, "kind", kind, _stated(asked), {**_flags(), "kind": word})
    return asked_for(kinds[kind], asked)


def asked_for(kind: type[Chosen], asked: Mapping[str, Any]) -> Chosen:
    """A class with the options that a command line gives; asked as of ``chosen_from``. Raises
    InvalidInput by the names of the flags.
    """
    having, flags = {item.name: item for item in fields(kind)}, _flags()
    kind.check_rules({name: asked[name] for name in _stated(asked)}, flags)
    return kind(**{name: _read(having[name], asked[name], flags[name]) for name in _stated(asked)})


def _flags() -> dict[str, str]:
    """{option: its flag} of the command that runs."""
    command = click.get_current_context().command
    return {item.name: item.opts[-1] for item in command.params if item.name}


def _stated(asked: Mapping[str, Any]) -> list[str]:
    """The names of those that the command line states, and leaves to no default."""
    source = click.get_current_context().get_parameter_source
    return [name for name in asked if source(name) is not ParameterSource.DEFAULT]


def _names(kinds: Kinds) -> tuple[str, ...]:
    """All options that have a flag, in the order of the classes."""
    rows = [item for kind in kinds.values() for item in fields(kind)]
    return tuple(dict.fromkeys(item.name for item in rows if option_of(item).flag is not None))


def _flag(kinds: Kinds, name: str) -> Callable[[Any], Any]:
    """The click option of a field; where several classes have it they differ in meaning alone."""
    having = {
        key: item for key, kind in kinds.items() for item in fields(kind) if item.name == name
    }
    item = next(iter(having.values()))
    known, annotation = option_of(item), str(item.type).partition(" | ")[0]
    meanings: dict[str, list[str]] = {}
    for key, field in having.items():
        meanings.setdefault(option_of(field).meaning, []).append(key)
    # where the meanings differ, each after the names that it goes with
    help_text = " ".join(
        text if len(meanings) == 1 else f"{either(keys)}: {text}" for text, keys in meanings.items()
    )
    choices = list(dict.fromkeys(c for field in having.values() for c in option_of(field).choices))
    attributes: dict[str, Any] = {
        "help": help_text,
        "metavar": known.metavar,
        "default": () if known.many else item.default,
    }
    if annotation != "bool":
        kind, count = (str, 1) if known.dimension else _TYPES.get(annotation, (float, 1))
        attributes |= {"type": click.Choice(choices) if choices else kind}
        attributes |= {"nargs": count, "multiple": known.many}
        attributes["show_default"] = bool(item.default)
    elif "/" not in _spelled(item, known):
        attributes["is_flag"] = True
    return click.option(_spelled(item, known), name, **attributes)


def _spelled(item: Field[Any], known: Option) -> str:
    return known.flag or f"--{item.name.replace('_', '-')}"


def _read(item: Field[Any], value: Any, flag: str) -> Any:
    """A value of the command line in SI. Raises InvalidInput by its flag."""
    known = option_of(item)
    if known.dimension:
        return quantity_given(value, flag, known.dimension)
    if known.many:
        return value
    check_option(item, value, flag)
    if known.convert is None:
        return value
    return tuple(map(known.convert, value)) if isinstance(value, tuple) else known.convert(value)


def axis_columns(command: Any) -> Any:
    """Decorator of a command: a flag for every column of a record of one axis."""
    for name in reversed(AXIS_COLUMNS):
        command = click.option(f"--{name}", metavar="COLUMN", help=_AXIS_HELP[name])(command)
    return command
