"""Several controllers in pictures: one panel per controller with common axes, or all overlaid."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from ambrose.core.frequency import frequency_response
from ambrose.judge.checks import Checks, Curve
from ambrose.judge.sensitivity import ALL_AXES
from ambrose.machine.machine import Machine
from ambrose.report import theme, units
from ambrose.report.comparison.envelope import NOT_EVALUATED
from ambrose.report.figures.filter_chains import filter_figure
from ambrose.report.figures.panels import Panel, panel_figure
from ambrose.report.page import Figure
from ambrose.report.record import thinned, trace_curves
from ambrose.report.verification import caption
from ambrose.rig.candidate import Candidate, find
from ambrose.rig.trace import Trace

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
_LOWEST, _HIGHEST = 0.1 * units.TWO_PI, 2e3 * units.TWO_PI
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
            words = (
                f"{caption(curves[0])} Above each panel: its peaks, as in the tables, point by "
                "point."
            )
            figures.append(Figure(units.prose(curves[0].title), picture, _with(words, hidden)))
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
            notes += [(point, units.quantity(match.value, match.unit))] if match is not None else []
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
        return Figure(units.prose(first.title), picture, _with("The controllers overlaid.", hidden))
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
    return Figure(units.prose(first.title), picture, _with(words, hidden))


def _family_note(checks: Checks, name: str, every: Sequence[str], stable: Sequence[str]) -> str:
    """The worst case, from the check of the same quantity."""
    check = find(checks, "robust.sensitivity.worst" if name == "robust.sensitivity" else name)
    missing = len(every) - len(stable)
    if missing:
        return f"{missing} of {len(every)} unstable"
    return f"worst case {units.number(check.value)}" if check is not None else ""


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
        "Current per displacement. First row: every axis from its own sensor. Second row: the "
        "first axis from the sensors of "
        "the others, which is where the controllers differ: cross coupling works against the "
        "seal's."
    )
    return (Figure("Controller gains", picture, _with(words, hidden)),)


def chain_figures(machine: Machine, candidates: Sequence[Candidate]) -> tuple[Figure, ...]:
    """The filter banks among the controllers: per channel its sections, and their Bode diagram."""
    words = (
        "Channels that are the same are drawn once: every section in series with its frequencies "
        "and dampings (○ zeros, × "
        "poles), and the response of the whole chain."
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
    return Panel(f"({i + 1},{j + 1}) {units.prose(arrow)}", tuple(curves), tuple(notes))


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
                        units.axis_name(axis),
                    )
                )
            rows.append(row)
    picture, hidden = panel_figure(rows, theme.styles(labels), height=96, view=calm, span=span)
    whole = max(float(curve.x[-1]) for *_, curve in responses)
    words = caption(first)
    if len(calm) < len(responses):
        words += " Of a run that is unstable or driven too far the outline of its growth is drawn."
    if span is not None and span[1] - span[0] < 0.99 * whole:
        span_words = f"{units.quantity(span[0], 's')} to {units.quantity(span[1], 's')}"
        words += (
            f" Shown from {span_words} of the {units.quantity(whole, 's')} computed; "
            "a double-click shows all."
        )
    return Figure(units.prose(first.title), picture, _with(words, hidden))


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
    when = "" if trace.stopped_at is None else f", down at {units.quantity(trace.stopped_at, 's')}"
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
