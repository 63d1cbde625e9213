"""Measurements of other programs as Records, through a column map (record/foreign.py); files are
read, never changed.
"""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from ambrose.core.checks import InvalidInput, check_path, check_positive, invalid
from ambrose.machine.description import OperatingPoint
from ambrose.machine.file.toml import read_table, read_toml
from ambrose.machine.kinds import Name, Quantity, Text, Words
from ambrose.machine.ordinary_file import NUMBERS
from ambrose.machine.part import Part
from ambrose.machine.units import shown
from ambrose.record.apart import variables_of
from ambrose.record.record import Record, si_values, uniform_rate
from ambrose.record.text_uff import Variable

# The column map: which variable or channel of another program's file is which signal, in which unit
# and with which sign.
#
# machine = "seal-rig" sample_rate_hz = 10000          # or [time]; either may be left out where the
# file knows it
#
# [point] speed = "12000 rpm" seal_pressure = "2.04 bar"
#
# [time] source = "t" unit = "ms"
#
# [[signal]] name = "y_A_zeta" source = "Rig/probe 1" unit = "um"                     # of scale *
# source + offset scale = -127.0 offset = 20.0


@dataclass(frozen=True, slots=True, repr=False)
class Column(Part):
    """One signal: ``name`` = scale * ``source`` + offset, in ``unit`` ("": the unit that the file
    states).
    """

    name: Annotated[Name, "name of the signal"]
    source: Annotated[
        str, Text("the name of a variable or channel"), "variable or channel in the file"
    ]
    unit: Annotated[
        Words, "unit of scale * source + offset; default: the one that the file states"
    ] = ""
    scale: Annotated[float, Quantity("plain number"), "factor of the numbers in the file"] = 1.0
    offset: Annotated[float, Quantity("plain number"), "what is added to them"] = 0.0

    def __post_init__(self) -> None:
        if not self.name or not self.source:
            raise InvalidInput(
                f"a column is {self.name!r} from {self.source!r}, but both must be named; fill "
                "them in"
            )
        if not math.isfinite(self.offset) or not math.isfinite(self.scale) or self.scale == 0:
            values = f"{self.scale:g} and {self.offset:g}"
            raise invalid(
                f"scale and offset of {self.name}",
                values,
                "finite, the scale not zero",
                "correct them",
            )


@dataclass(frozen=True, slots=True, repr=False)
class ColumnMap(Part):
    """All that a file of another program does not say about a record.

    columns: at least one. point: where the machine ran. time: the column of times, or
    sample_rate_hz [Hz]; with both they are compared. notes: further (key, text) attributes. Raises
    InvalidInput.
    """

    machine: Annotated[Name, "name of the machine"]
    columns: Annotated[tuple[Column, ...], "the signals"] = field(metadata={"key": "signal"})
    point: Annotated[OperatingPoint, "where the machine ran"]
    time: Annotated[Column | None, "the column of times"] = None
    sample_rate_hz: Annotated[float | None, Quantity("plain number"), "sampling frequency [Hz]"] = (
        None
    )
    notes: tuple[tuple[str, str], ...] = ()

    def __post_init__(self) -> None:
        if not self.columns:
            raise InvalidInput(
                "the column map names no signal; add a [[signal]] with name, source and unit"
            )
        for name, times in Counter(column.name for column in self.columns).items():
            if times > 1:
                raise InvalidInput(
                    f"the signal {name} is named {times} times, but must be once; rename one"
                )
        measured = [column for column in self.columns if column.name[:2] in {"y_", "i_", "u_"}]
        for (kind, source), times in Counter(
            (column.name[:2], column.source) for column in measured
        ).items():
            if times > 1:
                alike = [
                    column.name
                    for column in measured
                    if (column.name[:2], column.source) == (kind, source)
                ]
                names = " and ".join(alike)
                raise InvalidInput(
                    f"{names} both come from {shown(source)}, but are measured apart; correct one "
                    "source"
                )
        if self.sample_rate_hz is not None:
            check_positive(
                self.sample_rate_hz, "sample_rate_hz", "give the sampling frequency in Hz"
            )


def load_columns(path: str | Path) -> ColumnMap:
    """The column map in a TOML file. Raises InvalidInput naming file, table and key."""
    return read_columns(read_toml(path, "column map"), f"column map {path}")


def read_columns(document: Mapping[str, Any], name: str = "column map") -> ColumnMap:
    """The column map in a parsed TOML document; ``name`` stands in messages. Raises InvalidInput
    naming table and key.
    """
    from ambrose.machine.file.tables import keys_of, make_table, optional

    notes = (dict[str, Words], optional("further attributes of the record"))
    model = make_table(
        "ColumnMap", ColumnMap.__doc__ or "", {**keys_of(ColumnMap), "notes": notes}, ColumnMap
    )
    time, point = document.get("time"), document.get("point")
    if isinstance(time, Mapping):
        document = {**document, "time": {"name": "time", **time}}
    table = read_table(model, document, name)
    missing = [
        key for key in ("speed", "seal_pressure") if isinstance(point, Mapping) and key not in point
    ]
    if missing:
        raise InvalidInput(
            f"{name}: [point]: {' and '.join(missing)} is missing; the operating point must be "
            "known, add it"
        )
    try:
        stated = table.given()
        return ColumnMap(**{**stated, "notes": tuple(stated.get("notes", {}).items())})
    except InvalidInput as error:
        raise InvalidInput(f"{name}: {error}") from error


def columns_in_words(machine: str, names: Iterable[str], said: Mapping[str, str]) -> dict[str, Any]:
    """The document of a column map from words as a form takes them; raises InvalidInput for what
    should be a number and is none.

    names: of the signals; said: "from.<name>", the variable, a factor may stand before it
    ("-127 * probe"); "unit.<name>"; "speed" and "pressure"; "rate" [Hz]; "time" and "time.unit".
    What is empty or absent is left out.
    """
    document: dict[str, Any] = {
        "machine": machine,
        "point": {"speed": said.get("speed", ""), "seal_pressure": said.get("pressure", "")},
        "signal": [_in_words(name, said) for name in names if said.get(f"from.{name}")],
    }
    if said.get("rate"):
        document["sample_rate_hz"] = _number(said["rate"])
    if said.get("time"):
        document["time"] = {"source": said["time"], "unit": said.get("time.unit", "s")}
    return document


def _in_words(name: str, said: Mapping[str, str]) -> dict[str, Any]:
    factor, star, source = said[f"from.{name}"].partition("*")
    known: dict[str, Any] = {"name": name, "source": (source if star else factor).strip()}
    if star:
        known["scale"] = _number(factor)
    if unit := said.get(f"unit.{name}", ""):
        known["unit"] = unit
    return known


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        told = f"{text[:40]!r} is no number; write it as 10000 or -1.5e-3"
        raise InvalidInput(told) from None


_AGREE = 1e-3  # sample rates this close are the same one
_SAME = 0.01  # of a sample: starts this close are the same, or whole samples apart


def read_foreign(path: str | Path, columns: ColumnMap | Mapping[str, Any] | str | Path) -> Record:
    """The record in a MATLAB .mat (v4 to v7.3) or NI TDMS (.tdms) file, a text table, or a
    universal file (dataset 58).

    columns: a ColumnMap, its document as a dict, or its TOML file. Values are scaled, then
    converted from the column's unit to SI. The sample rate comes from the map, the time column or
    the file, and all that are there must agree. Raises InvalidInput for an unknown variable, a
    missing or wrong unit, NaN, a gap in time, no or contradictory sample rates, signals of
    different length, a truncated file. Reading TDMS needs the extra "tdms".
    """
    path = check_path(path, "record")
    if not isinstance(columns, ColumnMap):
        columns = read_columns(columns) if isinstance(columns, Mapping) else load_columns(columns)
    try:
        return _record(path, columns)
    except InvalidInput as error:
        raise InvalidInput(f"{path}: {str(error).removeprefix(f'{path}: ')}") from error


def variables_in_words(path: str | Path) -> str:
    """What a file holds that may become signals, or why it cannot be read, in a sentence."""
    path = check_path(path, "record")
    try:
        # the refusal of a name that is in no file lists those that are
        with variables_of(path, ["?"]):
            return ""
    except InvalidInput as error:
        return str(error).removeprefix(f"{path}: ")


def _record(path: Path, columns: ColumnMap) -> Record:
    wanted = [*columns.columns, *([] if columns.time is None else [columns.time])]
    with variables_of(path, [column.source for column in wanted]) as in_file:
        time = None if columns.time is None else in_file[-1]
        variables = in_file[: len(columns.columns)]
        rate, start = _timing(columns, variables, time)
        variables, begin, shifted = _on_one_time(columns, variables, rate)
        start = begin if start is None else start
        _check_lengths(columns, variables, time)
        for column, variable in zip(columns.columns, variables, strict=True):
            _check_finite(column, variable, lambda sample: f" (t = {start + sample / rate:g} s)")
        values = np.empty((len(variables), len(variables[0].values)))
        units = []
        for row, column, variable in zip(values, columns.columns, variables, strict=True):
            row[:], unit = _converted(column, variable)
            units.append(unit)
    values.flags.writeable = False
    names = tuple(column.name for column in columns.columns)
    notes = tuple({"shifted": shifted, **dict(columns.notes)}.items()) if shifted else columns.notes
    return Record(columns.machine, rate, names, tuple(units), values, columns.point, start, notes)


def _on_one_time(
    columns: ColumnMap, variables: list[Variable], rate: float
) -> tuple[list[Variable], float, str]:
    """The samples that all channels have, the time of the first [s], and a note where channels were
    cut: their files say when each begins. Raises InvalidInput where that is not whole samples
    apart.
    """
    known = [
        (variable.start, column.source)
        for column, variable in zip(columns.columns, variables, strict=True)
        if variable.start is not None
    ]
    if not known:
        return variables, 0.0, ""
    for begun, source in known:
        if not np.isfinite(begun):
            remedy = "correct it in the file, or export the channels as a text table"
            raise invalid(f"the start of the channel {source}", f"{begun} s", "finite", remedy)
    (first, early), (last, late) = min(known), max(known)
    if (last - first) * rate <= _SAME:
        return variables, last, ""
    shifts = [(last - (last if v.start is None else v.start)) * rate for v in variables]
    whole = [round(shift) for shift in shifts]
    count = min(len(v.values) - cut for v, cut in zip(variables, whole, strict=True))
    apart = max(abs(shift - cut) for shift, cut in zip(shifts, whole, strict=True)) > _SAME
    if apart or count < 1 or columns.time is not None or len(known) < len(variables):
        raise invalid(
            "the start of the channels",
            f"{first:.9g} s ({early}) and {last:.9g} s ({late})",
            "the same, or whole samples apart in channels that share samples and need no [time]",
            "resample them onto one time, or read each as a separate record",
        )
    moved = []
    for variable, cut in zip(variables, whole, strict=True):
        values = variable.values[cut : cut + count]
        finite = np.isfinite(values) if variable.bad is not None else np.ones(1, dtype=bool)
        bad = None if finite.all() else int(np.argmin(finite))
        moved.append(replace(variable, values=values, bad=bad))
    return (
        moved,
        last,
        f"{early} begins {max(whole)} samples before {late}: cut to their common time",
    )


def _check_lengths(columns: ColumnMap, variables: list[Variable], time: Variable | None) -> None:
    lengths = {
        column.source: len(variable.values)
        for column, variable in zip(columns.columns, variables, strict=True)
    }
    if columns.time is not None and time is not None:
        lengths[columns.time.source] = len(time.values)
    if len(set(lengths.values())) > 1:
        raise invalid(
            "the numbers of samples",
            lengths,
            "the same for all signals",
            "leave out those sampled otherwise, or resample them",
        )
    k = next(iter(lengths.values()))
    if k == 0 or k * len(variables) > NUMBERS:
        raise invalid(
            "the number of samples",
            k,
            f"at least 1, and at most {NUMBERS} values in all",
            "choose other variables",
        )


def _check_finite(column: Column, variable: Variable, moment: Callable[[int], str]) -> None:
    if np.iscomplexobj(variable.values):
        raise InvalidInput(
            f"{column.source} is a frequency response, not a time signal; name it in a [[path]] "
            f"of a column map of responses"
        )
    if (sample := variable.bad) is not None:
        at = f"{column.source} at sample {sample}{moment(sample)}"
        raise invalid(
            at, variable.values[sample], "finite", "cut the file before it, or measure again"
        )


def _converted(column: Column, variable: Variable) -> tuple[np.ndarray, str]:
    """Scaled values (k,) in SI and that unit."""
    unit = column.unit or variable.unit
    if not unit:
        raise InvalidInput(
            f"the signal {column.name} has no unit, neither in the file nor in the column map; "
            "add unit = ... to its [[signal]]"
        )
    with np.errstate(over="ignore", invalid="ignore"):  # refused by the record, with its sample
        scaled = column.scale * variable.values.astype(float) + column.offset
        return si_values(column.name, unit, scaled)


def _timing(
    columns: ColumnMap, variables: list[Variable], time: Variable | None
) -> tuple[float, float | None]:
    """Sample rate [Hz], every source that states it must agree, and the first time of the column of
    times [s].
    """
    stated: list[tuple[str, float]] = []
    start = None
    if columns.sample_rate_hz is not None:
        stated.append(("the column map", columns.sample_rate_hz))
    if columns.time is not None and time is not None:
        _check_finite(columns.time, time, lambda sample: "")
        seconds = _converted(columns.time, time)[0]
        try:
            stated.append((f"the time column {columns.time.source}", uniform_rate(seconds, None)))
        except InvalidInput as error:
            raise InvalidInput(f"the time column {columns.time.source}: {error}") from error
        start = float(seconds[0])
    for column, variable in zip(columns.columns, variables, strict=True):
        if variable.rate is not None:
            stated.append((f"the channel {column.source}", variable.rate))
    if not stated:
        raise InvalidInput(
            "the sample rate is not known; add sample_rate_hz or a [time] column to the column map"
        )
    (first, rate), *others = stated
    for source, other in others:
        if not abs(other - rate) <= _AGREE * rate:
            remedy = "correct the wrong one, or leave out the signals sampled otherwise"
            raise invalid(
                f"the sample rate of {source}",
                f"{other:.9g} Hz",
                f"that of {first}, {rate:.9g} Hz",
                remedy,
            )
    return rate, start
