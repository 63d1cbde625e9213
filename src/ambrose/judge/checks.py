"""What a verification returns: single verdicts, and the curves behind them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ambrose.core.presentation import Presented, data_frame, html_table, in_words, with_unit

_STABILITY = ("stability", "asymptotic stability")  # sources of a limit that only stability sets
_COLUMNS = ("value", "unit", "relation", "limit", "passed", "zone", "detail")


@dataclass(frozen=True, slots=True, repr=False)
class Check(Presented):
    """One criterion, evaluated.

    name: a stable identifier ("sensitivity.output.max"); title: for people; value in ``unit`` (SI);
    limit: None for information only; relation "<", "<=" or ">="; passed: None for information only;
    zone: "A".."D" where a standard has zones; source: standard, edition and clause; detail: where
    or why, in words.
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

    def facts(self) -> Mapping[str, Any]:
        """Value against limit, the verdict and where it was found."""
        limit = (
            {}
            if self.limit is None
            else {"limit": f"{self.relation} {self.limit:.4g}", "passed": self.passed}
        )
        zone = {} if self.zone is None else {"zone": self.zone}
        where = {} if not self.detail else {"detail": self.detail}
        return {
            "name": self.name,
            "value": with_unit(self.value, self.unit),
            **limit,
            **zone,
            **where,
        }

    @property
    def ratio(self) -> float | None:
        """The value over its limit, or the limit over the value where large is good: 1 at the
        limit, more beyond it.

        None without a limit; a limit of zero (a count, the real part of a pole) has no ratio: 0
        where it is met, else infinite.
        """
        if self.limit is None:
            return None
        if self.limit <= 0 or math.isnan(self.value):
            return 0.0 if self.passed else math.inf
        if self.relation.startswith(">"):
            return self.limit / self.value if self.value > 0 else math.inf
        return self.value / self.limit


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Curve(Presented):
    """One picture's worth of data: x (n,), y (k, n) with k labels; SI units; ``limits`` are
    labelled horizontal lines.

    kind: "frequency" (x in rad/s), "speed" (x in rad/s), "time" (x in s) or "poles" (x and y are
    real and imaginary parts).
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

    def facts(self) -> Mapping[str, Any]:
        """What is drawn over which range."""
        span = f"{self.x.min():.4g} to {self.x.max():.4g} {self.x_unit}" if self.x.size else "empty"
        return {
            "name": self.name,
            "title": self.title,
            self.kind: span,
            "lines": self.labels,
            "unit": self.y_unit,
        }

    def to_frame(self) -> Any:
        """A pandas.DataFrame: the values of x in SI units as its index, one column per line."""
        x = f"{self.kind} [{self.x_unit}]"
        return data_frame(
            {
                x: self.x,
                **{f"{n} [{self.y_unit}]": y for n, y in zip(self.labels, self.y, strict=True)},
            },
            x,
        )


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Checks(Presented):
    """The verdict on one closed loop at one operating point, or over a range around it.

    stable: of the loop at its centre, without any perturbation; False means that nothing else was
    evaluated. Of all that the checks cover, see ``holds``, which ``to_dict`` writes.

    notes: what was left out or approximated, and why, one sentence each. found: where in the
    tolerance box the searches found their worst, by parameter, as ``model.uncertainty.perturbed``
    takes it.
    """

    _DATA: ClassVar = ("label", "stable=holds", "passed", "checks")

    label: str
    stable: bool
    checks: tuple[Check, ...]
    curves: tuple[Curve, ...] = ()
    notes: tuple[str, ...] = ()
    found: tuple[Mapping[str, float], ...] = ()

    @property
    def passed(self) -> bool:
        """Whether the loop is stable and every check that has a limit is met."""
        return self.stable and all(check.passed is not False for check in self.checks)

    @property
    def lost(self) -> tuple[Check, ...]:
        """The failed checks that speak of stability: an unstable loop was found within the
        tolerances, or between points.
        """
        return tuple(
            check
            for check in self.failed
            if "stability" in check.name or check.source in _STABILITY
        )

    @property
    def holds(self) -> bool:
        """Whether the loop is stable and no unstable one was found within what these checks
        cover.
        """
        return self.stable and not self.lost

    @property
    def failed(self) -> tuple[Check, ...]:
        """The checks whose limit is not met."""
        return tuple(check for check in self.checks if check.passed is False)

    def __getitem__(self, name: str) -> Check:
        """The check of that name; raises KeyError."""
        return {check.name: check for check in self.checks}[name]

    def facts(self) -> Mapping[str, Any]:
        """The verdict, how many checks were made, and which failed."""
        return {
            "label": self.label,
            "stable": self.holds,
            "passed": self.passed,
            "checks": len(self.checks),
            "failed": [check.name for check in self.failed],
        }

    def _repr_html_(self) -> str:
        return checks_table(
            self.checks, f"{self.label}: {'passed' if self.passed else 'not passed'}"
        )

    def to_frame(self) -> Any:
        """A pandas.DataFrame with a row for each check, by name."""
        return data_frame(check_columns(self.checks), "check")

    def curve(self, name: str) -> Curve:
        """The curve of that name; raises KeyError."""
        return {curve.name: curve for curve in self.curves}[name]


def check_columns(checks: Sequence[Check]) -> dict[str, list[Any]]:
    """The checks as columns of a table: name, value, unit, relation, limit, passed, zone,
    detail.
    """
    return {
        "check": [c.name for c in checks],
        **{name: [getattr(c, name) for c in checks] for name in _COLUMNS},
    }


def checks_table(checks: Sequence[Check], caption: str) -> str:
    """The checks as an HTML table, those that failed first."""
    heading = ("check", "value", "limit", "passed", "zone", "where")
    rows = [
        (
            check.title,
            with_unit(check.value, check.unit),
            "" if check.limit is None else f"{check.relation} {check.limit:.4g}",
            "" if check.passed is None else in_words(check.passed),
            check.zone or "",
            check.detail,
        )
        for check in sorted(checks, key=lambda check: check.passed is not False)
    ]
    return html_table(rows, caption, heading)
