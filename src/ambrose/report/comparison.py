"""What a study adds to the page that compares its controllers: the commissioning on the rig (what
was identified, what runs as code, how it does) and the run-up (every step on the way up).
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from ambrose.core.frequency import frequency_response
from ambrose.identification.result import LoopIdentification
from ambrose.judge.campbell import critical_speeds
from ambrose.judge.checks import Checks, Curve, Verification
from ambrose.judge.loop_response import ALL_AXES
from ambrose.law.loop import timing_in_words
from ambrose.machine.file.toml import machine_hash
from ambrose.machine.machine import Machine
from ambrose.model.static_load import LEAST_AMPLIFICATION
from ambrose.report import comparison_tables, tables, theme
from ambrose.report.comparison_tables import NOT_EVALUATED, decision, envelope_section, quoted
from ambrose.report.figures.bode import Panel, filter_figure, panel_figure
from ambrose.report.identification import change_figure, parameters_table
from ambrose.report.page import Cell, Figure, Page, Row, Section, Table, numbers
from ambrose.report.record import record_figure, thinned, trace_curves
from ambrose.report.tables import findings_table
from ambrose.report.verification import (
    OVER_SPEED,
    Labelled,
    caption,
    curve_figures,
    machine_section,
    models_section,
    verification_page,
    with_checks,
)
from ambrose.rig.trace import Trace
from ambrose.rig.trial import Candidate, RunUp, Step, find, points_of

# Several controllers in pictures: one panel per controller with common axes, or all overlaid.


T = TypeVar("T")

_LOOPS = (  # (curve, the check that holds its refined peak)
    ("sensitivity.output", "sensitivity.output.max"),
    ("compliance", "compliance.max"),
    ("unbalance", "unbalance.orbit_0p"),
)
_COLUMNS = 4  # panels beside each other
_INSIDE, _OUTSIDE = 150, 40  # bins of a response in time, inside and outside the view
_OUTLINE = 120  # points of an outline
# [rad/s], and points: of the controller gains, 0.1 Hz to 2 kHz
_LOWEST, _HIGHEST = 0.1 * theme.TWO_PI, 2e3 * theme.TWO_PI
_POINTS = 500
_NONE = 1e-9  # a gain this small beside the largest is one that the controller does not have
_DELTA = re.compile(r"^(.*\S) ([+-]\d+(?:\.\d+)?)$")
# a time view goes from where the first response leaves this band (of its largest value) to where
_ONSET, _SETTLED = 0.02, 0.05
# the last one has settled into that band, and so much of its length before and after
_BEFORE, _AFTER = 0.06, 0.25


def loop_figures(candidates: Sequence[Candidate], points: Sequence[str]) -> tuple[Figure, ...]:
    """Output sensitivity, compliance and unbalance orbit: one panel per candidate, the operating
    points overlaid.
    """
    style = theme.styles(points)
    figures = []
    for name, check in _LOOPS:
        panels = [_loop_panel(candidate, points, name, check) for candidate in candidates]
        curves = [curve for panel in panels for _, curve in panel.curves]
        if curves:
            picture, hidden = panel_figure(wrapped(panels), style, mark_peaks=True)
            words = f"{caption(curves[0])} Above each panel: the peak at each operating point."
            figures.append(Figure(theme.prose(curves[0].title), picture, _with(words, hidden)))
    return tuple(figures)


def _loop_panel(candidate: Candidate, points: Sequence[str], name: str, check: str) -> Panel:
    curves, notes = [], []
    for point in points:
        checks = candidate.at(point)
        curve = _curve(checks, name)
        if checks is None:
            notes.append((point, NOT_EVALUATED))
        elif not checks.stable:
            notes.append((point, "unstable"))
        elif curve is not None:
            curves.append((point, _line(curve, curve.labels[0])))
            match = find(checks, check)
            notes += [(point, theme.quantity(match.value, match.unit))] if match is not None else []
    return Panel(candidate.name, tuple(curves), _one_unit(notes))


def _one_unit(notes: Sequence[tuple[str, str]]) -> tuple[tuple[str, str], ...]:
    """The unit only after the last number, where all share it."""
    parts = [text.rpartition("\u00a0") for _, text in notes]
    shared = {unit for number, _, unit in parts if number}
    last = max((i for i, (number, _, _) in enumerate(parts) if number), default=-1)
    if len(shared) != 1:
        return tuple(notes)
    return tuple(
        (label, number if number and i != last else text)
        for i, ((label, text), (number, _, _)) in enumerate(zip(notes, parts, strict=True))
    )


def family_figures(machine: Machine, candidates: Sequence[Candidate]) -> tuple[Figure, ...]:
    """Every curve of the robust verification: families in one panel per candidate, single lines
    overlaid.
    """
    boxes = [
        (candidate, candidate.robust) for candidate in candidates if candidate.robust is not None
    ]
    names = dict.fromkeys(curve.name for _, checks in boxes for curve in checks.curves)
    return tuple(_family_figure(machine, boxes, name) for name in names)


def _family_figure(
    machine: Machine, boxes: Sequence[tuple[Candidate, Checks]], name: str
) -> Figure:
    families = [
        (candidate, checks, curve)
        for candidate, checks in boxes
        if (curve := _curve(checks, name)) is not None
    ]
    first = families[0][2]
    if all(len(curve.labels) == 1 for _, _, curve in families):
        style = theme.candidate_styles([candidate.name for candidate, _ in boxes])
        panel = Panel("", tuple((candidate.name, curve) for candidate, _, curve in families))
        picture, hidden = panel_figure([[panel]], style, mark_peaks=True)
        return Figure(theme.prose(first.title), picture, _with("The controllers overlaid.", hidden))
    longest = max((curve.labels for _, _, curve in families), key=len)
    labels = _family_labels(machine, longest)
    panels = []
    for candidate, checks, curve in families:
        lines = tuple((labels.get(label, label), _line(curve, label)) for label in curve.labels)
        panels.append(
            Panel(candidate.name, lines, (("", _family_note(checks, name, longest, curve.labels)),))
        )
    others = theme.family_styles([name for panel in panels for name, _ in panel.curves])
    style = {**others, **theme.family_styles([labels[label] for label in longest])}
    picture, hidden = panel_figure(wrapped(panels), style, mark_peaks=True)
    words = (
        f"{caption(first)} Lines that are missing belong to unstable loops. Model: "
        f"{families[0][1].label}."
    )
    return Figure(theme.prose(first.title), picture, _with(words, hidden))


def _family_note(checks: Checks, name: str, every: Sequence[str], stable: Sequence[str]) -> str:
    """The worst case, from the check of the same quantity."""
    check = find(checks, "robust.sensitivity.worst" if name == "robust.sensitivity" else name)
    missing = len(every) - len(stable)
    if missing:
        return f"{missing} of {len(every)} unstable"
    return f"worst case {theme.number(check.value)}" if check is not None else ""


def _family_labels(machine: Machine, labels: Sequence[str]) -> dict[str, str]:
    """ "seal.center.k +0.5" as people read it: "seal.center.k +50 %"; other labels stay."""
    relative = {item.parameter: item.relative for item in machine.tolerances}
    legend = {}
    for label in labels:
        match = _DELTA.match(label)
        if match is None:
            legend[label] = label
            continue
        parameter, delta = match[1], float(match[2])
        width = relative.get(parameter)
        words = (
            "nominal"
            if delta == 0
            else f"{delta:+g} tolerance"
            if width is None
            else f"{100 * width * delta:+.3g}\u00a0%"
        )
        legend[label] = f"{parameter} {words}".replace("-", "−")
    return legend


def gain_figures(machine: Machine, candidates: Sequence[Candidate]) -> tuple[Figure, ...]:
    """Magnitude of the controllers' direct and cross-coupling gains, the candidates overlaid
    (Lauridsen 2017, P5, fig. 10).
    """
    systems = [(candidate.name, candidate.synthesis.controller) for candidate in candidates]
    n = min(len(machine.axes), *(min(system.D.shape) for _, system in systems))
    omega = np.geomspace(_LOWEST, _HIGHEST, _POINTS)
    gains: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    for name, system in systems:
        grid = omega if system.dt is None else omega[omega < np.pi / system.dt]
        gains[name] = grid, np.abs(frequency_response(system, grid).values[:, :n, :n])
    direct = [_gain_panel(machine, gains, i, i) for i in range(n)]
    cross = [_gain_panel(machine, gains, 0, j) for j in range(1, n)]
    picture, hidden = panel_figure(
        [*wrapped(direct), *wrapped(cross)],
        theme.candidate_styles([name for name, _ in systems]),
        height=190,
    )
    words = (
        "First row: each axis from its own sensor. Second row: the first axis from the other "
        "sensors; a gain there works against the cross-coupled stiffness of the seal."
    )
    return (Figure("Controller gains", picture, _with(words, hidden)),)


def chain_figures(machine: Machine, candidates: Sequence[Candidate]) -> tuple[Figure, ...]:
    """The filter banks among the controllers: per channel its sections, and their Bode diagram."""
    words = (
        "Equal channels are drawn once. ○ zeros, × poles, and the response of all sections in "
        "series."
    )
    banks = [
        (candidate.name, candidate.synthesis.filters)
        for candidate in candidates
        if candidate.synthesis.scheduled is None
    ]
    return tuple(
        Figure(f"{name}: filters", filter_figure(bank, machine.axes), words)
        for name, bank in banks
        if bank
    )


def _gain_panel(
    machine: Machine, gains: Mapping[str, tuple[np.ndarray, np.ndarray]], i: int, j: int
) -> Panel:
    axes = machine.axes
    curves, notes = [], []
    for name, (omega, gain) in gains.items():
        row = gain[:, i, j]
        if row.max() <= _NONE * gain.max():
            notes.append((name, f"{name}: none"))
            continue
        curves.append(
            (
                name,
                Curve(
                    "controller.gain",
                    "Gain",
                    "frequency",
                    omega,
                    row[None],
                    (f"{i + 1},{j + 1}",),
                    "rad/s",
                    "A/m",
                ),
            )
        )
    arrow = axes[i] if i == j else f"{axes[j]} → {axes[i]}"
    return Panel(f"({i + 1},{j + 1}) {theme.prose(arrow)}", tuple(curves), tuple(notes))


def time_figures(
    machine: Machine, candidates: Sequence[Candidate], points: Sequence[str]
) -> tuple[Figure, ...]:
    """Displacements and currents of every scenario: rows are axes, columns candidates, the
    operating points overlaid.
    """
    traces = [
        (candidate, point, trace) for candidate in candidates for point, trace in candidate.traces
    ]
    curves = [
        (candidate, point, trace, curve)
        for candidate, point, trace in traces
        for curve in trace_curves(trace, machine)
    ]
    return tuple(
        _time_figure(candidates, points, [row for row in curves if row[3].name == name])
        for name in dict.fromkeys(curve.name for *_, curve in curves)
    )


def _time_figure(
    candidates: Sequence[Candidate],
    points: Sequence[str],
    responses: Sequence[tuple[Candidate, str, Trace, Curve]],
) -> Figure:
    first = responses[0][3]
    axes = tuple(dict.fromkeys(label for *_, curve in responses for label in curve.labels))
    labels = [*points, *(point for _, point, _, _ in responses)]
    calm = tuple((point, curve) for _, point, trace, curve in responses if trace.passed)
    span = _lively(calm)
    rows = []
    for block in wrapped(candidates):
        for i, axis in enumerate(axes):
            row = []
            for candidate in block:
                mine = sorted(
                    (item for item in responses if item[0] is candidate),
                    key=lambda item: labels.index(item[1]),
                )
                lines = tuple(
                    (point, _drawable(curve, axis, trace, span)) for _, point, trace, curve in mine
                )
                notes = [(point, _ending(trace)) for _, point, trace, _ in mine if not trace.passed]
                notes += [
                    (point, f"{point}: {NOT_EVALUATED}")
                    for point in points
                    if candidate.at(point) is None
                ]
                row.append(
                    Panel(
                        candidate.name if i == 0 else "",
                        lines,
                        tuple(notes) if i == 0 else (),
                        theme.axis_name(axis),
                    )
                )
            rows.append(row)
    picture, hidden = panel_figure(rows, theme.styles(labels), height=96, view=calm, span=span)
    whole = max(float(curve.x[-1]) for *_, curve in responses)
    words = caption(first)
    if len(calm) < len(responses):
        words += " Of a run that is unstable or driven too far the outline of its growth is drawn."
    if span is not None and span[1] - span[0] < 0.99 * whole:
        span_words = f"{theme.quantity(span[0], 's')} to {theme.quantity(span[1], 's')}"
        words += (
            f" Shown from {span_words} of the {theme.quantity(whole, 's')} computed; "
            "a double-click shows all."
        )
    return Figure(theme.prose(first.title), picture, _with(words, hidden))


def _drawable(curve: Curve, axis: str, trace: Trace, span: tuple[float, float] | None) -> Curve:
    """One line as it is drawn: the lowest and the highest value of every bin, small ones inside the
    view; of a run that is not calm, whose oscillation would fill its panel, the outline of its
    growth to either side.
    """
    i = curve.labels.index(axis)
    row = curve.y[i : i + 1]
    if not trace.passed:
        both = np.vstack([_growth(curve.x, row[0]), -_growth(curve.x, -row[0])])
        keep = np.unique(np.linspace(0, row.shape[1] - 1, _OUTLINE).astype(int))
        return replace(curve, x=curve.x[keep], y=both[:, keep], labels=(axis, axis))
    low, high = (0, row.shape[1]) if span is None else np.searchsorted(curve.x, span)
    pieces = [(slice(0, low), _OUTSIDE), (slice(low, high), _INSIDE), (slice(high, None), _OUTSIDE)]
    parts = [
        thinned(curve.x[part], row[:, part], bins) for part, bins in pieces if curve.x[part].size
    ]
    return replace(
        curve,
        x=np.concatenate([x for x, _ in parts]),
        y=np.concatenate([y for _, y in parts], axis=1),
        labels=(axis,),
    )


def _growth(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Straight lines through the peaks that are higher than all before, over x (n,)."""
    highest = np.maximum.accumulate(y)
    rises = np.append(np.diff(highest) > 0, False)
    tops = np.flatnonzero(~rises & np.append(True, rises[:-1]))
    at = np.unique(np.r_[0, int(rises.argmax()), tops, len(x) - 1])  # flat before the first
    return np.interp(x, x[at], highest[at])


def _ending(trace: Trace) -> str:
    when = "" if trace.stopped_at is None else f", down at {theme.quantity(trace.stopped_at, 's')}"
    return f"{'unstable' if not trace.stable else 'driven too far'}{when}"


def _lively(curves: Sequence[tuple[str, Curve]]) -> tuple[float, float] | None:
    """From when to when these responses have something to show [s]; None without any that moves."""
    starts = []
    ends = []
    last = 0.0
    for _, curve in curves:
        size = np.abs(curve.y).max(axis=0)
        moving = np.flatnonzero(size > _ONSET * size.max())
        if moving.size:
            starts.append(float(curve.x[moving[0]]))
            ends.append(float(curve.x[np.flatnonzero(size > _SETTLED * size.max())[-1]]))
        last = max(last, float(curve.x[-1]))
    if not starts or min(starts) >= max(ends):
        return None
    length = max(ends) - min(starts)
    return max(0.0, min(starts) - _BEFORE * length), min(last, max(ends) + _AFTER * length)


def wrapped(items: Sequence[T]) -> list[Sequence[T]]:
    """In rows of equal length, or one shorter: five are three and two; of nothing none."""
    if not items:
        return []
    count = -(-len(items) // _COLUMNS)
    width = -(-len(items) // count)
    return [items[i : i + width] for i in range(0, len(items), width)]


def _curve(checks: Checks | None, name: str) -> Curve | None:
    return (
        next((curve for curve in checks.curves if curve.name == name), None)
        if checks is not None
        else None
    )


def _line(curve: Curve, label: str) -> Curve:
    """One line of the curve alone, with the limits that judge it: zones are of axes."""
    i = curve.labels.index(label)
    limits = curve.limits
    if label == ALL_AXES:
        limits = tuple(limit for limit in limits if not limit[0].startswith("zone"))
    return replace(curve, y=curve.y[i : i + 1], labels=(label,), limits=limits)


def _with(words: str, hidden: str) -> str:
    return words + (f" {hidden[:1].upper()}{hidden[1:]}." if hidden else "")


# Several controllers for one machine on one page, so that a reader can choose: who passes where,
# the quantities that decide side by side, the curves in panels with common axes, the gains, the
# time responses, everything else behind them, and what is signed.
#
#     comparison_page(machine, [Candidate("PID", synthesis, checks, boxes, traces), ...])
#
# Operating points keep their colour and dash wherever they are drawn; controllers stand in panels
# of their own, or have other colours where they are overlaid.


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
    facts = (*_identity(machine, candidates), *facts, tables.unstated(machine))
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
        return replace(verification, result=outcome, opening=opening, verdicts=())
    sections = [_glance(machine, candidates, points), _loops(candidates, points)]
    families = family_figures(machine, candidates)
    if families:
        words = "The stronger the line, the larger the parameter within its tolerance."
        sections.append(Section("Over the tolerances", words, families))
    sections.append(_controllers(machine, candidates))
    filters = chain_figures(machine, candidates)
    sections += [Section("Filters", "", filters, on_paper=False)] if filters else []
    responses = time_figures(machine, candidates, points)
    if responses:
        words = "Linear model, unless the rig is named. The panels of a figure share axes."
        sections.append(Section("Time responses", words, responses, on_paper=False))
    sections += [*_over_speed(over_speed), *extra]
    sections.append(machine_section(machine, models))
    sections += models_section(comparison)
    sections.append(_details(candidates, points))
    return Page(title, machine, tuple(sections), (), facts, date, result=outcome, opening=opening)


def _identity(machine: Machine, candidates: Sequence[Candidate]) -> tuple[tuple[str, str], ...]:
    """Every controller with its states and the first digits of its hash, which loop was checked,
    and the first tolerances.
    """
    names: dict[str, list[str]] = {}
    for c in candidates:
        names.setdefault(timing_in_words(c.timing), []).append(quoted(c.name))
    loops = (
        f"{', '.join(own)}: {timing}" if len(names) > 1 else timing for timing, own in names.items()
    )
    digests = (
        f"{quoted(c.name)} ({c.synthesis.controller.n_states}) {c.synthesis.digest[:12]}"
        for c in candidates
    )
    return (
        ("Controllers (states), SHA-256", ", ".join(digests)),
        ("Loop", "; ".join(loops)),
        tables.tolerances_in_head(machine),
    )


def _with_boxes(page: Page, machine: Machine, candidate: Candidate) -> Page:
    """The verification page of one controller, and what was evaluated between its points and over
    the tolerances around them.
    """
    if candidate.ranges:
        curves = [(part.label, curve) for part in candidate.ranges for curve in part.curves]
        title = "Between the operating points"
        page = with_checks(page, title, candidate.ranges, curve_figures(curves, ()))
    if candidate.robust is not None:
        drawn = family_figures(machine, [candidate])
        page = with_checks(page, "Over the tolerances", candidate.boxes, drawn)
    return page


def _glance(machine: Machine, candidates: Sequence[Candidate], points: Sequence[str]) -> Section:
    """The quantities that decide; folded: what is not met, and all of them point by point."""
    folded = []
    for candidate in candidates:
        every = Verification(candidate.checks, candidate.boxes, ranges=candidate.ranges)
        failing = tables.failing_table(every)
        if failing.rows:
            folded.append(replace(failing, title=f"{candidate.name}: requirements not met"))
    if len(points) > 1:
        folded += comparison_tables.point_tables(candidates, points)
    known = [
        point for label in points for point in machine.operation.envelope if point.label == label
    ]
    folded += [tables.operating_points_table(known)] if known else []
    contents = (replace(table, folded=True) for table in folded)
    first = comparison_tables.glance_table(machine, candidates, points)
    return Section("At a glance", "", (), (first, *contents))


def _loops(candidates: Sequence[Candidate], points: Sequence[str]) -> Section:
    words = "One panel per controller. An operating point has the same colour in all figures."
    hint = "Drag to zoom, double-click to zoom out, click on a legend entry to hide its lines."
    return Section("Closed loop, side by side", words, loop_figures(candidates, points), hint=hint)


def _controllers(machine: Machine, candidates: Sequence[Candidate]) -> Section:
    digest = machine_hash(machine)
    rows: list[Row] = []
    notes: list[Row] = []
    for candidate in candidates:
        synthesis = candidate.synthesis
        origin = synthesis.provenance.machine_hash
        what = (synthesis.method, synthesis.verdict, synthesis.certificate.plant)
        hashed = Cell("", detail=synthesis.digest)
        rows.append((candidate.name, *what, _critical(candidate.checks), hashed))
        remarks = [*synthesis.notes]
        if origin not in {None, digest}:
            remarks.append(f"Designed for another machine file: {origin}")
        notes += [(candidate.name, " ".join(remarks))] if remarks else []
    columns = ("Controller", "Method", "Status", "Certified on", _CRITICAL, "SHA-256")
    contents = [Table("How they were made", columns, tuple(rows), _PEAKS, (14, 10, 13, 16, 20, 27))]
    folded = [Table("Notes of the designs", ("Controller", "Notes"), tuple(notes))] if notes else []
    folded += [
        _history(candidate)
        for candidate in candidates
        if any("mu_mixed" in row for row in candidate.synthesis.history)
    ]
    contents += [replace(table, folded=True) for table in folded]
    return Section("Controllers", "", gain_figures(machine, candidates), tuple(contents))


def _history(candidate: Candidate) -> Table:
    """What each iteration of a mu synthesis reached."""
    history = candidate.synthesis.history
    known = [(key, words) for key, words in _HISTORY if any(key in row for row in history)]
    rows = tuple(
        numbers(*(theme.number(float(row[key]), 4) if key in row else "" for key, _ in known))
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
    return Section(
        "All checks in detail", "", (), tuple(folded), folded=True, hint=hint, on_paper=False
    )


# the rotor assembled at every speed where that was done, else frozen at one
_CURVES = ("unbalance.assembled_0p", "unbalance")
_CRITICAL = "Critical speeds (amplification factor)"
_PEAKS = (
    "Critical speeds: peaks of the unbalance response with an amplification factor of "
    f"{LEAST_AMPLIFICATION:g} or more (API 617), at the operating point that has the largest."
)


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
        f"{theme.join(theme.number(speed * theme.RPM, 4), 'rpm')} ({theme.number(factor, 2)})"
        for speed, factor in speeds
    ]
    return Cell(", ".join(words), detail=f"at {label}")


_ON_THE_RIG = (
    "The virtual rig takes the place of the machine: a record identifies the uncertain entries of "
    "the machine file, a robust controller is designed for them, exported and run. Full "
    "identification: commissioned/identified.html."
)
_CHANGE = (
    "Bars that leave the dot: the record moved the parameter. Magnets that carry weight differ "
    "from entries for unloaded ones."
)
_CYCLE = (
    "Lift-off, run-up to top speed with G2.5 unbalance, pressure, a knock, trip and coast-down, "
    "faster than on a machine: the displacement stays within the touchdown gap."
)


def commissioning_section(
    checked: LoopIdentification,
    reference: Candidate,
    commissioned: Candidate,
    points: Sequence[str],
    deployed: Sequence[tuple[str, str]],
    cycle: Trace,
    *,
    from_code: bool = True,
) -> Section:
    """points: labels of the operating points in order; deployed: (what, words) about the sampled
    controller and its code; cycle: from rest through all of its operation back to rest.

    from_code: whether the rig ran compiled code (otherwise its law in Python).
    """
    tables = (
        _rig_table(
            reference, commissioned, points, "compiled C code" if from_code else "its law in Python"
        ),
        _verdict(checked),
        replace(parameters_table(checked.result), folded=True),
        Table("The code", ("What", ""), tuple(deployed), folded=True),
        *([findings_table(checked.doubts)] if checked.doubts else []),
    )
    shown_of_it = [
        name for name in cycle.record.signals if name.partition("_")[0] in {"y", "speed", "p"}
    ]
    figures = (
        Figure("What the record changed", change_figure(checked.result), _CHANGE),
        Figure(
            f"Operating cycle: {cycle.text}",
            record_figure(cycle.record.select(shown_of_it)),
            _CYCLE,
        ),
    )
    return Section("Commissioned on the rig", _ON_THE_RIG, figures, tables, True)


def _verdict(checked: LoopIdentification) -> Table:
    mark = "pass" if checked.result.adequate else "fail"
    fits = [percent for _, _, percent in checked.result.fit]
    rows = (
        (
            Cell(checked.result.verdict, mark),
            Cell(f"{min(fits):.1f} to {max(fits):.1f} %", "number"),
        ),
    )
    return Table("The identification", ("Residual tests", "Fit of the displacements"), rows)


def _rig_table(
    reference: Candidate, commissioned: Candidate, points: Sequence[str], program: str
) -> Table:
    rows: list[Row] = []
    for point in points:
        pair = [_on_the_rig(candidate, point) for candidate in (reference, commissioned)]
        if any(trace is not None for trace in pair):
            rows.append((point, *(cell for trace in pair for cell in _outcome(trace))))
    columns = (
        "Operating point",
        "Outcome",
        "Largest displacement",
        "Outcome",
        "Largest displacement",
    )
    groups = (("", 1), (f"{reference.name}, in Python", 2), (f"{commissioned.name}, {program}", 2))
    scenarios = dict.fromkeys(
        trace.scenario for _, trace in commissioned.traces if "rig" in trace.scenario
    )  # the same for both
    return Table(
        f"On the nonlinear rig: {', '.join(scenarios)}", columns, tuple(rows), groups=groups
    )


def _on_the_rig(candidate: Candidate, point: str) -> Trace | None:
    return next(
        (trace for label, trace in candidate.traces if label == point and "rig" in trace.scenario),
        None,
    )


def _outcome(trace: Trace | None) -> tuple[Cell, Cell]:
    if trace is None:
        return Cell("not run", "none"), Cell("")
    largest = theme.quantity(float(np.abs(trace.record.values).max()), "m")
    return Cell(trace.text, "pass" if trace.passed else "fail"), Cell(largest, "number")


_SPAN = 0.1  # s, of the first and the last panel
_RISING = (
    "The machine runs up while a force or the set point steps every 50 ms. Settling is to 5 % of "
    "the peak of a step."
)


def run_up_section(
    runs: Sequence[RunUp], limit: float | None, order: Sequence[str] = ()
) -> Section:
    """runs: one per controller, in order; limit [s]: the settling time asked for (None: no
    verdict).
    """
    return Section("Run-up", _RISING, (run_up_figure(runs, order),), (_table(runs, limit),))


def _table(runs: Sequence[RunUp], limit: float | None) -> Table:
    rows: list[Row] = []
    every = [steps for run in runs for steps in (run.linear_steps, run.rig_steps)]
    longest = max(every, key=lambda run: run[-1].start if run else 0.0)
    for k, step in enumerate(longest):
        cells = [
            _settling(steps[k], limit) if k < len(steps) else Cell("ended before", "fail")
            for steps in every
        ]
        rows.append(
            (*numbers(theme.quantity(step.start, "s"), theme.quantity(step.speed, "rad/s")), *cells)
        )
    columns = ("Step at", "Speed", *("Linear", "Rig") * len(runs))
    groups = (("", 2), *((f"{run.name}, settles in", 2) for run in runs))
    note = "" if limit is None else f"Asked for: {theme.quantity(limit, 's')}."
    return Table(
        "Settling after every step", columns, tuple(rows), note, groups=groups, by_cell=True
    )


def _settling(step: Step, limit: float | None) -> Cell:
    if not np.isfinite(step.settling):
        return Cell("not within 50 ms", "fail")
    return Cell(
        theme.quantity(step.settling, "s"),
        "fail" if limit is not None and step.settling > limit else "number",
    )


def run_up_figure(runs: Sequence[RunUp], order: Sequence[str] = ()) -> Figure:
    """The first and the last 100 ms on the linear loop and on the rig, the controllers overlaid.

    order: the names of all controllers of the page, which fixes their colours.
    """
    names = [run.name for run in runs]
    last = min(run.linear.record.time[-1] for run in runs)
    rows = []
    for where in ("linear", "rig"):
        panels = []
        for words, start in (("first 100 ms", 0.0), ("last 100 ms", float(last) - _SPAN)):
            curves = tuple((run.name, _piece(getattr(run, where), start)) for run in runs)
            panels.append(
                Panel(f"{'Virtual rig' if where == 'rig' else 'Linear loop'}, {words}", curves)
            )
        rows.append(panels)
    picture, hidden = panel_figure(rows, theme.candidate_styles([*order, *names]))
    words = (
        "Displacement at the first sensor, from the start of the shown piece: low speed on the "
        "left, high speed on the right."
    )
    return Figure("Steps at the lowest and the highest speed", picture, f"{words} {hidden}".strip())


def _piece(trace: Trace, start: float) -> Curve:
    name = next(signal for signal in trace.record.signals if signal.startswith("y_"))
    time, values = trace.record.time, trace.record[name]
    inside = (time >= start - 1e-9) & (time <= start + _SPAN + 1e-9)
    x = time[inside] - start
    level = values - np.mean(values)  # the rig's rotor rests where its weight leaves it
    return Curve(
        "run-up", "displacement", "time", x, level[inside][None], (theme.axis_name(name),), "s", "m"
    )
