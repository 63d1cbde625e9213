"""Method "pid": the machine's own reference controller."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from ambrose.synthesis.methods.method import Lowered, Progress

if TYPE_CHECKING:
    from ambrose.judge.result import Synthesis
    from ambrose.model.plant import Plant


@dataclass(frozen=True, slots=True, kw_only=True)
class Pid(Lowered):
    """The reference controller of the machine file, decentralised PID or filter bank, certified on
    the plant. It is no design: a delay is in the verdict, in no model.
    """

    name: ClassVar[str] = "pid"
    title: ClassVar[str] = "PID"

    @classmethod
    def suits(cls, plant: Plant) -> bool:
        """Whether the machine file has a [controller] with gains."""
        return plant.machine.reference is not None

    def design(self, plant: Plant, progress: Progress) -> Synthesis:
        from ambrose.synthesis.pid import continuous_pid

        return continuous_pid(plant)
