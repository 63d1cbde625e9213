"""Stage: one controller, designed or taken up again from an earlier run."""

from __future__ import annotations

from pathlib import Path

from ambrose.core.checks import AmbroseError
from ambrose.judge.as_it_runs import sampled_margins
from ambrose.judge.certificate import contradiction
from ambrose.judge.controller_file import read_controller, write_controller
from ambrose.judge.plants import Progress
from ambrose.judge.result import Synthesis
from ambrose.machine.atomic_write import set_aside
from ambrose.model.plant import Plant
from ambrose.synthesis.design import design, provenance
from ambrose.synthesis.methods.method import Method


def resume_or_design(plant: Plant, method: Method, path: Path, progress: Progress) -> Synthesis:
    """The very Synthesis at ``path`` if the same design made it, else a new one, written there and
    read back.

    The same: package version, machine, operating point, method with its options, and not a byte
    changed since. What is taken up is certified again on the full plant, a scheduled controller at
    every speed of its grid. A file that is not taken up is called ``earlier-<name>``, and
    ``progress`` is told why.
    """
    if path.exists():
        try:
            kept = read_controller(path)
            wrong = _objection(plant, method, kept)
        except AmbroseError as error:
            wrong = str(error)
        if not wrong:
            return kept
        progress(f"{path.name} is not taken up: {wrong}; designing it anew")
        set_aside(path)
    return read_controller(write_controller(path, design(plant, method, progress=progress)))


def _objection(plant: Plant, method: Method, kept: Synthesis) -> str:
    """Why a kept controller is not what this design would give; "" where nothing speaks against
    it.
    """
    kept_key, key = kept.provenance.key, provenance(plant, method).key
    if other := [name for name in {**key, **kept_key} if kept_key.get(name) != key.get(name)]:
        return f"it was made for another {', '.join(other)}"
    wrong = contradiction(
        plant, kept, sampled_margins(plant, kept.law, method.on(plant.machine).timing())
    )
    if not wrong and kept.provenance.digest != kept.digest:
        return "it was changed after it was written"
    return wrong
