"""RecordWriter: a record written while it is measured or simulated, in constant memory; interrupted, it is still a record.

    with RecordWriter("run.h5", "seal-rig", 10e3, ("y_A_zeta",), ("m",), point) as writer:
        for block in blocks:                     # (p, any number) each
            writer.append(block)

Until the block ends, the samples are in ``run.partial.h5``, which read_record reads at any time: while it grows, after Ctrl-C,
after kill -9 (which loses the last ``chunk`` samples at most). Only when the block ends without an exception is it renamed to
``run.h5``. HDF5's single-writer mode orders what goes to disk so that the file is consistent at every moment; it is not closed
against power failure of the computer.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from ambrose.core.checks import InvalidInput, invalid
from ambrose.machine.atomic_write import draft_of
from ambrose.machine.description import OperatingPoint
from ambrose.machine.ordinary_file import refuse_special
from ambrose.machine.record.hdf5_file import COMPLETE, LIBVER, UNFINISHED, fixed
from ambrose.machine.record.record import Record

_CHUNK = 2048  # samples written at once


def partial_path(path: str | Path) -> Path:
    """Where a record is while it is being written: run.h5 -> run.partial.h5."""
    path = Path(path)
    return path.with_name(f"{path.stem}.partial{path.suffix}")


class RecordWriter:
    """Appends blocks of samples to an HDF5 record; use it as a context manager.

    path: of the finished record (.h5, .hdf5); it, and a partial one of that name, are replaced. machine, sample_rate_hz [Hz],
    signals, units, point, start_time [s] and notes as for a Record. chunk: samples that are written at once, and lost at most.
    note(key, text) adds a note that is known only later. Raises InvalidInput.
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
        chunk: int = _CHUNK,
    ) -> None:
        self.path = Path(path)
        if self.path.suffix.lower() not in {".h5", ".hdf5"}:
            raise invalid(f"the suffix of {self.path.name}", repr(self.path.suffix), ".h5 or .hdf5", "a stream is HDF5")
        if chunk < 1:
            raise invalid("chunk", chunk, "at least 1", f"leave it at {_CHUNK} samples")
        self.partial = partial_path(self.path)
        one = np.zeros((len(signals), 1))
        self._header = Record(
            machine, sample_rate_hz, tuple(signals), tuple(units), one, point or OperatingPoint(), start_time, notes
        )
        self._buffer = np.empty((len(signals), chunk))
        self._written = self._filled = 0
        self._late: dict[str, str] = {}
        self._file: Any = None
        self._datasets: list[Any] = []
        self._full = False

    @property
    def samples(self) -> int:
        """How many samples have been appended."""
        return self._written + self._filled

    def __enter__(self) -> Self:
        import h5py

        if self._file is not None or self.samples:
            raise InvalidInput(f"the record {self.path} was written by this writer already; make a new one")
        refuse_special(self.path, "record")
        with draft_of(self.partial, "record") as draft, h5py.File(draft, "w", libver=LIBVER) as file:
            attributes = {**self._header.attributes, COMPLETE: UNFINISHED}
            file.attrs.update({key: fixed(value) for key, value in attributes.items()})
            group = file.create_group("signals", track_order=True)
            layout = {"shape": (0,), "maxshape": (None,), "chunks": (self._buffer.shape[1],), "fillvalue": np.nan}
            for name, unit in zip(self._header.signals, self._header.units, strict=True):
                group.create_dataset(name, dtype="f8", fletcher32=True, **layout).attrs["unit"] = fixed(unit)
        self._file = h5py.File(self.partial, "r+", libver=LIBVER, rdcc_nbytes=1 << 18)  # HDF5 2 would keep 8 MB per signal
        self._file.swmr_mode = True
        self._datasets = [self._file["signals"][name] for name in self._header.signals]
        return self

    def append(self, block: ArrayLike) -> None:
        """Append samples (p, n) in SI, n at least 1. Raises InvalidInput for another shape, NaN, or a disk that is full."""
        if self._file is None:
            raise InvalidInput(f"the record {self.path} is not open; append within `with RecordWriter(...) as writer:`")
        values = np.asarray(block, dtype=float)
        p, chunk = self._buffer.shape
        if values.ndim != 2 or values.shape[0] != p or values.shape[1] == 0:
            raise invalid("the shape of a block", values.shape, f"({p}, n) with n > 0", "give one row per signal")
        if not np.isfinite(values).all():
            i, j = (int(index) for index in np.argwhere(~np.isfinite(values))[0])
            at = f"{self._header.signals[i]} at sample {self.samples + j}"
            raise invalid(at, values[i, j], "finite", f"stop before it; what came earlier is kept in {self.partial}")
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
        Record(h.machine, h.sample_rate_hz, h.signals, h.units, h.values, h.point, h.start_time, tuple(notes.items()))
        self._late[key] = text

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        try:
            if self._filled and not self._full:
                self._write_out()
        finally:
            self._close()
        if not self.samples:
            self.partial.unlink(missing_ok=True)
            if kind is None:
                raise InvalidInput(f"the record {self.path} got no samples; append at least one block")
        elif not self._full:
            self._finish(complete=kind is None)

    def _write_out(self) -> None:
        """Put the buffer into the file, and the file onto the disk; done twice, after an interruption, it is the same."""
        first, last = self._written, self._written + self._filled
        try:
            for data, row in zip(self._datasets, self._buffer, strict=True):
                data.resize((last,))
                data[first:last] = row[: self._filled]
            self._file.flush()
        except (OSError, RuntimeError) as error:
            self._full = True
            reason = str(error).splitlines()[0]
            raise InvalidInput(
                f"cannot write {self.partial} ({reason}); free some disk space and repeat the run, what was written is kept"
            ) from error
        self._written, self._filled = last, 0

    def _close(self) -> None:
        file, self._file, self._datasets = self._file, None, []
        try:
            file.close()
        except (OSError, RuntimeError):
            if not self._full:  # else reported already
                raise

    def _finish(self, *, complete: bool) -> None:
        """Add the late notes; a complete record loses its mark and gets its name."""
        import h5py

        if self._late or complete:
            with h5py.File(self.partial, "r+", libver=LIBVER) as file:
                file.attrs.update({key: fixed(text) for key, text in self._late.items()})
                if complete:
                    del file.attrs[COMPLETE]
        if complete:
            os.replace(self.partial, self.path)
