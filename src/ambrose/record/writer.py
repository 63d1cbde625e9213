"""RecordWriter: a record written while it is measured or simulated, in constant memory;
interrupted, it is still a record.

    with RecordWriter("run.h5", "seal-rig", 10e3, ("y_A_zeta",), ("m",), point) as writer:
        for block in blocks:                     # (p, any number) each
            writer.append(block)

Until the block ends, the samples are in ``run.h5.partial``, which read_record reads at any time:
while it grows, after Ctrl-C, after kill -9 (which loses the last ``chunk`` samples at most). Only
when the block ends without an exception does ``run.h5`` appear, complete, and the other go. What is
in the partial file survives a full disk and a failure of the writing itself (record/stream.py); a
power failure of the computer costs what the system had not yet put on the disk.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from ambrose.core.checks import InvalidInput, invalid
from ambrose.machine.atomic_write import check_file, draft_of
from ambrose.machine.claim import claimed
from ambrose.machine.description import OperatingPoint
from ambrose.record.hdf5_file import CHUNK, created
from ambrose.record.record import Record
from ambrose.record.stream import SUFFIX, block, blocks, samples


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
                        f"{self.partial} does not give back what was written; check the disk"
                    )
        except InvalidInput as error:
            raise InvalidInput(
                f"{error}; the samples are kept in {self.partial}, which `ambrose convert` reads"
            ) from error
        with suppress(OSError):  # the record is whole
            self.partial.unlink()
