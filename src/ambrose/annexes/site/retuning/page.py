"""The page of a retuning, one to sign: what the machine is now, what its controller does on it,
what replaces it, how it was tried.

write(retuning_page(retune(machine, records, controller, folder)), "retuning.html")
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ambrose.annexes.site.retuning.result import Retuning, Switch
from ambrose.judge.checks import Check, Checks, Curve
from ambrose.judge.verification import Verification
from ambrose.report import tables, theme, units
from ambrose.report.figures.curves import figure
from ambrose.report.figures.panels import Panel, panel_figure
from ambrose.report.identification.figures import change_figure
from ambrose.report.identification.page import parameters_table
from ambrose.report.page import Cell, Figure, Page, Row, Section, Table, Verdict, numbers

_SENSITIVITY = "sensitivity.output"
# what a person asks of a loop: checks and what they are called
_COMPARED = (
    ("stability.abscissa", "slowest decay"),
    ("sensitivity.output.max", "largest output sensitivity"),
    ("margin.disk.output", "disk margin, all outputs"),
    ("control.max", "largest gain from error to current"),
    ("unbalance.orbit_0p", "unbalance orbit"),
    ("unbalance.current_0p", "unbalance current"),
    ("impulse.current_0p", "current after a pulse"),
)
_OUTCOMES = {True: "pass", False: "fail", None: "none"}
_AROUND = 0.1  # s about a change of controllers that is drawn


def retuning_page(done: Retuning, *, date: str = "") -> Page:
    """The page of a retuning; date: ISO (today if empty)."""
    sections = [_steps(done)]
    if done.identification is not None:
        sections.append(_machine(done))
    sections += _loops(done)
    if done.switches:
        sections.append(_switches(done))
    if done.acceptance is not None:
        checks = tuple(tables.checks_table(loop.checks) for loop in done.acceptance.points)
        sections.append(Section("As measured after the change", "", (), checks))
    sections.append(_provenance(done))
    step = done.stopped_at
    words = "; ".join(item.words for item in done.steps[-1:]) if step is None else step.words
    result = Verdict(done.outcome.capitalize(), done.passed, units.prose(words))
    return Page(
        "Retuning of the magnetic bearing loop",
        done.machine,
        tuple(sections),
        (),
        (tables.machine_fact(done.given), ("Loop", str(done.timing))),
        date,
        result=result,
    )


def _steps(done: Retuning) -> Section:
    marks = {True: "holds", False: "does not hold", None: "for information"}
    rows = tuple(
        (
            step.title,
            Cell(marks[step.passed], _OUTCOMES[step.passed]),
            units.prose(step.words),
            ", ".join(step.files),
        )
        for step in done.steps
    )
    columns = ("Step", "Verdict", "What was found", "Files")
    table = Table("Steps", columns, rows, "", (20, 12, 48, 20))
    return Section("What was done", "", (), (table,))


def _machine(done: Retuning) -> Section:
    assert done.identification is not None  # asked before
    result = done.identification.result
    change = Figure(
        "Change from the machine file",
        change_figure(result),
        "With 95 % intervals, which are the box that the controllers are judged over.",
    )
    remarks = tables.capitalised(done.identification.remarks)
    return Section("The machine as it is", remarks, (change,), (parameters_table(result),), True)


def _loops(done: Retuning) -> Iterator[Section]:
    before, after = done.before, done.after
    if before is None:
        return
    both = [("running", before)] + ([] if after is None else [("new", after)])
    curves = [
        (f"{label}, {checks.label}" if len(before.points) > 1 else label, curve)
        for label, verification in both
        for checks in verification.points
        for curve in checks.curves
        if curve.name == _SENSITIVITY
    ]
    caption = (
        "On the identified machine, at every operating point that the loop holds; the limits are "
        "the machine file's and the zones of ISO 14839-3."
    )
    pictures = (Figure("Output sensitivity", figure(curves), caption),) if curves else ()
    boxes = [
        tables.checks_table(replace(checks, label=f"{label}: {checks.label}"))
        for label, verification in both
        for checks in verification.boxes
    ]
    yield Section("The loop before and after", "", pictures, (_compared(before, after),), True)
    if boxes:
        text = (
            "Found by search is what can happen; proved is what cannot be exceeded by any values "
            "of the parameters within their intervals, at any frequency; on a frequency grid is "
            "neither between its lines."
        )
        yield Section("Over the identified intervals", text, (), tuple(boxes), folded=True)


def _compared(before: Verification, after: Verification | None) -> Table:
    columns = ("Operating point", "Quantity", "Running", *(() if after is None else ("New",)))
    rows: list[Row] = []
    for number, old in enumerate(before.points):
        pair = [old] if after is None else [old, after.points[number]]
        for name, words in _COMPARED:
            found = [_named(checks, name) for checks in pair]
            if any(check is not None for check in found):
                rows.append((old.label, words, *map(_cell, found)))
    return Table("Point by point", columns, tuple(rows), "", by_cell=True)


def _named(checks: Checks, name: str) -> Check | None:
    return next((check for check in checks.checks if check.name == name), None)


def _cell(check: Check | None) -> Cell:
    if check is None:
        return Cell("unstable", "fail")
    unit = "1/s" if check.name == "stability.abscissa" else check.unit
    text = units.quantity(check.value, unit)
    return Cell(text, "fail" if check.passed is False else "number")


def _switches(done: Retuning) -> Section:
    pictures = []
    for run in done.switches:
        words = "To the new controller" if run.forward else "And back to the running one"
        picture, beyond = _moved(run)
        caption = (
            "Displacements about their mean on the nonlinear rig with the identified machine; "
            f"the controllers change at the dashed instant. {beyond}"
        )
        pictures.append(Figure(words, picture, caption))
    rows = tuple(
        (
            "to the new one" if run.forward else "the way back",
            Cell(run.trace.outcome, _OUTCOMES[run.passed]),
            *numbers(
                units.quantity(run.before, "m"),
                units.quantity(run.bump, "m"),
                units.quantity(run.allowed, "m"),
            ),
        )
        for run in done.switches
    )
    columns = ("Change", "Outcome", "Largest before", "After", "Allowed (assumed)")
    return Section("The change, tried", "", tuple(pictures), (Table("On the rig", columns, rows),))


def _moved(run: Switch) -> tuple[object, str]:
    record = run.trace.record
    names = tuple(name for name in record.signals if name.startswith("y_"))
    y = np.array([record[name] for name in names])
    middle = record.values.shape[1] // 2
    part = slice(
        max(middle - round(_AROUND * record.sample_rate_hz / 5), 0),
        middle + round(_AROUND * record.sample_rate_hz),
    )
    y = y - y[:, middle // 2 : middle].mean(axis=1, keepdims=True)
    panels = []
    for name, row in zip(names, y, strict=True):
        time, motion = record.time[part], row[None, part]
        curve = Curve("retuning", "", "time", time, motion, (name,), "s", "m")
        panels.append(Panel(units.axis_name(name), (("displacement", curve),)))
    rows = [panels[i : i + 2] for i in range(0, len(panels), 2)]
    style = {"displacement": theme.Style("#0072b2", "solid", "circle-open", 1.2)}
    return panel_figure(rows, style, height=130)


def _provenance(done: Retuning) -> Section:
    rows: list[tuple[str, str, Cell]] = [
        ("Running controller", done.running.method, Cell("", detail=done.running.digest)),
    ]
    if done.new is not None:
        rows.append(("New controller", done.new.method, Cell("", detail=done.new.digest)))
    delivery = done.delivery
    if delivery is not None and delivery.difference is not None:
        change = delivery.difference
        text = f"{len(change.changes)} entries"
        sums = f"CRC-32 {change.checksum_before} to {change.checksum}"
        rows.append(("Difference of parameters", text, Cell("", detail=sums)))
    if done.identification is not None:
        rows.append(("Records", done.identification.provenance.of_records, Cell("")))
    table = Table("", ("", "What", "Hash"), tuple(rows), "", (25, 35, 40))
    return Section("What it rests on", "", (), (table,))
