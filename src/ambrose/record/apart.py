"""Files of MATLAB and LabVIEW, and HDF5 of other programs, read in a process apart with a limited
amount of memory and time.

Their readers are other people's: a file that is damaged, or made to do harm, may crash them or make
them take all memory. The parent asks for variables by name; the child leaves their numbers in a
temporary file, which the parent maps. An HDF5 record is only tried: once the child came to its end,
so will the parent.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput
from ambrose.machine.limits import NUMBERS
from ambrose.record.hdf5_file import read_hdf5
from ambrose.record.mat_tdms import read_tree, read_variables
from ambrose.record.text_uff import Variable

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
