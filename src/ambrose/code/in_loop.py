"""The binary for the target in the loop with the virtual rig: the same scenario with the code on
its processor and on this computer, and how far the two records are apart.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any, cast

import numpy as np

from ambrose.code.block.block import ControlBlock
from ambrose.code.block.scheduled import ScheduledBlock
from ambrose.code.c.compiled import CompiledBlock, CompiledSchedule, Words
from ambrose.code.pipeline import unverified_block
from ambrose.code.processor_build import Link, Processor, Unit, build, processor_named, unit_of
from ambrose.code.processor_trial import check_room, check_trial
from ambrose.code.targets import C
from ambrose.core.checks import InvalidInput, invalid, names_wrong_types
from ambrose.core.presentation import Presented
from ambrose.core.statespace import StateSpace
from ambrose.judge.plants import Progress
from ambrose.law.law import LawLike, law_of
from ambrose.machine.machine import Machine
from ambrose.record.record import Record
from ambrose.rig.scenario import Scenario
from ambrose.rig.trace import Trace
from ambrose.rig.trial import simulate_scenario

# The target's binary as the program that the virtual rig runs: errors go to it, currents come back
# from it, sample by sample, over the pipe of its emulator.


class TargetProgram:
    """A block's binary on its processor, as the rig runs a program (``ControlProgram``).

    A context: the emulator ends with it. sample_time [s], delay [samples], system: as the rig asks
    of it. instructions: of the longest step so far (0 where only the emulator's log counts them).
    """

    def __init__(self, unit: Unit, processor: Processor, *, contraction: bool = False) -> None:
        """Compiles and starts it; contraction: whether the compiler may round a product and a sum
        at once. Raises InvalidInput.
        """
        if unit.law.beside:
            raise InvalidInput(
                "the target's binary runs in the loop without synchronous blocks; leave them out "
                "of the controller's file"
            )
        self.unit, self.block = unit, unit.base
        self.instructions = 0
        self._words = Words.of(self.block, unit.arithmetic)
        self._folder = tempfile.TemporaryDirectory(prefix="ambrose-")
        self._row = np.zeros(1, unit.given("="))
        self._row["valid"] = 1
        try:
            program = build(unit, processor, Path(self._folder.name), contraction)
            self._link = Link(unit, processor, program)
        except BaseException:
            self._folder.cleanup()
            raise

    def __enter__(self) -> TargetProgram:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """End the emulator, remove what was compiled."""
        self._link.close()
        self._folder.cleanup()

    @property
    def sample_time(self) -> float:
        return self.block.sample_time

    @property
    def delay(self) -> int:
        return self.block.delay

    @property
    def system(self) -> StateSpace:
        return cast(ControlBlock, self.block).system

    def begin(self, states: np.ndarray) -> None:
        """Everything as after its first call, then the states (n,)."""
        self._link.begin()
        if self.block.n_states:
            self._link.set_states(self._words.counts(states, self._words.state))

    def step(self, errors: np.ndarray) -> np.ndarray:
        """One sample: currents (p,) [A] from errors (m,) [m]."""
        self._row["error"] = self.unit.counts(errors, self.unit.metre)
        answer = self._link.steps(self._row, watching=False)
        self.instructions = max(self.instructions, int(answer["instructions"][0]))
        return np.asarray(answer["current"][0].astype(float) * self.unit.ampere)


class TargetSchedule(TargetProgram):
    """The same of a scheduled block, told speed [rad/s], pressure [Pa] or both before every step
    (``ScheduledProgram``).
    """

    block: ScheduledBlock

    def __init__(self, unit: Unit, processor: Processor, *, contraction: bool = False) -> None:
        super().__init__(unit, processor, contraction=contraction)
        self.told: Any = self.block.range[0]
        self.schedule(self.told)
        if self.block.watch:
            self._row["estimate"], self._row["half_width"] = math.nan, math.inf  # none

    @property
    def parameter(self) -> str:
        return self.block.along.name

    @property
    def range(self) -> tuple[Any, Any]:
        return self.block.range

    @property
    def system(self) -> StateSpace:
        """The law of the next step."""
        return self.block.at(self.block.known(self.told))

    def __call__(self, value: Any) -> StateSpace:
        return self.block.at(value)

    def schedule(self, value: Any) -> None:
        """Speed [rad/s] or pressure [Pa] of the next step, or both; NaN: not known."""
        self.told = value
        each = self.block.along.each
        for one, number in zip(each, value if self.block.along.parts else (value,), strict=True):
            self._row[one.name] = number


def target_program(
    unit: Unit, processor: Processor, *, contraction: bool = False
) -> TargetProgram | TargetSchedule:
    """A unit's binary on a processor, ready to run. Raises InvalidInput."""
    kind = TargetSchedule if unit.base.told else TargetProgram
    return kind(unit, processor, contraction=contraction)


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
    kind: Any = CompiledSchedule if unit.base.told else CompiledBlock
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
