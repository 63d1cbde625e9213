"""What a test needs beside Python, looked for in one place and told in one way: where it is absent
the test is skipped with "no <what>: <remedy>", which a summary can count (``pytest -rs``).
"""

import os
import shutil
from functools import cache
from pathlib import Path

import pytest

from ambrose.code.c.compiled import compiler_problem
from ambrose.code.processor_build import PROCESSORS

# places of programs that are no packages
MATIEC, STRUCPP = (Path(os.environ.get(name, "/nonexistent")) for name in ("MATIEC", "STRUCPP"))
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
_PLACES = {
    "iec2c": (MATIEC / "iec2c", "set MATIEC to the folder with iec2c and lib/"),
    "STruC++": (STRUCPP / "dist/node/cli.js", "set STRUCPP to its built repository"),
}


@cache
def lacking(what: str) -> str:
    """Why a test cannot have ``what`` here, "" where it can.

    what: "C compiler" (one that makes code which runs), "browser", the name of a processor (its
    compiler and its emulator), programs of which one is enough ("gcc or clang").
    """
    if what == "C compiler":
        problem = compiler_problem()
        return f"no {what}: {problem}" if problem else ""
    if what == "browser":
        return "" if CHROMIUM else "no browser: install chromium"
    if what in _PLACES:
        place, remedy = _PLACES[what]
        return "" if place.exists() else f"no {what}: {remedy}"
    if what in PROCESSORS:
        processor = PROCESSORS[what]
        programs = ("cc", processor.compiler, processor.emulator[0])
        return next(filter(None, map(lacking, programs)), "")
    known = what.split(" or ")
    return "" if any(map(shutil.which, known)) else f"no {what}: install {known[0]}"


def needs(*wanted: str) -> pytest.MarkDecorator:
    """Marks a test that is skipped where one of ``wanted`` is absent; see ``lacking``."""
    reason = next(filter(None, map(lacking, wanted)), "")
    return pytest.mark.skipif(bool(reason), reason=reason or "all is here")
