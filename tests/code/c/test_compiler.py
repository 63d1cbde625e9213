"""Compilers that hang, lie or cannot run, and folders for temporary files that cannot be used: told
soon, in one sentence.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path

import pytest

from ambrose.code.c import compiled as compiler
from ambrose.code.c.compiled import build_library, compiler_problem, has_compiler, load_library
from ambrose.code.fmu import check_compiler
from ambrose.core.checks import InvalidInput
from needs import needs

posix = pytest.mark.skipif(os.name != "posix", reason="a shell script stands in for the compiler")


@pytest.fixture
def fake(tmp_path, monkeypatch):
    """A compiler that is this shell script."""

    def made(script):
        folder = tmp_path / "bin"
        folder.mkdir()
        for name in compiler.COMPILERS:
            (folder / name).write_text(f"#!/bin/sh\n{script}\n")
            (folder / name).chmod(0o755)
        monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")

    return made


def alive(pid):
    """Whether a process runs; one that nobody has buried yet does not."""
    try:
        os.kill(pid, 0)
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


@posix
def test_a_compiler_that_hangs_is_found_soon_and_ends_with_all_that_it_started(
    fake, monkeypatch, tmp_path
):
    """It took two minutes, twice for an FMU, after the verification; and the compiler's own
    processes went on for ever.
    """
    fake(f"sleep 3600 & echo $! >> {tmp_path}/started; wait")
    monkeypatch.setattr(compiler, "_PROBE_TIME", 0.2)
    with pytest.raises(
        InvalidInput, match=r"did not end within 0\.2 s; write an FMU of sources only"
    ):
        check_compiler()
    assert "did not end" in compiler_problem() and not has_compiler()
    started = tmp_path / "started"
    for pid in map(int, started.read_text().split() if started.exists() else ()):
        while alive(pid):  # killed, and buried by the system in a moment
            time.sleep(0.01)


@posix
@pytest.mark.parametrize(
    ("script", "words"),
    [
        ("exit 0", "it made no library"),
        ("echo junk > library", "it made no library"),
        ("printf '\\377' >&2; exit 3", "refused the code"),
    ],
)
def test_a_compiler_that_makes_no_library_is_told(fake, script, words):
    """An FMU with junk for its binary was delivered; bytes that are no text were a traceback."""
    fake(script)
    with pytest.raises(InvalidInput, match=words):
        build_library("cc", {"a.c": "int a;"}, ["a.c"], (), "give another")
    assert words in compiler_problem()


def test_no_folder_for_temporary_files_is_told(monkeypatch, tmp_path):
    """It was a FileNotFoundError, which ended a study after its designs."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "none"))
    with pytest.raises(InvalidInput, match="set TMPDIR"):
        build_library(sys.executable, {}, [], (), "give another")
    with pytest.raises(InvalidInput, match="set TMPDIR"):
        load_library(b"")


def test_code_that_cannot_be_loaded_is_told():
    """As from a folder that lets no programs run: an OSError ended a study after its designs."""
    with pytest.raises(InvalidInput, match="cannot be loaded here"):
        load_library(b"\x7fELF")


@needs("cc")
def test_a_compiler_that_works_is_no_problem():
    assert compiler_problem() == ""
