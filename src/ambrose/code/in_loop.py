"""The binary for the target in the loop with the virtual rig: the same scenario with the code on
its processor and on this computer, and how far the two records are apart.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ambrose.code.c.compiled import CompiledBlock, CompiledSchedule
from ambrose.code.pipeline import unverified_block
from ambrose.code.processor.machines import processor_named
from ambrose.code.processor.program import target_program
from ambrose.code.processor.trial import check_room, check_trial
from ambrose.code.processor.unit import unit_of
from ambrose.code.targets import C
from ambrose.core.arguments import names_wrong_types
from ambrose.core.checks import invalid
from ambrose.core.presentation import Presented
from ambrose.judge.plants import Progress
from ambrose.law.law import LawLike, law_of
from ambrose.machine.machine import Machine
from ambrose.record.record import Record
from ambrose.rig.scenario import Scenario
from ambrose.rig.trace import Trace
from ambrose.rig.trial import simulate_scenario


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class InLoop(Presented):
    """A scenario with the target's binary as the controller.

    trace: with the binary on its processor; host: with the same code on this computer, which rounds
    every product and every sum. apart: by unit of the records' signals, the largest difference.
    instructions: of the longest step (0: not counted).
    """

    processor: str
    arithmetic: str
    contraction: bool
    trace: Trace
    host: Trace
    apart: Mapping[str, float]
    instructions: int

    @property
    def equal(self) -> bool:
        """Whether both records are the same to the last bit, and ended in the same way."""
        same = self.trace.record.values.shape == self.host.record.values.shape
        return same and self.trace.outcome == self.host.outcome and not any(self.apart.values())

    @property
    def bound(self) -> float | None:
        """What the records may be apart: 0 where every operation is rounded alike; None where
        contraction makes the rounding the processor's own, and the loop decides.
        """
        return None if self.contraction else 0.0

    @property
    def text(self) -> str:
        """One sentence of it."""
        where = f"on {self.processor} in {self.arithmetic}"
        if self.equal:
            count, samples = self.trace.record.values.shape
            return (
                f"{where}: {count} signals of {samples} samples equal this computer's to the last "
                "bit"
            )
        if self.trace.outcome != self.host.outcome:
            return f"{where}: {self.trace.outcome}, but on this computer {self.host.outcome}"
        told = ", ".join(f"{value:.2g} {unit}" for unit, value in self.apart.items() if value)
        return f"{where}: apart from this computer's record by up to {told}"

    def facts(self) -> Mapping[str, Any]:
        """Processor, arithmetic, outcome and agreement."""
        return {
            "processor": self.processor,
            "arithmetic": self.arithmetic,
            "outcome": self.trace.outcome,
            "equal": self.equal,
            "bound": self.bound,
            "apart": dict(self.apart),
            "instructions": self.instructions,
            "text": self.text,
        }

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready data."""
        return dict(self.facts())


@names_wrong_types
def simulate_on_target(
    machine: Machine,
    controller: LawLike,
    scenario: str | Scenario,
    target: C,
    *,
    contraction: bool = False,
    progress: Progress = lambda stage: None,
    **run: Any,
) -> InLoop:
    """Run a scenario with the exported code on its processor, in an emulator, and once more with it
    on this computer.

    target: as ``export`` takes it, ``C(try_on="cortex-m7", arithmetic="float")``: the block is the
    one that export writes, before its verification. contraction: let the compiler of the target
    round a product and a sum at once. run: further arguments of ``simulate`` (point, seed, path,
    ...); what is written is the record with the target's binary. Raises InvalidInput.
    """
    if target.try_on is None:
        raise invalid("try_on", None, "a processor", "C(try_on='cortex-m7')")
    processor = processor_named(target.try_on)
    compiler = check_trial(processor, target.arithmetic)
    block = unverified_block(controller, machine, target)
    unit = unit_of(block, target.arithmetic)
    check_room(unit, processor, target.flash, target.ram)
    how: dict[str, Any] = {"progress": progress, **run}
    # here first: what the rig refuses is refused before the emulator starts
    kind: Any = CompiledBlock if unit.told == () else CompiledSchedule
    here = kind(block, target.arithmetic, compiler)
    host = simulate_scenario(machine, here, scenario, **{**how, "path": None})
    progress(f"starting the code on {processor.name}")
    with target_program(unit, processor, contraction=contraction) as program:
        trace = simulate_scenario(machine, program, scenario, **how)
        trace = replace(trace, laws=(("Controller", law_of(controller).named),))
        most = program.instructions
    return InLoop(
        processor.name,
        target.arithmetic,
        contraction,
        trace,
        host,
        _apart(trace.record, host.record),
        most,
    )


def _apart(one: Record, other: Record) -> dict[str, float]:
    """Largest difference of two records of the same signals by unit, as long as both go on."""
    count = min(one.values.shape[1], other.values.shape[1])
    difference = np.abs(one.values[:, :count] - other.values[:, :count]).max(axis=1)
    found: dict[str, float] = {}
    for unit, value in zip(one.units, difference.tolist(), strict=True):
        found[unit] = max(found.get(unit, 0.0), value)
    return found
