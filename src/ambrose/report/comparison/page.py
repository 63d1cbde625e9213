"""Several controllers for one machine on one page, so that a reader can choose: who passes where,
the quantities that decide side by side, the curves in panels with common axes, the gains, the time
responses, everything else behind them, and what is signed.

    comparison_page(machine, [Candidate("PID", synthesis, checks, boxes, traces), ...])

Operating points keep their colour and dash wherever they are drawn; controllers stand in panels of
their own, or have other colours where they are overlaid.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import date as calendar

from ambrose.judge.checks import Checks
from ambrose.judge.critical_speeds import critical_speeds
from ambrose.machine.file.toml import machine_hash
from ambrose.machine.machine import Machine
from ambrose.model.separation import LEAST_AMPLIFICATION
from ambrose.report import tables, units
from ambrose.report.comparison import figures
from ambrose.report.comparison import tables as comparison_tables
from ambrose.report.comparison.envelope import decision, envelope_section
from ambrose.report.page import Cell, Page, Row, Section, Table, numbers
from ambrose.report.record import trace_curves
from ambrose.report.verification import (
    OVER_SPEED,
    Labelled,
    curve_figures,
    machine_section,
    models_section,
    verification_page,
    with_checks,
)
from ambrose.rig.candidate import Candidate, points_of
from ambrose.version import __version__

__all__ = ["Candidate", "comparison_page"]

# what a row of Synthesis.history may hold, and its column; bounds of mu over the frequencies
_HISTORY = (
    ("iteration", "Iteration"),
    ("order", "Order"),
    ("gamma", "γ"),
    ("mu_complex", "Complex µ, upper"),
    ("mu_mixed", "Mixed µ, upper"),
    ("mu_mixed_lower", "Mixed µ, lower"),
)


def comparison_page(
    machine: Machine,
    candidates: Sequence[Candidate],
    *,
    models: Sequence[tuple[str, str]] = (),
    comparison: Labelled = (),
    over_speed: Labelled = (),
    facts: Sequence[tuple[str, str]] = (),
    extra: Sequence[Section] = (),
    title: str = "Comparison of controllers",
    date: str = "",
) -> Page:
    """The report of one machine and several controllers; of a single one the verification report.

    candidates: in the order of the columns, with a name each; their operating points are matched by
    label. models, comparison, facts, date: as for ``verification_page``. over_speed: (candidate
    or operating point, Curve) pairs of maps over speed, one figure each; extra: sections of other
    stages, before the machine's. Raises InvalidInput for no candidates or names that do not tell
    them apart.
    """
    points = points_of(machine, candidates)
    opening, outcome = envelope_section(machine, candidates, points), decision(candidates)
    if len(candidates) == 1:
        only = candidates[0]
        report = verification_page(
            machine,
            [checks for point in points if (checks := only.at(point)) is not None],
            models=models,
            responses=[
                (point, curve)
                for point, trace in only.traces
                for curve in trace_curves(trace, machine)
            ],
            comparison=comparison,
            over_speed=over_speed,
            facts=facts,
            title=title,
            date=date,
        )
        verification = _with_boxes(report, machine, only)
        sections = [*verification.sections, signature_section(machine, candidates, date)]
        return replace(
            verification, sections=tuple(sections), signatures=(), result=outcome, opening=opening
        )
    sections = [_glance(machine, candidates, points), _loops(candidates, points)]
    families = figures.family_figures(machine, candidates)
    if families:
        words = (
            "The uncertain parameters go through their tolerances; the stronger the line, the "
            "larger the parameter."
        )
        sections.append(Section("Over the tolerances", words, families))
    sections.append(_controllers(machine, candidates))
    responses = figures.time_figures(machine, candidates, points)
    if responses:
        words = (
            "Linear model: valid while currents and displacements stay inside their limits. The "
            "panels of a figure share axes."
        )
        sections.append(Section("Time responses", words, responses))
    sections += [*_over_speed(over_speed), *extra]
    sections.append(machine_section(machine, models))
    sections += models_section(comparison)
    sections += [_details(candidates, points), signature_section(machine, candidates, date)]
    verdicts = comparison_tables.verdicts_of(candidates, points)
    return Page(title, machine, tuple(sections), verdicts, tuple(facts), date, (), outcome, opening)


def _with_boxes(page: Page, machine: Machine, candidate: Candidate) -> Page:
    """The verification page of one controller, and what was evaluated between its points and over
    the tolerances around them.
    """
    if candidate.ranges:
        curves = [(part.label, curve) for part in candidate.ranges for curve in part.curves]
        title = "Between the operating points"
        page = with_checks(page, title, candidate.ranges, curve_figures(curves, ()))
    if candidate.robust is not None:
        drawn = figures.family_figures(machine, [candidate])
        page = with_checks(page, "Over the tolerances", candidate.boxes, drawn)
    return page


def _glance(machine: Machine, candidates: Sequence[Candidate], points: Sequence[str]) -> Section:
    """Verdicts and the quantities that decide, over all points and (of several) point by point."""
    contents = [
        comparison_tables.verdict_table(candidates, points),
        comparison_tables.glance_table(machine, candidates, points),
    ]
    if len(points) > 1:
        contents += comparison_tables.point_tables(candidates, points)
    known = [
        point for label in points for point in machine.operation.envelope if point.label == label
    ]
    if known:
        contents.append(tables.operating_points_table(known))
    return Section("At a glance", "", (), tuple(contents))


def _loops(candidates: Sequence[Candidate], points: Sequence[str]) -> Section:
    words = (
        "One panel per controller, all with the same axes. Every operating point keeps its colour "
        "in all figures."
    )
    hint = (
        "Drag to zoom (all panels follow), double-click to see everything, click on a legend entry "
        "to hide or show its lines."
    )
    return Section(
        "Closed loop, side by side", words, figures.loop_figures(candidates, points), hint=hint
    )


def _controllers(machine: Machine, candidates: Sequence[Candidate]) -> Section:
    rows: list[Row] = []
    for candidate in candidates:
        synthesis = candidate.synthesis
        order = Cell(str(synthesis.controller.n_states), "number")
        rows.append(
            (
                candidate.name,
                synthesis.method,
                order,
                synthesis.verdict,
                synthesis.certificate.plant,
                candidate.timing,
                " ".join(synthesis.notes),
            )
        )
    columns = ("Controller", "Method", "Order", "Status", "Certified on", "Loop judged", "Notes")
    contents = [Table("How they were made", columns, tuple(rows))]
    contents += [
        _history(candidate)
        for candidate in candidates
        if any("mu_mixed" in row for row in candidate.synthesis.history)
    ]
    pictures = (
        *figures.gain_figures(machine, candidates),
        *figures.chain_figures(machine, candidates),
    )
    return Section("Controllers", "", pictures, tuple(contents))


def _history(candidate: Candidate) -> Table:
    """What each iteration of a mu synthesis reached."""
    history = candidate.synthesis.history
    known = [(key, words) for key, words in _HISTORY if any(key in row for row in history)]
    rows = tuple(
        numbers(*(units.number(float(row[key]), 4) if key in row else "" for key, _ in known))
        for row in history
    )
    return Table(
        f"{candidate.name}: what each iteration reached", tuple(words for _, words in known), rows
    )


def _over_speed(over_speed: Labelled) -> list[Section]:
    if not over_speed:
        return []
    labels = list(dict.fromkeys(label for label, _ in over_speed))
    pictures = [
        replace(figure, title=figure.title + (f", {label}" if len(labels) > 1 else ""))
        for label in labels
        for figure in curve_figures([pair for pair in over_speed if pair[0] == label], (label,))
    ]
    return [Section("Over speed", OVER_SPEED, tuple(pictures))]


def _details(candidates: Sequence[Candidate], points: Sequence[str]) -> Section:
    """Every check of every candidate, folded."""
    folded = []
    for candidate in candidates:
        ordered = [checks for point in points if (checks := candidate.at(point)) is not None]
        for checks in [*ordered, *candidate.boxes]:
            where, words = checks.label, tables.verdict(checks).text.partition(";")[0]
            folded.append(
                replace(tables.checks_table(checks), title=f"{candidate.name}, {where}: {words}")
            )
    hint = "Click on a line to unfold its table; paper shows those that are open."
    return Section("All checks in detail", "", (), tuple(folded), folded=True, hint=hint)


# the rotor assembled at every speed where that was done, else frozen at one
_CURVES = ("unbalance.assembled_0p", "unbalance")
_HASHES = (
    "Hashes are SHA-256: of all that is computed with in the machine file, and the digest in each "
    "controller's file. "
    "Critical speeds: peaks of the unbalance response with an amplification factor of "
    f"{LEAST_AMPLIFICATION:g} or more (peak "
    "speed over half-power band, as in API 617), at the operating point where the largest factor "
    "was found."
)


def signature_section(
    machine: Machine,
    candidates: Sequence[Candidate],
    date: str,
    names: Sequence[str] = ("Prepared", "Checked", "Released"),
) -> Section:
    """One table: what was judged, with what and when, and a line for each of ``names``."""
    digest = machine_hash(machine)
    rows: list[Row] = [("Machine file", machine.name, _hash(digest), "")]
    rows += [(candidate.name, *_controller(candidate, digest)) for candidate in candidates]
    rows += [
        ("Program", f"ambrose {__version__}", "", ""),
        ("Date", date or calendar.today().isoformat(), "", ""),
    ]
    rows += [(name, Cell("", "sign"), Cell("", "sign"), "name, date, signature") for name in names]
    columns = ("", "What", "Hash", "Critical speeds (amplification factor)")
    return Section(
        "To be signed", _HASHES, (), (Table("", columns, tuple(rows), "", (16, 26, 28, 30)),)
    )


def _controller(candidate: Candidate, digest: str) -> tuple[Cell, Cell, Cell]:
    synthesis = candidate.synthesis
    loop = candidate.timing.partition(":")[0]
    origin = synthesis.provenance.machine_hash
    other = f"designed for another machine file: {origin}" if origin not in {None, digest} else ""
    what = Cell(
        f"method {synthesis.method}, {synthesis.controller.n_states} states, {loop}", detail=other
    )
    return what, _hash(synthesis.digest), _critical(candidate.checks)


def _hash(digest: str) -> Cell:
    return Cell("", detail=digest)


def _critical(points: Sequence[Checks]) -> Cell:
    """Critical speeds at the operating point that has the largest amplification factor."""
    curves = [
        (checks.label, next((c for name in _CURVES for c in checks.curves if c.name == name), None))
        for checks in points
    ]
    known = [(label, critical_speeds(curve)) for label, curve in curves if curve is not None]
    if not known:
        return Cell("not evaluated", "muted")
    label, speeds = max(known, key=lambda item: max((factor for _, factor in item[1]), default=0.0))
    if not speeds:
        return Cell("none: critically damped")
    words = [
        f"{units.join(units.number(speed * units.RPM, 4), 'rpm')} ({units.number(factor, 2)})"
        for speed, factor in speeds
    ]
    return Cell(", ".join(words), detail=f"at {label}")
