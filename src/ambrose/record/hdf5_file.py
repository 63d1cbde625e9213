"""Records as HDF5: attributes at the root, one dataset of float64 per signal under /signals."""

import errno
import math
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    PlainValidator,
    ValidationError,
    ValidationInfo,
    WithJsonSchema,
)

from ambrose.core.checks import InvalidInput, invalid
from ambrose.machine.description import OperatingPoint
from ambrose.machine.file.tables import DIALECT, tidy_schema, write_schema
from ambrose.machine.ordinary_file import (
    BESIDE,
    CHECKED_FIRST,
    CHUNK_BYTES,
    NOTES,
    NUMBERS,
    PACKED,
    SIGNALS,
    TEXT,
    UNPACKED,
    Steady,
)
from ambrose.machine.units import quoted
from ambrose.record.record import FORMAT, POINT_KEYS, VERSION, Record, check_samples, si_values

# The attributes of a record's file, the same in every format, as a pydantic model with a published
# schema.


def _format(value: object) -> str:
    if value != FORMAT:
        remedy = (
            f"a record names its format and version {VERSION}; another program's becomes one by "
            "ambrose convert FILE --columns MAP -o record.h5 (the map: docs/reference/records.md)"
        )
        raise invalid("the format", quoted(value), repr(FORMAT), remedy)
    return FORMAT


def _version(value: object) -> int:
    if str(value) != str(VERSION):
        raise invalid(
            "the version", quoted(value), str(VERSION), "update ambrose or convert the file"
        )
    return VERSION


def _number(value: Any, info: ValidationInfo) -> float:
    """An attribute as a finite number; CSV has it as a text."""
    value = value.item() if isinstance(value, np.generic) else value
    try:  # True is no number, and a complex one would lose a part
        number = float(value) if np.asarray(value).dtype.kind in "iufU" else math.nan
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        name = str(info.field_name)
        raise invalid(
            POINT_KEYS.get(name, name), quoted(value), "a finite number", "correct the attribute"
        )
    return number


_Number = Annotated[float, PlainValidator(_number), WithJsonSchema({"type": "number"})]
_Optional = Annotated[float | None, PlainValidator(_number), WithJsonSchema({"type": "number"})]
_Text = Annotated[str, PlainValidator(str), WithJsonSchema({"type": "string"})]


class RecordAttributes(BaseModel):
    """The attributes of a record: in HDF5 those of the root, in CSV the lines "# key: value" before
    the header.

    Any further attribute is a note: a key in lower case with a text.
    """

    model_config = ConfigDict(extra="allow", frozen=True, defer_build=True)
    format: Annotated[str, PlainValidator(_format), WithJsonSchema({"const": FORMAT})] = Field(
        description="that of a record"
    )
    version: Annotated[int, PlainValidator(_version), WithJsonSchema({"const": VERSION})] = Field(
        description="version of the format"
    )
    machine: _Text = Field(description="name of the machine")
    speed_rad_s: _Number = Field(description="spin speed [rad/s]")
    seal_pressure_pa: _Number = Field(description="differential pressure of every seal [Pa]")
    bias_current_a: _Optional = Field(
        default=None, description="bias current [A]; default: that of each bearing"
    )
    whirl_frequency_rad_s: _Optional = Field(
        default=None,
        description="frequency [rad/s] at which frequency-dependent seals are read; default: the "
        "speed",
    )
    point: _Text = Field(default="", description="label of the operating point")
    sample_rate_hz: _Optional = Field(
        default=None, description="sampling frequency [Hz]; CSV may leave it to the time column"
    )
    start_time_s: _Number = Field(
        default=0.0, description="time of the first sample [s]; CSV has it in the time column"
    )
    samples: _Optional = Field(
        default=None, description="number of rows of a CSV file, so that a truncated one is noticed"
    )

    @property
    def operating_point(self) -> OperatingPoint:
        return OperatingPoint(**{name: getattr(self, key) for key, name in POINT_KEYS.items()})

    @property
    def notes(self) -> tuple[tuple[str, str], ...]:
        return tuple((key, str(value)) for key, value in (self.model_extra or {}).items())


def read_attributes(attributes: Mapping[str, Any]) -> RecordAttributes:
    """The attributes of a file, checked; refuses what is no record, of another version, or without
    its operating point.

    Raises InvalidInput.
    """
    try:
        return RecordAttributes.model_validate({"format": None, "version": None, **attributes})
    except ValidationError as error:
        problems = error.errors()
    missing = [str(problem["loc"][0]) for problem in problems if problem["type"] == "missing"]
    for problem in problems:
        if problem["type"] == "value_error" and (
            problem["loc"][0] in {"format", "version"} or not missing
        ):
            raise problem["ctx"]["error"]
    raise InvalidInput(
        f"the attribute {' and '.join(missing)} is missing; the operating point must be known, "
        "add it"
    )


def record_schema() -> dict[str, Any]:
    """JSON schema (draft 2020-12) of a record's attributes: every key with its meaning and form."""
    title = f"attributes of an ambrose record, version {VERSION}"
    schema = {"title": title, **tidy_schema(RecordAttributes.model_json_schema())}
    return {
        "$schema": DIALECT,
        **schema,
        "additionalProperties": {"type": "string", "description": "a note"},
    }


def record_of(
    attributes: RecordAttributes,
    signals: Sequence[tuple[str, str]],
    values: np.ndarray,
    rate: float,
    start: float,
) -> Record:
    """A Record from file attributes, (name, unit) pairs and values (p, k) in these units.

    ``values`` becomes the record's own: it is converted to SI in place and kept without a copy.
    """
    units = []
    for i, (name, unit) in enumerate(signals):
        values[i], si = si_values(name, unit, values[i])
        units.append(si)
    values.flags.writeable = False
    names = tuple(name for name, _ in signals)
    return Record(
        attributes.machine,
        rate,
        names,
        tuple(units),
        values,
        attributes.operating_point,
        start,
        attributes.notes,
    )


if __name__ == "__main__":  # python -m ambrose.record.hdf5_file docs/record.schema.json
    write_schema(record_schema(), sys.argv[1])


LIBVER = ("v110", "v110")  # the format of HDF5 1.10: checksums on the structure as well
CHUNK = 2048  # samples
_CHECKED = b"\x89HDF\r\n\x1a\n\3"  # a file begins so that has these checksums
_BLOCK = 1_000_000  # samples read together while they are checked
# what the library raises where a file is damaged
DAMAGE = (OSError, RuntimeError, KeyError, ValueError, TypeError, OverflowError, MemoryError)


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
        if not is_checked(path):
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
    except DAMAGE as error:
        raise InvalidInput(
            f"it cannot be read as HDF5 ({error}); it is damaged, truncated or of another kind"
        ) from error
    if attributes.sample_rate_hz is None:
        raise InvalidInput(
            "the attribute sample_rate_hz is missing; add the sampling frequency in Hz"
        )
    return record_of(attributes, units, values, attributes.sample_rate_hz, attributes.start_time_s)


def is_checked(path: Path) -> bool:
    """Whether the structure of an HDF5 file has checksums. One without may lead the library round
    in circles for ever. Raises OSError.
    """
    with path.open("rb") as raw:
        return raw.read(len(_CHECKED)) == _CHECKED


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
            "the size of the file's attributes",
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
