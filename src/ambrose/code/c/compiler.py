"""The C compiler of this computer."""

from __future__ import annotations

import ctypes
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from ambrose.core.checks import InvalidInput

COMPILERS = ("cc", "gcc", "clang")
_TIME_LIMIT, _PROBE_TIME = 120.0, 20.0  # s
# how shared libraries begin
_LIBRARIES = (b"\x7fELF", b"MZ", b"\xcf\xfa\xed\xfe", b"\xca\xfe\xba\xbe")


def find_compiler(compiler: str | None = None) -> str | None:
    """The compiler asked for, or the first of COMPILERS; None where it is not installed."""
    return next(
        (name for name in ((compiler,) if compiler else COMPILERS) if shutil.which(name)), None
    )


def has_compiler() -> bool:
    """Whether code can be compiled and run here."""
    return not compiler_problem()


def compiler_problem() -> str:
    """Why no code can be compiled and run here, found out with a function of one line; "" where it
    can.
    """
    compiler = find_compiler()
    if compiler is None:
        return f"there is no C compiler {' or '.join(COMPILERS)} on this computer"
    try:
        load_library(build_probe(compiler, "install another one"))
    except InvalidInput as error:
        return str(error)
    return ""


def build_probe(compiler: str, remedy: str) -> bytes:
    """The shared library of one line: quick, so that a compiler that hangs is found before it
    counts. Raises InvalidInput.
    """
    return build_library(
        compiler, {"probe.c": "int probe;\n"}, ["probe.c"], (), remedy, time_limit=_PROBE_TIME
    )


def load_library(code: bytes) -> ctypes.CDLL:
    """A shared library of these bytes in this process. Raises InvalidInput."""
    try:
        with tempfile.TemporaryDirectory(prefix="ambrose-") as folder:
            target = Path(folder) / "library.so"
            target.write_bytes(code)
            return ctypes.CDLL(str(target))
    except OSError as error:
        remedy = "set TMPDIR to a folder that has room and lets programs run"
        raise InvalidInput(f"compiled code cannot be loaded here: {error}; {remedy}") from error


def build_library(
    compiler: str,
    files: Mapping[str, str],
    sources: Sequence[str],
    flags: Sequence[str],
    remedy: str,
    libraries: str = "",
    time_limit: float = _TIME_LIMIT,
) -> bytes:
    """The shared library of ``sources``, which are among ``files`` by name. Raises InvalidInput,
    with the remedy.
    """
    command = [
        compiler,
        "-std=c99",
        "-O2",
        "-fPIC",
        "-shared",
        *flags,
        *sources,
        "-o",
        "library",
        *libraries.split(),
    ]
    try:
        with tempfile.TemporaryDirectory(prefix="ambrose-") as folder:
            for name, text in files.items():
                (Path(folder) / name).write_text(text, encoding="utf-8")
            status, message = _run(command, folder, time_limit)
            made = Path(folder) / "library"
            code = made.read_bytes() if made.is_file() else b""
    except subprocess.TimeoutExpired as error:
        raise InvalidInput(
            f"the C compiler {compiler} did not end within {time_limit:g} s; {remedy}"
        ) from error
    except OSError as error:
        reason = f"{error.strerror or error}{f' ({error.filename})' if error.filename else ''}"
        raise InvalidInput(
            f"the C compiler {compiler} cannot be run here: {reason}; {remedy}, or set TMPDIR"
        ) from error
    if status or not code.startswith(_LIBRARIES):
        raise InvalidInput(
            f"the C compiler {compiler} refused the code: {message or 'it made no library'}; "
            f"{remedy}"
        )
    return code


def _run(command: Sequence[str], folder: str, time_limit: float) -> tuple[int, str]:
    """Exit status and message of a program; beyond the limit [s], and on Ctrl-C, all processes that
    it started end with it.
    """
    silent = subprocess.DEVNULL
    with subprocess.Popen(
        command,
        cwd=folder,
        stdin=silent,
        stdout=silent,
        stderr=subprocess.PIPE,
        start_new_session=True,
    ) as process:
        try:
            _, message = process.communicate(timeout=time_limit)
        except BaseException:
            with suppress(OSError):
                os.killpg(
                    process.pid, signal.SIGKILL
                ) if sys.platform != "win32" else process.kill()
            raise
    return process.returncode, message.decode("utf-8", "replace").strip()[:500]
