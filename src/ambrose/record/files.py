"""Reading and writing the files of records, by their suffix.

SI in every file written; any unit of the right kind is understood when reading. Files are written
under a temporary name and renamed, so that a reader never meets half a file. A reader refuses what
it does not know and never alters its source. The formats: record/hdf5_file.py and
record/files.py. Long runs: record/stream.py. Files of other programs: record/foreign.py.
"""

import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from ambrose.core.checks import InvalidInput, check_path, invalid
from ambrose.machine.ordinary_file import (
    CHECKED_FIRST,
    NAME,
    NOTES,
    NUMBERS,
    SIGNALS,
    check_source,
    draft_of,
)
from ambrose.machine.units import quoted
from ambrose.record.hdf5_file import (
    RecordAttributes,
    read_attributes,
    read_hdf5,
    record_of,
    write_hdf5,
)
from ambrose.record.record import Record, si_values, uniform_rate
from ambrose.record.text_uff import number_block, refuse_encoding, refuse_separators

# Records as CSV: "# key: value" lines, a header of names with units, the time in the first column.


_HEAD_LINE = 3 * NAME * SIGNALS  # characters
_CELL, _BLANK = 100, 1000  # characters of a cell at most, on average; blank lines
_BLOCK, _READ = 200_000, 1 << 20  # numbers, and bytes, read together
_HEADER = re.compile(r"\s*([^\[\]]*?)\s*(?:\[([^\[\]]*)\]\s*)?")


def write_csv(record: Record, path: Path) -> None:
    """Numbers with seventeen digits, so that reading gives back the same; the number of samples
    shows a truncated file.
    """
    attributes = {**record.attributes, "samples": record.values.shape[1]}
    header = [
        "time [s]",
        *(f"{name} [{unit}]" for name, unit in zip(record.signals, record.units, strict=True)),
    ]
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.writelines(f"# {key}: {value}\n" for key, value in attributes.items())
        file.write(",".join(header) + "\n")
        np.savetxt(
            file, np.column_stack([record.time, record.values.T]), fmt="%.17g", delimiter=","
        )


def read_csv(path: Path) -> Record:
    """The record; a spreadsheet's byte order mark and line ends are understood. Raises
    InvalidInput.
    """
    with path.open("rb") as raw:
        refuse_encoding(raw.read(4096))
    with path.open(encoding="utf-8-sig") as file:
        try:
            lines: dict[str, str] = {}
            head = _lines(file, _HEAD_LINE)
            for count, line in enumerate(head):
                if not line.startswith("#"):
                    break
                if count > 2 * NOTES:
                    raise invalid(
                        "the number of lines that begin with #",
                        "larger",
                        f"at most {2 * NOTES}",
                        "leave some out",
                    )
                key, colon, value = line[1:].partition(":")
                if colon:
                    lines[key.strip()] = value.strip()
            else:
                line = ""
            if lines:  # a record, and no log of another program
                refuse_separators(line)
            attributes = read_attributes(lines)
            columns = _csv_columns(line)
            # refuses names and units first
            record_of(attributes, columns[1:], np.zeros((len(columns) - 1, 1)), 1.0, 0.0)
            time, values = _rows(file, file.tell(), columns)
        except InvalidInput:
            raise
        except UnicodeDecodeError as error:
            raise InvalidInput(
                "it is not a CSV file of this package (it is not in UTF-8); save it as CSV in "
                "UTF-8, or give the column map of a foreign log (ambrose convert --columns)"
            ) from error
        except ValueError as error:
            raise InvalidInput(
                f"the rows below the header cannot be read ({error}); give a number in every cell"
            ) from error
    _check_complete(path, attributes, len(time))
    time = si_values("time", columns[0][1], time)[0]
    rate = uniform_rate(time, attributes.sample_rate_hz)
    return record_of(attributes, columns[1:], values, rate, float(time[0]))


def _lines(file: TextIO, longest: int) -> Iterator[str]:
    """The lines that are not blank. Raises InvalidInput for a longer one, without reading all of
    it.
    """
    blank = 0
    while line := file.readline(longest + 1):
        if len(line) > longest:
            raise invalid(
                "the length of a line",
                "larger",
                f"at most {longest} characters",
                "is this a record?",
            )
        if not line.isspace():
            yield line
        elif (blank := blank + 1) > _BLANK:
            raise invalid("the number of blank lines", "larger", f"at most {_BLANK}", "remove them")


def _rows(
    file: TextIO, start: int, columns: Sequence[tuple[str, str]]
) -> tuple[np.ndarray, np.ndarray]:
    """Times (k,) and values (p, k) of the rows behind ``start``, block by block: they take the
    memory of the numbers once.
    """
    width = len(columns)

    def lines() -> Iterator[str]:
        file.seek(start)
        return _lines(file, _CELL * width)

    with open(file.name, "rb") as raw:
        ends = (
            (part.count(b"\n"), part.count(b"\r")) for part in iter(lambda: raw.read(_READ), b"")
        )
        rows = 1 + sum(max(pair) for pair in ends)  # at least so many
    if rows * width > NUMBERS:
        raise invalid(
            "the number of values", rows * width, f"at most {NUMBERS}", "split the record"
        )
    if rows * width > CHECKED_FIRST:
        rows = sum(len(table) for _, table in _blocks(lines(), columns))
    time = np.empty(rows)
    values = np.empty((width - 1, rows))
    filled = 0
    for first, table in _blocks(lines(), columns):
        filled = first + len(table)
        time[first:filled], values[:, first:filled] = table[:, 0], table[:, 1:].T
    if filled == 0:
        raise ValueError("there is none")
    return time[:filled], values if filled == rows else values[:, :filled].copy()


def _blocks(
    lines: Iterator[str], columns: Sequence[tuple[str, str]]
) -> Iterator[tuple[int, np.ndarray]]:
    """Number of the first row and numbers (n, columns) of one block after the other, all of them
    finite.
    """
    first = 0
    while block := list(islice(lines, max(1, _BLOCK // len(columns)))):
        where = range(first + 1, first + len(block) + 1)
        table = number_block(block, ",", len(columns), where, empty=False, what="data row")
        if not np.isfinite(table).all():
            i, j = (int(index) for index in np.argwhere(~np.isfinite(table))[0])
            if j == 0:
                raise invalid(
                    "a time", "not finite", "a number", f"look at data row {first + i + 1}"
                )
            at = f"{columns[j][0]} at sample {first + i} (t = {table[i, 0]:g} s)"
            raise invalid(at, table[i, j], "finite", "cut the record before it, or measure again")
        yield first, table
        first += len(table)


def _csv_columns(line: str) -> list[tuple[str, str]]:
    columns = []
    if line.count(",") > SIGNALS:
        raise invalid(
            "the number of signals", line.count(","), f"at most {SIGNALS}", "split the record"
        )
    for cell in line.rstrip("\r\n").split(","):
        match = _HEADER.fullmatch(cell.strip()) if len(cell) < 3 * NAME else None
        if match is None or not match[1] or match[2] is None:
            raise invalid(
                "the header cell",
                quoted(cell.strip()),
                "a name with its unit, such as y_A_zeta [m]",
                "add the unit",
            )
        columns.append((match[1], match[2]))
    if columns[0][0] != "time" or len(columns) < 2:
        raise invalid(
            "the first column",
            quoted(columns[0][0]),
            "time [s], followed by signals",
            "put the time first",
        )
    return columns


def _check_complete(path: Path, attributes: RecordAttributes, rows: int) -> None:
    """Refuse a file that states its number of samples and does not hold them all, to the end of the
    last line.
    """
    if attributes.samples is None:
        return
    with path.open("rb") as file:
        file.seek(-1, os.SEEK_END)
        ended = file.read(1) == b"\n"
    if rows != attributes.samples or not ended:
        raise invalid(
            "the number of whole rows",
            rows - (not ended),
            f"{attributes.samples:.0f}",
            "the file is truncated: copy it again",
        )


_SUFFIXES = (".h5", ".hdf5", ".csv")
_FOREIGN = {".mat", ".tdms", ".txt", ".dat", ".asc", ".uff", ".unv"}


def read_record(path: str | Path | Record) -> Record:
    """The record in an HDF5 (.h5, .hdf5) or CSV (.csv) file, or what an unfinished run has left so
    far (.partial). A Record is as it is.

    Raises InvalidInput with the file's name and what is wrong.
    """
    from ambrose.record.apart import try_record
    from ambrose.record.stream import SUFFIX, read_stream

    if isinstance(path, Record):
        return path
    path = check_path(path, "record")
    hdf5 = lambda path: read_hdf5(path, lambda: try_record(path))  # noqa: E731
    reader = _by_suffix(path, {".h5": hdf5, ".hdf5": hdf5, ".csv": read_csv, SUFFIX: read_stream})
    check_source(path, "record")
    try:
        return reader(path)
    except (InvalidInput, OSError) as error:
        raise InvalidInput(f"{path}: {error}") from error


def names_of_files(items: Iterable[Any]) -> tuple[str, ...]:
    """The names of those that are files."""
    return tuple(Path(item).name for item in items if isinstance(item, str | os.PathLike))


def write_record(record: Record, path: str | Path) -> Path:
    """Write the record as HDF5 (.h5, .hdf5) or CSV (.csv), atomically; returns the path. Raises
    InvalidInput.
    """
    path = check_path(path, "record")
    if not isinstance(record, Record):
        raise invalid(
            "the record", type(record).__name__, "a Record", "read_record and simulate give one"
        )
    writer = _by_suffix(path, {".h5": write_hdf5, ".hdf5": write_hdf5, ".csv": write_csv})
    with draft_of(path, "record") as draft:
        writer(record, draft)
    return path


def check_suffix(path: Path) -> None:
    """Refuses a name that write_record would refuse. Raises InvalidInput."""
    _by_suffix(path, dict.fromkeys(_SUFFIXES, read_record))


def _by_suffix(path: Path, choices: Mapping[str, Callable[..., Any]]) -> Callable[..., Any]:
    if path.suffix.lower() not in choices:
        foreign = path.suffix.lower() in _FOREIGN
        remedy = (
            "read it with a column map (ambrose convert --columns), or export it as a kind that "
            "has one"
        )
        remedy = (
            remedy if foreign else "export it as one of them, or as one that a column map reads"
        )
        remedy = f"{remedy}: see docs/reference/records.md"
        raise invalid(
            f"the suffix of {path.name}",
            repr(path.suffix),
            f"one of {', '.join(_SUFFIXES)}",
            remedy,
        )
    return choices[path.suffix.lower()]
