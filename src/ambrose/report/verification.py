"""The standard report of a verified loop: verdicts, machine, curves of all operating points
overlaid, models, checks.
"""

from __future__ import annotations

from collections.abc import Sequence

from ambrose.judge.checks import Checks, Curve
from ambrose.machine.machine import Machine
from ambrose.report import tables, units
from ambrose.report.captions import caption
from ambrose.report.figures.curves import figure
from ambrose.report.figures.rotor_drawing import machine_drawing
from ambrose.report.page import Figure, Report, Section, Table

Labelled = Sequence[tuple[str, Curve]]
OVER_SPEED = (
    "The closed loop assembled anew at every speed; where a mode meets the line of the speed, "
    "unbalance drives it."
)


def verification_report(
    machine: Machine,
    verifications: Sequence[Checks],
    *,
    models: Sequence[tuple[str, str]] = (),
    responses: Labelled = (),
    comparison: Labelled = (),
    over_speed: Labelled = (),
    facts: Sequence[tuple[str, str]] = (),
    title: str = "Verification of the magnetic bearing loop",
    date: str = "",
) -> Report:
    """The report of one machine and controller at several operating points.

    verifications: one Checks per operating point, labelled as in ``machine.operation``; their
    curves of the same name share a figure. models: (name, size in words) such as ("full model",
    "320 states"). responses: (operating point, Curve) pairs of time responses; comparison: (model,
    Curve) pairs, the reference model first; over_speed: (operating point, Curve) pairs of the
    Campbell map; pairs whose curves share a name share a figure. facts: (name, text) for the head,
    e.g. the controller. date: ISO date, today if empty. Raises InvalidInput.
    """
    order = [checks.label for checks in verifications]
    loops = [(checks.label, curve) for checks in verifications for curve in checks.curves]
    sections = [_overview(machine, verifications), machine_section(machine, models)]
    if loops:
        text = (
            "Every operating point keeps its colour and dash in all figures. Drag to zoom, "
            "double-click to see everything. "
            "Peaks in the legends are read from the points drawn; the tables hold the refined ones."
        )
        sections.append(Section("Closed loop", text, curve_figures(loops, order)))
    if over_speed:
        sections.append(Section("Over speed", OVER_SPEED, curve_figures(over_speed, order)))
    if responses:
        text = "Linear model: valid while currents and displacements stay well inside their limits."
        sections.append(Section("Time responses", text, curve_figures(responses, order)))
    sections += models_section(comparison)
    detailed = tuple(tables.checks_table(checks) for checks in verifications if checks.checks)
    sections.append(Section("All checks in detail", "", (), detailed))
    return Report(
        title,
        machine,
        tuple(sections),
        tuple(map(tables.verdict, verifications)),
        tuple(facts),
        date,
    )


def curve_figures(
    curves: Labelled, order: Sequence[str], *, overlay: bool = False
) -> tuple[Figure, ...]:
    """One figure for all curves of the same name, in the order of first appearance."""
    figures = []
    for name in dict.fromkeys(curve.name for _, curve in curves):
        same = [(label, curve) for label, curve in curves if curve.name == name]
        words = "" if overlay else caption(same[0][1])
        figures.append(
            Figure(units.prose(same[0][1].title), figure(same, order=order, overlay=overlay), words)
        )
    return tuple(figures)


def models_section(comparison: Labelled) -> list[Section]:
    """The curves of several models laid over each other; none without any."""
    words = (
        "The reference is drawn broad and pale, the others on top: where a thin line leaves the "
        "broad one, they differ."
    )
    return (
        [Section("Model against model", words, curve_figures(comparison, (), overlay=True))]
        if comparison
        else []
    )


def _overview(machine: Machine, verifications: Sequence[Checks]) -> Section:
    wanted = {checks.label for checks in verifications}
    points = [point for point in machine.operation.envelope if point.label in wanted]
    shown = [*tables.overview_tables(verifications)]
    if points:
        shown.append(tables.operating_points_table(points))
    return Section("Overview", "", (), tuple(shown))


def machine_section(machine: Machine, models: Sequence[tuple[str, str]]) -> Section:
    """The rotor drawing, the stations, the sizes of the models and what was chosen; models: as for
    the whole report.
    """
    words = (
        "To scale: shaft, bores (dashed), laminations that add mass but no stiffness (hatched), "
        "discs as the cylinder with "
        "their mass and inertias. Symbols at their true positions: bearings, sensors, seals, "
        "couplings; dots on the axis "
        "are finite-element nodes. Beneath: free-free mode shapes at standstill, with what "
        "bearings (squares), sensors "
        "(circles) and seals (diamonds) see of them. A bearing and its sensor on opposite sides "
        "of a zero need a phase "
        "reversal of the controller at that mode."
    )
    drawing = Figure("Rotor and free-free modes", machine_drawing(machine), words)
    shown = [tables.stations_table(machine)]
    if models:
        shown.append(Table("Models", ("Model", "Size"), tuple(models)))
    if machine.assumed:
        shown.append(Table("Chosen, not measured", ("Parameter", "Reason"), machine.assumed))
    return Section("Machine", "", (drawing,), tuple(shown))
