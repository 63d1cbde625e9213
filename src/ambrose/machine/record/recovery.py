"""An HDF5 file whose writer was killed or had no room left, readable again without touching it.

Such a file says in its first 48 bytes (superblock, version 3) that it is open for writing, or that it is longer than it is.
Both are put right in what the library gets to see; the file itself is not changed. The mark could be ignored by opening for
single-writer reading as well, but then the library waits for ever for what a truncated file lacks.
Format: HDF5 File Format Specification 3.0, II.A; checksum: B. Jenkins, lookup3 (public domain), 2006.
"""

from __future__ import annotations

import io
import os
import struct
from pathlib import Path
from typing import Any

_SIGNATURE = b"\x89HDF\r\n\x1a\n\x03\x08\x08"  # of version 3 with offsets and lengths of eight bytes
_FLAGS, _END, _CHECKSUM, _SIZE = 11, 28, 44, 48  # places in the superblock
_WORD = 0xFFFFFFFF


def left_open(path: Path) -> bool:
    """Whether the file says that it is open for writing, or longer than it is."""
    with path.open("rb") as file:
        start = file.read(_SIZE)
    if len(start) < _SIZE or not start.startswith(_SIGNATURE):
        return False
    return start[_FLAGS] != 0 or struct.unpack_from("<Q", start, _END)[0] > path.stat().st_size


class Settled(io.RawIOBase):
    """The bytes of a file that was left open, as if it had been closed; give it to h5py.File."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("rb")
        self._length = os.fstat(self._file.fileno()).st_size
        start = bytearray(self._file.read(_SIZE))
        start[_FLAGS] = 0
        struct.pack_into("<Q", start, _END, self._length)
        struct.pack_into("<I", start, _CHECKSUM, lookup3(bytes(start[:_CHECKSUM])))
        self._start = bytes(start)

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        return self._file.tell()

    def readinto(self, buffer: Any) -> int:
        place = self._file.tell()
        view = memoryview(buffer).cast("B")
        data = self._file.read(len(view))
        if place < _SIZE:
            data = (self._start[place:] + data[_SIZE - place :])[: len(data)]
        view[: len(data)] = data
        return len(data)

    def close(self) -> None:
        self._file.close()
        super().close()


def lookup3(data: bytes) -> int:
    """The checksum of HDF5's structures, 32 bits; data of at least one byte."""
    a = b = c = (0xDEADBEEF + len(data)) & _WORD
    blocks = [data[i : i + 12].ljust(12, b"\0") for i in range(0, len(data), 12)]
    for block in blocks[:-1]:
        a, b, c = ((x + y) & _WORD for x, y in zip((a, b, c), struct.unpack("<3I", block), strict=True))
        for turns in (4, 6, 8, 16, 19, 4):  # each round mixes c into a, then the names move on
            a = ((a - c) & _WORD) ^ _turned(c, turns)
            c = (c + b) & _WORD
            a, b, c = b, c, a
    a, b, c = ((x + y) & _WORD for x, y in zip((a, b, c), struct.unpack("<3I", blocks[-1]), strict=True))
    for turns in (14, 11, 25, 16, 4, 14, 24):
        c = ((c ^ b) - _turned(b, turns)) & _WORD
        a, b, c = b, c, a
    return b


def _turned(word: int, turns: int) -> int:
    return ((word << turns) | (word >> (32 - turns))) & _WORD
