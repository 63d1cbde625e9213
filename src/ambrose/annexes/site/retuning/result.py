"""What a retuning gives: its steps with their verdicts, and what each of them made."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ambrose.annexes.site.acceptance import Acceptance
from ambrose.code.pipeline import Delivery
from ambrose.core.presentation import Presented, to_plain
from ambrose.identification.result import LoopIdentification
from ambrose.judge.result import Synthesis
from ambrose.judge.verification import Verification
from ambrose.law.timing import Timing
from ambrose.machine.machine import Machine
from ambrose.rig.trace import Trace

RETUNED = "retuned"
UNCHANGED = "no change needed"
STOPPED = "stopped"


@dataclass(frozen=True, slots=True)
class Step:
    """A step of the chain. name: its key; title: what was asked; passed: whether it holds (None:
    for information); words: the answer, with its figures; files: what it left in the folder.
    """

    name: str
    title: str
    passed: bool | None
    words: str
    files: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Moved:
    """A parameter that was identified: the file's value [SI], the one found with its 95 %
    half-width, and that of the file's own tolerance (None: it states none).
    """

    path: str
    unit: str
    file: float
    value: float
    half: float
    tolerance: float | None

    @property
    def change(self) -> float:
        """Relative to the file's value; NaN for a value of zero."""
        return self.value / self.file - 1 if self.file else float("nan")

    @property
    def certain(self) -> bool:
        """Whether the file's value lies outside the interval."""
        return abs(self.value - self.file) > self.half

    @property
    def beyond(self) -> bool:
        """Whether it moved by more than the file's own tolerance and the interval."""
        return (
            self.tolerance is not None and abs(self.value - self.file) > self.tolerance + self.half
        )


@dataclass(frozen=True, slots=True)
class Switch:
    """A change of the running controller on the rig.

    forward: from the running one to the new one (else the way back); trace: the run; bump,
    before [m]: the largest displacement from the mean in the half second after the change, and
    before it; allowed [m]: how far it may go.
    """

    forward: bool
    trace: Trace
    bump: float
    before: float
    allowed: float

    @property
    def passed(self) -> bool:
        """Whether the rotor stayed free; on the way forward, and hardly moved."""
        return self.trace.passed and (
            not self.forward or self.bump <= max(self.before, self.allowed)
        )


@dataclass(frozen=True, slots=True, eq=False, repr=False, kw_only=True)
class Retuning(Presented):
    """The steps of a retuning and what they made; what was not come to is None or empty.

    given: the machine file's; identification: its ``machine`` is the one that was designed for,
    with the intervals as its tolerances; moved: what differs from the file. running, new: the
    controllers; before, after: their verifications over the intervals of the identified machine.
    delivery: the new one's code, and the difference from the running one's. switches: the change
    and the way back, on the rig. acceptance: of the change, from records after it.
    """

    given: Machine
    running: Synthesis
    timing: Timing
    steps: tuple[Step, ...]
    folder: Path
    identification: LoopIdentification | None = None
    moved: tuple[Moved, ...] = ()
    before: Verification | None = None
    new: Synthesis | None = None
    after: Verification | None = None
    delivery: Delivery | None = None
    switches: tuple[Switch, ...] = ()
    acceptance: Acceptance | None = None
    unchanged: bool = False

    @property
    def machine(self) -> Machine:
        """As identified, else as given."""
        return self.given if self.identification is None else self.identification.machine

    @property
    def stopped_at(self) -> Step | None:
        """The first step that does not hold."""
        return next((step for step in self.steps if step.passed is False), None)

    @property
    def outcome(self) -> str:
        """ "retuned", "no change needed" or "stopped"."""
        if self.stopped_at is not None:
            return STOPPED
        return UNCHANGED if self.unchanged else RETUNED

    @property
    def passed(self) -> bool:
        """Whether every step holds."""
        return self.stopped_at is None

    @property
    def text(self) -> str:
        """The outcome in a sentence."""
        step = self.stopped_at
        if step is not None:
            return f"stopped: {step.title.lower()}: {step.words}"
        return f"{self.outcome}: {self.steps[-1].words}"

    def facts(self) -> Mapping[str, Any]:
        return {
            "machine": self.given.name,
            "outcome": self.outcome,
            "steps": [step.name for step in self.steps],
        }

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready data: the steps, what moved, the worst sensitivities before and after."""
        return to_plain(
            {
                "machine": self.given.name,
                "outcome": self.outcome,
                "timing": str(self.timing),
                "steps": [
                    {
                        "name": step.name,
                        "title": step.title,
                        "passed": step.passed,
                        "words": step.words,
                        "files": list(step.files),
                    }
                    for step in self.steps
                ],
                "parameters": [
                    {
                        "path": item.path,
                        "unit": item.unit,
                        "file": item.file,
                        "value": item.value,
                        "half_width_95": item.half,
                        "change": item.change,
                        "certain": item.certain,
                    }
                    for item in self.moved
                ],
                "before": None if self.before is None else dict(self.before.facts()),
                "after": None if self.after is None else dict(self.after.facts()),
                "folder": str(self.folder),
            }
        )
