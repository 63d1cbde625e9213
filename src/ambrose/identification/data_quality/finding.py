"""RecordFinding: what is wrong, or doubtful, with a record or with what was identified from it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from ambrose.core.checks import InvalidInput, invalid

ERROR, WARNING = "error", "warning"


@dataclass(frozen=True, slots=True)
class RecordFinding:
    """severity: "error" (no number from this record can be trusted) or "warning"; ``what`` names record and signal,
    ``evidence`` the numbers that show it, ``remedy`` what to do. Raises InvalidInput for another severity."""

    severity: str
    what: str
    evidence: str
    remedy: str

    def __post_init__(self) -> None:
        if self.severity not in {ERROR, WARNING}:
            raise invalid("the severity of a finding", repr(self.severity), '"error" or "warning"', "choose one")

    def __str__(self) -> str:
        return f"{self.what}: {self.evidence}; {self.remedy}"


def refuse(findings: Iterable[RecordFinding]) -> None:
    """Raises InvalidInput with every error among the findings, the first one leading."""
    errors = [str(finding) for finding in findings if finding.severity == ERROR]
    if errors:
        raise InvalidInput("\n".join(errors))
