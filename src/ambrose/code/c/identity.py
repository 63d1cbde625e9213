"""What running code can be asked for: which code it is, and whether its tables are still those that
were written.

The checksum is CRC-32 (IEEE 802.3: polynomial 0xEDB88320 reflected, start and end inverted) over
the numbers of the tables in the order of the text, least significant octet first whatever the
processor's byte order. The tables are read back out of the text, so that none can be forgotten.
"""

from __future__ import annotations

import hashlib
import re
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ambrose.code.rendering import render
from ambrose.core.checks import InvalidInput
from ambrose.version import __version__

_COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)
_TABLE = re.compile(
    r"^static const (\w+) (\w+)((?:\[\w+\])+) =\s*(\{.*?\});[ \t]*$", re.DOTALL | re.M
)
_PLACES = ("law",)  # structures that point to tables
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_WORD = re.compile(r"[a-z_]\w*", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Table:
    """A constant table of a source text: the type of its numbers there, its name, and the numbers
    as they lie in memory, little-endian.
    """

    kind: str
    name: str
    numbers: np.ndarray


def tables_of(source: str, types: Mapping[str, str]) -> list[Table]:
    """The constant tables of a source in their order.

    types: {type in the text: numpy's}, such as {"real": "f8"}. Raises InvalidInput for a table
    whose numbers cannot be read: a defect of the text, not of the controller.
    """
    found = []
    plain = _COMMENT.sub("", source).replace("unsigned char", "uchar")
    for kind, name, _, body in _TABLE.findall(plain):
        digits = re.sub(r"(?<=[\d.])f\b", "", body)  # 1.5f: of single precision
        left = _WORD.findall(_NUMBER.sub("", digits))
        if kind in _PLACES:
            continue
        if left or kind not in types:
            raise InvalidInput(f"the table {name} of type {kind} cannot be read back: {left[:3]}")
        numbers = np.array([float(n) for n in _NUMBER.findall(digits)])
        whole = types[kind][0] in "iu"
        if whole:  # 64-bit words do not fit a double
            numbers = np.array([int(n) for n in _NUMBER.findall(digits)])
        dtype = np.dtype(f"<{types[kind]}")
        found.append(Table(kind.replace("uchar", "unsigned char"), name, numbers.astype(dtype)))
    return found


def checksum(tables: list[Table]) -> int:
    """CRC-32 of the tables, one after the other."""
    value = 0
    for table in tables:
        value = zlib.crc32(table.numbers.tobytes(), value)
    return value


def identity_facts(name: str, source: str, types: Mapping[str, str]) -> dict[str, Any]:
    """What identity.c.j2 and identity.h.j2 say of a source text: its tables, their checksum, and
    the words that name this code: name, hash of the text, version of what wrote it.
    """
    tables = tables_of(source, types)
    text = hashlib.sha256(source.encode()).hexdigest()[:16]
    listed = [
        {"name": t.name, "kind": t.kind, "count": t.numbers.size, "octets": t.numbers.itemsize}
        for t in tables
    ]
    return {
        "name": name,
        "prefix": name.upper(),
        "identified": listed,
        "checksum": f"0x{checksum(tables):08X}u",
        "identity": f"{name} {text} ambrose {__version__}",
    }


def with_identity(source: str, facts: Mapping[str, Any]) -> str:
    """The source text with the functions that tell checksum and identity at its end."""
    return source + render("identity.c.j2", facts)
