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


def coarse_text(name: str, tolerances: bool = True) -> str:
    """The file of a bundled machine with one element per section of the shaft; without tolerances
    where no test of it looks at what is judged over them, half of the time of a verification.
    """
    text = Path(str(bundled_machines()[name])).read_text(encoding="utf-8")
    if not tolerances:
        text = re.sub(r"^\[\[tolerance\]\].*\n(?:[^\[\n].*\n|\n)*", "", text, flags=re.M)
    return re.sub(r"elements = \d+", "elements = 1", text)


def coarse_file(name: str, tolerances: bool = True) -> str:
    """The path of such a file, for the command line; it lasts as long as the run of the tests."""
    kind = name if tolerances else f"{name}-without-tolerances"
    path = KEPT / f"{kind}.toml"
    if not path.exists():
        KEPT.mkdir(exist_ok=True)
        own = KEPT / f"{kind}-{os.getpid()}.toml"  # another worker may write it at the same time
        own.write_text(coarse_text(name, tolerances), encoding="utf-8")
        own.replace(path)
    return str(path)
