"""What a study leaves of the lateral analysis: ``lateral.html`` and ``lateral.json``."""

from __future__ import annotations

from pathlib import Path

from ambrose.annexes.rotordynamics.analysis import lateral
from ambrose.judge.plants import Progress
from ambrose.judge.result import Synthesis
from ambrose.machine.atomic_write import write_json
from ambrose.machine.machine import Machine
from ambrose.report.page import page_of, write


def write_lateral(
    machine: Machine, synthesis: Synthesis, directory: Path, progress: Progress
) -> None:
    """The analysis of a machine under the study's best controller; nothing where it never turns.

    Raises InvalidInput where it cannot be done or written, NumericalFailure as ``lateral`` does.
    """
    if not any(point.speed > 0 for point in machine.operation.envelope):
        return
    progress("lateral analysis")
    result = lateral(machine, synthesis)
    write_json(directory / "lateral.json", dict(result.to_dict()), "lateral analysis")
    write(page_of(result), directory / "lateral.html")
