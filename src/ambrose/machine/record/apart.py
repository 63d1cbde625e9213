"""Files of MATLAB and LabVIEW, read in a process apart with a limited amount of memory and time.

Their readers are other people's: a file that is damaged, or made to do harm, may crash them or make them take all memory. The
parent asks for variables by name; the child leaves their numbers in a temporary file, which the parent maps.
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
from ambrose.machine.record.mat_tdms import Variable, read_variables

_MEMORY = 900_000_000  # bytes of the child, where the system can limit it (Linux)
_SECONDS, _BYTES_PER_SECOND = 20.0, 5_000_000  # time of the child: for any file, and by its size


@contextmanager
def variables_of(path: Path, names: Sequence[str]) -> Iterator[list[Variable]]:
    """The variables of these names (``mat_tdms.read_variables``), valid within the block. Raises InvalidInput."""
    with tempfile.TemporaryDirectory(prefix="ambrose-", ignore_cleanup_errors=True) as folder:
        answer = Path(folder, "answer.json")
        numbers = answer.with_suffix(".numbers")
        told = _ask(path, names, answer)
        if "refused" in told:
            raise InvalidInput(told["refused"])
        yield [
            Variable(np.memmap(numbers, np.dtype(kind), "r", start, (count,)) if count else np.empty(0), *rest)
            for kind, start, count, *rest in told["variables"]
        ]


def _ask(path: Path, names: Sequence[str], answer: Path) -> dict[str, Any]:
    limit = _SECONDS + (path.stat().st_size / _BYTES_PER_SECOND if path.is_file() else 0)
    found = {"PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "OPENBLAS_NUM_THREADS": "1"}
    remedy = "it is damaged, too large, or made to do harm: save its numbers again as plain variables"
    try:
        status = subprocess.run(
            [sys.executable, "-P", "-m", __name__, str(path), str(answer)], input=json.dumps(names).encode(), timeout=limit,
            env={**os.environ, **found}, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=False,
        ).returncode  # fmt: skip
    except subprocess.TimeoutExpired:
        raise InvalidInput(f"{path}: it cannot be read within {limit:.0f} s; {remedy}") from None
    try:
        return dict(json.loads(answer.read_text(encoding="utf-8")))
    except (OSError, ValueError):
        raise InvalidInput(f"{path}: its reader came to a sudden end (status {status}); {remedy}") from None


def _answer(path: Path, answer: Path) -> None:
    """What the child does."""
    names = json.load(sys.stdin)
    _limit_memory()
    try:
        told = []
        with answer.with_suffix(".numbers").open("wb") as file:
            for variable in read_variables(path, names):
                values = np.ascontiguousarray(variable.values)
                told.append([values.dtype.str, file.tell(), len(values), variable.unit, variable.rate, variable.bad])
                values.tofile(file)
        text = json.dumps({"variables": told})
    except InvalidInput as error:
        text = json.dumps({"refused": str(error)})
    answer.write_text(text, encoding="utf-8")


def _limit_memory() -> None:
    with suppress(ImportError, AttributeError, OSError, ValueError):  # not on Windows; elsewhere the system may not heed it
        import resource

        hard = resource.getrlimit(resource.RLIMIT_DATA)[1]
        most = _MEMORY if hard == resource.RLIM_INFINITY else min(_MEMORY, hard)
        resource.setrlimit(resource.RLIMIT_DATA, (most, hard))
        resource.setrlimit(resource.RLIMIT_CORE, (0, resource.getrlimit(resource.RLIMIT_CORE)[1]))


if __name__ == "__main__":
    _answer(Path(sys.argv[1]), Path(sys.argv[2]))
