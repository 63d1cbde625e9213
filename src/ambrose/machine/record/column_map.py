"""The column map: which variable or channel of another program's file is which signal, in which unit and with which sign.

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
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from ambrose.core.checks import InvalidInput, check_positive, invalid
from ambrose.machine.description import OperatingPoint
from ambrose.machine.messages import shown, suggestion
from ambrose.machine.units import DIMENSIONS, read_quantity

_POINT = {"speed": "angular rate", "seal_pressure": "pressure", "bias_current": "current", "whirl_frequency": "angular rate"}
_NUMBERS = ("scale", "offset", "sample_rate_hz")


@dataclass(frozen=True, slots=True)
class Column:
    """One signal: ``name`` = scale * ``source`` + offset, in ``unit`` ("": the unit that the file states)."""

    name: str
    source: str
    unit: str = ""
    scale: float = 1.0
    offset: float = 0.0

    def __post_init__(self) -> None:
        if not self.name or not self.source:
            raise InvalidInput(f"a column is {self.name!r} from {self.source!r}, but both must be named; fill them in")
        if not math.isfinite(self.offset) or not math.isfinite(self.scale) or self.scale == 0:
            values = f"{self.scale:g} and {self.offset:g}"
            raise invalid(f"scale and offset of {self.name}", values, "finite, the scale not zero", "correct them")


@dataclass(frozen=True, slots=True)
class ColumnMap:
    """All that a file of another program does not say about a record.

    columns: at least one. point: where the machine ran. time: the column of times, or sample_rate_hz [Hz]; with both they are
    compared. notes: further (key, text) attributes. Raises InvalidInput.
    """

    machine: str
    columns: tuple[Column, ...]
    point: OperatingPoint
    time: Column | None = None
    sample_rate_hz: float | None = None
    notes: tuple[tuple[str, str], ...] = field(default=())

    def __post_init__(self) -> None:
        if not self.columns:
            raise InvalidInput("the column map names no signal; add a [[signal]] with name, source and unit")
        names = [column.name for column in self.columns]
        for name in names:
            if names.count(name) > 1:
                raise InvalidInput(f"the signal {name} is named {names.count(name)} times, but must be once; rename one")
        if self.sample_rate_hz is not None:
            check_positive(self.sample_rate_hz, "sample_rate_hz", "give the sampling frequency in Hz")


def load_columns(path: str | Path) -> ColumnMap:
    """The column map in a TOML file. Raises InvalidInput naming file, table and key."""
    path = Path(path)
    try:
        return read_columns(tomllib.loads(path.read_text(encoding="utf-8")))
    except OSError as error:
        raise InvalidInput(f"the column map {path} cannot be read: {error.strerror or error}; check its name") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, InvalidInput) as error:
        raise InvalidInput(f"column map {path}: {error}") from error


def read_columns(document: Mapping[str, Any]) -> ColumnMap:
    """The column map in a parsed TOML document. Raises InvalidInput naming table and key."""
    _known(document, ("machine", "sample_rate_hz", "point", "time", "signal", "notes"), "")
    _needed(document, ("machine", "point", "signal"), "")
    signals = document["signal"]
    if not isinstance(signals, Sequence) or isinstance(signals, str):
        raise InvalidInput("signal is not a list of tables; write [[signal]]")
    columns = tuple(_column(table, f"[[signal]] number {i + 1}: ") for i, table in enumerate(signals))
    time = _column({"name": "time", **_table(document["time"], "[time]")}, "[time]: ") if "time" in document else None
    rate = _number(document, "sample_rate_hz", "") if "sample_rate_hz" in document else None
    notes = _table(document.get("notes", {}), "[notes]")
    texts = tuple((key, _text(notes, key, "[notes]: ")) for key in notes)
    return ColumnMap(_text(document, "machine", ""), columns, _point(document["point"]), time, rate, texts)


def _point(value: Any) -> OperatingPoint:
    table = _table(value, "[point]")
    _known(table, (*_POINT, "label"), "[point]: ")
    _needed(table, ("speed", "seal_pressure"), "[point]: ")
    numbers = {}
    for key, dimension in _POINT.items():
        if key in table:
            try:
                numbers[key] = read_quantity(table[key], DIMENSIONS[dimension])
            except ValueError as error:
                raise InvalidInput(f"[point]: {key} {error}") from error
    return OperatingPoint(**numbers, label=_text(table, "label", "[point]: ") if "label" in table else "")


def _column(value: Any, where: str) -> Column:
    table = _table(value, where.removesuffix(": "))
    known = [item.name for item in fields(Column)]
    _known(table, known, where)
    _needed(table, ("name", "source"), where)
    given: dict[str, Any] = {
        key: _number(table, key, where) if key in _NUMBERS else _text(table, key, where) for key in known if key in table
    }
    try:
        return Column(**given)
    except InvalidInput as error:
        raise InvalidInput(f"{where}{error}") from error


def _table(value: Any, where: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise InvalidInput(f"{where} is {shown(value)}, but must be a table of keys and values; write one")
    return value


def _known(table: Mapping[str, Any], known: Sequence[str], where: str) -> None:
    for key in table:
        if key not in known:
            raise InvalidInput(f"{where}unknown key {key!r}; {suggestion(str(key), known)}")


def _needed(table: Mapping[str, Any], keys: Sequence[str], where: str) -> None:
    missing = [key for key in keys if key not in table]
    if missing:
        raise InvalidInput(f"{where}{' and '.join(missing)} is missing; add it")


def _number(table: Mapping[str, Any], key: str, where: str) -> float:
    value = table[key]
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise InvalidInput(f"{where}{key} is {shown(value)}, but must be a number; write it without quotes and unit")
    return float(value)


def _text(table: Mapping[str, Any], key: str, where: str) -> str:
    value = table[key]
    if not isinstance(value, str):
        raise InvalidInput(f"{where}{key} is {shown(value)}, but must be a text; write it in quotes")
    return value
