"""Records as HDF5: attributes at the root, one dataset of float64 per signal under /signals.

The attribute complete = "false" marks what an interrupted run left (record/writer.py): its signals may differ in length and end
in chunks that were never written. Such a file is read as far as every signal reaches.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, invalid
from ambrose.machine.limits import BESIDE, CHECKED_FIRST, CHUNK_BYTES, NOTES, NUMBERS, PACKED, SIGNALS, TEXT, UNPACKED
from ambrose.machine.messages import quoted
from ambrose.machine.record.attributes import RecordAttributes, read_attributes, record_of
from ambrose.machine.record.record import Record, check_samples
from ambrose.machine.record.recovery import Settled, left_open

LIBVER = ("v110", "v110")  # the format of HDF5 1.10: checksums on the structure as well
COMPLETE, UNFINISHED = "complete", "false"  # the attribute that an unfinished record carries
_BLOCK = 1_000_000  # samples read together while they are checked
_DAMAGE = (OSError, RuntimeError, KeyError, ValueError, TypeError, OverflowError, MemoryError)


def write_hdf5(record: Record, path: Path) -> None:
    """In the format of HDF5 1.10 with checksums on data and structure, and texts of fixed length: damage is always noticed."""
    import h5py

    with h5py.File(path, "w", libver=LIBVER) as file:
        file.attrs.update({key: fixed(value) for key, value in record.attributes.items()})
        group = file.create_group("signals", track_order=True)
        for name, unit, values in zip(record.signals, record.units, record.values, strict=True):
            group.create_dataset(name, data=values, dtype="f8", chunks=True, fletcher32=True).attrs["unit"] = fixed(unit)


def fixed(value: Any) -> Any:
    """An attribute as it is stored: a text with fixed length, a number as it is."""
    import h5py

    text = value.encode() if isinstance(value, str) else b""
    return np.array(text, h5py.string_dtype("utf-8", len(text))) if text else value


def read_hdf5(path: Path) -> Record:
    """The record, also one that is still being written or whose writer was killed. Raises InvalidInput."""
    import h5py

    try:
        with _opened(path) as file:
            if "format" in file.attrs:
                _check_beside(file.get("signals"), path.stat().st_size, h5py)
            if len(file.attrs) > NOTES:
                raise invalid("the number of attributes", len(file.attrs), f"at most {NOTES}", "remove some")
            attributes = read_attributes({key: _attribute(file.attrs, key) for key in file.attrs})
            group = file.get("signals")
            if not isinstance(group, h5py.Group) or not len(group):
                raise InvalidInput("the group /signals is missing or empty; a record keeps one dataset per signal there")
            if len(group) > SIGNALS:
                raise invalid("the number of signals", len(group), f"at most {SIGNALS}", "split the record")
            datasets = {name: _dataset(group, name, h5py) for name in group}
            units = [(name, str(_attribute(data.attrs, "unit"))) for name, data in datasets.items()]
            check_packing(list(datasets.values()), path)
            record_of(attributes, units, np.zeros((len(units), 1)), 1.0, 0.0)  # refuses names and units, before all is read
            values = _values(datasets, attributes)
    except InvalidInput:
        raise
    except _DAMAGE as error:
        raise InvalidInput(f"it cannot be read as HDF5 ({error}); it is damaged, truncated or of another kind") from error
    if attributes.sample_rate_hz is None:
        raise InvalidInput("the attribute sample_rate_hz is missing; add the sampling frequency in Hz")
    return record_of(attributes, units, values, attributes.sample_rate_hz, attributes.start_time_s)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """The file, open for reading, whatever became of its writer."""
    import h5py

    with Settled(path) if left_open(path) else nullcontext(path) as source, h5py.File(source, "r") as file:
        yield file


def _attribute(attributes: Any, key: str) -> Any:
    """An attribute, after its size was looked at; "" where there is none."""
    if key not in attributes:
        return ""
    head = attributes.get_id(key)
    if head.shape != () or head.get_storage_size() > TEXT or head.dtype.kind in "V":
        what = "an array" if head.shape else "too long"
        raise invalid(f"the attribute {quoted(key)}", what, f"a number or a text of at most {TEXT} bytes", "remove it")
    value = attributes[key]
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else value


def _check_beside(group: Any, size: int, h5py: Any) -> None:
    """Refuse a file with much more than its signals: opening an attribute reads it, however long it is."""
    names = list(group) if isinstance(group, h5py.Group) and len(group) <= SIGNALS else []
    plain = [name for name in names if isinstance(group.get(name, getlink=True), h5py.HardLink)]
    stored = sum(data.id.get_storage_size() for name in plain if isinstance(data := group[name], h5py.Dataset))
    if size - stored > BESIDE:
        raise invalid("what the file holds beside its signals", f"{size - stored} bytes", f"at most {BESIDE}", "remove it")


def check_packing(datasets: Sequence[Any], path: Path) -> None:
    """Refuse datasets that would unpack to much more than their file, as only zeros do. Raises InvalidInput."""
    size, held = path.stat().st_size, sum((data.size or 0) * max(data.dtype.itemsize, 8) for data in datasets)
    if held > max(UNPACKED, PACKED * size):
        raise invalid("the file's content", f"{held} bytes in {size}", f"at most {PACKED} times the file", "is it damaged?")
    chunk = max((math.prod(data.chunks or (0,)) * data.dtype.itemsize for data in datasets), default=0)
    if chunk > CHUNK_BYTES:
        raise invalid(
            "a chunk", f"{chunk} bytes", f"at most {CHUNK_BYTES}", "repack the file with smaller chunks (h5repack -l)"
        )


def _dataset(group: Any, name: str, h5py: Any) -> Any:
    data = group[name] if isinstance(group.get(name, getlink=True), h5py.HardLink) else None
    if not isinstance(data, h5py.Dataset) or data.ndim != 1 or data.dtype.kind not in "fiu" or data.is_virtual:
        raise invalid(f"/signals/{name}", "something else", "a dataset of real numbers with one axis", "export it again")
    if data.size * len(group) > NUMBERS:
        raise invalid("the number of values", data.size * len(group), f"at most {NUMBERS}", "split the record")
    return data


def _values(datasets: dict[str, Any], attributes: RecordAttributes) -> np.ndarray:
    """All signals (p, k) in the units of the file; of an unfinished record the samples that all signals have."""
    complete = (COMPLETE, UNFINISHED) not in attributes.notes
    lengths = {name: data.shape[0] for name, data in datasets.items()}
    if complete and len(set(lengths.values())) > 1:
        raise invalid("the numbers of samples", lengths, "the same for all signals", "export the record again")
    k = min(lengths.values())
    if complete:
        if k * len(datasets) > CHECKED_FIRST:
            rate = attributes.sample_rate_hz or math.nan
            for name, data in datasets.items():
                for first in range(0, k, _BLOCK):
                    check_samples(name, data[first : min(first + _BLOCK, k)], first, attributes.start_time_s, rate)
        return _read(datasets, k)
    chunk = max((data.chunks or (1,))[0] for data in datasets.values())
    try:
        values = _read(datasets, k)
    except OSError:  # the last chunk of a signal was being written when the writer was killed
        k = (k - 1) // chunk * chunk
        values = _read(datasets, k)
    k = int(np.append(np.isnan(values).any(axis=0), True).argmax())  # NaN fills what was never written
    if k == 0:
        raise InvalidInput("the run was interrupted before its first block was written; there is nothing to read, repeat it")
    return values if k == values.shape[1] else values[:, :k].copy()


def _read(datasets: dict[str, Any], k: int) -> np.ndarray:
    values = np.empty((len(datasets), k))
    for row, data in zip(values, datasets.values(), strict=True):
        row[:] = data[:k]
    return values
