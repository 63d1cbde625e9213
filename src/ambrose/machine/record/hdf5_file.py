"""Records as HDF5: attributes at the root, one dataset of float64 per signal under /signals.

The attribute complete = "false" marks what an interrupted run left (record/writer.py): its signals may differ in length and end
in chunks that were never written. Such a file is read as far as every signal reaches.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, invalid
from ambrose.machine.record.attributes import read_attributes, record_of
from ambrose.machine.record.record import LARGEST, Record
from ambrose.machine.record.recovery import Settled, left_open

LIBVER = ("v110", "v110")  # the format of HDF5 1.10: checksums on the structure as well
COMPLETE, UNFINISHED = "complete", "false"  # the attribute that an unfinished record carries
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
            attributes = read_attributes({key: _plain(value, key) for key, value in file.attrs.items()})
            group = own_member(file, "signals", "/signals") if "signals" in file else None
            if not isinstance(group, h5py.Group) or not len(group):
                raise InvalidInput("the group /signals is missing or empty; a record keeps one dataset per signal there")
            datasets = {name: _dataset(group, name, h5py) for name in group}
            units = [(name, str(_plain(data.attrs.get("unit", ""), "unit"))) for name, data in datasets.items()]
            values = _values(datasets, complete=(COMPLETE, UNFINISHED) not in attributes.notes)
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


def own_member(group: Any, name: str, place: str) -> Any:
    """What stands under ``name`` in the file itself: a link could lead into any file of this computer, and so could numbers
    kept outside (external storage, virtual datasets). Raises InvalidInput."""
    import h5py

    found = group[name] if isinstance(group.get(name, getlink=True), h5py.HardLink) else None
    if found is None or (isinstance(found, h5py.Dataset) and (found.is_virtual or found.external)):
        raise invalid(place, "a link, or kept in another file", "in the file itself", "export it again, in one file")
    return found


def _plain(value: Any, key: str) -> Any:
    if isinstance(value, str):
        value = value.encode("utf-8", "surrogateescape")
    if isinstance(value, bytes):
        value = value.decode("utf-8", "replace")
    if not isinstance(value, str) and np.ndim(value) != 0:
        raise invalid(f"the attribute {key}", "an array", "a number or a text", "remove it")
    return value


def _dataset(group: Any, name: str, h5py: Any) -> Any:
    data = own_member(group, name, f"/signals/{name}")
    if not isinstance(data, h5py.Dataset) or data.ndim != 1 or data.dtype.kind not in "fiu":
        raise invalid(f"/signals/{name}", "something else", "a dataset of real numbers with one axis", "export it again")
    if data.size * len(group) > LARGEST:
        raise invalid("the number of values", data.size * len(group), f"at most {LARGEST}", "split the record")
    return data


def _values(datasets: dict[str, Any], *, complete: bool) -> np.ndarray:
    """All signals (p, k) in the units of the file; of an unfinished record the samples that all signals have."""
    lengths = {name: data.shape[0] for name, data in datasets.items()}
    if complete and len(set(lengths.values())) > 1:
        raise invalid("the numbers of samples", lengths, "the same for all signals", "export the record again")
    k = min(lengths.values())
    if complete:
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
