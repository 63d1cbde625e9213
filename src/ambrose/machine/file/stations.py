"""A rotor from a spreadsheet, and one written as such: a row per station, as CSV or a workbook.

    length [mm]; od [mm]; id [mm]; E [GPa]; rho [kg/m^3]; disc mass [kg]; disc Ip [kg m^2]; ...
    50;          40;      0;       210;     7850;         ;               ;

Every row is a piece of shaft; what stands in its disc and bearing columns stands at its left end,
and a row of length 0 at the shaft's right end. Columns may be missing but for length and od, in any
order; units stand in brackets behind the name, or in a row below the names (file/stations.py).
"""

import csv
import io
import math
import os
import re
import warnings
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from types import ModuleType
from typing import Any
from zipfile import ZipFile

from ambrose.core.checks import InvalidInput
from ambrose.machine.attachment import Piece, mesh, node_positions
from ambrose.machine.file.ross import GIVE, merged, parse_ross, rotor_of_ross
from ambrose.machine.ordinary_file import (
    ELEMENTS,
    NAME,
    TOML_BYTES,
    check_source,
    draft_of,
    read_text,
    write_text,
)
from ambrose.machine.part import MATERIALS, Disc, Material, RotorModel, ShaftSection
from ambrose.machine.units import (
    DIMENSIONS,
    in_si,
    one_line,
    quoted,
    read_quantity,
    rewrite_quantity,
    suggestion,
)

# Workbooks (*.xlsx): their sheets as rows of cells, and one sheet written. Read by openpyxl, the
# extra "xlsx": values only. What a table would lose without a word stands among the faults of a
# sheet: merged cells, comments, formulas that were never computed.


_MOST_BYTES = 50_000_000  # of a workbook, unpacked
_MOST_ROWS, _MOST_COLUMNS = 2000, 100  # of a sheet that is read

Row = tuple[int, list[str | float]]  # the number of its line, and its cells


@dataclass(frozen=True, slots=True)
class Sheet:
    """rows: those that are not empty. faults: the number of a row and what is wrong in it, in a
    sentence.
    """

    name: str
    rows: tuple[Row, ...]
    faults: tuple[tuple[int, str], ...]


def read_sheets(path: str | os.PathLike[str]) -> list[Sheet]:
    """The sheets of a workbook. Raises InvalidInput."""
    source, library = check_source(path, "workbook"), _openpyxl()
    try:
        with ZipFile(source) as parts:
            size = sum(part.file_size for part in parts.infolist())
        if size > _MOST_BYTES:
            raise InvalidInput(
                f"{source} unpacks to {size} bytes, more than any table of stations; save the "
                "table alone as a workbook"
            )
        with warnings.catch_warnings():  # of drawings and rules that it does not keep
            warnings.simplefilter("ignore")
            written, computed = (
                library.load_workbook(source, data_only=values, keep_links=False)
                for values in (False, True)
            )
    except InvalidInput:
        raise
    except Exception as error:  # whatever the library meets in a broken file
        raise InvalidInput(
            f"{source} is not a workbook that can be read ({error}); save it again as .xlsx, "
            "without a password"
        ) from error
    return [_sheet(sheet, computed[sheet.title]) for sheet in written.worksheets]


def _sheet(written: Any, computed: Any) -> Sheet:
    faults = [
        (
            area.min_row,
            f"{area.coord} is one merged cell; split it, and fill every cell that counts",
        )
        for area in written.merged_cells.ranges
    ]
    rows = list[Row]()
    size = (1, min(written.max_row, _MOST_ROWS + 1), 1, min(written.max_column, _MOST_COLUMNS))
    areas = (sheet.iter_rows(*size) for sheet in (written, computed))
    for cells, results in zip(*areas, strict=True):
        line = cells[0].row
        faults += [
            (line, f"{cell.coordinate} {fault}")
            for cell, result in zip(cells, results, strict=True)
            for fault in _faults(cell, result.value)
        ]
        values = [_cell_of(result.value) for result in results]
        if any(value != "" for value in values):
            rows.append((line, values))
    if rows and rows[-1][0] > _MOST_ROWS:
        faults.append(
            (rows[-1][0], f"it has over {_MOST_ROWS} rows; keep those of the rotor alone")
        )
    return Sheet(written.title, tuple(rows), tuple(sorted(faults)))


def _faults(cell: Any, value: Any) -> Iterator[str]:
    if cell.data_type == "f" and value is None:
        yield (
            "is a formula without a value; open the workbook in a spreadsheet program and save it, "
            "or write the number"
        )
    if cell.comment is not None:
        yield (
            f"has the comment {quoted(cell.comment.text)}, which no table keeps; move it into the "
            "column label, or delete it"
        )


def _cell_of(value: Any) -> str | float:
    """A number as it is, all else as a text in one line."""
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return value
    return "" if value is None else " ".join(str(value).split())


def write_sheet(path: str | os.PathLike[str], name: str, rows: Sequence[Sequence[Any]]) -> None:
    """One sheet as a workbook; texts stay texts, whatever they begin with. Raises InvalidInput."""
    book = _openpyxl().Workbook()
    sheet, book.active.title = book.active, name
    for row in rows:
        sheet.append([value if value != "" else None for value in row])
    for cell in (cell for row in sheet.iter_rows() for cell in row if isinstance(cell.value, str)):
        cell.data_type = "s"  # "=" begins no formula
    with draft_of(path, "table of stations") as draft, Path(draft).open("xb") as stream:
        book.save(stream)


def _openpyxl() -> ModuleType:
    try:
        import openpyxl
    except ImportError as error:
        raise InvalidInput(
            "workbooks (*.xlsx) need the package openpyxl; install it with: pip install "
            "'ambrose[xlsx]', or save the sheet as CSV"
        ) from error
    return openpyxl


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
        """A number of it in SI, the one that a machine file reads from the same digits. Raises
        InvalidInput where its unit is missing or of another kind.
        """
        kind = DIMENSIONS[dimension]
        if not self.unit and kind.unit != "-":
            raise InvalidInput(
                f'{self.kind} has no unit; name it in the first row, such as "{self.kind} '
                f'[{example}]"'
            )
        try:
            in_si(0.0, self.unit or "-", kind)
        except ValueError as error:
            raise InvalidInput(f"the unit of {self.kind} {error}") from None
        own = self.unit in {"", "-", kind.unit}
        return number if own else read_quantity(f"{float(number)!r} {self.unit}", kind)


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
    separator, rows = _csv_rows(text, example)
    return _named(rows, separator, known, words, required, example, exact)


def _csv_rows(text: str, example: str) -> tuple[str, list[Row]]:
    """The separator of a CSV text, and its rows. Raises InvalidInput."""
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
        return separator, [(lines[reader.line_num - 1][0], [*row]) for row in reader]
    except csv.Error as error:
        raise InvalidInput(f"it is not a CSV table ({error}); {example}") from None


def _named(
    rows: Sequence[Row],
    separator: str,
    known: Mapping[str, Sequence[str]],
    words: Collection[str],
    required: Sequence[str],
    example: str,
    exact: bool = False,
) -> NamedTable:
    """The table in rows of cells; separator: "" where the cells say themselves which are numbers.
    Raises InvalidInput.
    """
    (_, header), *rest = rows
    while len(header) > 1 and not str(header[-1]).strip():
        header.pop()
    columns = [_column(place, str(cell), known, exact) for place, cell in enumerate(header)]
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
    for line, row in rest:
        while len(row) > len(columns) and row[-1] == "":
            row.pop()
        refuse_counts(line, len(row), len(columns))
        cells = dict[Column, str]()
        for column, cell in zip(columns, row, strict=True):
            if not separator and column.kind not in words and isinstance(cell, str) and cell:
                raise InvalidInput(
                    f"line {line}: {column.kind} is the text {quoted(cell)}, but must be a number; "
                    "write it as a number of the spreadsheet, with its unit in the row of names"
                )
            if said := cell.strip() if isinstance(cell, str) else repr(cell):
                cells[column] = said
        found.append((line, cells))
    numbers = [
        [
            (line, piece)
            for line, cells in found
            for piece in cells.get(column, "").split(None if separator != "," else "\n")
        ]
        for column in columns
        if column.kind not in words
    ]
    mark = "." if separator in {",", ""} else decimal_mark(numbers)
    return NamedTable(tuple(columns), tuple(found), mark)


def _column(place: int, cell: str, known: Mapping[str, Sequence[str]], exact: bool) -> Column:
    name, unit = heading(cell)
    word = name if exact else _plain(name)
    kind = next(
        (
            kind
            for kind, others in known.items()
            if word in ((kind, *others) if exact else map(_plain, (kind, *others)))
        ),
        "",
    )
    return Column(kind, unit, word, place)


def _plain(name: str) -> str:
    return " ".join(re.split(r"[\s_.]+", name.lower())).strip()


_COLUMNS = {  # name -> (dimension, other names)
    "station": ("plain number", ("station no", "station number", "no", "nr", "number", "node")),
    "length": ("length", ("l", "element length", "section length")),
    "od": (
        "length",
        (
            *("outer diameter", "outside diameter", "diameter", "od left", "left od", "od l"),
            *("outer diameter left", "left outer diameter"),
        ),
    ),
    "od right": (
        "length",
        ("right od", "od r", "outer diameter right", "right outer diameter"),
    ),
    "id": (
        "length",
        (
            *("inner diameter", "inside diameter", "bore", "id left", "left id", "id l"),
            *("inner diameter left", "left inner diameter"),
        ),
    ),
    "id right": (
        "length",
        ("right id", "id r", "inner diameter right", "right inner diameter"),
    ),
    "mass diameter": ("length", ("mass od",)),
    "elements": ("plain number", ()),
    "material": ("", ()),
    "e": ("elastic modulus", ("young", "youngs modulus", "young's modulus", "elastic modulus")),
    "rho": ("density", ("density",)),
    "nu": ("ratio", ("poisson", "poisson ratio", "poisson's ratio")),
    "disc": ("", ("disk", "disc name", "disk name")),
    "disc mass": ("mass", ("disk mass", "mass", "added mass", "external mass", "lumped mass")),
    "disc ip": ("moment of inertia", ("disk ip", "ip", "added ip", "polar inertia")),
    "disc id": (
        "moment of inertia",
        ("disk id", "disc it", "disk it", "it", "added it", "diametral inertia"),
    ),
    "bearing": ("", ()),
    "label": ("", ("name", "tag", "remark")),
}
_NAMES = {kind: others for kind, (_, others) in _COLUMNS.items()}
_WORDS = {kind for kind, (dimension, _) in _COLUMNS.items() if not dimension}
_KINDS = {_plain(name): kind for kind, others in _NAMES.items() for name in (kind, *others)}
_REQUIRED = ("length", "od")
_EXAMPLE = "length [mm]; od [mm]; id [mm]; E [GPa]; rho [kg/m^3]; disc mass [kg]"
_STEEL = Material()
_NUMBER = re.compile(r"\s*([+-]?[.,]?\d|nan\b|inf\b)", re.IGNORECASE)  # begins a cell


def rotor_of_stations(text: str, name: str) -> RotorModel:
    """The rotor in the text of a CSV file; ``name`` stands in messages. Raises InvalidInput."""
    try:
        separator, rows = _csv_rows(text, _EXAMPLE)
        return _rotor(rows, separator)
    except InvalidInput as error:
        other = "" if "length" in text.lower() else f"; {GIVE}"  # any CSV file comes here
        raise InvalidInput(f"{name}: {error}{other}") from None


def rotor_of_workbook(path: Path) -> RotorModel:
    """The rotor in the one sheet of a workbook that holds a table of stations. Raises
    InvalidInput.
    """
    sheets = [(sheet, begin) for sheet in read_sheets(path) for begin in _begins(sheet.rows)[:1]]
    if len(sheets) != 1:
        names = " and ".join(quoted(sheet.name) for sheet, _ in sheets)
        raise InvalidInput(
            f"{path}: the sheets {names} hold a table each; keep one of them"
            if names
            else f"{path}: no sheet has a row that names length and od; name the columns in one "
            f"row, such as {_EXAMPLE}"
        )
    ((sheet, begin),) = sheets
    try:
        for line, fault in sheet.faults:
            if line >= sheet.rows[begin][0]:
                raise InvalidInput(fault)
        return _rotor(sheet.rows, "")
    except InvalidInput as error:
        raise InvalidInput(f"{path}, sheet {quoted(sheet.name)}: {error}") from None


def _begins(rows: Sequence[Row]) -> list[int]:
    """Which rows name the columns of a table of stations."""
    return [
        i
        for i, (_, cells) in enumerate(rows)
        if {_KINDS.get(_plain(heading(cell)[0])) for cell in cells if isinstance(cell, str)}
        >= {*_REQUIRED}
    ]


def _with_units(rows: Sequence[Row]) -> list[Row]:
    """The rows of a table without empty columns; the units of a row below the names, which has no
    number, behind these. Raises InvalidInput.
    """
    long = max(len(cells) for _, cells in rows)
    padded = [[*cells, *[""] * (long - len(cells))] for _, cells in rows]
    kept = [j for j in range(long) if any(cells[j] != "" for cells in padded)]
    plain = [
        (line, [cells[j] for j in kept if j < len(cells)]) for line, cells in rows if any(cells)
    ]
    (line, names), *rest = plain
    if not rest or not any(rest[0][1]) or any(_NUMBER.match(str(cell)) for cell in rest[0][1]):
        return plain
    header = list[str | float]()
    for name, cell in zip(names, rest[0][1], strict=False):
        unit = str(cell).strip().strip("[]()")
        word, stated = heading(str(name))
        if unit and stated not in {"", unit}:
            raise InvalidInput(
                f'{word} has two units, "{stated}" in line {line} and "{unit}" in line '
                f"{rest[0][0]}; leave one out"
            )
        header.append(f"{word} [{unit}]" if unit else name)
    return [(line, header), *rest[1:]]


def _rotor(rows: Sequence[Row], separator: str) -> RotorModel:
    begins = _begins(rows) or [0]
    if len(begins) > 1:
        raise InvalidInput(
            f"line {rows[begins[1]][0]} begins a second table; keep one rotor in a table"
        )
    heads = rows[: begins[0]]
    table = _named(_with_units(rows[begins[0] :]), separator, _NAMES, _WORDS, _REQUIRED, _EXAMPLE)
    sections = list[ShaftSection]()
    discs = list[Disc]()
    bearings = list[float]()
    at = 0.0
    before: float | None = None
    bare = False
    for line, row in table.rows:
        words = {column.kind: cell for column, cell in row.items() if column.kind in _WORDS}
        try:
            get = {
                column.kind: _read(table, column, cell)
                for column, cell in row.items()
                if column.kind not in _WORDS
            }
            if "station" in {column.kind for column in table.columns}:
                before = _next_station(get.get("station"), before)
            figures = [get.get(f"disc {key}", 0.0) for key in ("mass", "ip", "id")]
            if min(figures) < 0:
                raise InvalidInput(
                    "mass, Ip and It of a disc must not be negative; correct the row"
                )
            if any(figures):
                label = words.get("disc") or f"disc{len(discs) + 1}"
                discs.append(Disc(label, at, *figures))
            if words.get("bearing", "no").lower() not in {"0", "no", "-"}:
                bearings.append(at)
            if not get.get("length") and line == table.rows[-1][0]:
                continue
            sections.append(_section(at, get, words))
        except InvalidInput as error:
            raise InvalidInput(f"line {line}: {error}") from None
        at += sections[-1].length
        bare |= "material" not in words and not {"e", "rho"} <= get.keys()
    if not sections:
        raise InvalidInput("no row has a length; give a row per piece of shaft")
    return RotorModel(
        "rotor",
        tuple(merged(sections)),
        tuple(discs),
        tuple(bearings),
        source="table of stations",
        assumed={"shaft.material": "steel, where the table names none"} if bare else {},
        left_out=tuple(
            f"line {line}: {' '.join(str(cell) for cell in cells if cell != '')}"
            for line, cells in heads
        ),
    )


def _next_station(number: float | None, before: float | None) -> float:
    """The number of a station after the one before. Raises InvalidInput."""
    if number is None or number != round(number):
        raise InvalidInput("the station has no whole number; number every row, or drop the column")
    if before is not None and number != before + 1:
        kind = (
            "is there twice"
            if number == before
            else "is out of order"
            if number < before
            else "leaves a gap"
        )
        raise InvalidInput(
            f"station {number:g} behind {before:g} {kind}; give the stations from left to right, "
            "numbered one by one"
        )
    return number


def _section(at: float, get: Mapping[str, float], words: Mapping[str, str]) -> ShaftSection:
    """The piece of shaft of a row. Raises InvalidInput."""
    length, od, bore = (get.get(key, 0.0) for key in ("length", "od", "id"))
    ends = (od, bore), (get.get("od right", od), get.get("id right", bore))
    if length <= 0 or min(outer for outer, _ in ends) <= 0:
        raise InvalidInput(
            f"length is {1e3 * length:g} mm and od {1e3 * od:g} mm, but both must be positive; "
            "correct the row (only the last one, for what stands at the right end, needs no length)"
        )
    for outer, inner in ends:
        if not 0 <= inner < outer:
            raise InvalidInput(
                f"id is {1e3 * inner:g} mm, but must be from 0 to below od, {1e3 * outer:g} mm; "
                "correct them, or exchange the names of the two columns"
            )
    name, count = words.get("material", ""), get.get("elements")
    known = MATERIALS.get(name, _STEEL)
    if name and name not in MATERIALS and not {"e", "rho"} <= get.keys():
        raise InvalidInput(
            f"the material {quoted(name)} is unknown; {suggestion(name, MATERIALS)}, or give its E "
            "and rho"
        )
    if count is not None and (count < 1 or count != round(count)):
        raise InvalidInput(f"elements is {count:g}, but must be 1, 2, ...; correct or empty it")
    material = Material(
        get.get("rho", known.density),
        get.get("e", known.youngs_modulus),
        get.get("nu", known.poisson_ratio),
        name,
    )
    return ShaftSection(
        at,
        length,
        od,
        bore,
        get.get("mass diameter"),
        min(max(math.ceil(length / od), 1), 20) if count is None else int(count),
        material,
        words.get("label", ""),
        *(ends[1] if ends[0] != ends[1] else (None, None)),
    )


def _read(table: NamedTable, column: Column, cell: str) -> float:
    number = table.number(column, cell)
    dimension = _COLUMNS[column.kind][0]
    example = DIMENSIONS[dimension].example.partition(" ")[2]
    return column.si(number, dimension, example) if number else 0.0


_WRITTEN = {  # columns of a table that is written, where they are not the bare names
    **{kind: f"{kind} [mm]" for kind, (what, _) in _COLUMNS.items() if what == "length"},
    "e": "E [GPa]",
    "rho": "rho [kg/m^3]",
    "disc mass": "disc mass [kg]",
    "disc ip": "disc Ip [kg m^2]",
    "disc id": "disc It [kg m^2]",
}


def station_table(rotor: RotorModel, places: Iterable[float]) -> list[list[str]]:
    """The rows of a table of stations, names first: every piece of the shaft between discs and
    bearings, in elements as ``mesh`` makes them with these further places [m]. Columns without
    content are left out.
    """
    attached = [
        *((disc.position, disc) for disc in rotor.discs),
        *((at, None) for at in rotor.bearings),
    ]
    pieces = mesh(rotor.shaft, [*places, *(at for at, _ in attached)])
    nodes = node_positions(pieces)
    carried: dict[int, list[Disc | None]] = {}
    for at, disc in attached:
        away = [abs(node - at) for node in nodes]
        carried.setdefault(away.index(min(away)), []).append(disc)
    cuts = [
        i
        for i, piece in enumerate(pieces)
        if i == 0
        or i in carried
        or piece.section is not (last := pieces[i - 1]).section
        or abs(piece.length - last.length) > 1e-9 * last.length
    ]
    rows = [
        {**_shaft_cells(pieces[i:j]), **_carried_cells(carried.get(i, []))}
        for i, j in pairwise([*cuts, len(pieces)])
    ]
    if len(pieces) in carried:
        rows.append({"length": "0", **_carried_cells(carried[len(pieces)])})
    table = [{"station": str(i), **row} for i, row in enumerate(rows, 1)]
    kinds = [kind for kind in _COLUMNS if any(row.get(kind) for row in table)]
    names = [_WRITTEN.get(kind, kind) for kind in kinds]
    return [names, *([row.get(kind, "") for kind in kinds] for row in table)]


def _carried_cells(parts: Sequence[Disc | None]) -> dict[str, str]:
    """Discs at a node as one, by the first one's name; None: a bearing."""
    discs = [disc for disc in parts if disc is not None]
    sums = {
        "disc mass": sum(disc.mass for disc in discs),
        "disc ip": sum(disc.polar_inertia for disc in discs),
        "disc id": sum(disc.diametral_inertia for disc in discs),
    }
    bearing = {"bearing": "x"} if None in parts else {}
    return {"disc": discs[0].name, **_cells(sums), **bearing} if discs else bearing


def _cells(values: Mapping[str, float | None]) -> dict[str, str]:
    """Numbers [SI] as they stand in a table, with the fewest digits that read back as the same."""
    return {
        kind: rewrite_quantity(
            f"0 {heading(_WRITTEN[kind])[1]}", value, DIMENSIONS[_COLUMNS[kind][0]]
        ).partition(" ")[0]
        for kind, value in values.items()
        if value is not None
    }


def _shaft_cells(pieces: Sequence[Piece]) -> dict[str, str]:
    section, ends = pieces[0].section, (pieces[0].left, pieces[-1].right)
    left, right = (section.diameters(place) for place in ends)
    taper = {"od right": right[0], "id right": right[1]} if section.conical else {}
    length = section.length * (ends[1] - ends[0])
    numbers = {
        "length": float(f"{length:.12g}"),  # without the rounding of places
        "od": left[0],
        "id": left[1],
        "mass diameter": section.mass_diameter,
        "e": section.material.youngs_modulus,
        "rho": section.material.density,
    }
    return {
        **_cells(numbers | taper),
        "nu": f"{section.material.poisson_ratio!r}",
        "elements": str(len(pieces)),
        "material": section.material.name,
        "label": section.label,
    }


def write_stations(path: Path, rotor: RotorModel, places: Iterable[float] = ()) -> int:
    """The rotor as a table of stations, *.csv or *.xlsx (``station_table``); returns how many.
    Raises InvalidInput.
    """
    names, *rows = station_table(rotor, places)
    if path.suffix.lower() == ".xlsx":
        typed = [
            [
                cell if name in _WORDS or not cell else float(cell)
                for name, cell in zip(names, row, strict=True)
            ]
            for row in rows
        ]
        write_sheet(path, "stations", [names, *typed])
    else:
        lines = io.StringIO()
        csv.writer(lines, lineterminator="\n").writerows([names, *rows])
        write_text(path, lines.getvalue(), "table of stations")
    return len(rows)


def read_rotor(path: str | os.PathLike[str]) -> RotorModel:
    """The rotor in a file of ROSS (*.toml, *.json) or a table of stations (*.csv, *.xlsx), called
    as the file. Raises InvalidInput.
    """
    source = Path(path)
    suffix = source.suffix.lower()
    if suffix == ".xlsx":
        rotor = rotor_of_workbook(source)
    else:
        text = read_text(source, "rotor model", TOML_BYTES)
        rotor = (
            rotor_of_stations(text, str(source))
            if suffix in {".csv", ".txt"}
            else rotor_of_ross(parse_ross(text, str(source), suffix), str(source))
        )
    elements = sum(section.elements for section in rotor.shaft)
    if elements > ELEMENTS:
        raise InvalidInput(
            f"{source}: the shaft has {elements} elements in all, but at most {ELEMENTS} are "
            "allowed; join rows of equal diameters, or give fewer elements"
        )
    return replace(
        rotor,
        name=one_line(source.stem).strip()[:NAME] or "rotor",
        source=f"{rotor.source}, {one_line(source.name)}",
    )
