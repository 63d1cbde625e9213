"""Bundled machines on a coarse mesh, for tests that compare computations with each other: a quarter
of the states.
"""

from dataclasses import replace

from ambrose.machine.file.toml import load_machine
from ambrose.machine.machine import Machine


def coarse(machine: str | Machine) -> Machine:
    """One element per section of the shaft; frequencies below 1 kHz stay within 1e-4."""
    machine = load_machine(machine) if isinstance(machine, str) else machine
    return replace(machine, shaft=tuple(replace(section, elements=1) for section in machine.shaft))
