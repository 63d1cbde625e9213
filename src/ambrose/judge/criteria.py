"""A value held against its limit: a Check with verdict and zone. The limits themselves are data
(machine/criteria.py).
"""

from __future__ import annotations

from dataclasses import replace

from ambrose.judge.checks import Check
from ambrose.machine.criteria import Criterion, Demand


def zone(criterion: Criterion, value: float) -> str | None:
    """The zone of a value; None for a criterion without zones."""
    for limit in criterion.limits:
        if value < limit.value:
            return limit.zone or None
    return criterion.beyond


def holds(value: float, relation: str, limit: float) -> bool:
    """Whether ``value relation limit``; relation "<", "<=" or ">="."""
    return bool({"<": value < limit, "<=": value <= limit, ">=": value >= limit}[relation])


def judge(
    name: str, title: str, value: float, unit: str, wanted: Demand, detail: str = ""
) -> Check:
    """The Check of a value against a Demand, with verdict and zone where there are any."""
    check = Check(
        name,
        title,
        float(value),
        unit,
        wanted.limit,
        wanted.relation,
        source=wanted.source,
        detail=detail,
    )
    if wanted.zones is not None:
        check = replace(check, zone=zone(wanted.zones, value))
    if wanted.limit is not None:
        check = replace(check, passed=holds(value, wanted.relation, wanted.limit))
    return check


def information(
    name: str, title: str, value: float, unit: str, detail: str = "", relation: str = "<="
) -> Check:
    """A Check without a limit; relation "<=" where small is good, ">=" where large is."""
    return Check(name, title, float(value), unit, relation=relation, detail=detail)


def required_line(requirement: float | None) -> tuple[tuple[str, float], ...]:
    """The user's own limit as a labelled horizontal line for a Curve; nothing without one."""
    return () if requirement is None else (("required", float(requirement)),)


def zone_lines(
    criterion: Criterion, requirement: float | None = None, of: str = ""
) -> tuple[tuple[str, float], ...]:
    """Labelled horizontal lines for a Curve: the user's own limit, and the borders "zone A/B" ...
    of the criterion; of: the lines that these judge, where the curve has others.
    """
    above = [*(limit.zone for limit in criterion.limits[1:]), criterion.beyond]
    return required_line(requirement) + tuple(
        (f"zone {limit.zone}/{next_}{of and f' of {of}'}", limit.value)
        for limit, next_ in zip(criterion.limits, above, strict=True)
    )
