"""Another code's results, or measured ones, as a table: CSV with a row of names first.

    kind;     speed [rpm]; amplitude [um p-p]; amplification [-]; log_decrement [-]; whirl;   probe
    critical; 5230;        34.1;               6.2;               ;                  ;        VE1
    mode;     5411;        ;                   ;                  0.34;              forward;
    response; 9000;        12.0;               ;                  ;                  ;        VE1

``critical``: a peak of the unbalance response; ``mode``: a damped natural frequency; ``response``:
an amplitude at a speed. Columns stand in any order; but for kind and speed they may be missing.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from ambrose.core.checks import InvalidInput
from ambrose.machine.file.text_table import Column, NamedTable, named_table
from ambrose.machine.messages import quoted

KINDS = ("critical", "mode", "response")
WHIRLS = ("forward", "backward", "planar")
_EXAMPLE = "kind; speed [rpm]; amplitude [um p-p]; log_decrement [-]"
_COLUMNS = {  # name -> other names
    "kind": (),
    "speed": ("frequency", "rpm"),
    "amplitude": ("response",),
    "amplification": ("af", "amplification_factor"),
    "log_decrement": ("logdec", "log decrement", "log dec"),
    "damping_ratio": ("damping ratio", "zeta"),
    "whirl": ("direction",),
    "probe": ("reading",),
    "case": ("placement",),
    "label": ("name",),
}
_WORDS = ("kind", "whirl", "probe", "case", "label")
_PEAKS = {"p-p": 1.0, "pp": 1.0, "pk-pk": 1.0, "0-p": 2.0, "0-pk": 2.0}


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
    try:
        table = named_table(text, _COLUMNS, _WORDS, required=("kind", "speed"), example=_EXAMPLE)
        for column in table.columns:
            if column.kind not in _WORDS:
                _si(column, 1.0)  # its unit, before any row
    except InvalidInput as error:
        raise InvalidInput(f"{name}: {error}") from None
    return tuple(_row(f"{name}, line {line}", table, cells) for line, cells in table.rows)


def _si(column: Column, number: float) -> float:
    """In SI, amplitudes peak to peak: 0-p counts twice. Raises InvalidInput."""
    if column.kind == "speed":
        unit = column.unit or ("rpm" if column.word == "rpm" else "")
        return replace(column, unit=unit).si(number, "angular rate", "rpm")
    if column.kind != "amplitude":
        return column.si(number, "ratio", "-")
    length, _, peak = column.unit.rpartition(" ")
    if peak not in _PEAKS:
        raise InvalidInput(
            f'the unit of amplitude is "{column.unit}", but must say whether it is peak to peak or '
            'zero to peak; write "amplitude [um p-p]" or "amplitude [um 0-p]"'
        )
    return replace(column, unit=length).si(number, "length", "um p-p") * _PEAKS[peak]


def _row(where: str, table: NamedTable, cells: Mapping[Column, str]) -> TheirRow:
    words = {column.kind: cell for column, cell in cells.items() if column.kind in _WORDS}
    try:
        values = {
            column.kind: _si(column, table.number(column, cell))
            for column, cell in cells.items()
            if column.kind not in _WORDS
        }
    except InvalidInput as error:
        raise InvalidInput(f"{where}: {error}") from None
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
