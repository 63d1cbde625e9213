"""Another code's results, or measured ones, as a table: CSV with a row of names first.

    kind;     speed [rpm]; amplitude [um p-p]; amplification [-]; log_decrement [-]; whirl;   probe
    critical; 5230;        34.1;               6.2;               ;                  ;        VE1
    mode;     5411;        ;                   ;                  0.34;              forward;
    response; 9000;        12.0;               ;                  ;                  ;        VE1

``critical``: a peak of the unbalance response; ``mode``: a damped natural frequency; ``response``:
an amplitude at a speed. Columns stand in any order; but for kind and speed they may be missing.
"""

from __future__ import annotations

import csv
import math
import re
from dataclasses import dataclass

from ambrose.core.checks import InvalidInput
from ambrose.machine.messages import quoted, suggestion
from ambrose.machine.units import DIMENSIONS, Dimension, read_quantity

KINDS = ("critical", "mode", "response")
WHIRLS = ("forward", "backward", "planar")
_EXAMPLE = "kind; speed [rpm]; amplitude [um p-p]; log_decrement [-]"
_COLUMNS = {  # name -> (an example of its unit, other names)
    "kind": ("", ()),
    "speed": ("rpm", ("frequency", "rpm")),
    "amplitude": ("um p-p", ("response",)),
    "amplification": ("-", ("af", "amplification_factor")),
    "log_decrement": ("-", ("logdec", "log decrement", "log dec")),
    "damping_ratio": ("-", ("damping ratio", "zeta")),
    "whirl": ("", ("direction",)),
    "probe": ("", ("reading",)),
    "case": ("", ("placement",)),
    "label": ("", ("name",)),
}
_WORDS = ("kind", "whirl", "probe", "case", "label")
# what speeds and amplitudes are written in, beside the units of a machine file
_MORE = {"speed": {"cpm": "rpm", "1/min": "rpm"}, "amplitude": {"mil": "1e-3 in", "µm": "um"}}
_PEAKS = {"p-p": 1.0, "pp": 1.0, "pk-pk": 1.0, "0-p": 2.0, "0-pk": 2.0}
_MIL = 25.4e-6  # [m]


@dataclass(frozen=True, slots=True)
class TheirRow:
    """One row: speed [rad/s], amplitude peak to peak [m]; None or "" where it says nothing."""

    kind: str
    speed: float
    amplitude: float | None = None
    amplification: float | None = None
    log_decrement: float | None = None
    whirl: str = ""
    probe: str = ""
    case: str = ""
    label: str = ""


def read_table(text: str, name: str) -> tuple[TheirRow, ...]:
    """The rows of a CSV text; ``name`` stands in messages. Raises InvalidInput."""
    lines = [line for line in text.splitlines() if line.strip() and line.lstrip()[0] != "#"]
    if len(lines) < 2:
        raise InvalidInput(f"{name}: it needs a row of names ({_EXAMPLE}) and a row per result")
    mark = max(";\t,", key=lines[0].count)
    header, *rows = csv.reader(lines, delimiter=mark)
    columns = [_column(name, cell) for cell in header]
    names = [column for column, _, _ in columns]
    if twice := next((column for column in names if names.count(column) > 1), None):
        raise InvalidInput(f'{name}: the column "{twice}" stands there twice; leave one out')
    for column in ("kind", "speed"):
        if column not in names:
            raise InvalidInput(
                f'{name}: the column "{column}" is missing; its first row names the columns, such '
                f"as {_EXAMPLE}"
            )
    return tuple(
        _row(f"{name}, row {number}", columns, row, mark) for number, row in enumerate(rows, 2)
    )


def _column(name: str, cell: str) -> tuple[str, float, str]:
    """A column's name, its factor to SI, and its unit as it stands."""
    match = re.fullmatch(r"\s*([^\[(]*?)\s*(?:[\[(](.*)[\])])?\s*", cell)
    word = "" if match is None else match[1].lower()
    unit = "" if match is None or match[2] is None else match[2].strip()
    column = next((key for key, (_, more) in _COLUMNS.items() if word == key or word in more), "")
    if not column:
        raise InvalidInput(
            f"{name}: the column {quoted(cell.strip())} is unknown; {suggestion(word, _COLUMNS)}"
        )
    if column in _WORDS:
        return column, 1.0, ""
    if word == "rpm" and not unit:
        unit = "rpm"
    where = f"{name}, column {column}"
    if column == "speed":
        return column, _factor(where, _MORE["speed"].get(unit, unit), "angular rate", "rpm"), unit
    if column == "amplitude":
        return column, _amplitude(where, unit), unit
    if unit not in ("", "-", "%"):
        raise InvalidInput(f'{where}: its unit is "{unit}", but must be "-" or "%"; correct it')
    return column, 0.01 if unit == "%" else 1.0, unit


def _amplitude(where: str, unit: str) -> float:
    """The factor from an amplitude's unit to metres peak to peak: 0-p counts twice."""
    length, _, peak = unit.rpartition(" ")
    if peak not in _PEAKS:
        raise InvalidInput(
            f'{where}: its unit is "{unit}", but must say whether it is peak to peak or zero to '
            'peak; write "amplitude [um p-p]" or "amplitude [um 0-p]"'
        )
    if length in ("mil", "mils"):
        return _MIL * _PEAKS[peak]
    return _factor(where, _MORE["amplitude"].get(length, length), "length", "um p-p") * _PEAKS[peak]


def _factor(where: str, unit: str, dimension: str, example: str) -> float:
    kind: Dimension = DIMENSIONS[dimension]
    if not unit:
        raise InvalidInput(
            f'{where}: it has no unit; name it in the first row, such as "[{example}]"'
        )
    try:
        return read_quantity(f"1 {unit}", kind)
    except ValueError:
        known = ", ".join(kind.units)
        raise InvalidInput(
            f'{where}: the unit "{unit}" is no {kind.name}; write one of {known}'
        ) from None


def _row(where: str, columns: list[tuple[str, float, str]], row: list[str], mark: str) -> TheirRow:
    if len(row) > len(columns):
        raise InvalidInput(
            f"{where}: it has {len(row)} cells, but {len(columns)} columns are named; check the "
            "separator"
        )
    words: dict[str, str] = {}
    values: dict[str, float] = {}
    for (column, factor, _), cell in zip(columns, row, strict=False):
        if not cell.strip():
            continue
        if column in _WORDS:
            words[column] = cell.strip()
        else:
            values[column] = factor * _number(where, column, cell.strip(), mark)
    kind = words.get("kind", "").lower()
    if kind not in KINDS:
        raise InvalidInput(
            f"{where}: kind is {quoted(words.get('kind', ''))}, but must be one of "
            f"{', '.join(KINDS)}; correct the row"
        )
    whirl = words.get("whirl", "").lower()
    if whirl and whirl not in WHIRLS:
        raise InvalidInput(
            f"{where}: whirl is {quoted(whirl)}, but must be one of {', '.join(WHIRLS)}; correct "
            "the row, or leave it empty"
        )
    if values.get("speed", 0.0) <= 0:
        raise InvalidInput(f"{where}: it needs a speed above 0; give one, or leave the row out")
    for column in ("amplitude", "amplification"):
        if values.get(column, 0.0) < 0:
            raise InvalidInput(
                f"{where}: {column} is negative, but must be at least 0; correct it, or leave the "
                "cell empty"
            )
    if kind == "response" and not values.get("amplitude"):
        raise InvalidInput(f"{where}: a response needs an amplitude; give one, or drop the row")
    damping = values.get("damping_ratio")
    decrement = values.get("log_decrement")
    if damping is not None and decrement is None:
        if not abs(damping) < 1:
            raise InvalidInput(
                f"{where}: damping_ratio is {damping:g}, but must lie below 1; give it as a share "
                "of critical damping, or with [%]"
            )
        # delta = 2 pi zeta/sqrt(1 - zeta^2)
        decrement = 2 * math.pi * damping / math.sqrt(1 - damping**2)
    return TheirRow(
        kind,
        values["speed"],
        values.get("amplitude"),
        values.get("amplification"),
        decrement,
        whirl,
        words.get("probe", ""),
        words.get("case", ""),
        words.get("label", ""),
    )


def _number(where: str, column: str, cell: str, mark: str) -> float:
    # a decimal comma, where commas do not separate
    text = cell.replace(",", ".") if mark != "," and "." not in cell else cell
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InvalidInput(
            f"{where}: {column} is {quoted(cell)}, but must be a number; units stand in the first "
            "row"
        )
    return value
