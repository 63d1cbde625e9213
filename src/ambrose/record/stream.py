"""A record that grows: blocks, each with its length and checksum, that are only ever added at the
end of the file.

Whatever becomes of its writer, all blocks but the last are whole, and the checksum tells whether
that is. First an "H" block: JSON with the attributes, signals and units; then "S": samples (n, p),
little-endian floats of 8 bytes; "N": JSON with notes that came late.
"""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ambrose.core.checks import InvalidInput, invalid
from ambrose.machine.json_text import parse_json
from ambrose.machine.limits import NUMBERS
from ambrose.record.attributes import read_attributes, record_of
from ambrose.record.record import Record

SUFFIX = ".partial"
COMPLETE, UNFINISHED = "complete", "false"  # the note that an unfinished record carries
_SIGNATURE = b"ambrose-stream-1\n"
_HEAD = struct.Struct("<cQI")  # kind, bytes of the content, its CRC-32

Kind = Literal[b"H", b"S", b"N"]


def block(kind: Kind, content: bytes | Mapping[str, Any]) -> bytes:
    """One block; the first of a file, "H", with the signature before it."""
    data = content if isinstance(content, bytes) else json.dumps(content).encode()
    return (
        (_SIGNATURE if kind == b"H" else b"") + _HEAD.pack(kind, len(data), zlib.crc32(data)) + data
    )


def blocks(path: Path) -> Iterator[tuple[bytes, bytes]]:
    """(kind, content) of the whole blocks of a file, one after the other. Raises InvalidInput where
    it is none of these.
    """
    left = path.stat().st_size - len(_SIGNATURE)
    with path.open("rb") as file:
        if file.read(len(_SIGNATURE)) != _SIGNATURE:
            raise InvalidInput(
                "it does not begin as a record that is being written; check the name"
            )
        while left >= _HEAD.size:
            kind, length, checksum = _HEAD.unpack(file.read(_HEAD.size))
            left -= _HEAD.size + length
            if left < 0 or zlib.crc32(data := file.read(length)) != checksum:
                return
            yield kind, data


def samples(content: bytes, p: int) -> np.ndarray:
    """The samples (p, n) of an "S" block."""
    return np.frombuffer(content, "<f8").reshape(-1, p).T


def read_stream(path: Path) -> Record:
    """What an unfinished run has written so far, with the note complete = "false". Raises
    InvalidInput.
    """
    size = path.stat().st_size
    if size > 9 * NUMBERS:
        raise invalid(
            "the file's size",
            f"{size} bytes",
            f"at most {9 * NUMBERS}",
            "it is no record that was being written",
        )
    parts = blocks(path)
    kind, content = next(parts, (b"", b""))
    if kind != b"H":
        raise InvalidInput(
            "the run was interrupted before it began; there is nothing to read, repeat it"
        )
    try:
        return _joined(content, parts, size)
    except InvalidInput:
        raise
    except (
        KeyError,
        TypeError,
        ValueError,
        AttributeError,
        ZeroDivisionError,
        RecursionError,
    ) as error:
        raise InvalidInput(
            f"its blocks do not fit together ({error!r}); another program wrote them"
        ) from error


def _joined(head: bytes, parts: Iterator[tuple[bytes, bytes]], size: int) -> Record:
    """The content of the "H" block and the blocks behind it as a record; size: of the file
    [bytes].
    """
    header = parse_json(head, "repeat the run")
    p, filled = len(header["signals"]), 0
    values, notes = np.empty((p, size // (8 * p))), {COMPLETE: UNFINISHED}
    for kind, content in parts:
        if kind == b"N":
            notes |= parse_json(content, "repeat the run")
        else:
            part = samples(content, p)
            values[:, filled : filled + part.shape[1]] = part
            filled += part.shape[1]
    if not filled:
        raise InvalidInput(
            "the run was interrupted before its first block was written; there is nothing to "
            "read, repeat it"
        )
    attributes = read_attributes({**header["attributes"], **notes})
    signals = list(zip(header["signals"], header["units"], strict=True))
    # a Record refuses a rate of 0
    start, rate = attributes.start_time_s, attributes.sample_rate_hz or 0.0
    return record_of(attributes, signals, values[:, :filled].copy(), rate, start)
