"""Channels in text tables of any program (*.csv, *.txt, *.dat, *.asc) and in universal files
(*.uff, *.unv), dataset 58.

A table's separator, decimal mark and header lines are found by looking at its rows: from the first
data row on every row has the same number of cells, and all of them are numbers. What cannot be told
apart is refused, never guessed.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ambrose.core.checks import InvalidInput
from ambrose.machine.limits import FOREIGN_NUMBERS, NAME, SIGNALS
from ambrose.machine.messages import suggestion

_LINE = 3 * NAME * SIGNALS  # characters
_HEAD = 1000  # lines before the first row of numbers
_SEPARATORS = ("\t", ";", ",", None)  # None: spaces
_CELL = re.compile(r"\s*(.*?)\s*(?:[\[(]([^\[\]()]*)[\])])?\s*")
_BLOCK = 20_000  # rows converted together
# of dataset 58: kind of number, numbers a line, characters a number
_REAL = {2: ("f4", 6, 13), 4: ("f8", 4, 20)}

_SHOWN = 20  # names in a message


@dataclass(frozen=True, slots=True)
class Variable:
    """One axis of numbers (k,) as they stand in the file; unit and sample rate [Hz] where the file
    states them.

    bad: the first sample that is not finite.
    """

    values: np.ndarray
    unit: str = ""
    rate: float | None = None
    bad: int | None = None


Find = Callable[[str], Variable]


@contextmanager
def text_table(path: Path) -> Iterator[Find]:
    """By the name in the header, or by place: "column 2". Raises InvalidInput."""
    lines = _lines(path)
    separator, comma, start, width = _form(lines)
    names, units = _header(lines[:start], separator, width)
    if (len(lines) - start) * width > 4 * FOREIGN_NUMBERS:
        raise InvalidInput(f"it has more than {4 * FOREIGN_NUMBERS} numbers; export it in parts")
    parts = []
    for first in range(start, len(lines), _BLOCK):
        rows = [_numbers(line, separator, comma) for line in lines[first : first + _BLOCK]]
        try:
            parts.append(np.loadtxt(rows, delimiter=separator, comments=None, ndmin=2))
        except ValueError as error:
            what = f"the rows from line {first + 1} on are no table of {width} numbers"
            raise InvalidInput(f"{what} ({error}); export it anew") from None
    if {part.shape[1] for part in parts} != {width}:
        raise InvalidInput(f"its rows have not {width} numbers each; export it anew")
    table = np.vstack(parts)

    def find(name: str) -> Variable:
        place = re.fullmatch(r"column (\d+)", name)
        if names.count(name) > 1:
            raise InvalidInput(
                f"the column {name!r} stands there {names.count(name)} times; name it by its "
                'place, "column 2"'
            )
        if name in names:
            index = names.index(name)
        elif place and 1 <= int(place[1]) <= width:
            index = int(place[1]) - 1
        else:
            raise unknown(name, [*filter(None, names)] or [f"column 1 to column {width}"], "column")
        return Variable(table[:, index], units[index])

    yield find


def _lines(path: Path) -> list[str]:
    data = path.read_bytes()
    if b"\0" in data[:4096]:
        raise InvalidInput(
            "it is no text; export the record as a text table, or as a file of MATLAB or LabVIEW"
        )
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("cp1252", errors="replace")  # what spreadsheets write elsewhere
    lines = [line for line in text.splitlines() if line.strip()]
    if any(len(line) > _LINE for line in lines[:_HEAD]):
        raise InvalidInput(f"a line has more than {_LINE} characters; is it a record?")
    return lines


def _form(lines: list[str]) -> tuple[str | None, bool, int, int]:
    """Separator, whether commas are decimal, index of the first row of numbers, and how many
    numbers a row has.
    """
    sample = lines[-20:] if len(lines) > 40 else lines[len(lines) // 2 :]
    for separator in _SEPARATORS:
        for comma in (False, True) if separator != "," else (False,):
            widths = {_width(line, separator, comma) for line in sample}
            if len(widths) != 1 or 0 in widths or (separator is not None and widths == {1}):
                continue
            width = widths.pop()
            for start, line in enumerate(lines[:_HEAD]):
                if _width(line, separator, comma) == width:
                    return separator, comma, start, width
    remedy = "export numbers in columns, separated by comma, semicolon, tab or spaces"
    if not any(line.strip() for line in lines):
        raise InvalidInput(f"the file is empty; {remedy}")
    raise InvalidInput(
        f"its last rows are no numbers in equally many columns (line {len(lines)}); {remedy}, and "
        "copy all of it"
    )


def _numbers(line: str, separator: str | None, comma: bool) -> str:
    """A row with decimal points, and without a separator at its end."""
    line = line.strip("\r\n ")
    line = line[:-1] if separator is not None and line.endswith(separator) else line
    return line.replace(",", ".") if comma else line


def _width(line: str, separator: str | None, comma: bool) -> int:
    """How many numbers a row has; 0 where a cell is none."""
    cells = line.rstrip("\r\n").split(separator)
    if len(cells) > 1 and not cells[-1].strip():
        cells.pop()  # a separator at the end
    try:
        for cell in cells:
            float(cell.replace(",", ".") if comma else cell)
    except ValueError:
        return 0
    return len(cells)


def _header(lines: list[str], separator: str | None, width: int) -> tuple[list[str], list[str]]:
    """Names and units of the columns: the last line of so many cells, and one of units below it."""
    rows = [_cells(line, separator) for line in lines]
    full = [row for row in rows if len(row) == width and any(row)]
    names, below = (full[-1], []) if full else ([""] * width, [])
    if len(full) > 1 and len(rows) > 1 and rows[-1] is full[-1] and rows[-2] is full[-2]:
        names, below = full[-2], full[-1]
    matches = [_CELL.fullmatch(cell) for cell in names]
    headings = [
        (match[1] or "", match[2] or "") if match else (cell, "")
        for match, cell in zip(matches, names, strict=True)
    ]
    units = [cell.strip("[]() ") for cell in below] or [""] * width
    return [name for name, _ in headings], [
        unit or other for (_, unit), other in zip(headings, units, strict=True)
    ]


def _cells(line: str, separator: str | None) -> list[str]:
    cells = [
        cell.strip().strip('"').strip()
        for cell in line.strip().lstrip("#%").strip("\r\n").split(separator)
    ]
    return cells[:-1] if len(cells) > 1 and not cells[-1] else cells


@dataclass(frozen=True, slots=True)
class _Set:
    names: tuple[str, ...]
    unit: str
    rate: float | None
    values: np.ndarray


@contextmanager
def universal(path: Path) -> Iterator[Find]:
    """By the first line of a dataset 58 ("y_A_zeta"), by node and direction ("101:+Z") or by place
    ("set 2").

    Raises InvalidInput.
    """
    sets = list(_sets(path.read_bytes()))
    if not sets:
        raise InvalidInput(
            "it holds no dataset 58 (function at a nodal degree of freedom); export time signals "
            "as such"
        )

    def find(name: str) -> Variable:
        place = re.fullmatch(r"set (\d+)", name)
        chosen = [item for item in sets if name in item.names] or (
            [sets[int(place[1]) - 1]] if place and 1 <= int(place[1]) <= len(sets) else []
        )
        if len(chosen) != 1:
            known = [item.names[0] for item in sets]
            if len(chosen) > 1:
                raise InvalidInput(
                    f'{len(chosen)} datasets are called {name!r}; name one by its place, "set 1" '
                    f'to "set {len(sets)}"'
                )
            raise unknown(name, known, "dataset")
        return Variable(chosen[0].values, chosen[0].unit, chosen[0].rate)

    yield find


def _sets(data: bytes) -> Iterator[_Set]:
    at = 0
    while (
        match := re.compile(rb"^ {4}-1[ \t]*\r?\n[ \t]*58(b?)([^\n]*)\n", re.MULTILINE).search(
            data, at
        )
    ) is not None:
        head, at = _take(data, match.end(), 11)
        if match[1]:
            count = [int(word) for word in match[2].split()[:4]]
            raw, at = data[at : at + count[3]], at + count[3]
            yield _set(head, raw, "<" if count[0] == 1 else ">")
        else:
            end = re.compile(rb"^ {4}-1[ \t]*\r?$", re.MULTILINE).search(data, at)
            if end is None:
                raise InvalidInput("its last dataset has no end; copy the whole file")
            yield _set(head, data[at : end.start()], "")
            at = end.end()


def _take(data: bytes, at: int, count: int) -> tuple[list[str], int]:
    lines = []
    for _ in range(count):
        end = data.find(b"\n", at)
        if end < 0:
            raise InvalidInput("its last dataset is cut off; copy the whole file")
        lines.append(data[at:end].decode("cp1252", errors="replace").rstrip("\r"))
        at = end + 1
    return lines, at


def _set(head: list[str], body: bytes, order: str) -> _Set:
    """A dataset: eleven lines of heading, then numbers as text, or as bytes of that order."""
    title = head[0].strip()
    try:
        kind, (code, count, even) = (
            int(head[5][:5]),
            (int(head[6][i : i + 10]) for i in (0, 10, 20)),
        )
        step = float(head[6][43:56])
        node, direction = int(head[5][41:51]), int(head[5][51:55])
    except (ValueError, IndexError):
        raise InvalidInput(
            f"the heading of the dataset {title!r} cannot be read; export it again as dataset 58"
        ) from None
    if kind != 1 or code not in _REAL:
        what = "a function of another kind than time response" if kind != 1 else "complex numbers"
        raise InvalidInput(
            f"the dataset {title!r} holds {what}; export real time signals (function type 1)"
        )
    if not 0 < count <= FOREIGN_NUMBERS:
        raise InvalidInput(
            f"the dataset {title!r} states {count} numbers, at most {FOREIGN_NUMBERS} are read; "
            "export it in parts"
        )
    if not even or not step > 0:
        raise InvalidInput(
            f"the dataset {title!r} is not evenly spaced in time; export it with a constant step"
        )
    dtype, per_line, size = _REAL[code]
    if order:
        values = np.frombuffer(
            body[: len(body) // int(dtype[1]) * int(dtype[1])], f"{order}{dtype}"
        ).astype(float)
    else:
        text = body.decode("ascii", errors="replace").replace("\r", "").split("\n")
        cells = [
            row[i : i + size]
            for row in text
            for i in range(0, min(len(row.rstrip()), per_line * size), size)
        ]
        try:
            values = np.array([float(cell.replace("D", "E")) for cell in cells])
        except ValueError:
            raise InvalidInput(
                f"the numbers of the dataset {title!r} cannot be read; export it again"
            ) from None
    if len(values) != count:
        raise InvalidInput(
            f"the dataset {title!r} states {count} numbers and holds {len(values)}; copy the "
            "whole file"
        )
    axis = "XYZ"[(abs(direction) - 1) % 3] if direction else ""
    place = f"{node}:{'-' if direction < 0 else '+'}{axis}" if axis else str(node)
    unit = head[8][46:66].strip()
    names = tuple(name for name in (title, place) if name and name != "NONE")
    return _Set(names or (place,), "" if unit == "NONE" else unit, 1 / step, values)


def unknown(name: str, known: list[str], kind: str) -> InvalidInput:
    """A name that the file does not know, and those that it does."""
    rest = f" and {len(known) - _SHOWN} rest" if len(known) > _SHOWN else ""
    hint = suggestion(name, known, "")
    listed = (
        f"it has {', '.join(known[:_SHOWN])}{rest}"
        if known
        else f"there is no {kind} at that place"
    )
    close = f"; {hint}" if hint.startswith("did you mean") else ""
    return InvalidInput(f"there is no {kind} {name!r} in the file; {listed}{close}")
