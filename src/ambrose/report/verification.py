"""The standard page of a verified loop: verdicts, machine, curves of all operating points overlaid,
models, checks; and the caption of a curve, which says what to look at.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from ambrose.judge.checks import Checks, Curve
from ambrose.judge.verification import Verification
from ambrose.machine.machine import Machine
from ambrose.report import tables, units
from ambrose.report.figures.curves import figure
from ambrose.report.figures.rotor_drawing import machine_drawing
from ambrose.report.page import Figure, Page, Section, Table, Verdict

# The first entry whose words all occur in the curve's name applies.
_BY_NAME = {
    "complementary": "The peak bounds the multiplicative plant error that the loop survives "
    "(1/peak); it should fall off "
    "steeply before the first bending mode.",
    "control": "Current asked for per metre of sensor noise or run-out. The plateau at high "
    "frequency is the controller's gain "
    "there: noise times this is current.",
    "sensitivity input": "Peak against the zone limits, seen at the plant's input. It should not "
    "exceed the output sensitivity "
    "by much; if it does, the axes are unequal.",
    "sensitivity": "The peak is what counts: its inverse is the distance to instability. ISO "
    "14839-3 judges each axis by the "
    "zone limits; the maximum singular value covers all axes at once. A narrow spike at a bending "
    "mode is spillover, a broad "
    "hump is poor damping of the rigid modes.",
    "compliance": "Displacement per force on the rotor. The peak shows the softest frequency, the "
    "left end the static "
    "stiffness (integral action makes it fall).",
    "unbalance current": "Control current under the residual unbalance. Look at the largest "
    "against the amplifier's limit.",
    "unbalance": "Orbit (zero to peak) under the worst placement of the residual unbalance. Look "
    "at the passages through the "
    "critical speeds and at the margin to the limit over the speed range.",
    "margin loop": "One loop cut open, the others closed. Stability margins are read where the "
    "curve passes 1.",
    "campbell": "Damped frequencies over speed; solid forward or planar, dashed backward whirl. "
    "Crossings with the 1× line are "
    "the critical speeds.",
    "current": "Control currents. Look at the largest against the amplifier's limit: beyond it "
    "the linear result does not "
    "hold.",
    "displacement": "Displacements at the sensors. Look at the largest against the touchdown gap "
    "and at how fast they settle.",
}

_BY_KIND = {
    "frequency": "Circles mark the peaks that the legend quotes.",
    "speed": "Look for crossings and for lines that leave their limits inside the speed range.",
    "time": "Look at the largest excursion and at how fast it settles.",
    "poles": "Everything in the shaded half is unstable. Left: rigid-body and controller poles; "
    "right: all poles, the "
    "bending modes at high frequency with little damping.",
}

_ALIASES = {"T": "complementary", "KS": "control", "S": "sensitivity"}


def caption(curve: Curve) -> str:
    """The caption of a figure of that curve."""
    name = " ".join(
        _ALIASES.get(part, part) for part in curve.name.replace(".", " ").split()
    ).lower()
    if curve.kind != "poles":
        for words, text in _BY_NAME.items():
            if all(word in name for word in words.split()):
                return text
    return _BY_KIND.get(curve.kind, "")


Labelled = Sequence[tuple[str, Curve]]
OVER_SPEED = (
    "The closed loop assembled anew at every speed; where a mode meets the line of the speed, "
    "unbalance drives it."
)


def verification_page(
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
) -> Page:
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
            "Every operating point keeps its colour in all figures. Drag to zoom, "
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
    return Page(
        title,
        machine,
        tuple(sections),
        tuple(map(tables.verdict, verifications)),
        tuple(facts),
        date,
    )


def page_of_verification(verification: Verification, machine: Machine, **options: Any) -> Page:
    """The page of a Verification; options: as for ``verification_page``. What was shown beyond the
    operating points stands in sections of its own.
    """
    page = verification_page(machine, verification.points, **options)
    for title, checks in (
        ("Between the operating points", verification.ranges),
        ("Over the tolerances", verification.boxes),
        ("While parameters move", verification.moving),
    ):
        page = with_checks(page, title, checks) if checks else page
    titles = (check.title for _, checks in verification.labelled for check in checks.failed)
    failed = "; ".join(units.prose(title) for title in dict.fromkeys(titles))
    words = "every check passed" if verification.passed else f"fails: {failed or 'stability'}"
    facts = (
        tables.machine_fact(machine),
        ("Controller", verification.controller),
        ("Loop judged", verification.timing),
        ("Left out", ", ".join(verification.left_out)),
        ("Not varied", ", ".join(verification.not_varied)),
    )
    result = Verdict("Result", verification.passed, words)
    return replace(page, facts=(*page.facts, *facts), result=result)


def with_checks(
    page: Page, title: str, checks: Sequence[Checks], figures: Sequence[Figure] = ()
) -> Page:
    """The page with a section of further checks before its last one, and their verdicts."""
    section = Section(title, "", tuple(figures), tuple(map(tables.checks_table, checks)))
    sections = (*page.sections[:-1], section, page.sections[-1])
    return replace(page, sections=sections, verdicts=(*page.verdicts, *map(tables.verdict, checks)))


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
    overview = [*tables.overview_tables(verifications)]
    if points:
        overview.append(tables.operating_points_table(points))
    return Section("Overview", "", (), tuple(overview))


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
    contents = [tables.stations_table(machine)]
    if models:
        contents.append(Table("Models", ("Model", "Size"), tuple(models)))
    contents += tables.assumed_table(machine)
    return Section("Machine", "", (drawing,), tuple(contents))
