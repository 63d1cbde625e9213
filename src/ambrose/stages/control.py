"""Stage: one controller, designed or taken up again from an earlier run."""

from __future__ import annotations

from pathlib import Path

from ambrose.core.checks import AmbroseError
from ambrose.evaluation.plants import Progress
from ambrose.plant.model import Plant
from ambrose.synthesis.as_it_runs import sampled_margins
from ambrose.synthesis.certificate import contradiction
from ambrose.synthesis.controller_file import read_controller, write_controller
from ambrose.synthesis.design import design, provenance
from ambrose.synthesis.options import DesignOptions
from ambrose.synthesis.result import Synthesis


def resume_or_design(
    plant: Plant, method: str, path: Path, progress: Progress, options: DesignOptions | None = None
) -> Synthesis:
    """The very Synthesis at ``path`` if the same design made it, else a new one, written there.

    The same: package version, machine, operating point, method and options. What is taken up is certified again on the full
    plant, a scheduled controller at every speed of its grid; where the margins are not those of the file it is designed anew.
    """
    options = options or DesignOptions()
    try:
        kept = read_controller(path)
    except AmbroseError:
        kept = None  # absent, or not readable any more
    if kept is not None and kept.provenance.key == provenance(plant, method, options).key:
        wrong = contradiction(plant, kept, sampled_margins(plant, kept.law, options.on(plant.machine).timing()))
        if not wrong:
            return kept
        progress(f"{path.name} is not taken up: {wrong}; designing it anew")
    synthesis = design(plant, method, options=options, progress=progress)
    write_controller(path, synthesis)
    return synthesis
