"""The self-test of exported C code, compiled and run on this computer."""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ambrose.code.c.compiler import COMPILERS, find_compiler
from ambrose.core.checks import InvalidInput

_SECONDS = 30.0  # of compiler and test, each
_WORDS = ("-std=c99", "-O2", "-o", "test")
_SHOWN = 4000  # letters of what was printed


@dataclass(frozen=True, slots=True)
class SelfTest:
    """Whether every sample agreed; text: what compiler or test printed."""

    passed: bool
    text: str


def run_self_test(sources: Sequence[Path]) -> SelfTest:
    """Compile C files, of which one has main, and run the program, in a folder of its own. Raises
    InvalidInput without a compiler, and where it takes too long.
    """
    compiler = find_compiler()
    if compiler is None:
        raise InvalidInput(
            f"there is no C compiler {' or '.join(COMPILERS)} on this computer; install one"
        )
    with tempfile.TemporaryDirectory(prefix="ambrose-") as folder:
        files = [str(Path(path).resolve()) for path in sources]
        built = _run([compiler, *_WORDS, *files, "-lm"], folder)
        ran = _run([str(Path(folder, "test"))], folder) if built.returncode == 0 else built
    passed = ran.returncode == 0
    text = (ran.stdout + ran.stderr)[-_SHOWN:].strip()
    return SelfTest(
        passed, text or ("every sample agrees" if passed else "it fails without a word")
    )


def _run(words: list[str], folder: str) -> subprocess.CompletedProcess[str]:
    try:
        return subprocess.run(
            words,
            cwd=folder,
            capture_output=True,
            encoding="utf-8",
            errors="replace",
            timeout=_SECONDS,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise InvalidInput(
            f"the self-test took longer than {_SECONDS:g} s and was ended; run it by hand"
        ) from None
