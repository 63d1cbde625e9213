"""Bundled machines on a coarse mesh, for tests that compare computations with each other: a quarter
of the states.
"""

import os
import re
from dataclasses import replace
from pathlib import Path

from ambrose.machine.file.toml import bundled_machines, load_machine
from ambrose.machine.machine import Machine
from compiled_once import KEPT


def coarse(machine: str | Machine) -> Machine:
    """One element per section of the shaft; frequencies below 1 kHz stay within 1e-4."""
    machine = load_machine(machine) if isinstance(machine, str) else machine
    return replace(machine, shaft=tuple(replace(section, elements=1) for section in machine.shaft))


def coarse_text(name: str) -> str:
    """The file of a bundled machine with one element per section of the shaft."""
    text = Path(str(bundled_machines()[name])).read_text(encoding="utf-8")
    return re.sub(r"elements = \d+", "elements = 1", text)


def coarse_file(name: str) -> str:
    """The path of such a file, for the command line; it lasts as long as the run of the tests."""
    path = KEPT / f"{name}.toml"
    if not path.exists():
        KEPT.mkdir(exist_ok=True)
        own = KEPT / f"{name}-{os.getpid()}.toml"  # another worker may write it at the same time
        own.write_text(coarse_text(name), encoding="utf-8")
        own.replace(path)
    return str(path)
