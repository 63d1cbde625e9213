"""Channels in text tables of any program (*.csv, *.txt, *.dat, *.asc) and in universal files
(*.uff, *.unv), dataset 58.

A table's separator, decimal mark and header lines are found by looking at its rows: from the first
data row on every row has the same number of cells, and all of them are numbers or empty. What
cannot be told apart is refused, never guessed (machine/file/stations.py).
"""

import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ambrose.core.checks import InvalidInput
from ambrose.machine.file.stations import (
    Cell,
    decimal_mark,
    heading,
    refuse_counts,
    refuse_two_marks,
)
from ambrose.machine.ordinary_file import FOREIGN_NUMBERS, NAME, SIGNALS
from ambrose.machine.units import DIMENSIONS, in_si, quoted, suggestion

_LINE = 3 * NAME * SIGNALS  # characters
_HEAD = 1000  # lines before the first row of numbers
_SEPARATORS = ("\t", ";", ",", None)  # None: spaces
_BLOCK = 20_000  # rows converted together
_NAMES = re.compile(r"[^\s\[(]+(?:\s*[\[(][^\])]*[\])])?")  # between spaces, "x [um]" as one
# a mark that no digits are set apart by: other than three digits follow, or zeros stand before
_DECIMALS = re.compile(r"[.,](?!\d{3}(?![\deEdD]))|(?<![1-9\d])0*[.,]|\d{4}[.,]")
_ONE_NUMBER = re.compile(r"\s*[+-]?\d+,\d+\s*")
# of dataset 58: kind of number, numbers a line, characters a number; complex ones are pairs
_REAL = {2: ("f4", 6, 13), 4: ("f8", 4, 20), 5: ("f4", 6, 13), 6: ("f8", 4, 20)}
_COMPLEX = (5, 6)
_TIMES, _RESPONSES = 1, 4  # types of function
ABSCISSA = "abscissa of "  # before the name of a dataset: its frequencies [Hz]

_ORDERS = {1: "<", 2: ">"}  # of its bytes
_IEEE = 2
_FLOATS = {1: "VAX", 3: "IBM"}
_TIME, _FREQUENCY = (0, 17), (0, 18)  # what its abscissa may be: not said, or that
_HERTZ = ("", "hz", "hertz")
_SECONDS = dict.fromkeys(("none", "", "sec", "secs", "second", "seconds", "s"), "s")

_SHOWN = 20  # names in a message


@dataclass(frozen=True, slots=True)
class Variable:
    """One axis of numbers (k,) as the file means them, its own scale and offset counted; unit,
    sample rate [Hz] and time of the first sample [s] where the file states them.

    bad: the first sample that is not finite.
    """

    values: np.ndarray
    unit: str = ""
    rate: float | None = None
    start: float | None = None
    bad: int | None = None


Find = Callable[[str], Variable]


@contextmanager
def text_table(path: Path) -> Iterator[Find]:
    """By the name in the header, or by place: "column 2". Raises InvalidInput."""
    lines = _lines(path)
    separator, start, width = _form(lines)
    rows, where = lines[start:], [number for number, _ in lines[start:]]
    if len(rows) * width > 4 * FOREIGN_NUMBERS:
        raise InvalidInput(f"it has more than {4 * FOREIGN_NUMBERS} numbers; export it in parts")
    mark = "." if separator == "," else _mark(rows, separator)
    parts = []
    for first in range(0, len(rows), _BLOCK):
        block = [line for _, line in rows[first : first + _BLOCK]]
        if mark == ",":
            block = [line.replace(",", ".") for line in block]
        parts.append(number_block(block, separator, width, where[first:], empty=True))
    table = np.vstack(parts)
    headings = _headings(lines[:start], separator, width, rows, table)
    names = [name for name, _ in headings]

    def find(name: str) -> Variable:
        place = re.fullmatch(r"column (\d+)", name)
        if names.count(name) > 1:
            raise InvalidInput(
                f"the column {name!r} stands there {names.count(name)} times; name it by its "
                'place, "column 2"'
            )
        if name in names:
            index = names.index(name)
        elif place and 1 <= int(place[1]) <= len(names):
            index = int(place[1]) - 1
        else:
            places = [f"column 1 to column {len(names)}"]
            raise unknown(name, [*filter(None, names)] or places, "column")
        values, row = table[:, index], int(np.argmax(np.isnan(table[:, index])))
        if np.isnan(values[row]) and not _cells(rows[row][1], separator)[index]:
            raise InvalidInput(
                f"the column {name!r} is empty in line {where[row]}; fill the cell, or leave out "
                "the rows or the column"
            )
        return Variable(values, headings[index][1])

    yield find


def number_block(
    rows: Sequence[str],
    separator: str | None,
    width: int,
    where: Sequence[int],
    *,
    empty: bool,
    what: str = "line",
) -> np.ndarray:
    """Rows of ``width`` numbers (n, width), with decimal points; where: the numbers of their
    lines, or of ``what`` they are. empty: an empty cell is NaN, otherwise it is refused. Raises
    InvalidInput with place and cell.
    """
    try:
        table = np.loadtxt(rows, delimiter=separator, comments=None, ndmin=2)
        if table.shape == (len(rows), width):
            return table
    except ValueError:
        pass  # whose words are for programmers
    numbers = np.full((len(rows), width), np.nan)
    for row, (line, text) in enumerate(zip(where, rows, strict=False)):
        cells = text.rstrip("\r\n").split(separator)
        refuse_counts(line, len(cells), width, "there are", what)
        for place, cell in enumerate(cells):
            if not _is_number(cell.strip()) or not (empty or cell.strip()):
                found = f"{quoted(cell.strip())} is no number" if cell.strip() else "it is empty"
                raise InvalidInput(
                    f"{what} {line}, column {place + 1}: {found}; give a number in every cell, and "
                    "export the rest apart"
                )
            if cell.strip():
                numbers[row, place] = float(cell)
    return numbers


def refuse_encoding(start: bytes) -> None:
    """Raises InvalidInput for the first bytes of a file that are no text, or text in UTF-16."""
    marked = start[:2] in (b"\xff\xfe", b"\xfe\xff")
    # of plain letters every second byte is zero
    halves = [half.count(0) for half in (start[0::2], start[1::2])]
    if marked or (max(halves) > 0.4 * len(start) and min(halves) == 0):
        raise InvalidInput('it is text in UTF-16 ("Unicode text"); save it as CSV in UTF-8')
    if b"\0" in start:
        raise InvalidInput(
            "it is not text; export the record as a text table, or as a file of MATLAB or LabVIEW"
        )


def refuse_separators(header: str) -> None:
    """Raises InvalidInput for a line of headings that commas do not separate."""
    found = [name for mark, name in ((";", "a semicolon"), ("\t", "a tab")) if mark in header]
    if found:
        raise InvalidInput(
            f"its columns are separated by {found[0]}, but must be by commas; export it with "
            "commas and decimal points, or give a column map (ambrose convert --columns)"
        )


def _lines(path: Path) -> list[Cell]:
    """The lines that are not blank, with their numbers."""
    data = path.read_bytes()
    refuse_encoding(data[:4096])
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("cp1252", errors="replace")  # what spreadsheets write elsewhere
    lines = [(n, line) for n, line in enumerate(text.splitlines(), 1) if line.strip()]
    if any(len(line) > _LINE for _, line in lines[:_HEAD]):
        raise InvalidInput(f"a line has more than {_LINE} characters; is it a record?")
    return lines


def _form(lines: list[Cell]) -> tuple[str | None, int, int]:
    """Separator, index of the first row of numbers, and how many cells a row has."""
    sample = lines[-20:] if len(lines) > 40 else lines[len(lines) // 2 :]
    for separator in _SEPARATORS:
        widths = {_width(line, separator) for _, line in sample}
        if len(widths) != 1 or 0 in widths or (separator is not None and widths == {1}):
            continue
        width = widths.pop()
        for start, (_, line) in enumerate(lines[:_HEAD]):
            following = lines[min(start + 1, len(lines) - 1)][1]
            if _width(line, separator) == width == _width(following, separator):
                return separator, start, width
    remedy = "export numbers in columns, separated by comma, semicolon, tab or spaces"
    if not lines:
        raise InvalidInput(f"the file is empty; {remedy}")
    raise InvalidInput(
        f"its last rows are no numbers in equally many columns (line {lines[-1][0]}); {remedy}, "
        "and copy all of it"
    )


def _is_number(cell: str) -> bool:
    try:
        float(cell or "0")
    except ValueError:
        return False
    return True


def _width(line: str, separator: str | None) -> int:
    """How many cells a row of numbers has, empty ones too; 0 where a cell is no number."""
    cells = line.strip("\r\n").split(separator)
    if separator != ",":
        cells = [cell.replace(",", ".") for cell in cells]
    kept = [cell.strip() for cell in cells]
    return len(kept) if any(kept) and all(map(_is_number, kept)) else 0


def _mark(rows: list[Cell], separator: str | None) -> str:
    """The decimal mark of rows in which commas do not separate. Raises InvalidInput."""
    refuse_two_marks(*(next((row for row in rows if mark in row[1]), None) for mark in ",."))
    if all(_DECIMALS.search(line) is None for _, line in rows):
        cells = ([(n, cell) for cell in _cells(line, separator)] for n, line in rows)
        return decimal_mark([*zip(*cells, strict=False)])
    return "," if any("," in line for _, line in rows) else "."


def _headings(
    lines: list[Cell],
    separator: str | None,
    width: int,
    rows: list[Cell],
    table: np.ndarray,
) -> list[tuple[str, str]]:
    """Names and units of the columns: the last line of so many cells, and one of units below it.
    The last line before the numbers names them all, or none. Raises InvalidInput.
    """
    head = [_named(line, separator, width) for _, line in lines]
    if width > 1 and np.isnan(table[:, -1]).all() and not (head and len(head[-1]) == width):
        width -= 1  # a separator at the end of each row
    head = [
        row[:width] if len(row) == width + 1 and row[-1] in ("", "Comment") else row for row in head
    ]
    full = [row for row in head if len(row) == width and any(row)]
    last = len(head[-1]) if head else 0
    if last > 1 and lines[-1][1].lstrip()[0] not in "#%":
        refuse_counts(rows[0][0], width, last)
    if separator == ",":
        _refuse_commas(rows, width, last)
    names, below = (full[-1], [""] * width) if full else ([""] * width, [""] * width)
    if len(full) > 1 and head[-1] is full[-1] and head[-2] is full[-2]:
        names, below = full[-2], full[-1]
    found = [heading(cell) for cell in names]
    return [
        (name, unit or other.strip("[]() "))
        for (name, unit), other in zip(found, below, strict=True)
    ]


def _refuse_commas(rows: list[Cell], width: int, named: int) -> None:
    """Raises InvalidInput where commas may as well be decimal marks."""
    for line, text in rows[:20]:
        if re.search(r"(?:^|,)\s*0\d+\s*(?:,|$)", text):
            raise InvalidInput(
                f"{quoted(text)} in line {line} may have decimal commas between separating ones; "
                "export it with decimal points, or with semicolons"
            )
    if width == 2 and named != 2 and all(_ONE_NUMBER.fullmatch(text) for _, text in rows):
        raise InvalidInput(
            f"its rows may have 2 numbers, or 1 with a decimal comma ({quoted(rows[0][1])}), and "
            f"its header names {named}; export it with decimal points, or name both columns"
        )


def _named(line: str, separator: str | None, width: int) -> list[str]:
    """The cells of a line that may name columns; between spaces, "x [um]" is one."""
    if separator is not None:
        return _cells(line.strip().lstrip("#%"), separator)
    text = line.strip().lstrip("#%").strip()
    wide = re.split(r"\s{2,}", text)
    return wide if len(wide) == width else _NAMES.findall(text)


def _cells(line: str, separator: str | None) -> list[str]:
    return [cell.strip().strip('"').strip() for cell in line.strip("\r\n").split(separator)]


@contextmanager
def universal(path: Path) -> Iterator[Find]:
    """By the first line of a dataset 58 ("y_A_zeta"), by node and direction ("101:+Z") or by place
    ("set 2").

    Raises InvalidInput.
    """
    sets = list(_sets(path.read_bytes()))
    if not sets:
        raise InvalidInput(
            "it has no dataset 58 (function at a nodal degree of freedom); export time signals "
            "as such"
        )

    def find(name: str) -> Variable:
        place = re.fullmatch(rf"({ABSCISSA})?set (\d+)", name)
        kind = [
            item for item in sets if item[0][0].startswith(ABSCISSA) == bool(place and place[1])
        ]
        chosen = [found for names, found in sets if name in names] or (
            [kind[int(place[2]) - 1][1]] if place and 1 <= int(place[2]) <= len(kind) else []
        )
        if len(chosen) > 1:
            raise InvalidInput(
                f'{len(chosen)} datasets are called {name!r}; name one by its place, "set 1" '
                f'to "set {len(sets)}"'
            )
        if not chosen:
            raise unknown(name, [names[0] for names, _ in sets], "dataset")
        return chosen[0]

    yield find


def _sets(data: bytes) -> Iterator[tuple[tuple[str, ...], Variable]]:
    """Names and numbers of every dataset 58. Raises InvalidInput."""
    begin = re.compile(rb"^ {4}-1[ \t]*\r?\n[ \t]*58(b?)([^\n]*)\n", re.MULTILINE)
    at = 0
    while (match := begin.search(data, at)) is not None:
        head, at = _take(data, match.end(), 11)
        if match[1]:
            words = match[2].split()
            if len(words) < 4 or not all(word.isdigit() for word in words[:4]):
                raise InvalidInput("the first line of a dataset 58b cannot be read; export it anew")
            order, floats, lines, size = (int(word) for word in words[:4])
            if floats != _IEEE or lines != 11 or order not in _ORDERS:
                raise InvalidInput(
                    f"the dataset {head[0].strip()!r} holds {_FLOATS.get(floats, 'unknown')} "
                    f"floats under {lines} lines of heading, but IEEE ones under 11 are read; "
                    "export it as text, or with IEEE floats"
                )
            yield from _set(head, data[at : at + size], _ORDERS[order])
            at += size
        else:
            end = re.compile(rb"^ {4}-1[ \t]*\r?$", re.MULTILINE).search(data, at)
            if end is None:
                raise InvalidInput("its last dataset has no end; copy the whole file")
            yield from _set(head, data[at : end.start()], "")
            at = end.end()


def _take(data: bytes, at: int, count: int) -> tuple[list[str], int]:
    lines = []
    for _ in range(count):
        end = data.find(b"\n", at)
        if end < 0:
            raise InvalidInput("its last dataset is cut off; copy the whole file")
        try:
            line = data[at:end].decode("utf-8")
        except UnicodeDecodeError:
            line = data[at:end].decode("cp1252", errors="replace")
        lines.append(line.rstrip("\r"))
        at = end + 1
    return lines, at


def _set(head: list[str], body: bytes, order: str) -> Iterator[tuple[tuple[str, ...], Variable]]:
    """A dataset: eleven lines of heading, then numbers as text, or as bytes of that order; of a
    frequency response its frequencies, too.
    """
    title = head[0].strip()
    try:
        kind, abscissa = int(head[5][:5]), int(head[7][:10])
        code, count, even = (int(head[6][i : i + 10]) for i in (0, 10, 20))
        start, step = (float(head[6][i : i + 13]) for i in (30, 43))
        node, direction = int(head[5][41:51]), int(head[5][51:55])
    except (ValueError, IndexError):
        raise InvalidInput(
            f"the heading of the dataset {title!r} cannot be read; export it again as dataset 58"
        ) from None
    responses = kind == _RESPONSES and code in _COMPLEX
    if not responses and (kind != _TIMES or code not in _REAL or code in _COMPLEX):
        what = "complex numbers" if kind == _TIMES else "a function of another kind"
        raise InvalidInput(
            f"the dataset {title!r} holds {what}, neither a time response (function type 1, real) "
            "nor a frequency response (type 4, complex); export it as one of them"
        )
    if not 0 < count <= FOREIGN_NUMBERS:
        raise InvalidInput(
            f"the dataset {title!r} states {count} numbers, at most {FOREIGN_NUMBERS} are read; "
            "export it in parts"
        )
    places = [f"{node}:{_sense(direction)}" if direction else str(node)]
    unit, of_time = (_said(head[line][46:67]) for line in (8, 7))
    if responses:
        axis, values = _lines_of(title, body, order, code, count, (start, step) if even else None)
        node, direction = (_whole(head[5][i:j]) for i, j in ((66, 76), (76, 80)))
        places = [f"{places[0]}/{node}:{_sense(direction)}" if direction else f"{places[0]}/{node}"]
        names = tuple(name for name in (_said(title), *places) if name)
        if abscissa not in _FREQUENCY or of_time.lower() not in _HERTZ:
            raise InvalidInput(
                f"the abscissa of the dataset {title!r} is of type {abscissa} in {of_time!r}, but "
                "must be frequency in Hz; export it so"
            )
        below = _said(head[9][46:67])
        yield names, Variable(values, f"{unit}/{below}" if unit and below else "")
        yield tuple(ABSCISSA + name for name in names), Variable(axis, "Hz")
        return
    if not even or not step > 0:
        raise InvalidInput(
            f"the dataset {title!r} is not evenly spaced in time; export it with a constant step"
        )
    try:
        if abscissa not in _TIME:
            raise ValueError(f"is of type {abscissa}, but must be time; export it over time")
        second = in_si(1.0, _SECONDS.get(of_time.lower(), of_time), DIMENSIONS["time"])
    except ValueError as error:
        raise InvalidInput(f"the abscissa of the dataset {title!r} {error}") from None
    names = tuple(name for name in (_said(title), *places) if name)
    values = _values(title, body, order, code, count)
    yield names, Variable(values, unit, 1 / (step * second), start * second)


def _said(text: str) -> str:
    """A text of a heading, "" where it is said to be none."""
    return "" if text.strip() == "NONE" else text.strip()


def _whole(text: str) -> int:
    return int(text) if text.strip().lstrip("+-").isdigit() else 0


def _sense(direction: int) -> str:
    return f"{'-' if direction < 0 else '+'}{'XYZ'[(abs(direction) - 1) % 3]}"


def _lines_of(
    title: str, body: bytes, order: str, code: int, count: int, even: tuple[float, float] | None
) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies and complex values (count,); even: the first frequency and the step, else every
    value stands behind its own frequency, of thirteen characters, or single as the file likes.
    """
    if even is not None:
        pairs = _values(title, body, order, code, 2 * count).reshape(-1, 2)
        return even[0] + even[1] * np.arange(count), pairs[:, 0] + 1j * pairs[:, 1]
    if code == _COMPLEX[1] and order and len(body) == 20 * count:  # single before double
        mixed = np.frombuffer(body, [("f", f"{order}f4"), ("v", f"{order}f8", 2)])
        return mixed["f"].astype(float), mixed["v"][:, 0] + 1j * mixed["v"][:, 1]
    if code == _COMPLEX[1] and not order:
        rows = (line for line in body.split(b"\n") if line.strip())
        body = b"\n".join(b" " * 7 + line.rstrip(b"\r") for line in rows)  # all twenty wide
        threes = _values(title, body, order, code, 3 * count, 3)
    else:
        threes = _values(title, body, order, code, 3 * count)
    threes = threes.reshape(-1, 3)
    return threes[:, 0].copy(), threes[:, 1] + 1j * threes[:, 2]


def _values(
    title: str, body: bytes, order: str, code: int, count: int, per_line: int = 0
) -> np.ndarray:
    dtype, usual, size = _REAL[code]
    per_line = per_line or usual
    if order:
        whole = len(body) // int(dtype[1]) * int(dtype[1])
        values = np.frombuffer(body[:whole], f"{order}{dtype}").astype(float)
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
    filling = values[count:]  # zeros to the end of the last line, as some programs write them
    if len(values) < count or filling.any() or len(filling) >= per_line or (order and len(filling)):
        remedy = "copy the whole file" if len(values) < count else "export it anew"
        raise InvalidInput(
            f"the dataset {title!r} states {count} numbers and holds {len(values)}; {remedy}"
        )
    return values[:count]


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
