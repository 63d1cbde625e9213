"""The values of a machine file as fields of a form: where each stands, how it is written, what a
refusal says of it, and the text with others in their places.

A place is the keys and numbers down to a value, joined by dots: "bearing.0.gap".
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError

from ambrose.core.checks import InvalidInput
from ambrose.machine.messages import called

_Place = tuple[str | int, ...]


def tables_of(text: str) -> list[tuple[str, str]]:
    """Name and heading of every table at the top of a machine file."""
    return [
        (name, f"[[{name}]]" if isinstance(value, list) else f"[{name}]")
        for name, value in tomlkit.parse(text).items()
        if isinstance(value, list | dict)
    ]


def fields_of(text: str) -> dict[str, tuple[str, str]]:
    """Of every value of a machine file, by its place: its heading as messages have it, and how it
    is written.
    """
    found: dict[str, tuple[str, str]] = {}
    for name, value in tomlkit.parse(text).items():
        if isinstance(value, list):
            entries = _listed(value, (name,), "", name)
        else:
            entries = _entries(value, (name,), f"[{name}]")
        for place, where, item in entries:
            found[".".join(map(str, place))] = where, _written(item)
    return found


def _entries(value: Any, place: _Place, where: str) -> Iterator[tuple[_Place, str, Any]]:
    """Place, heading and value of everything below a table that is no table itself."""
    if isinstance(value, dict):
        for key, below in value.items():
            if key == "assumed":  # reasons, in many words
                continue
            name = ".".join(str(part) for part in (*place, key) if isinstance(part, str))
            if isinstance(below, dict):
                heading = f"{where}, [{name}]" if where and len(place) > 1 else f"[{name}]"
                yield from _entries(below, (*place, key), heading)
            elif isinstance(below, list) and below and isinstance(below[0], dict):
                yield from _listed(below, (*place, key), where if len(place) > 1 else "", name)
            else:
                yield (*place, key), where, below


def _listed(value: Any, place: _Place, where: str, name: str) -> Iterator[tuple[_Place, str, Any]]:
    """As ``_entries``, of tables in double brackets."""
    for i, entry in enumerate(value):
        heading = f"[[{name}]] {called(entry, name.rpartition('.')[2], i + 1)}"
        yield from _entries(entry, (*place, i), f"{where}, {heading}" if where else heading)


def _written(item: Any) -> str:
    """A value as it stands in the file; texts without their quotes."""
    return str(item) if isinstance(item, str) else str(item.as_string())


def with_fields(text: str, values: Mapping[str, str]) -> str:
    """The text of a machine file with values by their place; only what differs from what stands
    there changes, a place that it does not have is passed over, an empty value is taken out.
    """
    document = tomlkit.parse(text)
    before = fields_of(text)
    for name, value in values.items():
        if name in before and value != before[name][1]:
            _set(document, name.split("."), value)
    return document.as_string()


def _set(document: Any, place: list[str], value: str) -> None:
    """A value at its place, a text unless it reads as a number, a list or true and false."""
    item = document
    for part in place[:-1]:
        item = item[int(part)] if part.isdecimal() and isinstance(item, list) else item[part]
    text = value.strip()
    if not text:
        item.remove(place[-1])
        return
    new: Any = text
    if not isinstance(item[place[-1]], str) or re.match(r"[-+\d\[]", text):
        with suppress(TOMLKitError, ValueError):
            new = tomlkit.value(text)
    item[place[-1]] = new


def beside(error: InvalidInput, text: str, source: str) -> dict[str, str]:
    """The sentences of a refusal of a text, by the place of the value that each is about.

    source: what the refusal calls the text.
    """
    lines = getattr(error, "problems", None) or [
        line.removeprefix("  - ").removeprefix(f"{source}: ") for line in str(error).splitlines()
    ]
    with suppress(Exception):  # what is no TOML has no fields
        found: dict[str, str] = {}
        for name, (where, _) in fields_of(text).items():
            key = name.rpartition(".")[2]
            about = [line for line in lines if _is_about(line, where, key)]
            if about:
                found[name] = " ".join(about)
        return found
    return {}


def _is_about(line: str, where: str, key: str) -> bool:
    """Whether a sentence begins with a place and a key."""
    head = f"{where}: "
    begins = rf'(unknown key ")?{re.escape(key)}\b'
    return line.startswith(head) and re.match(begins, line[len(head) :]) is not None
