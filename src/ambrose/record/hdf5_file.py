"""Records as HDF5: attributes at the root, one dataset of float64 per signal under /signals."""

from __future__ import annotations

import errno
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, invalid
from ambrose.machine.atomic_write import Steady
from ambrose.machine.limits import (
    BESIDE,
    CHECKED_FIRST,
    CHUNK_BYTES,
    NOTES,
    NUMBERS,
    PACKED,
    SIGNALS,
    TEXT,
    UNPACKED,
)
from ambrose.machine.messages import quoted
from ambrose.record.attributes import RecordAttributes, read_attributes, record_of
from ambrose.record.record import Record, check_samples

LIBVER = ("v110", "v110")  # the format of HDF5 1.10: checksums on the structure as well
CHUNK = 2048  # samples
_CHECKED = b"\x89HDF\r\n\x1a\n\3"  # a file begins so that has these checksums
_BLOCK = 1_000_000  # samples read together while they are checked
_DAMAGE = (OSError, RuntimeError, KeyError, ValueError, TypeError, OverflowError, MemoryError)


def write_hdf5(record: Record, path: Path) -> None:
    """Texts of fixed length and checksums on data and structure: damage is always noticed. Raises
    OSError.
    """
    with created(
        path,
        record.attributes,
        zip(record.signals, record.units, strict=True),
        record.values.shape[1],
    ) as datasets:
        for data, values in zip(datasets, record.values, strict=True):
            data[:] = values


@contextmanager
def created(
    path: Path, attributes: Mapping[str, Any], signals: Iterable[tuple[str, str]], samples: int
) -> Iterator[list[Any]]:
    """A new file in the format of HDF5 1.10: a dataset for each (name, unit), to be filled in the
    block. Raises OSError.
    """
    import h5py

    cache = {"rdcc_nbytes": 1 << 18}  # HDF5 2 would keep 8 MB per signal
    with Steady(path) as stream, h5py.File(stream, "w", libver=LIBVER, **cache) as file:
        file.attrs.update({key: fixed(value) for key, value in attributes.items()})
        group, datasets = file.create_group("signals", track_order=True), []
        for name, unit in signals:
            layout = {"chunks": (min(samples, CHUNK),), "fletcher32": True}
            datasets.append(group.create_dataset(name, (samples,), "f8", **layout))
            datasets[-1].attrs["unit"] = fixed(unit)
        yield datasets


def fixed(value: Any) -> Any:
    """An attribute as it is stored: a text with fixed length, a number as it is."""
    import h5py

    text = value.encode() if isinstance(value, str) else b""
    return np.array(text, h5py.string_dtype("utf-8", len(text))) if text else value


def read_hdf5(path: Path, first: Callable[[], None] = lambda: None) -> Record:
    """The record. Raises InvalidInput.

    A structure without checksums, and texts of variable length in any file, may lead the library
    round in circles for ever; ``first`` is called before either is looked at, to try it in a
    process apart.
    """
    import h5py

    first = lru_cache(first)
    try:
        with path.open("rb") as raw:
            if raw.read(len(_CHECKED)) != _CHECKED:
                first()
        with opened(path) as file:
            group = (
                own_member(file, "signals", "/signals")
                if file.get("signals", getlink=True)
                else None
            )
            if "format" in file.attrs:
                _check_beside(group, path.stat().st_size, h5py)
            if len(file.attrs) > NOTES:
                raise invalid(
                    "the number of attributes", len(file.attrs), f"at most {NOTES}", "remove some"
                )
            attributes = read_attributes(
                {key: _attribute(file.attrs, key, first) for key in file.attrs}
            )
            if not isinstance(group, h5py.Group) or not len(group):
                raise InvalidInput(
                    "the group /signals is missing or empty, a record's datasets; a file of "
                    "another program needs --columns"
                )
            if len(group) > SIGNALS:
                raise invalid(
                    "the number of signals", len(group), f"at most {SIGNALS}", "split the record"
                )
            datasets = {name: _dataset(group, name, h5py) for name in group}
            units = [
                (name, str(_attribute(data.attrs, "unit", first)))
                for name, data in datasets.items()
            ]
            check_packing(list(datasets.values()), path)
            # refuses names and units, before all is read
            record_of(attributes, units, np.zeros((len(units), 1)), 1.0, 0.0)
            values = _values(datasets, attributes)
    except InvalidInput:
        raise
    except _DAMAGE as error:
        raise InvalidInput(
            f"it cannot be read as HDF5 ({error}); it is damaged, truncated or of another kind"
        ) from error
    if attributes.sample_rate_hz is None:
        raise InvalidInput(
            "the attribute sample_rate_hz is missing; add the sampling frequency in Hz"
        )
    return record_of(attributes, units, values, attributes.sample_rate_hz, attributes.start_time_s)


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """An HDF5 file for reading. Where its file system has no locks, without one. Raises
    InvalidInput where another program writes it, and OSError.
    """
    import h5py

    try:
        file = h5py.File(path, "r")
    except OSError as error:
        if error.errno in (errno.EAGAIN, errno.EACCES) and "lock" in str(error):
            raise InvalidInput(
                "another program has it open for writing; close it there, and try again"
            ) from error
        if error.errno not in (errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS):
            raise
        file = h5py.File(path, "r", locking=False)
    with file:
        yield file


def own_member(group: Any, name: str, place: str) -> Any:
    """What stands under ``name`` in the file itself: a link could lead into any file of this
    computer, and so could numbers kept outside (external storage, virtual datasets). Raises
    InvalidInput.
    """
    import h5py

    member = group[name] if isinstance(group.get(name, getlink=True), h5py.HardLink) else None
    if member is None or (
        isinstance(member, h5py.Dataset) and (member.is_virtual or member.external)
    ):
        raise invalid(
            place,
            "a link, or kept in another file",
            "in the file itself",
            "export it again, in one file",
        )
    return member


def _attribute(attributes: Any, key: str, first: Callable[[], None]) -> Any:
    """An attribute, after its size was looked at; "" where there is none. first: called before one
    of variable length.
    """
    if key not in attributes:
        return ""
    head = attributes.get_id(key)
    if head.shape != () or head.get_storage_size() > TEXT or head.dtype.kind in "V":
        what = "an array" if head.shape else "too long"
        raise invalid(
            f"the attribute {quoted(key)}",
            what,
            f"a number or a text of at most {TEXT} bytes",
            "remove it",
        )
    if head.dtype.kind == "O":
        first()
    value = attributes[key]
    if isinstance(value, str):
        value = value.encode("utf-8", "surrogateescape")
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else value


def _check_beside(group: Any, size: int, h5py: Any) -> None:
    """Refuse a file with much more than its signals: opening an attribute reads it, however long it
    is.
    """
    names = list(group) if isinstance(group, h5py.Group) and len(group) <= SIGNALS else []
    plain = [name for name in names if isinstance(group.get(name, getlink=True), h5py.HardLink)]
    stored = sum(
        data.id.get_storage_size()
        for name in plain
        if isinstance(data := group[name], h5py.Dataset)
    )
    if size - stored > BESIDE:
        raise invalid(
            "what the file holds beside its signals",
            f"{size - stored} bytes",
            f"at most {BESIDE}",
            "remove it",
        )


def check_packing(datasets: Sequence[Any], path: Path) -> None:
    """Refuse datasets that would unpack to much more than their file, as only zeros do. Raises
    InvalidInput.
    """
    size, unpacked = (
        path.stat().st_size,
        sum((data.size or 0) * max(data.dtype.itemsize, 8) for data in datasets),
    )
    if unpacked > max(UNPACKED, PACKED * size):
        raise invalid(
            "the file's content",
            f"{unpacked} bytes in {size}",
            f"at most {PACKED} times the file",
            "is it damaged?",
        )
    chunk = max(
        (math.prod(data.chunks or (0,)) * data.dtype.itemsize for data in datasets), default=0
    )
    if chunk > CHUNK_BYTES:
        raise invalid(
            "a chunk",
            f"{chunk} bytes",
            f"at most {CHUNK_BYTES}",
            "repack the file with smaller chunks (h5repack -l)",
        )


def _dataset(group: Any, name: str, h5py: Any) -> Any:
    data = own_member(group, name, f"/signals/{name}")
    if not isinstance(data, h5py.Dataset) or data.ndim != 1 or data.dtype.kind not in "fiu":
        raise invalid(
            f"/signals/{name}",
            "something else",
            "a dataset of real numbers with one axis",
            "export it again",
        )
    if data.size * len(group) > NUMBERS:
        raise invalid(
            "the number of values", data.size * len(group), f"at most {NUMBERS}", "split the record"
        )
    return data


def _values(datasets: dict[str, Any], attributes: RecordAttributes) -> np.ndarray:
    """All signals (p, k) in the units of the file."""
    lengths = {name: data.shape[0] for name, data in datasets.items()}
    if len(set(lengths.values())) > 1:
        raise invalid(
            "the numbers of samples", lengths, "the same for all signals", "export the record again"
        )
    k, rate = min(lengths.values()), attributes.sample_rate_hz or math.nan
    if k * len(datasets) > CHECKED_FIRST:
        for name, data in datasets.items():
            for first in range(0, k, _BLOCK):
                check_samples(
                    name, data[first : min(first + _BLOCK, k)], first, attributes.start_time_s, rate
                )
    return _read(datasets, k)


def _read(datasets: dict[str, Any], k: int) -> np.ndarray:
    values = np.empty((len(datasets), k))
    for row, data in zip(values, datasets.values(), strict=True):
        row[:] = data[:]
    return values
