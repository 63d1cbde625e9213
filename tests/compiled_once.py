"""What a C compiler made is kept for the run of the tests, by the text that it was made of.

The same controller's code is compiled by the package (which checks what it exports) and by several
tests: with the same compiler, flags and files the first result is copied.
"""

import hashlib
import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from ambrose.code.c import compiled as compiler

RUN = os.environ.get("PYTEST_XDIST_TESTRUNUID", str(os.getpid()))  # one for all workers of a run
KEPT = Path(tempfile.gettempdir()) / f"ambrose-tests-{RUN}"
TEXTS = {".c", ".h"}


def key_of(command, folder):
    """A name for what a command makes: of the compiler, its flags, the files that it is given and
    those beside them. None where a file is no text of C, or nothing is made.
    """
    program = shutil.which(command[0])
    if program is None or "-o" not in command:
        return None
    target = command.index("-o") + 1
    given = {
        index: Path(folder) / word for index, word in enumerate(command) if not word.startswith("-")
    }
    files = {index: path for index, path in given.items() if path.is_file() and index != target}
    if any(path.suffix not in TEXTS for path in files.values()):
        return None
    words = [files[i].name if i in files else word for i, word in enumerate(command)]
    words[0], words[target] = program, ""
    beside = {path for file in files.values() for path in file.parent.glob("*.h")}
    found = hashlib.sha256(repr(words).encode())
    for path in sorted({*files.values(), *beside}, key=lambda path: path.name):
        found.update(path.name.encode() + path.read_bytes())
    found.update(Path(program).read_bytes()[:4096])  # a script that stands in for the compiler
    return found.hexdigest()


def once(command, folder, compile_it):
    """Status and complaints of ``compile_it()``; what it made lies where the command says."""
    key = key_of(command, folder)
    if key is None:
        return compile_it()
    target = Path(folder) / command[command.index("-o") + 1]
    if (KEPT / key).exists():
        shutil.copy(KEPT / key, target)
        return 0, ""
    status, complaints = compile_it()
    if status == 0 and not complaints and target.exists():
        KEPT.mkdir(exist_ok=True)
        own = KEPT / f"{key}-{os.getpid()}"  # another worker may make the same at the same time
        shutil.copy(target, own)
        own.replace(KEPT / key)
    return status, complaints


def build(command, folder="."):
    """Status and complaints of the compiler."""

    def compile_it():
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        return done.returncode, done.stderr

    return once(command, folder, compile_it)


def install():
    """The package's own compiling as well."""
    compile_it = compiler._run
    compiler._run = lambda command, folder, limit: once(
        command, folder, lambda: compile_it(command, folder, limit)
    )
