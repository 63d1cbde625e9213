"""Record: measured or simulated signals with names, units, sample rate and operating point, SI
inside. Its files: files.py.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ambrose.core.checks import (
    InvalidInput,
    check_finite,
    check_positive,
    invalid,
    names_wrong_types,
)
from ambrose.core.presentation import Presented, data_frame, html_table
from ambrose.machine.description import OperatingPoint
from ambrose.machine.ordinary_file import (
    LARGEST_SAMPLE,
    LARGEST_TIME,
    LONGEST_SAMPLE,
    NAME,
    NOTES,
    SAMPLE_TIME,
    SIGNALS,
    TEXT,
)
from ambrose.machine.units import DIMENSIONS, Dimension, in_si, quoted

# The sample rate of a column of times, and what is wrong with the times.


# largest deviation of one time step from the others, as a fraction: beyond it, a sample was
# mistimed
_JITTER = 0.05


def uniform_rate(time: np.ndarray, stated: float | None) -> float:
    """The sample rate [Hz] of uniformly increasing times (k,) [s]; raises InvalidInput at a gap or
    a mistimed sample.
    """
    if len(time) < 2:
        raise invalid("the number of samples", len(time), "at least 2", "one row has no time step")
    if not np.isfinite(time).all():
        raise invalid(
            "a time",
            "not finite",
            "a number",
            f"look at data row {int(np.argmin(np.isfinite(time))) + 1}",
        )
    with np.errstate(over="ignore"):
        step = np.diff(time)
        usual = float(np.median(step))
        bad = np.flatnonzero(~(np.abs(step - usual) <= _JITTER * abs(usual)))
    if usual <= 0 or len(bad):
        i = int(bad[0]) if len(bad) else 0
        what = f"{step[i]:g} s after t = {time[i]:.9g} s"
        missing = round(step[i] / usual) - 1 if usual > 0 and abs(step[i]) < 1e15 * usual else 0
        remedy = (
            f"{missing} samples are missing there"
            if missing > 0
            else "resample the signals uniformly"
        )
        raise invalid("a time step", what, f"positive and uniform (here {usual:g} s)", remedy)
    rate = (len(time) - 1) / float(time[-1] - time[0])
    if stated is None:
        return float(f"{rate:.12g}")
    if abs(stated - rate) > 1e-3 * rate:
        raise invalid(
            "sample_rate_hz",
            stated,
            f"that of the time column, {rate:.9g} Hz",
            "correct one of them",
        )
    return stated


FORMAT, VERSION = "ambrose-record", 1
_PREFIXES = {
    **dict.fromkeys(("y", "d", "r", "q"), "length"),
    **dict.fromkeys(("u", "e", "i"), "current"),
    "f": "force",
    "qdot": "velocity",
    "p": "pressure",
    "speed": "angular rate",
    "time": "time",
}
POINT_KEYS = {
    "speed_rad_s": "speed",
    "seal_pressure_pa": "seal_pressure",
    "bias_current_a": "bias_current",
    "whirl_frequency_rad_s": "whirl_frequency",
    "point": "label",
}
RESERVED = {
    "format",
    "version",
    "machine",
    "sample_rate_hz",
    "start_time_s",
    "samples",
    *POINT_KEYS,
}
_BLOCK = 1_000_000  # samples looked at together
_SIGNAL, _KEY = re.compile(r"[A-Za-z][A-Za-z0-9_-]*"), re.compile(r"[a-z][a-z0-9_]*")


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Record(Presented):
    """Signals sampled together at one operating point.

    machine: the machine's name. sample_rate_hz [Hz]. signals: p names such as "y_A_zeta"; units:
    their SI units; values (p, k), kept read-only. start_time [s] of the first sample. notes:
    further (key, text) attributes of the file. Raises InvalidInput for NaN, repeated names, a unit
    that is not SI or does not fit the name's prefix (y_, d_, r_, q_ [m], qdot_ [m/s], u_, e_, i_
    [A], f_ [N], p_ [Pa], speed_ [rad/s]).
    """

    machine: str
    sample_rate_hz: float
    signals: tuple[str, ...]
    units: tuple[str, ...]
    values: np.ndarray
    point: OperatingPoint = field(default_factory=OperatingPoint)
    start_time: float = 0.0
    notes: tuple[tuple[str, str], ...] = ()

    @names_wrong_types
    def __post_init__(self) -> None:
        check_rate(self.sample_rate_hz)
        check_operating_point(self.point)
        if abs(check_finite(self.start_time, "start_time")) > LARGEST_TIME:
            raise invalid(
                "start_time",
                f"{self.start_time:g}",
                f"at most {LARGEST_TIME:g} s",
                "correct its unit",
            )
        _check_texts(self)
        p = len(self.signals)
        if np.asarray(self.values).dtype.kind not in "iufb":
            raise invalid(
                "values",
                f"of type {np.asarray(self.values).dtype}",
                "real numbers",
                "give one row per signal",
            )
        values = self.values if _is_settled(self.values) else np.array(self.values, dtype=float)
        if values.ndim != 2 or values.shape[0] != p or values.shape[1] == 0:
            raise invalid(
                "the shape of values",
                values.shape,
                f"({p}, k) with k > 0",
                "give one row per signal",
            )
        for name, row in zip(self.signals, values, strict=True):
            check_samples(name, row, 0, self.start_time, self.sample_rate_hz)
        values.flags.writeable = False
        object.__setattr__(self, "values", values)
        # files do not keep their order
        object.__setattr__(self, "notes", tuple(sorted(self.notes)))

    @property
    def dt(self) -> float:
        """Sample time [s]."""
        return 1.0 / self.sample_rate_hz

    @property
    def time(self) -> np.ndarray:
        """Times of the samples (k,) [s]."""
        return self.start_time + np.arange(self.values.shape[1]) / self.sample_rate_hz

    @property
    def attributes(self) -> dict[str, Any]:
        """What a file says beside the signals, by the keys of record/hdf5_file.py."""
        point = {key: getattr(self.point, name) for key, name in POINT_KEYS.items()}
        return {
            "format": FORMAT,
            "version": VERSION,
            "machine": self.machine,
            "sample_rate_hz": self.sample_rate_hz,
            "start_time_s": self.start_time,
            **{key: value for key, value in point.items() if value not in {None, ""}},
            **dict(self.notes),
        }

    def facts(self) -> Mapping[str, Any]:
        samples = self.values.shape[1]
        duration, rate = f"{samples * self.dt:.6g} s", f"{self.sample_rate_hz:.6g} Hz"
        return {
            "machine": self.machine,
            "duration": duration,
            "rate": rate,
            "point": self.point,
            "signals": list(self.signals),
        }

    def _repr_html_(self) -> str:
        facts = [(name, str(value)) for name, value in self.facts().items() if name != "signals"]
        rows = [
            (name, unit, f"{row.min():.4g}", f"{row.mean():.4g}", f"{row.max():.4g}")
            for name, unit, row in zip(self.signals, self.units, self.values, strict=True)
        ]
        return html_table(facts, "Record") + html_table(
            rows, "Signals", ("signal", "unit", "lowest", "mean", "highest")
        )

    def to_dict(self) -> dict[str, Any]:
        """The attributes and, under "signals", each signal's unit and values, as plain data."""
        signals = {
            name: {"unit": unit, "values": row.tolist()}
            for name, unit, row in zip(self.signals, self.units, self.values, strict=True)
        }
        return {**self.attributes, "signals": signals}

    def to_frame(self) -> Any:
        """A pandas DataFrame over "time [s]", one column per signal, "y_A_zeta [m]". Raises
        InvalidInput without pandas.
        """
        named = zip(self.signals, self.units, self.values, strict=True)
        return data_frame(
            {"time [s]": self.time, **{f"{name} [{unit}]": row for name, unit, row in named}},
            "time [s]",
        )

    def __getitem__(self, name: str) -> np.ndarray:
        """The samples (k,) of one signal; raises InvalidInput listing the known ones."""
        # only now: linear algebra takes as long to load as a record to read
        from ambrose.core.statespace import index_of

        return self.values[index_of(name, self.signals, "signal")[0]]

    def select(self, names: str | Sequence[str]) -> Record:
        """The record with these signals only, in the order given."""
        from ambrose.core.statespace import index_of

        i = index_of(names, self.signals, "signal")
        values = self.values[i]
        values.flags.writeable = False  # or it would be copied once more
        return replace(
            self,
            signals=tuple(self.signals[j] for j in i),
            units=tuple(self.units[j] for j in i),
            values=values,
        )

    def between(self, start: float, stop: float) -> Record:
        """The samples with start <= t < stop [s]; raises InvalidInput where there are none."""
        time = self.time
        if not start < stop:
            raise invalid(
                "the time window",
                f"[{start:g}, {stop:g}) s",
                "from an earlier to a later time",
                "give the beginning first",
            )
        kept = np.flatnonzero((time >= start - 1e-6 * self.dt) & (time < stop - 1e-6 * self.dt))
        if not len(kept):
            raise invalid(
                "the time window",
                f"[{start:g}, {stop:g}) s",
                f"within {time[0]:g} to {time[-1]:g} s",
                "move it",
            )
        return replace(
            self, values=self.values[:, kept[0] : kept[-1] + 1], start_time=float(time[kept[0]])
        )


def _is_settled(values: Any) -> bool:
    """Whether these values are floats that nobody can write to: a long record is not copied
    again.
    """
    return (
        type(values) is np.ndarray
        and values.dtype == float
        and values.base is None
        and not values.flags.writeable
    )


def check_samples(name: str, values: np.ndarray, first: int, start: float, rate: float) -> None:
    """Refuse samples (n,) of a signal, from number ``first`` on, that are not finite, or that are
    larger than any signal. Raises InvalidInput.
    """
    for begin in range(0, len(values), _BLOCK):  # a long record has no second array of its length
        usable = np.abs(values[begin : begin + _BLOCK]) <= LARGEST_SAMPLE  # NaN is not
        if not usable.all():
            j = begin + int(np.argmin(usable))
            at = f"{name} at sample {first + j} (t = {start + (first + j) / rate:g} s)"
            if np.isfinite(values[j]):
                allowed, remedy = f"at most {LARGEST_SAMPLE:g} in its SI unit", "correct its unit"
            else:
                allowed, remedy = "finite", "cut the record before it"
            raise invalid(at, values[j], allowed, f"{remedy}, or measure again")


def _check_texts(record: Record) -> None:
    for what, count, most in (
        ("signals", len(record.signals), SIGNALS),
        ("notes", len(record.notes), NOTES),
    ):
        if count > most:
            raise invalid(f"the number of {what}", count, f"at most {most}", "split the record")
    keys, names = Counter(key for key, _ in record.notes), Counter(record.signals)
    if len(record.units) != len(record.signals):
        raise invalid(
            "the number of units",
            len(record.units),
            str(len(record.signals)),
            "give one per signal",
        )
    if not record.signals:
        raise invalid("the number of signals", 0, "at least 1", "a record needs a signal")
    for name, unit in zip(record.signals, record.units, strict=True):
        if not _SIGNAL.fullmatch(name) or name == "time" or names[name] > 1 or len(name) > NAME:
            wanted = "unique, other than time, of letters, digits, _ and -"
            raise invalid(f"the signal name {quoted(name)}", "not usable", wanted, "rename it")
        si = _dimension(name, unit).unit
        if unit != si:
            raise invalid(
                f"the unit of {name}",
                quoted(unit),
                f"the SI unit {si!r}",
                "convert with si_values() first",
            )
    for key, text in (("machine", record.machine), ("point", record.point.label), *record.notes):
        if (
            not isinstance(text, str)
            or "\n" in text
            or "\r" in text
            or text != text.strip()
            or len(text) > TEXT
        ):
            raise invalid(
                key[:NAME],
                quoted(text),
                "one line of text without outer spaces",
                "shorten or strip it",
            )
    for key, _ in record.notes:
        if not _KEY.fullmatch(key) or key in RESERVED or keys[key] > 1 or len(key) > NAME:
            raise invalid(
                f"the note {quoted(key)}",
                "not usable",
                "a unique lower_case word that the format leaves free",
                "rename it",
            )


def signal_dimension(name: str) -> Dimension:
    """What a signal measures, by the prefix of its name ("y_A_zeta": length, in "m"). Raises
    InvalidInput if unknown.
    """
    prefix = name.partition("_")[0]
    if prefix not in _PREFIXES:
        raise invalid(
            f"the prefix of signal {quoted(name)}",
            quoted(prefix),
            f"one of {', '.join(_PREFIXES)}",
            "rename the signal",
        )
    return DIMENSIONS[_PREFIXES[prefix]]


_BIAS = "leave it out for the bearings' own"
_SPIN = "spin is positive from x to y: correct its sign, or swap the axes"


def check_operating_point(point: OperatingPoint) -> None:
    """Raises InvalidInput for a number at which no record or response is measured: one that is not
    finite, a negative speed or whirl frequency, a bias current that is not positive.
    """
    for key, name in POINT_KEYS.items():
        value = getattr(point, name)
        if name == "seal_pressure":  # an idle gauge shows a little less than nothing
            check_finite(value, key)
        elif value is not None and name != "label":
            is_bias = name == "bias_current"
            check_positive(value, key, _BIAS if is_bias else _SPIN, zero_allowed=not is_bias)


def check_rate(rate: float) -> None:
    """Raises InvalidInput for a sample rate [Hz] that no record has."""
    check_positive(rate, "sample_rate_hz", "give the sampling frequency in Hz")
    if not 1 / LONGEST_SAMPLE <= rate <= 1 / SAMPLE_TIME:
        allowed = f"{1 / LONGEST_SAMPLE:g} to {1 / SAMPLE_TIME:g} Hz"
        raise invalid("sample_rate_hz", f"{rate:g}", allowed, "correct its unit or its exponent")


def si_values(name: str, unit: str, values: np.ndarray) -> tuple[np.ndarray, str]:
    """``values`` of the signal ``name`` given in ``unit``, in SI, with that SI unit. Raises
    InvalidInput for a wrong unit.
    """
    dimension = _dimension(name, unit)
    return in_si(values, unit, dimension), dimension.unit


def _dimension(name: str, unit: str) -> Dimension:
    """The dimension of a signal: by its prefix where that is known, else by its unit."""
    if not unit or not unit.strip():
        raise InvalidInput(
            f"signal {name} has no unit; name it, such as {name} [m], or [-] for a ratio"
        )
    prefix = name.partition("_")[0]
    candidates = (
        [DIMENSIONS[_PREFIXES[prefix]]] if prefix in _PREFIXES else list(DIMENSIONS.values())
    )
    for dimension in candidates:
        if unit == dimension.unit:
            return dimension
    for dimension in candidates:
        with suppress(ValueError):
            in_si(1.0, unit, dimension)
            return dimension
    if prefix in _PREFIXES:
        what = candidates[0]
        raise invalid(
            f"the unit of {name}",
            quoted(unit),
            f"a unit of {what.name} such as {what.unit}",
            "correct the unit",
        )
    raise invalid(
        f"the unit of {name}",
        quoted(unit),
        "a known unit",
        "convert the signal to an SI unit and write that",
    )
