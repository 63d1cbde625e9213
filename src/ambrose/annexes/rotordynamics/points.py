"""Stability and sensitivity at every operating point of the machine file: what is cheap
enough to judge everywhere, as ``ambrose.verify`` judges it. Of each the worst point is a row.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ambrose.annexes.rotordynamics import standard
from ambrose.annexes.rotordynamics.loop import ShaftLoop
from ambrose.annexes.rotordynamics.result import OWN, Item
from ambrose.judge.checks import Check, Checks
from ambrose.judge.nominal import check_sensitivity
from ambrose.law.law import LawLike, law_of
from ambrose.law.loop import running_law
from ambrose.law.timing import Timing
from ambrose.machine.criteria import SENSITIVITY, SENSITIVITY_RANGE
from ambrose.machine.machine import Machine
from ambrose.model.assemble import assemble

REST = (
    "Judged at every operating point of the machine file: stability and sensitivity, without "
    "tolerances. ambrose verify judges the rest there: orbits, currents, forces, voltages and "
    "margins, and all of it over the tolerances."
)


@dataclass(frozen=True, slots=True)
class Points:
    """The checks of each operating point, and the labels of those that the law does not cover."""

    judged: tuple[Checks, ...]
    uncovered: tuple[str, ...] = ()


def judge_sensitivity(
    machine: Machine, loop: ShaftLoop, given: LawLike, timing: Timing | None
) -> Points:
    """All operating points that the law covers; loop: at the one of the analysis, which counts even
    where it is none of the machine file's.
    """
    law = law_of(given)
    points, own = list(machine.operation.envelope), loop.plant.point
    if own not in [replace(point, label=own.label) for point in points]:
        points.append(own)
    judged: list[Checks] = []
    uncovered: list[str] = []
    for point in points:
        plant = assemble(machine, point)
        if law.covers(plant):
            judged.append(check_sensitivity(plant, running_law(law, plant, timing)))
        else:
            uncovered.append(point.label or f"{standard.rpm(point.speed)} rpm")
    return Points(tuple(judged), tuple(uncovered))


def rows(points: Points, machine: Machine) -> Iterator[Item]:
    """Stability and sensitivity, the worst operating point of each."""
    judged = points.judged
    if points.uncovered:
        labels = ", ".join(points.uncovered)
        yield Item(
            "points.covered",
            "Operating points that the controller does not cover",
            "Ambrose",
            "stability of the loop as it runs",
            OWN,
            float(len(points.uncovered)),
            "-",
            "<=",
            0.0,
            False,
            f"not judged at {labels}: outside the range of the controller's schedule",
        )
    if not judged:
        return
    several = f"worst of {len(judged)} operating points: " if len(judged) > 1 else "at "

    def row(
        name: str,
        title: str,
        of: tuple[str, ...],
        edition: str,
        clause: str,
        basis: str = OWN,
        most: float = math.inf,
        more: str = "",
    ) -> Iterator[Item]:
        found = [
            (item, checks.label) for checks in judged for item in checks.checks if item.name in of
        ]
        if not found:
            return
        worst, where = max(found, key=lambda pair: _severity(pair[0]))
        limit = worst.limit if worst.limit is None else min(worst.limit, most)
        if limit is None and math.isfinite(most):
            limit = most
        axis = worst.name.rpartition(".")[2]
        place = f"axis {axis}, " if axis in machine.axes else ""
        yield Item(
            name,
            f"{title}, {several}{where}",
            edition,
            clause,
            basis,
            worst.value,
            "1/s" if worst.unit == "rad/s" else worst.unit,
            worst.relation,
            limit,
            None if limit is None else _meets(worst.value, worst.relation, limit),
            f"{place}{worst.detail}{_others(found, where)}{more}",
        )

    axes = tuple(f"sensitivity.output.{axis}" for axis in machine.axes)
    zone = SENSITIVITY.limits[0].value
    upto = SENSITIVITY_RANGE.limits[0].value / (2 * np.pi)
    lost = [checks.label for checks in judged if not checks.stable]
    unstable = f"; none at {', '.join(lost)}, where the loop is unstable" if lost else ""
    yield from row(
        "points.stability",
        "Largest real part of the poles",
        ("stability.abscissa",),
        "Ambrose",
        "stability of the loop as it runs",
    )
    yield from row(
        "iso.sensitivity",
        "Peak sensitivity of a control axis",
        axes,
        standard.ISO_3,
        "zone A, or the machine file's sensitivity_peak where that is less",
        "checked",
        zone,
        f"; up to {upto:.4g} Hz or three times the speed{unstable}",
    )
    yield from row(
        "points.sensitivity_max",
        "Peak sensitivity, maximum singular value",
        ("sensitivity.output.max",),
        "Machine file",
        "sensitivity_peak, asked of all axes together",
        more=unstable,
    )


def _severity(check: Check) -> float:
    """The larger the worse; what is not known is the worst."""
    if math.isnan(check.value):
        return math.inf
    return -check.value if check.relation.startswith(">") else check.value


def _meets(value: float, relation: str, limit: float) -> bool:
    if relation == "<":
        return value < limit
    return value >= limit if relation == ">=" else value <= limit


def _others(found: list[tuple[Check, str]], worst: str) -> str:
    """The worst value of every other operating point."""
    best: dict[str, Check] = {}
    for check, label in found:
        if label not in best or _severity(check) > _severity(best[label]):
            best[label] = check
    words = [f"{label} {check.value:.4g}" for label, check in best.items() if label != worst]
    return f"; at the others {', '.join(words)}" if words else ""
