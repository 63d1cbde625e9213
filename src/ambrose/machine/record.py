"""Record: measured or simulated signals with names, units, sample rate and operating point; its HDF5 and CSV files.

SI inside and in every file written; any unit of the right kind is understood when reading. Files are written under a temporary
name and renamed, so that a reader never meets half a file. A reader refuses what it does not know and never alters its source.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, check_finite, check_positive, invalid
from ambrose.core.statespace import index_of
from ambrose.machine.description import OperatingPoint
from ambrose.machine.units import DIMENSIONS, Dimension, read_quantity
from ambrose.machine.writing import draft_of

FORMAT, VERSION = "ambrose-record", 1
_PREFIXES = {
    **dict.fromkeys(("y", "d", "r", "q"), "length"), **dict.fromkeys(("u", "e", "i"), "current"),
    "f": "force", "qdot": "velocity", "p": "pressure", "speed": "angular rate", "time": "time",
}  # fmt: skip
_POINT = {
    "speed_rad_s": "speed",
    "seal_pressure_pa": "seal_pressure",
    "bias_current_a": "bias_current",
    "whirl_frequency_rad_s": "whirl_frequency",
    "point": "label",
}
_REQUIRED = ("machine", "speed_rad_s", "seal_pressure_pa")
_RESERVED = {"format", "version", "machine", "sample_rate_hz", "start_time_s", "samples", *_POINT}
_SIGNAL, _KEY = re.compile(r"[A-Za-z][A-Za-z0-9_]*"), re.compile(r"[a-z][a-z0-9_]*")
_HEADER = re.compile(r"\s*([^\[\]]*?)\s*(?:\[([^\[\]]*)\]\s*)?")
_JITTER = 0.05  # largest deviation of one time step from the others, as a fraction: beyond it, a sample was mistimed
_LARGEST = 500_000_000  # numbers in one file: 4 GB


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """Signals sampled together at one operating point.

    machine: the machine's name. sample_rate_hz [Hz]. signals: p names such as "y_A_zeta"; units: their SI units; values
    (p, k), kept read-only. start_time [s] of the first sample. notes: further (key, text) attributes of the file.
    Raises InvalidInput for NaN, repeated names, a unit that is not SI or does not fit the name's prefix (y_, d_, r_, q_ [m],
    qdot_ [m/s], u_, e_, i_ [A], f_ [N], p_ [Pa], speed_ [rad/s]).
    """

    machine: str
    sample_rate_hz: float
    signals: tuple[str, ...]
    units: tuple[str, ...]
    values: np.ndarray
    point: OperatingPoint = field(default_factory=OperatingPoint)
    start_time: float = 0.0
    notes: tuple[tuple[str, str], ...] = ()

    def __post_init__(self) -> None:
        check_positive(self.sample_rate_hz, "sample_rate_hz", "give the sampling frequency in Hz")
        check_finite(self.start_time, "start_time")
        _check_texts(self)
        p = len(self.signals)
        values = np.array(self.values, dtype=float)
        if values.ndim != 2 or values.shape[0] != p or values.shape[1] == 0:
            raise invalid("the shape of values", values.shape, f"({p}, k) with k > 0", "give one row per signal")
        bad = np.argwhere(~np.isfinite(values))
        if len(bad):
            i, j = (int(index) for index in bad[0])
            at = f"sample {j} (t = {self.start_time + j / self.sample_rate_hz:g} s)"
            raise invalid(f"{self.signals[i]} at {at}", values[i, j], "finite", "cut the record before it, or measure again")
        values.flags.writeable = False
        object.__setattr__(self, "values", values)
        object.__setattr__(self, "notes", tuple(sorted(self.notes)))  # files do not keep their order

    @property
    def dt(self) -> float:
        """Sample time [s]."""
        return 1.0 / self.sample_rate_hz

    @property
    def time(self) -> np.ndarray:
        """Times of the samples (k,) [s]."""
        return self.start_time + np.arange(self.values.shape[1]) / self.sample_rate_hz

    def __getitem__(self, name: str) -> np.ndarray:
        """The samples (k,) of one signal; raises InvalidInput listing the known ones."""
        return self.values[index_of(name, self.signals, "signal")[0]]

    def select(self, names: str | Sequence[str]) -> Record:
        """The record with these signals only, in the order given."""
        i = index_of(names, self.signals, "signal")
        return replace(
            self, signals=tuple(self.signals[j] for j in i), units=tuple(self.units[j] for j in i), values=self.values[i]
        )

    def between(self, start: float, stop: float) -> Record:
        """The samples with start <= t < stop [s]; raises InvalidInput where there are none."""
        time = self.time
        kept = np.flatnonzero((time >= start - 1e-6 * self.dt) & (time < stop - 1e-6 * self.dt))
        if not len(kept):
            raise invalid("the time window", f"[{start:g}, {stop:g}) s", f"within {time[0]:g} to {time[-1]:g} s", "move it")
        return replace(self, values=self.values[:, kept[0] : kept[-1] + 1], start_time=float(time[kept[0]]))


def _check_texts(record: Record) -> None:
    if len(record.units) != len(record.signals):
        raise invalid("the number of units", len(record.units), str(len(record.signals)), "give one per signal")
    if not record.signals:
        raise invalid("the number of signals", 0, "at least 1", "a record needs a signal")
    for name, unit in zip(record.signals, record.units, strict=True):
        if not _SIGNAL.fullmatch(name) or name == "time" or record.signals.count(name) > 1:
            raise invalid(f"the signal name {name!r}", "not usable", "a unique identifier other than time", "rename it")
        si = _dimension(name, unit).unit
        if unit != si:
            raise invalid(f"the unit of {name}", repr(unit), f"the SI unit {si!r}", "convert with si_values() first")
    for key, text in (("machine", record.machine), ("point", record.point.label), *record.notes):
        if not isinstance(text, str) or "\n" in text or "\r" in text or text != text.strip():
            raise invalid(f"{key}", repr(text), "one line of text without outer spaces", "shorten or strip it")
    for key, _ in record.notes:
        if not _KEY.fullmatch(key) or key in _RESERVED or [k for k, _ in record.notes].count(key) > 1:
            raise invalid(
                f"the note {key!r}", "not usable", "a unique lower_case word that the format leaves free", "rename it"
            )


def signal_dimension(name: str) -> Dimension:
    """What a signal measures, by the prefix of its name ("y_A_zeta": length, in "m"). Raises InvalidInput if unknown."""
    prefix = name.partition("_")[0]
    if prefix not in _PREFIXES:
        raise invalid(f"the prefix of signal {name!r}", repr(prefix), f"one of {', '.join(_PREFIXES)}", "rename the signal")
    return DIMENSIONS[_PREFIXES[prefix]]


def si_values(name: str, unit: str, values: np.ndarray) -> tuple[np.ndarray, str]:
    """``values`` of the signal ``name`` given in ``unit``, in SI, with that SI unit. Raises InvalidInput for a wrong unit."""
    dimension = _dimension(name, unit)
    return (values, unit) if unit == dimension.unit else (values * read_quantity(f"1 {unit}", dimension), dimension.unit)


def _dimension(name: str, unit: str) -> Dimension:
    """The dimension of a signal: by its prefix where that is known, else by its unit."""
    if not unit or not unit.strip():
        raise InvalidInput(f"signal {name} has no unit; name it, such as {name} [m], or [-] for a ratio")
    prefix = name.partition("_")[0]
    candidates = [DIMENSIONS[_PREFIXES[prefix]]] if prefix in _PREFIXES else list(DIMENSIONS.values())
    complaint = ""
    for dimension in candidates:
        if unit == dimension.unit:
            return dimension
    for dimension in candidates:
        try:
            read_quantity(f"1 {unit}", dimension)
        except ValueError as error:
            complaint = complaint or str(error)
        else:
            return dimension
    if prefix in _PREFIXES:
        what = candidates[0]
        raise invalid(f"the unit of {name}", repr(unit), f"a unit of {what.name} such as {what.unit}", "correct the unit")
    raise invalid(f"the unit of {name}", repr(unit), "a known unit", "convert the signal to an SI unit and write that")


def read_record(path: str | Path) -> Record:
    """The record in an HDF5 (.h5, .hdf5) or CSV (.csv) file. Raises InvalidInput with the file's name and what is wrong."""
    path = Path(path)
    reader = _by_suffix(path, {".h5": _read_hdf5, ".hdf5": _read_hdf5, ".csv": _read_csv})
    if not path.is_file():
        raise InvalidInput(f"{path} is not a file; check the name")
    try:
        return reader(path)
    except (InvalidInput, OSError) as error:
        raise InvalidInput(f"{path}: {error}") from error


def write_record(record: Record, path: str | Path) -> Path:
    """Write the record as HDF5 (.h5, .hdf5) or CSV (.csv), atomically; returns the path. Raises InvalidInput."""
    path = Path(path)
    writer = _by_suffix(path, {".h5": _write_hdf5, ".hdf5": _write_hdf5, ".csv": _write_csv})
    with draft_of(path, "record") as draft:
        writer(record, draft)
    return path


def _by_suffix(path: Path, choices: Mapping[str, Callable[..., Any]]) -> Callable[..., Any]:
    if path.suffix.lower() not in choices:
        raise invalid(f"the suffix of {path.name}", repr(path.suffix), f"one of {', '.join(choices)}", "rename the file")
    return choices[path.suffix.lower()]


def _attributes(record: Record) -> dict[str, Any]:
    """All attributes of a record's file except those of its signals."""
    point = {key: getattr(record.point, name) for key, name in _POINT.items()}
    return {
        "format": FORMAT, "version": VERSION, "machine": record.machine, "sample_rate_hz": record.sample_rate_hz,
        "start_time_s": record.start_time, **{key: value for key, value in point.items() if value not in {None, ""}},
        **dict(record.notes),
    }  # fmt: skip


def _check_format(attributes: Mapping[str, Any]) -> None:
    if attributes.get("format") != FORMAT:
        raise invalid(
            "the format", repr(attributes.get("format")), repr(FORMAT), f"a record names its format and version {VERSION}"
        )
    if str(attributes.get("version")) != str(VERSION):
        raise invalid("the version", repr(attributes.get("version")), str(VERSION), "update ambrose or convert the file")
    missing = [key for key in _REQUIRED if key not in attributes]
    if missing:
        raise InvalidInput(f"the attribute {' and '.join(missing)} is missing; the operating point must be known, add it")


def _record(attributes: Mapping[str, Any], signals: Sequence[tuple[str, str, np.ndarray]], rate: float, start: float) -> Record:
    """A Record from file attributes (checked by _check_format) and (name, unit, values) in any units."""
    point = {name: attributes[key] for key, name in _POINT.items() if key in attributes}
    numbers = {name: _number(value, name) for name, value in point.items() if name != "label"}
    converted = [si_values(name, unit, values) for name, unit, values in signals]
    return Record(
        str(attributes["machine"]), rate, tuple(name for name, _, _ in signals), tuple(unit for _, unit in converted),
        np.stack([values for values, _ in converted]), OperatingPoint(**numbers, label=str(point.get("label", ""))), start,
        tuple((key, str(value)) for key, value in attributes.items() if key not in _RESERVED),
    )  # fmt: skip


def _number(value: Any, name: str) -> float:
    try:
        return float(check_finite(float(value), name))
    except (TypeError, ValueError) as error:
        raise invalid(name, repr(value), "a finite number", "correct the attribute") from error


def _write_hdf5(record: Record, path: Path) -> None:
    """In the format of HDF5 1.10 with checksums on data and structure, and texts of fixed length: damage is always noticed."""
    import h5py

    def fixed(value: Any) -> Any:
        text = value.encode() if isinstance(value, str) else b""
        return np.array(text, h5py.string_dtype("utf-8", len(text))) if text else value

    with h5py.File(path, "w", libver=("v110", "v110")) as file:
        file.attrs.update({key: fixed(value) for key, value in _attributes(record).items()})
        group = file.create_group("signals", track_order=True)
        for name, unit, values in zip(record.signals, record.units, record.values, strict=True):
            group.create_dataset(name, data=values, dtype="f8", chunks=True, fletcher32=True).attrs["unit"] = fixed(unit)


def _read_hdf5(path: Path) -> Record:
    import h5py

    try:
        with h5py.File(path, "r") as file:
            attributes = {key: _plain(value, key) for key, value in file.attrs.items()}
            _check_format(attributes)
            group = file.get("signals")
            if not isinstance(group, h5py.Group) or not len(group):
                raise InvalidInput("the group /signals is missing or empty; a record keeps one dataset per signal there")
            signals = [_hdf5_signal(group, name, h5py) for name in group]
    except InvalidInput:
        raise
    except (OSError, RuntimeError, KeyError, ValueError, TypeError, OverflowError, MemoryError) as error:
        raise InvalidInput(f"it cannot be read as HDF5 ({error}); it is damaged, truncated or of another kind") from error
    lengths = {name: len(values) for name, _, values in signals}
    if len(set(lengths.values())) > 1:
        raise invalid("the numbers of samples", lengths, "the same for all signals", "export the record again")
    if "sample_rate_hz" not in attributes:
        raise InvalidInput("the attribute sample_rate_hz is missing; add the sampling frequency in Hz")
    start = _number(attributes.get("start_time_s", 0.0), "start_time_s")
    return _record(attributes, signals, _number(attributes["sample_rate_hz"], "sample_rate_hz"), start)


def _plain(value: Any, key: str) -> Any:
    if isinstance(value, bytes):
        value = value.decode("utf-8", "replace")
    if not isinstance(value, str) and np.ndim(value) != 0:
        raise invalid(f"the attribute {key}", "an array", "a number or a text", "remove it")
    return value


def _hdf5_signal(group: Any, name: str, h5py: Any) -> tuple[str, str, np.ndarray]:
    data = group[name] if isinstance(group.get(name, getlink=True), h5py.HardLink) else None
    if not isinstance(data, h5py.Dataset) or data.ndim != 1 or data.dtype.kind not in "fiu" or data.is_virtual:
        raise invalid(f"/signals/{name}", "something else", "a dataset of real numbers with one axis", "export it again")
    if data.size * len(group) > _LARGEST:
        raise invalid("the number of values", data.size * len(group), f"at most {_LARGEST}", "split the record")
    return name, str(_plain(data.attrs.get("unit", ""), "unit")), data[:].astype(float)


def _write_csv(record: Record, path: Path) -> None:
    attributes = {**_attributes(record), "samples": record.values.shape[1]}
    header = ["time [s]", *(f"{name} [{unit}]" for name, unit in zip(record.signals, record.units, strict=True))]
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.writelines(f"# {key}: {value}\n" for key, value in attributes.items())
        file.write(",".join(header) + "\n")
        np.savetxt(file, np.column_stack([record.time, record.values.T]), fmt="%.17g", delimiter=",")


def _read_csv(path: Path) -> Record:
    import warnings

    try:
        with path.open(encoding="utf-8-sig") as file:
            attributes: dict[str, str] = {}
            line = file.readline()
            while line.startswith("#"):
                key, colon, value = line[1:].partition(":")
                if colon:
                    attributes[key.strip()] = value.strip()
                line = file.readline()
            _check_format(attributes)
            columns = _csv_columns(line)
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                table = np.loadtxt(file, delimiter=",", comments=None, ndmin=2)
    except InvalidInput:
        raise
    except (ValueError, UserWarning) as error:
        raise InvalidInput(f"the rows below the header cannot be read ({error}); give a number in every cell") from error
    if table.shape[1] != len(columns):
        raise invalid("the number of columns", table.shape[1], f"{len(columns)} as in the header", "export it again")
    _check_complete(path, attributes, len(table))
    time = si_values("time", columns[0][1], table[:, 0])[0]
    rate = _uniform_rate(time, attributes.get("sample_rate_hz"))
    signals = [(name, unit, table[:, j]) for j, (name, unit) in enumerate(columns) if j > 0]
    return _record(attributes, signals, rate, float(time[0]))


def _csv_columns(line: str) -> list[tuple[str, str]]:
    if ";" in line or "\t" in line:
        raise invalid("the separator of the columns", "a semicolon or tab", "a comma", "export with comma and decimal point")
    columns = []
    for cell in line.rstrip("\r\n").split(","):
        match = _HEADER.fullmatch(cell)
        if match is None or not match[1] or match[2] is None:
            raise invalid("the header cell", repr(cell.strip()), "a name with its unit, such as y_A_zeta [m]", "add the unit")
        columns.append((match[1], match[2]))
    if columns[0][0] != "time" or len(columns) < 2:
        raise invalid("the first column", repr(columns[0][0]), "time [s], followed by signals", "put the time first")
    return columns


def _check_complete(path: Path, attributes: Mapping[str, str], rows: int) -> None:
    """Refuse a file that states its number of samples and does not hold them all, to the end of the last line."""
    if "samples" not in attributes:
        return
    with path.open("rb") as file:
        file.seek(-1, os.SEEK_END)
        ended = file.read(1) == b"\n"
    if str(rows) != attributes["samples"] or not ended:
        raise invalid(
            "the number of whole rows", rows - (not ended), attributes["samples"], "the file is truncated: copy it again"
        )


def _uniform_rate(time: np.ndarray, stated: str | None) -> float:
    """The sample rate [Hz] of uniformly increasing times (k,) [s]; raises InvalidInput at a gap or a mistimed sample."""
    if len(time) < 2:
        raise invalid("the number of samples", len(time), "at least 2", "the time step cannot be told from one row")
    if not np.isfinite(time).all():
        raise invalid("a time", "not finite", "a number", f"look at data row {int(np.argmin(np.isfinite(time))) + 1}")
    step = np.diff(time)
    usual = float(np.median(step))
    bad = np.flatnonzero(np.abs(step - usual) > _JITTER * abs(usual))
    if usual <= 0 or len(bad):
        i = int(bad[0]) if len(bad) else 0
        what = f"{step[i]:g} s after t = {time[i]:.9g} s"
        missing = round(step[i] / usual) - 1 if usual > 0 else 0
        remedy = f"{missing} samples are missing there" if missing > 0 else "resample the signals uniformly"
        raise invalid("a time step", what, f"positive and uniform (here {usual:g} s)", remedy)
    rate = (len(time) - 1) / float(time[-1] - time[0])
    if stated is None:
        return float(f"{rate:.12g}")
    given = _number(stated, "sample_rate_hz")
    if abs(given - rate) > 1e-3 * rate:
        raise invalid("sample_rate_hz", given, f"that of the time column, {rate:.9g} Hz", "correct one of them")
    return given
