"""What a verification returns: single verdicts, and the curves behind them."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ambrose.core.presentation import to_plain


@dataclass(frozen=True, slots=True)
class Check:
    """One criterion, evaluated.

    name: a stable identifier ("sensitivity.output.max"); title: for people; value in ``unit`` (SI); limit: None for
    information only; relation "<", "<=" or ">="; passed: None for information only; zone: "A".."D" where a standard has zones;
    source: standard, edition and clause; detail: where or why, in words.
    """

    name: str
    title: str
    value: float
    unit: str
    limit: float | None = None
    relation: str = "<="
    passed: bool | None = None
    zone: str | None = None
    source: str = ""
    detail: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """One picture's worth of data: x (n,), y (k, n) with k labels; SI units; ``limits`` are labelled horizontal lines.

    kind: "frequency" (x in rad/s), "speed" (x in rad/s), "time" (x in s) or "poles" (x and y are real and imaginary parts).
    """

    name: str
    title: str
    kind: str
    x: np.ndarray
    y: np.ndarray
    labels: tuple[str, ...]
    x_unit: str
    y_unit: str
    limits: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Checks:
    """The verdict on one closed loop at one operating point; ``stable`` False means that nothing else was evaluated.

    notes: what was left out or approximated, and why, one sentence each.
    """

    label: str
    stable: bool
    checks: tuple[Check, ...]
    curves: tuple[Curve, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether the loop is stable and every check that has a limit is met."""
        return self.stable and all(check.passed is not False for check in self.checks)

    def __getitem__(self, name: str) -> Check:
        """The check of that name; raises KeyError."""
        for check in self.checks:
            if check.name == name:
                return check
        raise KeyError(name)

    def to_dict(self) -> dict[str, Any]:
        """The verdict without its curves as JSON-ready data; numbers that are not finite become strings ("inf")."""
        return {
            "label": self.label,
            "stable": self.stable,
            "passed": self.passed,
            "checks": [to_plain(asdict(check)) for check in self.checks],
        }

    def curve(self, name: str) -> Curve:
        """The curve of that name; raises KeyError."""
        for curve in self.curves:
            if curve.name == name:
                return curve
        raise KeyError(name)
