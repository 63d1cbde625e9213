"""Records as HDF5: attributes at the root, one dataset of float64 per signal under /signals."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, invalid
from ambrose.machine.atomic_write import Steady
from ambrose.machine.record.attributes import read_attributes, record_of
from ambrose.machine.record.record import LARGEST, Record

LIBVER = ("v110", "v110")  # the format of HDF5 1.10: checksums on the structure as well
CHUNK = 2048  # samples
_DAMAGE = (OSError, RuntimeError, KeyError, ValueError, TypeError, OverflowError, MemoryError)


def write_hdf5(record: Record, path: Path) -> None:
    """Texts of fixed length and checksums on data and structure: damage is always noticed. Raises OSError."""
    with created(path, record.attributes, zip(record.signals, record.units, strict=True), record.values.shape[1]) as datasets:
        for data, values in zip(datasets, record.values, strict=True):
            data[:] = values


@contextmanager
def created(path: Path, attributes: Mapping[str, Any], signals: Iterable[tuple[str, str]], samples: int) -> Iterator[list[Any]]:
    """A new file in the format of HDF5 1.10: a dataset for each (name, unit), to be filled in the block. Raises OSError."""
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


def read_hdf5(path: Path) -> Record:
    """The record. Raises InvalidInput."""
    import h5py

    try:
        with h5py.File(path, "r") as file:
            attributes = read_attributes({key: _plain(value, key) for key, value in file.attrs.items()})
            group = own_member(file, "signals", "/signals") if "signals" in file else None
            if not isinstance(group, h5py.Group) or not len(group):
                raise InvalidInput("the group /signals is missing or empty; a record keeps one dataset per signal there")
            datasets = {name: _dataset(group, name, h5py) for name in group}
            units = [(name, str(_plain(data.attrs.get("unit", ""), "unit"))) for name, data in datasets.items()]
            values = _values(datasets)
    except InvalidInput:
        raise
    except _DAMAGE as error:
        raise InvalidInput(f"it cannot be read as HDF5 ({error}); it is damaged, truncated or of another kind") from error
    if attributes.sample_rate_hz is None:
        raise InvalidInput("the attribute sample_rate_hz is missing; add the sampling frequency in Hz")
    return record_of(attributes, units, values, attributes.sample_rate_hz, attributes.start_time_s)


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


def _values(datasets: dict[str, Any]) -> np.ndarray:
    """All signals (p, k) in the units of the file."""
    lengths = {name: data.shape[0] for name, data in datasets.items()}
    if len(set(lengths.values())) > 1:
        raise invalid("the numbers of samples", lengths, "the same for all signals", "export the record again")
    values = np.empty((len(datasets), min(lengths.values())))
    for row, data in zip(values, datasets.values(), strict=True):
        row[:] = data[:]
    return values
