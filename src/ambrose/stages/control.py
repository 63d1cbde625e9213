"""Stage: one controller, designed or taken up again from an earlier run."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from ambrose.core.checks import AmbroseError
from ambrose.machine.file.toml import machine_hash
from ambrose.plant.model import Plant
from ambrose.synthesis.controller_file import read_controller, write_controller
from ambrose.synthesis.design import design, on_full_plant
from ambrose.synthesis.order_selection import Measure
from ambrose.synthesis.result import Synthesis

Progress = Callable[[str], None]


def kept_or_designed(
    plant: Plant, method: str, path: Path, progress: Progress, *, delay: float = 0.0, judge: Measure | None = None
) -> Synthesis:
    """The controller at ``path`` if it was made for exactly this machine (certified again), else a new one, written there.

    delay [s]: of the sampled loop that a new one is designed for; judge: as for ``design``.
    """
    try:
        kept = read_controller(path)
        if kept.certificate and (kept.provenance.machine_hash, kept.method) == (machine_hash(plant.machine), method):
            return kept if kept.scheduled is not None else on_full_plant(plant, kept, {})
    except AmbroseError:
        pass  # absent, or not readable any more: designed anew
    synthesis = design(plant, method, delay=delay, judge=judge, progress=progress)
    write_controller(path, synthesis, plant.machine)
    return synthesis
