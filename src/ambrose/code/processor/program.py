"""The target's binary as the program that the virtual rig runs: errors go to it, currents come back
from it, sample by sample, over the pipe of its emulator.
"""

from __future__ import annotations

import math
import tempfile
from pathlib import Path
from types import TracebackType
from typing import Any, cast

import numpy as np

from ambrose.code.block.fixed import ControlBlock
from ambrose.code.block.scheduled import ScheduledBlock
from ambrose.code.block.supervised import SupervisedBlock
from ambrose.code.c.compiled import Words
from ambrose.code.processor.build import build
from ambrose.code.processor.link import Link
from ambrose.code.processor.machines import Processor
from ambrose.code.processor.unit import Unit
from ambrose.core.checks import InvalidInput
from ambrose.core.statespace import StateSpace


class TargetProgram:
    """A block's binary on its processor, as the rig runs a program (``ControlProgram``).

    A context: the emulator ends with it. sample_time [s], delay [samples], system: as the rig asks
    of it. instructions: of the longest step so far (0 where only the emulator's log counts them).
    """

    def __init__(self, unit: Unit, processor: Processor, *, contraction: bool = False) -> None:
        """Compiles and starts it; contraction: whether the compiler may round a product and a sum
        at once. Raises InvalidInput.
        """
        if unit.beside:
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
        if isinstance(self.block, SupervisedBlock):
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
        supervised = isinstance(self.block, SupervisedBlock)
        lost = supervised and math.isnan(self.told)
        return self.block.at(self.block.range[0] if lost else self.told)

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
    kind = TargetSchedule if isinstance(unit.base, ScheduledBlock) else TargetProgram
    return kind(unit, processor, contraction=contraction)
