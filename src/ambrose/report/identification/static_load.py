"""The page of K_i from static loads: values beside the machine's, how straight force over current
is, the levels.

write(static_page(done), "static.html")
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ambrose.identification.findings import Code
from ambrose.identification.parameters import COVERAGE
from ambrose.identification.result import StaticIdentification
from ambrose.identification.static_load.identify import StaticLoad
from ambrose.identification.validation.agreement import Agreement
from ambrose.report import theme, units
from ambrose.report.identification.page import (
    compared_table,
    repeats_table,
)
from ambrose.report.page import Figure, Page, Row, Section, Table, Verdict, numbers
from ambrose.report.tables import doubtful, without_findings

_LINEAR = 0.01  # probability below which the straight line is rejected
_FIGURE = (
    "Magnet force over control current, less the straight line: what is left at every load level, "
    "with the cubic through the "
    "levels. Points about zero mean a straight magnet; ends that bend down are iron that "
    "saturates, a jump to one side "
    "friction or a stop; points above each other at one current were loaded across this axis. "
    "Bars: 95 % of the mean currents, "
    "as forces."
)


def static_page(
    checked: StaticIdentification, *, compared: Sequence[Agreement] | None = None, date: str = ""
) -> Page:
    """The report of static loads; compared: with another method's; date: ISO (today if empty)."""
    machine, result = checked.given, checked.result
    tables = [static_table(checked)]
    if checked.repeats is not None:
        tables.append(repeats_table(checked.repeats))
    if compared is not None:
        tables.append(compared_table(compared))
    picture = Figure("Force beyond the straight line", line_figure(result), _FIGURE)
    sections = [
        Section("Force per current", "", (picture,), tuple(tables), True),
        Section("Load levels", "", (), (levels_table(result),), folded=True),
    ]
    count = len(result.warnings)
    verdicts = (
        Verdict(
            "Straightness",
            not any(finding.code == Code.CURVED for finding in result.warnings),
            units.prose(result.verdict),
        ),
        without_findings("Loads", result.warnings, "both sides, position held"),
    )
    words = "to be doubted; see below" if count else "identified, and nothing speaks against it"
    facts = (
        ("Records", ", ".join(checked.provenance.records)),
        ("Operating point", result.point.label),
        (
            "Levels",
            f"{len(result.levels.loads)}, loads at "
            f"{', '.join(units.axis_name(port) for port in result.levels.ports)}",
        ),
        ("Largest force of a magnet", units.quantity(float(np.abs(result.forces).max()), "N")),
    )
    return Page(
        "Force per current from static loads",
        machine,
        (*doubtful(result.warnings), *sections),
        verdicts,
        facts,
        date,
        result=Verdict("Result", not count, words),
    )


def static_table(checked: StaticIdentification) -> Table:
    """K_i of every axis: the machine's, the line over the loads, the slope at rest."""
    result = checked.result
    rows: list[Row] = []
    for i, path in enumerate(result.paths):
        value, half = float(result.values[i]), COVERAGE * float(result.standard_deviations[i])
        rest, rest_half = float(result.at_rest[i]), COVERAGE * float(result.at_rest_deviations[i])
        before = float(result.start[i])
        cells = numbers(
            units.quantity(before, "N/A", 4),
            units.plus_minus(value, half, "N/A"),
            f"{units.fixed(100 * (value / before - 1), 100 * half / before)} %",
            units.plus_minus(rest, rest_half, "N/A"),
            f"{units.number(100 * float(result.stiffness_share[i]), 2)} %",
            f"{units.number(100 * (value / rest - 1), 2)} %"
            if result.linearity[i] < _LINEAR
            else "straight",
        )
        rows.append((path, *cells))
    note = (
        "Line: slope over these loads, which goes into the machine file, with 95 %. At rest: "
        "slope of a cubic at the unloaded "
        "working point, which small motion sees. By displacement: share of the magnet's force "
        "that K_s makes; K_i is as wrong "
        "as K_s by this share. Line over tangent: by how much they part where the levels are "
        "curved (99 %)."
    )
    columns = (
        "Parameter",
        "Machine",
        "Line",
        "Change",
        "At rest",
        "By displacement",
        "Line over tangent",
    )
    return Table("Force per current", columns, tuple(rows), note)


def levels_table(result: StaticLoad) -> Table:
    """Every level: loads, displacement and current of every axis."""
    levels = result.levels
    rows: list[Row] = []
    for j in range(len(levels.loads)):
        loads = ", ".join(f"{units.number(float(load), 3)} N" for load in levels.loads[j])
        moved = ", ".join(units.number(1e6 * float(y), 2) for y in levels.displacement[j])
        currents = ", ".join(units.number(float(i), 3) for i in levels.current[j])
        forces = ", ".join(units.number(float(f), 3) for f in result.forces[j])
        rows.append(
            (str(int(levels.record[j])), f"{levels.start[j]:.2f} s", loads, moved, currents, forces)
        )
    ports = ", ".join(units.axis_name(port) for port in levels.ports)
    axes = ", ".join(units.axis_name(axis) for axis in result.axes)
    columns = (
        "Record",
        "From",
        f"Loads {ports}",
        "Displacement [µm]",
        "Current [A]",
        "Magnet force [N]",
    )
    return Table(
        "Load levels",
        columns,
        tuple(rows),
        f"Per axis: {axes}. Forces are relative to the unloaded rotor.",
    )


def line_figure(result: StaticLoad) -> Any:
    """Magnet force less the straight line [N] over the control current [A], an axis each, with the
    cubic through the levels.
    """
    lefts = [_beyond(result, i) for i in range(len(result.axes))]
    shares = [
        100 * float(np.abs(left).max() / np.ptp(result.forces[:, i]))
        for i, left in enumerate(lefts)
    ]
    titles = [
        f"<b>{units.axis_name(axis)}</b>, {units.number(share, 2)} % of its range"
        for axis, share in zip(result.axes, shares, strict=True)
    ]
    figure = theme.subplots(
        rows=1, cols=len(titles), subplot_titles=titles, shared_yaxes=True, horizontal_spacing=0.02
    )
    for i, (current, left) in enumerate(zip(result.levels.current.T, lefts, strict=True)):
        place = {"row": 1, "col": i + 1}
        bars = COVERAGE * result.values[i] * result.levels.current_deviation[:, i]
        theme.scatter(
            figure,
            place,
            current,
            left,
            mode="markers",
            marker={"size": 7, "color": "#0072b2"},
            error_y={"type": "data", "array": bars, "thickness": 1.2, "width": 3},
            hovertemplate="%{x:.4g} A: %{y:.3g} N beyond the line<extra></extra>",
        )
        if len(current) > 5:
            span = np.linspace(current.min(), current.max(), 60)
            cubic = np.polynomial.Polynomial.fit(current, left, 3)
            theme.scatter(figure, place, span, cubic(span), line={"color": theme.INK, "width": 1.5})
        figure.add_hline(y=0, line={"color": theme.MUTED, "width": 1}, **place)
        figure.update_xaxes(title_text="Control current [A]", **place)
    figure.update_yaxes(title_text="Force beyond the line [N]", row=1, col=1)
    return theme.dress(figure, 300, legend=False)


def _beyond(result: StaticLoad, i: int) -> np.ndarray:
    """The magnet force (m,) [N] of an axis less its straight line over the current."""
    current, force = result.levels.current[:, i], result.forces[:, i]
    slope, level = np.polyfit(current, force, 1)
    return np.asarray(force - slope * current - level)
