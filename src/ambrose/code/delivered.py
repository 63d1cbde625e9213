"""A delivery tried on its processor: what is refused before the verification, and the trial of what
was written.
"""

from __future__ import annotations

from collections.abc import Callable

from ambrose.code.processor.machines import PROCESSORS
from ambrose.code.processor.trial import Trial, check_room, check_trial, try_unit
from ambrose.code.processor.unit import Law, unit_of
from ambrose.code.targets import C, Files
from ambrose.core.checks import invalid


def check_processor(target: C, block: Callable[[], Law]) -> None:
    """What can be refused of a trial before the loop is verified: options without a processor, a
    compiler or emulator that is not there, and a controller whose code alone is too large. block:
    makes it, unverified. Raises InvalidInput.
    """
    if target.try_on is None:
        for name in ("clock", "flash", "ram"):
            if getattr(target, name) is not None:
                raise invalid(
                    name, getattr(target, name), "left out", "it goes with try_on: name a processor"
                )
        return
    processor, arithmetic = PROCESSORS[target.try_on], target.arithmetic
    check_trial(processor, arithmetic)
    if target.flash is not None or target.ram is not None:
        check_room(unit_of(block(), arithmetic), processor, target.flash, target.ram)


def try_target(target: C, law: Law, files: Files, progress: Callable[[str], None]) -> Trial:
    """The files of a law, run on the target's processor. Raises InvalidInput."""
    processor = PROCESSORS[target.try_on or ""]
    texts = {name: text for name, text in files.items() if isinstance(text, str)}
    unit = unit_of(law, target.arithmetic, texts)
    check_room(unit, processor, target.flash, target.ram)
    return try_unit(unit, processor, clock=target.clock, progress=progress)
