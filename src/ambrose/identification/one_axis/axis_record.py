"""What of a record belongs to one axis: its displacement, what drove it, and what drove the loop.

A file of this package is read by the names of its signals, a text table by its header or the places
of its columns ("column 2").
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, check_path, invalid
from ambrose.machine.ordinary_file import check_source
from ambrose.machine.units import DIMENSIONS, in_si
from ambrose.record.files import read_record
from ambrose.record.record import Record, check_rate, check_samples, uniform_rate
from ambrose.record.text_uff import text_table

LEAST = 500  # samples
_LEAST_SPAN = 1e-18  # of a signal, in its SI unit: no sensor resolves a part of it; assumed
_TABLES = {".txt", ".dat", ".asc", ".csv"}
# what a column may be called, in lower case, without its unit
_KNOWN = {
    "time": ("t", "time", "t_s", "seconds"),
    "displacement": ("y", "displacement", "position"),
    "drive": ("u", "drive", "command", "input"),
    "reference": ("r", "e", "excitation", "reference", "yd", "setpoint"),
    "current": ("i", "current"),
    "voltage": (),
}
_PREFIXES: dict[str, tuple[str, ...]] = {
    "displacement": ("y_",),
    "drive": ("u_",),
    "reference": ("e_", "r_"),
    "current": ("i_",),
}
_WITH_UNIT = re.compile(r"(.*?)\s*\[([^\[\]]+)\]")
_NEEDED = ("displacement", "drive")


@dataclass(frozen=True, slots=True, eq=False)
class AxisRecord:
    """name of the file. rate [Hz]. position (n,) [m]; drive (n,) in ``unit``: what the plant is
    driven by, as commanded or measured; reference (n,): what drives the loop from outside; current
    (n,) [A] and voltage (n,) [V] of the coil, None: not recorded. start [s]. columns: (what, name
    in the file).
    """

    name: str
    rate: float
    position: np.ndarray
    drive: np.ndarray
    unit: str
    reference: np.ndarray | None = None
    current: np.ndarray | None = None
    voltage: np.ndarray | None = None
    start: float = 0.0
    columns: tuple[tuple[str, str], ...] = ()

    @property
    def time(self) -> np.ndarray:
        """(n,) [s]"""
        return self.start + np.arange(len(self.position)) / self.rate

    def between(self, start: float, stop: float) -> AxisRecord:
        """The samples with start <= t < stop [s]. Raises InvalidInput where there are too few."""
        time = self.time
        kept = (time >= start) & (time < stop)
        if kept.sum() < LEAST:
            raise invalid(
                "the part from start to stop",
                f"{kept.sum()} samples",
                f"at least {LEAST} of the {len(time)} from {time[0]:g} to {time[-1]:g} s",
                "choose a longer one",
            )
        cut: dict[str, Any] = {
            name: None if (row := getattr(self, name)) is None else row[kept]
            for name in ("position", "drive", "reference", "current", "voltage")
        }
        return replace(self, start=float(time[kept][0]), **cut)


def read_axis(
    source: Any,
    *,
    columns: dict[str, str] | None = None,
    sample_rate_hz: float | None = None,
) -> AxisRecord:
    """The axis of a Record or of a file.

    columns: what is not found by its name, {"displacement", "drive", "reference", "current",
    "voltage", "time": name or "column 2"}, in a text table "column 2 [mm]" where its header says no
    unit; "none" leaves out what would be found. sample_rate_hz [Hz]: of a
    text table without times. A text table's displacement is in m where its header names no unit.
    Raises InvalidInput for what is missing, not finite, too short or unevenly sampled.
    """
    wanted = dict(columns or {})
    for word in wanted:
        if word not in _KNOWN:
            raise invalid("a column", repr(word), f"one of {', '.join(_KNOWN)}", "correct it")
    if isinstance(source, Record):
        return _of_record(source, wanted, source.machine)
    path = check_path(source, "record")
    check_source(path, "record")
    try:
        if is_text_table(path):
            return _of_table(path, wanted, sample_rate_hz)
        return _of_record(read_record(path), wanted, path.name)
    except InvalidInput as error:
        raise InvalidInput(f"{path}: {str(error).removeprefix(f'{path}: ')}") from error


def is_text_table(path: Path) -> bool:
    """Whether it is a text table that does not say that it is a record of this package. Raises
    InvalidInput for a file that cannot be read.
    """
    check_source(path, "record")
    if path.suffix.lower() not in _TABLES:
        return False
    with path.open("rb") as file:
        return path.suffix.lower() != ".csv" or b"ambrose-record" not in file.read(400)


def _of_record(record: Record, wanted: dict[str, str], name: str) -> AxisRecord:
    chosen = {what: given for what, given in wanted.items() if given and given != "none"}
    chosen.pop("time", None)
    alone = sum(signal.startswith("y_") for signal in record.signals) == 1
    for what, prefixes in _PREFIXES.items():
        if what in wanted:
            continue
        matches = [signal for signal in record.signals if signal.startswith(prefixes)]
        # of several the axis's own, as its displacement names it
        axis = chosen.get("displacement", "").partition("_")[2]
        own = [signal for signal in matches if axis and signal.partition("_")[2] == axis]
        if own:
            chosen[what] = own[0]
        elif len(matches) == 1 and alone:
            chosen[what] = matches[0]
        elif matches and what in _NEEDED:
            raise InvalidInput(
                f"it has {len(matches)} signals that may be the {what} ({', '.join(matches)}); "
                f"name the axis's own, {what} {matches[0]}"
            )
    _check_needed(chosen, list(record.signals))
    rows = {what: record[signal] for what, signal in chosen.items()}
    unit = record.units[record.signals.index(chosen["drive"])]
    return _checked(
        name, record.sample_rate_hz, rows, unit, record.start_time, tuple(chosen.items())
    )


def _of_table(path: Path, wanted: dict[str, str], rate: float | None) -> AxisRecord:
    rows: dict[str, np.ndarray] = {}
    chosen: dict[str, str] = {}
    unit = ""
    with text_table(path) as find:
        for what, names in _KNOWN.items():
            match = _WITH_UNIT.fullmatch(wanted.get(what, ""))
            given, stated = (match[1], match[2]) if match else (wanted.get(what, ""), "")
            if given == "none":
                continue
            found = find(given) if given else _guess(find, names)
            if found is None:
                continue
            chosen[what] = given or next(name for name in _spelled(names) if _has(find, name))
            known = stated or found.unit
            rows[what] = _in_si(what, found.values.astype(float), known)
            unit = known if what == "drive" else unit
    _check_needed(chosen, [])
    start = 0.0
    if "time" in rows:
        time = rows.pop("time")
        rate = uniform_rate(time, rate)
        start = float(time[0])
    elif rate is None:
        raise InvalidInput(
            "no column of times is found in it; name it, such as time column 1, or give the "
            "sample rate"
        )
    return _checked(path.name, rate, rows, unit, start, tuple(chosen.items()))


def _spelled(names: tuple[str, ...]) -> tuple[str, ...]:
    return (*names, *(name.capitalize() for name in names), *(name.upper() for name in names))


def _has(find: Callable[[str], Any], name: str) -> bool:
    try:
        find(name)
    except InvalidInput:
        return False
    return True


def _guess(find: Callable[[str], Any], names: tuple[str, ...]) -> Any:
    return next((find(name) for name in _spelled(names) if _has(find, name)), None)


def _in_si(what: str, values: np.ndarray, unit: str) -> np.ndarray:
    kinds = {"time": "time", "displacement": "length", "current": "current"}
    if not unit or what not in kinds:
        return values
    try:
        return in_si(values, unit, DIMENSIONS[kinds[what]])
    except ValueError as error:
        raise InvalidInput(f"the unit of the {what} {error}") from error


def _check_needed(chosen: dict[str, str], known: list[str]) -> None:
    if "drive" not in chosen and "current" in chosen:
        chosen["drive"] = chosen["current"]
    missing = [what for what in _NEEDED if what not in chosen]
    if missing:
        has = f" among {', '.join(known[:12])}" if known else " by its header"
        raise InvalidInput(
            f"no {' and no '.join(missing)} is found{has}; name the column, such as "
            f"{missing[0]} 'column 2'; several axes of a machine become a record by ambrose "
            "convert --columns"
        )


def _checked(
    name: str,
    rate: float,
    rows: dict[str, np.ndarray],
    unit: str,
    start: float,
    columns: tuple[tuple[str, str], ...],
) -> AxisRecord:
    check_rate(rate)
    if "drive" not in rows:
        rows["drive"] = rows["current"]
        unit = unit or "A"
    for what, values in rows.items():
        check_samples(f"the {what}", values, 0, start, rate)
        span = float(np.ptp(values))
        if 0 < span < _LEAST_SPAN:
            raise invalid(
                f"the span of the {what}",
                f"{span:.3g}",
                f"0 or at least {_LEAST_SPAN:g}",
                "correct its unit, or leave its column out",
            )
    count = len(rows["displacement"])
    if count < LEAST:
        raise invalid("the record", f"{count} samples", f"at least {LEAST}", "record for longer")
    return AxisRecord(
        name,
        float(rate),
        rows["displacement"],
        rows["drive"],
        unit or "-",
        rows.get("reference"),
        rows.get("current"),
        rows.get("voltage", rows["drive"] if unit == "V" else None),
        start,
        columns,
    )
