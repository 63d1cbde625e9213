"""Workbooks of spreadsheet programs (*.xlsx): their sheets as rows of cells, and one sheet written.

Read by openpyxl, the extra "xlsx": values only. What a table would lose without a word stands among
the faults of a sheet: merged cells, comments, formulas that were never computed.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any
from zipfile import ZipFile

from ambrose.core.checks import InvalidInput
from ambrose.machine.ordinary_file import check_source, draft_of
from ambrose.machine.units import quoted

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
        values = [_plain(result.value) for result in results]
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


def _plain(value: Any) -> str | float:
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
