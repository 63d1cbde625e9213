"""A record that grows: blocks, each with its length and checksum, that are only ever added at the
end of the file.

Whatever becomes of its writer, all blocks but the last are whole, and the checksum tells whether
that is. First an "H" block: JSON with the attributes, signals and units; then "S": samples (n, p),
little-endian floats of 8 bytes; "N": JSON with notes that came late.
"""

import io
import json
import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike

from ambrose.core.checks import InvalidInput, invalid
from ambrose.machine.description import OperatingPoint
from ambrose.machine.ordinary_file import NUMBERS, check_file, claimed, draft_of, parse_json
from ambrose.record.hdf5_file import CHUNK, created, read_attributes, record_of
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
            "it is not an unfinished record",
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


# RecordWriter: a record written while it is measured or simulated, in constant memory; interrupted,
# it is still a record.
#
#     with RecordWriter("run.h5", "seal-rig", 10e3, ("y_A_zeta",), ("m",), point) as writer:
#         for block in blocks:                     # (p, any number) each
#             writer.append(block)
#
# Until the block ends, the samples are in ``run.h5.partial``, which read_record reads at any time:
# while it grows, after Ctrl-C, after kill -9 (which loses the last ``chunk`` samples at most). Only
# when the block ends without an exception does ``run.h5`` appear, complete, and the other go. What
# is in the partial file survives a full disk and a failure of the writing itself
# (record/stream.py); a power failure of the computer costs what the system had not yet put on the
# disk.


def partial_path(path: str | Path) -> Path:
    """Where a record is while it is being written: run.h5 -> run.h5.partial."""
    path = Path(path)
    return path.with_name(f"{path.name}{SUFFIX}")


class RecordWriter:
    """Appends blocks of samples to an HDF5 record; use it as a context manager.

    path: of the finished record (.h5, .hdf5); it, and a partial one of that name, are replaced.
    machine, sample_rate_hz [Hz], signals, units, point, start_time [s] and notes as for a Record.
    chunk: samples that are written at once, and lost at most. note(key, text) adds a note that is
    known only later. Raises InvalidInput.
    """

    def __init__(
        self,
        path: str | Path,
        machine: str,
        sample_rate_hz: float,
        signals: Sequence[str],
        units: Sequence[str],
        point: OperatingPoint | None = None,
        start_time: float = 0.0,
        notes: tuple[tuple[str, str], ...] = (),
        *,
        chunk: int = CHUNK,
    ) -> None:
        self.path = Path(path)
        if self.path.suffix.lower() not in {".h5", ".hdf5"}:
            raise invalid(
                f"the suffix of {self.path.name}",
                repr(self.path.suffix),
                ".h5 or .hdf5",
                "a stream is HDF5",
            )
        if chunk < 1:
            raise invalid("chunk", chunk, "at least 1", f"leave it at {CHUNK} samples")
        self.partial = partial_path(self.path)
        one = np.zeros((len(signals), 1))
        self._header = Record(
            machine,
            sample_rate_hz,
            tuple(signals),
            tuple(units),
            one,
            point or OperatingPoint(),
            start_time,
            notes,
        )
        self._buffer = np.empty((len(signals), chunk))
        self._written = self._filled = 0
        self._late: dict[str, str] = {}
        self._file: io.FileIO | None = None
        self._end = 0  # of the last whole block
        self._stack = ExitStack()

    @property
    def samples(self) -> int:
        """How many samples have been appended."""
        return self._written + self._filled

    def __enter__(self) -> Self:
        if self._file is not None or self.samples:
            raise InvalidInput(
                f"the record {self.path} was written by this writer already; make a new one"
            )
        check_file(self.path, "record")
        header = {name: getattr(self._header, name) for name in ("attributes", "signals", "units")}
        with ExitStack() as stack:
            stack.enter_context(claimed(self.partial, "record"))
            with draft_of(self.partial, "record") as draft:
                self._end = draft.write_bytes(block(b"H", header))
            self._file = stack.enter_context(io.FileIO(self.partial, "r+"))
            self._stack = stack.pop_all()
        return self

    def append(self, block: ArrayLike) -> None:
        """Append samples (p, n) in SI, n at least 1. Raises InvalidInput for another shape, NaN, or
        a disk that is full.
        """
        if self._file is None:
            raise InvalidInput(
                f"the record {self.path} is not open; append within `with RecordWriter(...) as "
                "writer:`"
            )
        values = np.asarray(block, dtype=float)
        p, chunk = self._buffer.shape
        if values.ndim != 2 or values.shape[0] != p or values.shape[1] == 0:
            raise invalid(
                "the shape of a block",
                values.shape,
                f"({p}, n) with n > 0",
                "give one row per signal",
            )
        if not np.isfinite(values).all():
            i, j = (int(index) for index in np.argwhere(~np.isfinite(values))[0])
            at = f"{self._header.signals[i]} at sample {self.samples + j}"
            raise invalid(
                at,
                values[i, j],
                "finite",
                f"stop before it; what came earlier is kept in {self.partial}",
            )
        done = 0
        if self._filled == chunk:  # an earlier attempt failed
            self._write_out()
        while done < values.shape[1]:
            n = min(chunk - self._filled, values.shape[1] - done)
            self._buffer[:, self._filled : self._filled + n] = values[:, done : done + n]
            self._filled, done = self._filled + n, done + n
            if self._filled == chunk:
                self._write_out()

    def note(self, key: str, text: str) -> None:
        """Add or replace a note of the finished record. Raises InvalidInput as Record does."""
        notes = {**dict(self._header.notes), **self._late, key: text}
        h = self._header
        Record(
            h.machine,
            h.sample_rate_hz,
            h.signals,
            h.units,
            h.values,
            h.point,
            h.start_time,
            tuple(notes.items()),
        )
        self._late[key] = text

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        with self._stack:
            try:
                if self._filled:
                    self._write_out()
                if self._late:
                    self._add(block(b"N", self._late))
            except InvalidInput:
                if kind is None:  # else something failed before, or this itself was told already
                    raise
            finally:
                self._file = None
            if not self.samples:
                self.partial.unlink(missing_ok=True)
                if kind is None:
                    raise InvalidInput(
                        f"the record {self.path} got no samples; append at least one block"
                    )
            elif kind is None:
                self._finish()

    def _write_out(self) -> None:
        """Put the buffer into the file."""
        self._add(block(b"S", self._buffer[:, : self._filled].T.astype("<f8").tobytes()))
        self._written, self._filled = self._written + self._filled, 0

    def _add(self, content: bytes) -> None:
        """A block behind the last whole one, whatever an attempt before this one has left there."""
        assert self._file is not None
        view = memoryview(content)
        try:
            self._file.truncate(self._end)
            self._file.seek(self._end)
            while view:
                view = view[self._file.write(view) or 0 :]
        except OSError as error:
            remedy = "free some disk space and repeat the run, what was written is kept"
            raise InvalidInput(
                f"cannot write {self.partial} ({error.strerror or error}); {remedy}"
            ) from error
        self._end += len(content)

    def _finish(self) -> None:
        """The finished record from the partial one, which then goes."""
        h = self._header
        attributes = {**h.attributes, **self._late}
        try:
            with (
                draft_of(self.path, "record") as draft,
                created(
                    draft, attributes, zip(h.signals, h.units, strict=True), self._written
                ) as datasets,
            ):
                done = 0
                for part in (
                    samples(content, len(datasets))
                    for kind, content in blocks(self.partial)
                    if kind == b"S"
                ):
                    for data, row in zip(datasets, part, strict=True):
                        data[done : done + part.shape[1]] = row
                    done += part.shape[1]
                if done < self._written:
                    raise InvalidInput(
                        f"{self.partial} differs from what was written; check the disk"
                    )
        except InvalidInput as error:
            raise InvalidInput(
                f"{error}; the samples are kept in {self.partial}, which `ambrose convert` reads"
            ) from error
        with suppress(OSError):  # the record is whole
            self.partial.unlink()
