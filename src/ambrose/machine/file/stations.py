"""A rotor from a spreadsheet: a row per station, saved as CSV.

    length [mm]; od [mm]; id [mm]; E [GPa]; rho [kg/m^3]; disc mass [kg]; disc Ip [kg m^2]; ...
    50;          40;      0;       210;     7850;         ;               ;

Every row is a piece of shaft; what stands in its disc and bearing columns stands at its left end,
and a row of length 0 at the shaft's right end. Columns may be missing but for length and od, in any
order; units stand in brackets behind the name (file/stations.py).
"""

from __future__ import annotations

import csv
import math
import os
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ambrose.core.checks import InvalidInput
from ambrose.machine.file.ross import GIVE, merged, parse_ross, rotor_of_ross
from ambrose.machine.ordinary_file import NAME, TOML_BYTES, read_text
from ambrose.machine.part import Disc, Material, RotorModel, ShaftSection
from ambrose.machine.units import DIMENSIONS, in_si, one_line, quoted, suggestion

# Tables as text, of any program: what their cells are, or a refusal. One reader for stations of a
# rotor, filters, results of another code, and logs (record/text_uff.py).
#
# The separator is the header's; a row has as many cells as the header; a table has one decimal
# mark. What cannot be told apart is refused, never guessed: "1.234" beside "0,5" is 1234 in many
# countries.


_HEADING = re.compile(r"\s*(.*?)\s*(?:[\[(]([^\[\]()]*)[\])])?\s*")
# three digits behind every mark and no leading zero: they may be set apart, and no decimals
_SET_APART = re.compile(r"[+-]?[1-9]\d{0,2}(?:[.,]\d{3})+")
_WHOLE = re.compile(r"[+-]?\d{1,3}")
_ONE_MARK = "write all numbers with one decimal mark, and nothing between their digits"

Cell = tuple[int, str]  # the number of its line, and what stands there


def heading(cell: str) -> tuple[str, str]:
    """Name and unit of a column, "x [um]" or "x (um)"; quotes around it are none of it."""
    match = _HEADING.fullmatch(cell.strip().strip('"'))
    return (cell.strip(), "") if match is None else (match[1], (match[2] or "").strip())


def decimal_mark(columns: Sequence[Sequence[Cell]]) -> str:
    """The mark in the numbers of these columns, "." or ","; raises InvalidInput where both stand
    there, or where digits may be set apart by it.
    """
    cells = [cell for column in columns for cell in column]
    refuse_two_marks(*(next((c for c in cells if mark in c[1]), None) for mark in ",."))
    marked = [cell for cell in cells if re.search("[.,]", cell[1])]
    if all(_SET_APART.fullmatch(cell[1]) for cell in marked):
        for column in columns:
            whole = next((cell for cell in column if _WHOLE.fullmatch(cell[1])), None)
            doubt = next((cell for cell in column if _SET_APART.fullmatch(cell[1])), None)
            if whole and doubt:
                line, text = doubt
                raise InvalidInput(
                    f'"{text}" in line {line} may be {re.sub("[.,]", "", text)}, beside '
                    f'"{whole[1]}" in line {whole[0]}; {_ONE_MARK}, such as {text}0'
                )
    return "," if any("," in cell[1] for cell in marked) else "."


def refuse_two_marks(comma: Cell | None, point: Cell | None) -> None:
    """Raises InvalidInput where a table has numbers with either."""
    if comma and point:
        raise InvalidInput(
            f"it has decimal commas ({quoted(comma[1])} in line {comma[0]}) and points "
            f"({quoted(point[1])} in line {point[0]}), of which one may set digits apart; "
            f"{_ONE_MARK}"
        )


def refuse_counts(
    line: int, cells: int, columns: int, said: str = "the header names", what: str = "line"
) -> None:
    """Raises InvalidInput where a row has another number of cells than there are columns."""
    if cells != columns:
        raise InvalidInput(
            f"{what} {line} has {cells} cells, but {said} {columns} columns; give every column a "
            "name, and every row a cell for each, an empty one where there is nothing"
        )


@dataclass(frozen=True, slots=True)
class Column:
    """What stands in a column: its name here, its unit as written and its place."""

    kind: str
    unit: str
    word: str
    place: int

    def si(self, number: float, dimension: str, example: str) -> float:
        """A number of it in SI. Raises InvalidInput where its unit is missing or of another
        kind.
        """
        kind = DIMENSIONS[dimension]
        if not self.unit and kind.unit != "-":
            raise InvalidInput(
                f'{self.kind} has no unit; name it in the first row, such as "{self.kind} '
                f'[{example}]"'
            )
        try:
            return in_si(number, self.unit or "-", kind)
        except ValueError as error:
            raise InvalidInput(f"the unit of {self.kind} {error}") from None


@dataclass(frozen=True, slots=True)
class NamedTable:
    """A table whose first row names its columns.

    rows: the number of the line, and the cells of those that are not empty, by column. Where a
    cell is refused, the message begins with its line.
    """

    columns: tuple[Column, ...]
    rows: tuple[tuple[int, Mapping[Column, str]], ...]
    mark: str

    def number(self, column: Column, cell: str) -> float:
        """Raises InvalidInput."""
        try:
            value = float(cell.replace(",", ".") if self.mark == "," else cell)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise InvalidInput(
                f"{column.kind} is {quoted(cell)}, but must be a number; units are in the first "
                f'row, as "{column.kind} [...]"'
            )
        return value


def named_table(
    text: str,
    known: Mapping[str, Sequence[str]],
    words: Collection[str],
    *,
    required: Sequence[str],
    example: str,
    exact: bool = False,
) -> NamedTable:
    """The table in a CSV text. known: the columns that it may have, and their other names; words:
    those that hold no numbers; several numbers may stand in a cell. exact: capitals matter. Lines
    that begin with # are left out. Raises InvalidInput.
    """
    lines = [
        (number, line)
        for number, line in enumerate(text.lstrip("\ufeff").splitlines(), 1)
        if line.strip() and line.lstrip()[0] != "#"
    ]
    if len(lines) < 2:
        raise InvalidInput(f"it needs a row of names ({example}) and a row for each entry")
    separator = max(";\t,", key=lines[0][1].count)
    try:
        reader = csv.reader((line for _, line in lines), delimiter=separator, skipinitialspace=True)
        (_, header), *rows = [(lines[reader.line_num - 1][0], row) for row in reader]
    except csv.Error as error:
        raise InvalidInput(f"it is not a CSV table ({error}); {example}") from None
    while len(header) > 1 and not header[-1].strip():
        header.pop()
    columns = [_column(place, cell, known, exact) for place, cell in enumerate(header)]
    kinds = [column.kind for column in columns]
    for column, kind in zip(columns, kinds, strict=True):
        if not kind:
            raise InvalidInput(
                f"the column {quoted(column.word)} is unknown; {suggestion(column.word, known)}"
            )
        if kinds.count(kind) > 1:
            raise InvalidInput(f'the column "{kind}" is given twice; leave one out')
    if missing := [kind for kind in required if kind not in kinds]:
        raise InvalidInput(
            f'the column "{missing[0]}" is missing; its first row names the columns, such as '
            f"{example}"
        )
    found = []
    for line, row in rows:
        while len(row) > len(columns) and not row[-1].strip():
            row.pop()
        refuse_counts(line, len(row), len(columns))
        pairs = zip(columns, row, strict=True)
        found.append((line, {column: cell.strip() for column, cell in pairs if cell.strip()}))
    numbers = [
        [
            (line, piece)
            for line, cells in found
            for piece in cells.get(column, "").split(None if separator != "," else "\n")
        ]
        for column in columns
        if column.kind not in words
    ]
    mark = "." if separator == "," else decimal_mark(numbers)
    return NamedTable(tuple(columns), tuple(found), mark)


def _column(place: int, cell: str, known: Mapping[str, Sequence[str]], exact: bool) -> Column:
    name, unit = heading(cell)
    word = name if exact else name.lower()
    kind = next((kind for kind, others in known.items() if word == kind or word in others), "")
    return Column(kind, unit, word, place)


_COLUMNS = {  # name -> (dimension, other names)
    "length": ("length", ("l",)),
    "od": ("length", ("outer diameter", "outer_diameter", "diameter")),
    "id": ("length", ("inner diameter", "inner_diameter", "bore")),
    "mass diameter": ("length", ("mass_diameter", "mass od")),
    "e": ("elastic modulus", ("young", "youngs_modulus", "youngs modulus")),
    "rho": ("density", ("density",)),
    "nu": ("ratio", ("poisson", "poisson_ratio")),
    "disc mass": ("mass", ("disk mass", "mass")),
    "disc ip": ("moment of inertia", ("disk ip", "ip")),
    "disc id": ("moment of inertia", ("disk id",)),
    "bearing": ("", ()),
    "label": ("", ("name", "tag")),
}
_NAMES = {kind: others for kind, (_, others) in _COLUMNS.items()}
_WORDS = {kind for kind, (dimension, _) in _COLUMNS.items() if not dimension}
_STEEL = Material()


def rotor_of_stations(text: str, name: str) -> RotorModel:
    """The rotor in the text of a CSV file; ``name`` stands in messages. Raises InvalidInput."""
    try:
        table = named_table(
            text,
            _NAMES,
            _WORDS,
            required=("length", "od"),
            example="length [mm]; od [mm]; id [mm]; E [GPa]; rho [kg/m^3]; disc mass [kg]",
        )
        return _rotor(table)
    except InvalidInput as error:
        other = "" if "length" in text.lower() else f"; {GIVE}"  # any CSV file comes here
        raise InvalidInput(f"{name}: {error}{other}") from None


def _rotor(table: NamedTable) -> RotorModel:
    sections = list[ShaftSection]()
    discs = list[Disc]()
    bearings = list[float]()
    at = 0.0
    for line, row in table.rows:
        words = {column.kind: cell for column, cell in row.items() if column.kind in _WORDS}
        try:
            get = {
                column.kind: _read(table, column, cell)
                for column, cell in row.items()
                if column.kind not in _WORDS
            }
        except InvalidInput as error:
            raise InvalidInput(f"line {line}: {error}") from None
        if get.get("disc mass"):
            label = f"disc{len(discs) + 1}"
            discs.append(
                Disc(label, at, get["disc mass"], get.get("disc ip", 0.0), get.get("disc id", 0.0))
            )
        if words.get("bearing", "no").lower() not in {"0", "no", "-"}:
            bearings.append(at)
        length = get.get("length", 0.0)
        if length == 0:
            continue
        if length < 0 or get.get("od", 0.0) <= 0:
            raise InvalidInput(
                f"line {line}: length and od must be positive; correct the row, or leave its "
                "length out for the end"
            )
        material = Material(
            get.get("rho", _STEEL.density),
            get.get("e", _STEEL.youngs_modulus),
            get.get("nu", _STEEL.poisson_ratio),
        )
        od, heavy = get["od"], get.get("mass diameter")
        label = words.get("label", "")
        elements = min(max(math.ceil(length / od), 1), 20)
        sections.append(
            ShaftSection(at, length, od, get.get("id", 0.0), heavy, elements, material, label)
        )
        at += length
    if not sections:
        raise InvalidInput("no row has a length; give a row per piece of shaft")
    named = {"e", "rho"} & {column.kind for column in table.columns}
    assumed = {} if named else {"shaft.material": "steel, as the table names no material"}
    return RotorModel(
        "rotor",
        tuple(merged(sections)),
        tuple(discs),
        tuple(bearings),
        source="table of stations",
        assumed=assumed,
    )


def _read(table: NamedTable, column: Column, cell: str) -> float:
    number = table.number(column, cell)
    dimension = _COLUMNS[column.kind][0]
    example = DIMENSIONS[dimension].example.partition(" ")[2]
    return column.si(number, dimension, example) if number else 0.0


def read_rotor(path: str | os.PathLike[str]) -> RotorModel:
    """The rotor in a file of ROSS (*.toml, *.json) or a table of stations (*.csv), called as the
    file. Raises InvalidInput.
    """
    source = Path(path)
    text, suffix = read_text(source, "rotor model", TOML_BYTES), source.suffix.lower()
    if suffix in {".csv", ".txt"}:
        rotor = rotor_of_stations(text, str(source))
    else:
        rotor = rotor_of_ross(parse_ross(text, str(source), suffix), str(source))
    return replace(
        rotor,
        name=one_line(source.stem).strip()[:NAME] or "rotor",
        source=f"{rotor.source}, {one_line(source.name)}",
    )
