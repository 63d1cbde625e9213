"""The column map: which variable or channel of another program's file is which signal, in which
unit and with which sign.

machine = "seal-rig"
sample_rate_hz = 10000          # or [time]; either may be left out where the file knows it

[point]
speed = "12000 rpm"
seal_pressure = "2.04 bar"

[time]
source = "t"
unit = "ms"

[[signal]]
name = "y_A_zeta"
source = "Rig/probe 1"
unit = "um"                     # of scale * source + offset
scale = -127.0
offset = 20.0
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from ambrose.core.checks import InvalidInput, check_positive, invalid
from ambrose.machine.description import OperatingPoint
from ambrose.machine.kinds import Name, Quantity, Text, Words
from ambrose.machine.messages import shown
from ambrose.machine.part import Part


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
    from ambrose.machine.file.toml import read_toml

    return read_columns(read_toml(path, "column map"), f"column map {path}")


def read_columns(document: Mapping[str, Any], name: str = "column map") -> ColumnMap:
    """The column map in a parsed TOML document; ``name`` stands in messages. Raises InvalidInput
    naming table and key.
    """
    from ambrose.machine.file.parse import read_table
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
