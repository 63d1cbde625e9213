"""The C compiler of this computer."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from ambrose.core.checks import InvalidInput

COMPILERS = ("cc", "gcc", "clang")
_TIME_LIMIT = 120.0  # s


def find_compiler(compiler: str | None = None) -> str | None:
    """The compiler asked for, or the first of COMPILERS; None where it is not installed."""
    return next((name for name in ((compiler,) if compiler else COMPILERS) if shutil.which(name)), None)


def has_compiler() -> bool:
    """Whether the code can be compiled here."""
    return find_compiler() is not None


def build_library(
    compiler: str, files: Mapping[str, str], sources: Sequence[str], flags: Sequence[str], remedy: str, libraries: str = ""
) -> bytes:
    """The shared library of ``sources``, which are among ``files`` by name. Raises InvalidInput, with the remedy."""
    with tempfile.TemporaryDirectory(prefix="ambrose-") as folder:
        for name, text in files.items():
            (Path(folder) / name).write_text(text, encoding="utf-8")
        command = [compiler, "-std=c99", "-O2", "-fPIC", "-shared", *flags, *sources, "-o", "library", *libraries.split()]
        try:
            done = subprocess.run(
                command, cwd=folder, capture_output=True, text=True, check=False, timeout=_TIME_LIMIT
            )  # fmt: skip
        except (OSError, subprocess.TimeoutExpired) as error:
            raise InvalidInput(f"the C compiler {compiler} did not run: {error}; {remedy}") from error
        if done.returncode:
            message = done.stderr.strip()[:500] or "no message"
            raise InvalidInput(f"the C compiler {compiler} refused the code: {message}; {remedy}")
        return (Path(folder) / "library").read_bytes()
