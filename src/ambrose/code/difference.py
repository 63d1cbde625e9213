"""What changes in the code when one controller replaces another of the same structure: the entries
of its tables, and the way back.

difference = parameter_difference(before["controller.c"], after["controller.c"])
difference.changes, difference.checksum

Two files have the same structure where nothing but numbers in tables, and comments, differ: then
the tables may be written into the running unit, and nothing else of it changes. A checksum over all
tables says which of the two a unit holds.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import zip_longest
from typing import Any

from ambrose.core.checks import InvalidInput
from ambrose.core.presentation import json_text

# static const real from_error[NI][NX] = {{1.0, -2.5e-3}, ...};
_TABLE = re.compile(r"static const (\w+) (\w+)((?:\[\w+\])+) =[^{;]*(\{[^;]*\});")
_COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)
_NUMBER = re.compile(r"[^\s{},]+")
_OWN = "parameters"
DIFFERENCE, BACK = f"{_OWN}.json", f"{_OWN}-back.json"
_HOW = (
    "CRC-32 (IEEE 802.3) over all tables in the order of the C file, each entry in the order of "
    "memory as a little-endian IEEE 754 double"
)


@dataclass(frozen=True, slots=True)
class Change:
    """One entry of a table: its place in memory, counted from 0, and its number before and after,
    as the C file spells them.
    """

    table: str
    index: int
    before: str
    after: str


@dataclass(frozen=True, slots=True)
class Difference:
    """changes: of the tables; sizes: entries of every table; checksum_before, checksum: CRC-32 of
    all tables.
    """

    changes: tuple[Change, ...]
    sizes: Mapping[str, int]
    checksum_before: str
    checksum: str

    def reversed(self) -> Difference:
        """The way back."""
        changes = tuple(Change(c.table, c.index, c.after, c.before) for c in self.changes)
        return Difference(changes, self.sizes, self.checksum, self.checksum_before)

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready data, numbers as doubles."""
        rows = [
            {"table": c.table, "index": c.index, "before": before, "after": after}
            for c in self.changes
            for before, after in [(_value(c.before), _value(c.after))]
        ]
        return {
            "checksum_before": self.checksum_before,
            "checksum_after": self.checksum,
            "checksum_is": _HOW,
            "tables": dict(self.sizes),
            "changes": rows,
        }

    def files(self) -> dict[str, str]:
        """{name: text} of the difference and of the way back."""
        both = {DIFFERENCE: self, BACK: self.reversed()}
        return {name: json_text(item.to_dict(), indent=1) + "\n" for name, item in both.items()}

    def apply(self, source: str) -> str:
        """A C file with the changes in its tables. Raises InvalidInput where it does not hold the
        tables that the difference begins from, or would not end with those that it leads to.
        """
        if (found := checksum_of(source)) != self.checksum_before:
            raise InvalidInput(
                f"the tables have the checksum {found}, but the difference begins from "
                f"{self.checksum_before}; read out which controller runs"
            )
        wanted = {(change.table, change.index): change.after for change in self.changes}

        def edited(match: re.Match[str]) -> str:
            count = iter(range(match[4].count(",") + 1))
            entry = lambda own: wanted.get((match[2], next(count)), own[0])  # noqa: E731
            return match[0].replace(match[4], _NUMBER.sub(entry, match[4]))

        text = _TABLE.sub(edited, source)
        if (ended := checksum_of(text)) != self.checksum:
            raise InvalidInput(
                f"the changed tables have the checksum {ended}, not {self.checksum}; the "
                "difference is damaged: export it again"
            )
        return text


def parameter_difference(before: str, after: str) -> Difference:
    """What leads from one C file to another of the same structure.

    Raises InvalidInput that names the first line that differs beside the tables.
    """
    rest = [_TABLE.sub(r"\1 \2\3", _COMMENT.sub("", text)) for text in (before, after)]
    for one, other in zip_longest(*(text.splitlines() for text in rest), fillvalue=""):
        if one.strip() != other.strip():
            line = f"{one.strip() or 'nothing'!s} and {other.strip() or 'nothing'!s}"
            raise InvalidInput(
                f"the two controllers have not the same structure ({line}), so the whole unit "
                "must be replaced; design the new one with the states, or the filters, of the old"
            )
    old, new = _tables(before), _tables(after)
    short = [name for name, entries in old.items() if len(entries) != len(new[name])]
    if short:
        raise InvalidInput(
            f"the table {short[0]} has not the same size in both controllers, so the whole unit "
            "must be replaced"
        )
    changes = tuple(
        Change(name, i, a, b)
        for name, entries in old.items()
        for i, (a, b) in enumerate(zip(entries, new[name], strict=True))
        if _value(a) != _value(b)
    )
    sizes = {name: len(entries) for name, entries in old.items()}
    return Difference(changes, sizes, checksum_of(before), checksum_of(after))


def checksum_of(source: str) -> str:
    """CRC-32 of all tables of a C file, eight hexadecimal digits."""
    numbers = [_value(entry) for entries in _tables(source).values() for entry in entries]
    return f"{zlib.crc32(struct.pack(f'<{len(numbers)}d', *numbers)):08x}"


def _tables(source: str) -> dict[str, list[str]]:
    found = _TABLE.finditer(_COMMENT.sub("", source))
    return {match[2]: _NUMBER.findall(match[4]) for match in found}


def _value(literal: str) -> float:
    return float(literal.rstrip("fFlL")) + 0.0  # no negative zero
