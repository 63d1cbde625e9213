"""Files of MATLAB and LabVIEW, and HDF5 of other programs, read in a process apart with a limited
amount of memory and time.

Their readers are other people's: a file that is damaged, or made to do harm, may crash them or make
them take all memory. The parent asks for variables by name; the child leaves their numbers in a
temporary file, which the parent maps. An HDF5 record is only tried: once the child came to its end,
so will the parent.
"""

import json
import math
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput
from ambrose.machine.ordinary_file import (
    CONTROLLER_NUMBERS,
    FOREIGN_NUMBERS,
    NUMBERS,
    TEXT,
    check_source,
)
from ambrose.record.hdf5_file import check_packing, opened, own_member, read_hdf5
from ambrose.record.text_uff import Variable, text_table, universal, unknown

# Variables and channels in the files of other programs: MATLAB .mat (to version 7, and 7.3) and NI
# TDMS.
#
# Each reader hands out numbers by the name that its program uses, and what the file says about
# them; nothing is interpreted here.


_PART = re.compile(r"(?P<name>.*?)\s*\(\s*(?:(?P<row>\d+)\s*,\s*:|:\s*,\s*(?P<column>\d+))\s*\)")
_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_NUMERIC = {
    b"double",
    b"single",
    b"logical",
    *(f"{sign}int{bits}".encode() for sign in ("", "u") for bits in (8, 16, 32, 64)),
}
_PACKING = ("scale_factor", "add_offset", "_FillValue", "missing_value")
_NEVER = np.datetime64("1905-01-01")  # LabVIEW's time 0, in 1904, is of a channel without a start
_TABLES, _UNIVERSAL = (".csv", ".txt", ".dat", ".asc"), (".uff", ".unv")


def read_variables(path: Path, names: Iterable[str]) -> Iterator[Variable]:
    """The variables of these names, one after the other. Raises InvalidInput; what a reader's crash
    is, apart.py knows.
    """
    with _opened(path) as find:
        for name in names:
            variable = find(name)
            finite = np.isfinite(variable.values)
            yield variable if finite.all() else replace(variable, bad=int(np.argmin(finite)))


@contextmanager
def _opened(path: Path) -> Iterator[Callable[[str], Variable]]:
    """A function from the name of a variable to its Variable, while the file is open for reading.

    MATLAB: "y", a field "log.y", a column or row of a matrix "Y(:,2)", "Y(2,:)". TDMS:
    "group/channel". HDF5: "group/dataset", and columns or rows as of MATLAB's. Raises InvalidInput.
    """
    readers = {".mat": _matlab, ".tdms": _tdms, **dict.fromkeys((".h5", ".hdf5"), _hdf5)}
    readers |= {**dict.fromkeys(_TABLES, text_table), **dict.fromkeys(_UNIVERSAL, universal)}
    if path.suffix.lower() not in readers:
        page = "see docs/reference/records.md, Files of other programs"
        raise InvalidInput(
            f"{path}: it is not of a kind known here ({', '.join(readers)}); export it as one of "
            f"them, {page}"
        )
    check_source(path, "file of another program")
    with _refused(path), readers[path.suffix.lower()](path) as find:
        yield find


def read_tree(path: Path) -> dict[str, Any]:
    """All variables of a MAT-file as plain data: matrices by rows, structs as dicts, cells as
    lists, complex numbers as text.

    Raises InvalidInput for a file of version 7.3, and for too many numbers.
    """
    import scipy.io

    check_source(path, "MAT-file")
    with _refused(path):
        if _is_hdf5(path):
            raise InvalidInput(
                "it is of MATLAB's version 7.3; save it as an older one: save('name.mat', '-v7')"
            )
        left = [CONTROLLER_NUMBERS]
        return {
            name: _plain(value, left)
            for name, value in scipy.io.loadmat(path).items()
            if not name.startswith("__")
        }


def _plain(value: Any, left: list[int]) -> Any:
    """Of what loadmat gives; left: how many numbers may still come. Objects (ss, tf) are None:
    nobody but MATLAB reads them.
    """
    import scipy.sparse

    array = value.toarray() if scipy.sparse.issparse(value) else np.asarray(value)
    left[0] -= array.size
    if left[0] < 0:
        raise InvalidInput(
            f"it holds more than {CONTROLLER_NUMBERS} numbers; save the controller alone"
        )
    if array.dtype.names:
        entries = [
            {name: _plain(entry[name], left) for name in array.dtype.names}
            for entry in array.ravel()
        ]
        return None if "arr" in array.dtype.names else entries[0] if len(entries) == 1 else entries
    if array.dtype.kind == "O":
        return [[_plain(entry, left) for entry in row] for row in np.atleast_2d(array)]
    if array.dtype.kind in "US":
        return str(array.item()) if array.size == 1 else [str(text) for text in array.ravel()]
    if array.dtype.kind == "c":
        array = np.vectorize(str, otypes=[object])(array)
    return array.tolist()


@contextmanager
def _refused(path: Path) -> Iterator[None]:
    """What a reader raises, as an InvalidInput that names the file."""
    try:
        yield
    except MemoryError:
        most = f"a variable may have {FOREIGN_NUMBERS} numbers"
        raise InvalidInput(f"{path}: it takes too much memory; {most}, save it in parts") from None
    except InvalidInput as error:
        raise InvalidInput(f"{path}: {str(error).removeprefix(f'{path}: ')}") from error
    except Exception as error:  # parsers of damaged files raise anything
        words = (str(error).splitlines() or [type(error).__name__])[0]
        raise InvalidInput(
            f"{path}: it cannot be read ({words}); it is damaged, truncated or of another kind"
        ) from error


def _is_hdf5(path: Path) -> bool:
    """By its signature, which may stand behind a block of 512, 1024 ... bytes; the library would
    ask for a lock.
    """
    places = (0, *(2**n for n in range(9, 16)))
    with path.open("rb") as file:
        return any(file.seek(at) == at and file.read(8) == _SIGNATURE for at in places)


@contextmanager
def _matlab(path: Path) -> Iterator[Callable[[str], Variable]]:
    if _is_hdf5(path):
        with opened(path) as tree:
            load = lru_cache(maxsize=1)(lambda plain: _from_tree(tree, plain, path))
            yield lambda name: _part(name, load)
    else:
        import scipy.io

        known = {name: math.prod(map(int, shape)) for name, shape, _ in scipy.io.whosmat(path)}
        top_of = lru_cache(maxsize=1)(lambda top: scipy.io.loadmat(path, variable_names=[top])[top])
        yield lambda name: _part(name, lambda plain: Variable(_from_matlab5(top_of, known, plain)))


@contextmanager
def _hdf5(path: Path) -> Iterator[Callable[[str], Variable]]:
    def load(tree: Any, plain: str) -> Variable:
        found = _from_tree(tree, plain, path, "/")
        return replace(found, values=found.values.T)

    with opened(path) as tree:
        kept = lru_cache(maxsize=1)(lambda plain: load(tree, plain))
        yield lambda name: _part(name, kept)


def _part(name: str, get: Callable[[str], Variable]) -> Variable:
    """A vector, or one row or column of a matrix."""
    match = _PART.fullmatch(name)
    found = get(match["name"] if match else name)
    array = found.values
    if array.size == 0:
        raise InvalidInput(f"the variable {name} is empty; save it with its samples")
    if array.ndim > 2 or array.dtype.kind not in "fiub":
        kind = (
            "complex numbers"
            if array.dtype.kind == "c"
            else "no numbers"
            if array.ndim <= 2
            else "a block of numbers"
        )
        raise InvalidInput(
            f"the variable {name} has {kind}, but must have real numbers in rows or columns; save "
            "its parts"
        )
    array = np.atleast_2d(array)
    if match is None:
        if min(array.shape) != 1:
            size = " x ".join(map(str, array.shape))
            raise InvalidInput(
                f"the variable {name} is {size}, but one signal is needed; name a column, such as "
                f"{name}(:,1)"
            )
        return replace(found, values=array.ravel())
    axis = 0 if match["row"] else 1
    index = int(match["row"] or match["column"])
    if not 1 <= index <= array.shape[axis]:
        what = "rows" if axis == 0 else "columns"
        raise InvalidInput(
            f"{name} does not exist, the variable has {array.shape[axis]} {what}; count from 1"
        )
    return replace(found, values=array.take(index - 1, axis=axis))


def _from_matlab5(
    load: Callable[[str], np.ndarray], known: Mapping[str, int], name: str
) -> np.ndarray:
    top, *fields = name.split(".")
    if top not in known:
        raise unknown(name, list(known), "variable")
    _check_count(top, known[top])
    value = load(top)
    for i, key in enumerate(fields):
        names = value.dtype.names or ()
        if key not in names:
            raise unknown(name, [".".join((top, *fields[:i], n)) for n in names], "variable")
        value = value[key]
        while value.dtype == object and value.size == 1:
            value = value.item()
    return np.asarray(value)


def _check_count(name: str, count: int) -> None:
    if count > FOREIGN_NUMBERS:
        raise InvalidInput(
            f"{name} has {count} numbers, but at most {FOREIGN_NUMBERS} are read; save it in parts"
        )


def _from_tree(tree: Any, name: str, path: Path, mark: str = ".") -> Variable:
    import h5py

    node = tree
    keys = name.strip("/").split(mark)
    for i, key in enumerate(keys):
        members = (
            [member for member in node if not member.startswith("#")]
            if isinstance(node, h5py.Group)
            else []
        )
        if key not in members:
            raise unknown(name, [mark.join((*keys[:i], member)) for member in members], "variable")
        node = own_member(node, key, name)
    if not isinstance(node, h5py.Dataset):
        raise unknown(name, [f"{name}{mark}{member}" for member in node], "variable")
    kind = node.attrs.get("MATLAB_class", b"double")
    kind = kind.encode() if isinstance(kind, str) else kind
    if kind not in _NUMERIC or "MATLAB_object_decode" in node.attrs:
        raise InvalidInput(
            f"the variable {name} is not an array of real numbers; save its parts as arrays"
        )
    if node.attrs.get("MATLAB_empty", 0):  # what is stored are its sizes
        return Variable(np.empty(0))
    _check_count(name, node.size or 0)
    check_packing([node], path)
    values = np.asarray(node[()]).T  # MATLAB stores column by column
    unit = _said(node, "units", "") or _said(node, "unit", "")
    return Variable(_unpacked(node, name, values), str(unit))


def _said(node: Any, key: str, default: Any) -> Any:
    """A short attribute of a dataset, a text or a number, or an array of one."""
    if key not in node.attrs or node.attrs.get_id(key).get_storage_size() > TEXT:
        return default
    value = np.asarray(node.attrs[key]).ravel()
    if value.size != 1:
        return default
    one = value[0]
    return one.decode("utf-8", "replace") if isinstance(one, bytes) else one


def _unpacked(node: Any, name: str, values: np.ndarray) -> np.ndarray:
    """Numbers as the conventions of netCDF and CF pack them: value = scale_factor stored +
    add_offset, and what stands for a missing one is none.
    """
    if not set(_PACKING) & set(node.attrs):
        return values
    stated = {key: _said(node, key, math.nan) for key in _PACKING if key in node.attrs}
    if values.dtype.kind not in "fiu" or not all(
        isinstance(value, (int, float, np.number)) for value in stated.values()
    ):
        raise InvalidInput(
            f"the variable {name} states {', '.join(stated)} that are arrays, but must be "
            "single numbers; save the variable unpacked"
        )
    missing = [values == stated[key] for key in ("_FillValue", "missing_value") if key in stated]
    factor, added = (
        float(stated.get(*key)) for key in (("scale_factor", 1.0), ("add_offset", 0.0))
    )
    with np.errstate(over="ignore", invalid="ignore"):  # named as not finite, with its sample
        found = values * factor + added
    return np.where(np.any(missing, axis=0), np.nan, found) if missing else found


def _stated(name: str, said: Mapping[str, Any], key: str) -> float | None:
    """A number that a channel of LabVIEW states, None where it does not. Raises InvalidInput."""
    try:
        return None if said.get(key) is None else float(said[key])
    except (TypeError, ValueError) as error:
        raise InvalidInput(
            f"{key} of the channel {name} is {said[key]!r}, but must be a number of seconds; "
            "correct it in DIAdem, or export the channels as a text table"
        ) from error


@contextmanager
def _tdms(path: Path) -> Iterator[Callable[[str], Variable]]:
    try:
        from nptdms import TdmsFile
        from nptdms.log import log_manager
    except ImportError as error:
        raise InvalidInput(
            "NI TDMS files need the package npTDMS; install it with: pip install 'ambrose[tdms]'"
        ) from error

    doubts: list[str] = []

    def note(entry: Any) -> bool:
        doubts.append(entry.getMessage())
        return False  # reported in an exception, not on the screen

    def find(name: str) -> Variable:
        if doubts:  # a file cut within its last channels still has the others in full
            raise InvalidInput(
                f"the file is incomplete ({doubts[0]}); copy it again, or save it again in "
                "LabVIEW or DIAdem"
            )
        if name not in channels:
            raise unknown(name, list(channels), "channel")
        channel = channels[name]
        _check_count(name, len(channel))
        values = channel[:]
        if values.dtype.kind == "M":  # a column of time stamps
            values = (values - values[:1]) / np.timedelta64(1, "s")
            return Variable(values, "s")
        if values.dtype.kind not in "fiub":
            raise InvalidInput(f"the channel {name} has no real numbers; name another channel")
        said = channel.properties
        begun = said.get("wf_start_time")
        step, start = (_stated(name, said, f"wf_{key}") for key in ("increment", "start_offset"))
        start = start or 0.0 if step else None
        if start is not None and begun is not None and begun > _NEVER:
            start += float((begun - first) / np.timedelta64(1, "ns")) * 1e-9
        unit = str(said.get("unit_string", "") or "")
        return Variable(values, unit, 1 / step if step else None, start)

    log_manager.console_handler.addFilter(note)
    try:
        # not by its name: it would read an index file beside it
        with path.open("rb") as stream, TdmsFile.open(stream) as file:
            if file.file_status.incomplete_final_segment and not doubts:
                doubts.append("its last segment was never finished")
            channels = {
                f"{group.name}/{channel.name}": channel
                for group in file.groups()
                for channel in group.channels()
            }
            begins = [channel.properties.get("wf_start_time") for channel in channels.values()]
            first = min(
                (time for time in begins if time is not None and time > _NEVER), default=None
            )
            yield find
    finally:
        log_manager.console_handler.removeFilter(note)


_ALL = ("*",)  # no name of a variable
_MEMORY = 900_000_000  # bytes of the child, where the system can limit it (Linux)
_SECONDS, _BYTES_PER_SECOND = 20.0, 5_000_000  # time of the child: for any file, and by its size


@contextmanager
def variables_of(path: Path, names: Sequence[str]) -> Iterator[list[Variable]]:
    """The variables of these names (``mat_tdms.read_variables``), valid within the block. Raises
    InvalidInput.
    """
    with tempfile.TemporaryDirectory(prefix="ambrose-", ignore_cleanup_errors=True) as folder:
        answer = Path(folder, "answer.json")
        numbers = answer.with_suffix(".numbers")
        variables = _ask(path, names, answer)
        yield [
            Variable(
                np.memmap(numbers, np.dtype(kind), "r", start, (count,)) if count else np.empty(0),
                *rest,
            )
            for kind, start, count, *rest in variables["variables"]
        ]


def tree_of(path: Path) -> dict[str, Any]:
    """All variables of a MAT-file as plain data (``mat_tdms.read_tree``). Raises InvalidInput."""
    with tempfile.TemporaryDirectory(prefix="ambrose-", ignore_cleanup_errors=True) as folder:
        return dict(_ask(path, _ALL, Path(folder, "answer.json"))["tree"])


def try_record(path: Path) -> None:
    """Read an HDF5 record, all of it, in vain. Raises InvalidInput where it is refused, or where
    its reader finds no end.
    """
    with tempfile.TemporaryDirectory(prefix="ambrose-", ignore_cleanup_errors=True) as folder:
        _ask(path, None, Path(folder, "answer.json"))


def _ask(path: Path, names: Sequence[str] | None, answer: Path) -> dict[str, Any]:
    limit = _SECONDS + (path.stat().st_size / _BYTES_PER_SECOND if path.is_file() else 0)
    environment = {
        "PYTHONPATH": os.pathsep.join(filter(None, sys.path)),
        "OPENBLAS_NUM_THREADS": "1",
    }
    remedy = (
        "it is damaged, too large, or made to do harm: save its numbers again as plain variables"
    )
    with subprocess.Popen(
        [sys.executable, "-P", "-m", __name__, str(path), str(answer), str(limit)],
        env={**os.environ, **environment},
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    ) as child:
        try:
            child.communicate(json.dumps(names).encode(), timeout=limit)
        except subprocess.TimeoutExpired:
            raise InvalidInput(f"it cannot be read within {limit:.0f} s; {remedy}") from None
        finally:  # also when interrupted: nobody is left behind
            child.kill()
            child.wait()
    try:
        answered = dict(json.loads(answer.read_text(encoding="utf-8")))
    except (OSError, ValueError):
        raise InvalidInput(
            f"its reader came to a sudden end (status {child.returncode}); {remedy}"
        ) from None
    if "refused" in answered:
        raise InvalidInput(answered["refused"])
    return answered


def _answer(path: Path, answer: Path, seconds: float) -> None:
    """What the child does."""
    names = json.load(sys.stdin)
    _limit(_MEMORY + (16 * NUMBERS if names is None else 0), seconds)
    try:
        entries, tree = [], None
        if names is None:
            read_hdf5(path)
        elif tuple(names) == _ALL:
            names, tree = None, read_tree(path)
        with answer.with_suffix(".numbers").open("wb") as file:
            for variable in read_variables(path, names) if names else ():
                values = np.ascontiguousarray(variable.values)
                entries.append(
                    [
                        values.dtype.str,
                        file.tell(),
                        len(values),
                        variable.unit,
                        variable.rate,
                        variable.start,
                        variable.bad,
                    ]
                )
                values.tofile(file)
        text = json.dumps({"variables": entries, "tree": tree})
    except InvalidInput as error:
        text = json.dumps({"refused": str(error)})
    answer.write_text(text, encoding="utf-8")


def _limit(memory: int, seconds: float) -> None:
    """A process that is without a parent comes to its end as well."""
    # not on Windows; elsewhere the system may not heed it
    with suppress(ImportError, AttributeError, OSError, ValueError):
        import resource

        hard = resource.getrlimit(resource.RLIMIT_DATA)[1]
        most = memory if hard == resource.RLIM_INFINITY else min(memory, hard)
        resource.setrlimit(resource.RLIMIT_DATA, (most, hard))
        resource.setrlimit(
            resource.RLIMIT_CPU, (int(seconds) + 2, resource.getrlimit(resource.RLIMIT_CPU)[1])
        )
        resource.setrlimit(resource.RLIMIT_CORE, (0, resource.getrlimit(resource.RLIMIT_CORE)[1]))


if __name__ == "__main__":
    _answer(Path(sys.argv[1]), Path(sys.argv[2]), float(sys.argv[3]))
