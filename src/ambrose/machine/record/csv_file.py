"""Records as CSV: "# key: value" lines, a header of names with units, the time in the first column."""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np

from ambrose.core.checks import InvalidInput, invalid
from ambrose.machine.record.attributes import RecordAttributes, read_attributes, record_of
from ambrose.machine.record.record import Record, si_values
from ambrose.machine.record.timing import uniform_rate

_HEADER = re.compile(r"\s*([^\[\]]*?)\s*(?:\[([^\[\]]*)\]\s*)?")


def write_csv(record: Record, path: Path) -> None:
    """Numbers with seventeen digits, so that reading gives back the same; the number of samples shows a truncated file."""
    attributes = {**record.attributes, "samples": record.values.shape[1]}
    header = ["time [s]", *(f"{name} [{unit}]" for name, unit in zip(record.signals, record.units, strict=True))]
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.writelines(f"# {key}: {value}\n" for key, value in attributes.items())
        file.write(",".join(header) + "\n")
        np.savetxt(file, np.column_stack([record.time, record.values.T]), fmt="%.17g", delimiter=",")


def read_csv(path: Path) -> Record:
    """The record; a spreadsheet's byte order mark and line ends are understood. Raises InvalidInput."""
    import warnings

    try:
        with path.open(encoding="utf-8-sig") as file:
            lines: dict[str, str] = {}
            line = file.readline()
            while line.startswith("#"):
                key, colon, value = line[1:].partition(":")
                if colon:
                    lines[key.strip()] = value.strip()
                line = file.readline()
            attributes = read_attributes(lines)
            columns = _csv_columns(line)
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                table = np.loadtxt(file, delimiter=",", comments=None, ndmin=2)
    except InvalidInput:
        raise
    except (ValueError, UserWarning) as error:
        raise InvalidInput(f"the rows below the header cannot be read ({error}); give a number in every cell") from error
    if table.shape[1] != len(columns):
        raise invalid("the number of columns", table.shape[1], f"{len(columns)} as in the header", "export it again")
    _check_complete(path, attributes, len(table))
    time = si_values("time", columns[0][1], table[:, 0])[0]
    rate = uniform_rate(time, attributes.sample_rate_hz)
    return record_of(attributes, columns[1:], table[:, 1:].T.copy(), rate, float(time[0]))


def _csv_columns(line: str) -> list[tuple[str, str]]:
    if ";" in line or "\t" in line:
        raise invalid("the separator of the columns", "a semicolon or tab", "a comma", "export with comma and decimal point")
    columns = []
    for cell in line.rstrip("\r\n").split(","):
        match = _HEADER.fullmatch(cell)
        if match is None or not match[1] or match[2] is None:
            raise invalid("the header cell", repr(cell.strip()), "a name with its unit, such as y_A_zeta [m]", "add the unit")
        columns.append((match[1], match[2]))
    if columns[0][0] != "time" or len(columns) < 2:
        raise invalid("the first column", repr(columns[0][0]), "time [s], followed by signals", "put the time first")
    return columns


def _check_complete(path: Path, attributes: RecordAttributes, rows: int) -> None:
    """Refuse a file that states its number of samples and does not hold them all, to the end of the last line."""
    if attributes.samples is None:
        return
    with path.open("rb") as file:
        file.seek(-1, os.SEEK_END)
        ended = file.read(1) == b"\n"
    if rows != attributes.samples or not ended:
        raise invalid(
            "the number of whole rows", rows - (not ended), f"{attributes.samples:.0f}", "the file is truncated: copy it again"
        )
