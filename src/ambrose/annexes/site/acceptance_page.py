"""The page that is signed on site: measured sensitivity, closed and open loop of every axis over
what was predicted.

write(acceptance_page(accept(machine, controller, records)), "acceptance.html")
"""

from __future__ import annotations

import numpy as np

from ambrose.annexes.site.acceptance import Acceptance, MeasuredLoop
from ambrose.judge.criteria import required_line, zone_lines
from ambrose.law.law import law_of
from ambrose.machine.criteria import SENSITIVITY
from ambrose.machine.file.toml import machine_hash
from ambrose.report import tables, units
from ambrose.report.figures.measured import nyquist, panels
from ambrose.report.page import Cell, Figure, Page, Section, Table

_SENSITIVITY = (
    "Modulus of the output sensitivity of every axis with the other loops closed (ISO 14839-3), "
    "and the largest singular value of the whole matrix, which is stricter. Blue with its 95 % "
    "band: measured, and nothing where noise hides the loop. Thin: what the machine file "
    "predicted, and with the magnets at the static load of the record. Limits judge the band's "
    "upper edge."
)
_CLOSED = "Modulus of the complementary sensitivity 1 − S of every axis: reference to displacement."
_OPEN = (
    "Open loop 1/S − 1 of every axis with the other loops closed, about the critical point −1. "
    "Circles: the borders of the "
    "zones, |S| = 3, 4 and 5; a loop that stays outside the largest is in zone A."
)

_WIDTHS = (20, 40, 40)  # [%] of the columns of the table of what was measured


def acceptance_page(accepted: Acceptance, *, date: str = "") -> Page:
    """The page of an acceptance; date: ISO (today if empty)."""
    limit = accepted.machine.requirements.sensitivity_peak
    sections = [
        section
        for loop in accepted.points
        for section in _sections(loop, limit, len(accepted.points) > 1)
    ]
    sections.append(
        Section(
            "All checks",
            "",
            (),
            tuple(tables.checks_table(loop.checks) for loop in accepted.points),
        )
    )
    verdicts = [tables.verdict(loop.checks) for loop in accepted.points]
    digest = law_of(accepted.controller).digest
    rows = (
        ("Machine file", accepted.machine.name, Cell("", detail=machine_hash(accepted.machine))),
        ("Controller", f"{accepted.timing}", Cell("", detail=digest)),
        *(("Record", name, Cell("", detail=sha256)) for name, sha256 in accepted.records),
    )
    sections.append(
        Section("What was measured", "", (), (Table("", ("", "What", "Hash"), rows, "", _WIDTHS),))
    )
    return Page(
        "Acceptance of the magnetic bearing loop",
        accepted.machine,
        tuple(sections),
        tuple(verdicts),
        (),
        date,
    )


def _sections(loop: MeasuredLoop, requirement: float | None, several: bool) -> list[Section]:
    """The three figures of one record. requirement: the machine's limit of |S|, drawn beside the
    zones of the axes; several: the point's name stands in the titles.
    """
    where = f", {loop.checks.label}" if several else ""
    names = [units.axis_name(axis) for axis in loop.axes]
    diagonal = {label: np.einsum("wii->wi", S) for label, S in loop.predicted}

    # per prediction: modulus of every axis, and sigma_max of the whole matrix in the last column
    S = {
        label: np.column_stack([np.abs(diagonal[label]), np.linalg.norm(full, 2, axis=(1, 2))])
        for label, full in loop.predicted
    }
    sensitivity = panels(
        [*names, "σ max"],
        loop.omega,
        np.column_stack([loop.modulus, loop.sigma]),
        np.column_stack([loop.modulus - loop.half, loop.low]),
        np.column_stack([loop.modulus + loop.half, loop.high]),
        S,
        [zone_lines(SENSITIVITY, requirement)] * len(names) + [required_line(requirement)],
        loop.told,
    )

    # T_ii = 1 - S_ii has the error of S_ii; the open loop of an axis is 1/S_ii - 1
    told = loop.told[:, :-1]
    T = np.abs(1 - np.einsum("wii->wi", loop.S))
    opened = {label: 1 / S_ii - 1 for label, S_ii in diagonal.items()}
    closed = {label: np.abs(1 - S_ii) for label, S_ii in diagonal.items()}
    none: list[tuple[tuple[str, float], ...]] = [()] * len(names)
    figures = (
        Figure(f"Sensitivity{where}", sensitivity, _SENSITIVITY),
        Figure(f"Open loop{where}", nyquist(names, loop.omega, loop.loops, opened, told), _OPEN),
        Figure(
            f"Closed loop{where}",
            panels(names, loop.omega, T, T - loop.half, T + loop.half, closed, none, told),
            _CLOSED,
        ),
    )
    return [Section(f"Measured over predicted{where}", "", figures)]
