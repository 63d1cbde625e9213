"""Candidate: one controller and everything found about it, as the comparison of several takes it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ambrose.core.checks import InvalidInput
from ambrose.machine.machine import Machine
from ambrose.simulation.trace import Trace
from ambrose.synthesis.result import Synthesis
from ambrose.verification.checks import Check, Checks


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """One controller and everything found about it. Raises InvalidInput for a name or a label that does not tell apart.

    name: for people ("PID", "H-infinity", "mu"); checks: per operating point; robust: over the whole tolerance box, from
    verify.robust (None: not evaluated); traces: (operating point, trace) pairs, several scenarios.
    """

    name: str
    synthesis: Synthesis
    checks: tuple[Checks, ...]
    robust: Checks | None = None
    traces: tuple[tuple[str, Trace], ...] = ()

    def __post_init__(self) -> None:
        if not self.name.strip():
            raise InvalidInput("a candidate has no name; give it one, e.g. that of its method")
        if not self.checks:
            raise InvalidInput(f"candidate {self.name!r} has no checks; verify it at one operating point at least")
        labels = [checks.label for checks in self.checks]
        twice = next((label for label in labels if labels.count(label) > 1), None)
        if twice is not None:
            raise InvalidInput(f"candidate {self.name!r} has two verifications labelled {twice!r}; give every point its label")

    @property
    def passed(self) -> bool:
        """Whether every check at every operating point and over the tolerance box is met."""
        return all(checks.passed for checks in self.checks) and (self.robust is None or self.robust.passed)

    def at(self, point: str) -> Checks | None:
        """What was found at the operating point of that label; None where it was not verified."""
        return next((checks for checks in self.checks if checks.label == point), None)


def find(checks: Checks | None, name: str) -> Check | None:
    """The check of that name, if there is one."""
    return next((check for check in checks.checks if check.name == name), None) if checks is not None else None


def points_of(machine: Machine, candidates: Sequence[Candidate]) -> tuple[str, ...]:
    """The labels of all operating points, by rising speed and seal pressure; unknown ones last, as they come.

    Raises InvalidInput for no candidates, or two of the same name.
    """
    names = [candidate.name for candidate in candidates]
    if not names or len(set(names)) < len(names):
        raise InvalidInput(f"the candidates are named {', '.join(names) or 'not at all'}, but need one name each; rename them")
    known = {point.label: (point.speed, point.seal_pressure) for point in machine.operation.points}
    labels = dict.fromkeys(checks.label for candidate in candidates for checks in candidate.checks)
    return tuple(sorted(labels, key=lambda label: known.get(label, (float("inf"), 0.0))))
