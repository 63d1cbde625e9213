"""Reading and writing the files of records, by their suffix.

SI in every file written; any unit of the right kind is understood when reading. Files are written
under a temporary name and renamed, so that a reader never meets half a file. A reader refuses what
it does not know and never alters its source. The formats: record/hdf5_file.py and
record/csv_file.py. Long runs: record/writer.py. Files of other programs: record/foreign.py.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from ambrose.core.checks import InvalidInput, check_path, invalid
from ambrose.machine.atomic_write import draft_of
from ambrose.machine.ordinary_file import check_source
from ambrose.record.record import Record

_SUFFIXES = (".h5", ".hdf5", ".csv")
_FOREIGN = {".mat", ".tdms", ".txt", ".dat", ".asc", ".uff", ".unv"}


def read_record(path: str | Path) -> Record:
    """The record in an HDF5 (.h5, .hdf5) or CSV (.csv) file, or what an unfinished run has left so
    far (.partial).

    Raises InvalidInput with the file's name and what is wrong.
    """
    from ambrose.record.apart import try_record
    from ambrose.record.csv_file import read_csv
    from ambrose.record.hdf5_file import read_hdf5
    from ambrose.record.stream import SUFFIX, read_stream

    path = check_path(path, "record")
    hdf5 = lambda path: read_hdf5(path, lambda: try_record(path))  # noqa: E731
    reader = _by_suffix(path, {".h5": hdf5, ".hdf5": hdf5, ".csv": read_csv, SUFFIX: read_stream})
    check_source(path, "record")
    try:
        return reader(path)
    except (InvalidInput, OSError) as error:
        raise InvalidInput(f"{path}: {error}") from error


def write_record(record: Record, path: str | Path) -> Path:
    """Write the record as HDF5 (.h5, .hdf5) or CSV (.csv), atomically; returns the path. Raises
    InvalidInput.
    """
    from ambrose.record.csv_file import write_csv
    from ambrose.record.hdf5_file import write_hdf5

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
        remedy = f"{remedy}: see docs/records.md"
        raise invalid(
            f"the suffix of {path.name}",
            repr(path.suffix),
            f"one of {', '.join(_SUFFIXES)}",
            remedy,
        )
    return choices[path.suffix.lower()]
