"""What a study adds to the page that compares its controllers: the commissioning on the rig (what
was identified, what runs as code, how it does) and the run-up (every step on the way up).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ambrose.identification.result import LoopIdentification
from ambrose.judge.checks import Curve
from ambrose.report import theme, units
from ambrose.report.figures.panels import Panel, panel_figure
from ambrose.report.identification.figures import change_figure
from ambrose.report.identification.page import parameters_table
from ambrose.report.page import Cell, Figure, Row, Section, Table, numbers
from ambrose.report.record import record_figure
from ambrose.report.tables import findings_table
from ambrose.rig.candidate import Candidate
from ambrose.rig.run_up import Step
from ambrose.rig.trace import Trace
from ambrose.rig.trial import RunUp

_ON_THE_RIG = (
    "The virtual rig stands for the machine on site. A record taken under the reference "
    "controller identifies the machine "
    "file's uncertain entries; a robust controller is designed for what was found and for the "
    "delay of its sampled loop, "
    "exported as C, and tried on the rig. Its checks above are those of the sampled loop, with "
    "the computing delay, on the "
    "identified machine. Full identification: commissioned/identified.html."
)
_CHANGE = (
    "How far the record moved every parameter from the machine file. A magnet's force per current "
    "and negative stiffness "
    "belong to its static load: entries stated for an unloaded magnet differ where it carries "
    "weight."
)
_CYCLE = (
    "One run of the deployed controller: from rest in the touchdown bearings it levitates the "
    "rotor, which runs up to its top "
    "speed with G2.5 of unbalance and is pressurised; a knock, then a trip: pressure drops and "
    "the rotor coasts down. Speed "
    "and pressure change faster than any machine's."
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
        Table("The code", ("What", ""), tuple(deployed)),
        _verdict(checked),
        parameters_table(checked.result),
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
    largest = units.quantity(float(np.abs(trace.record.values).max()), "m")
    return Cell(trace.text, "pass" if trace.passed else "fail"), Cell(largest, "number")


_SPAN = 0.1  # s, of the first and the last panel
_RISING = (
    "The machine runs up while a force or the set point steps every 50 ms. A scheduled controller "
    "changes with the speed, a "
    "fixed one was designed for one speed. Speeds are those at the start of a step; settling is "
    "to 5 % of its own peak."
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
            (*numbers(units.quantity(step.start, "s"), units.quantity(step.speed, "rad/s")), *cells)
        )
    columns = ("Step at", "Speed", *("Linear", "Rig") * len(runs))
    groups = (("", 2), *((f"{run.name}, settles in", 2) for run in runs))
    note = "" if limit is None else f"Asked for: {units.quantity(limit, 's')}."
    return Table(
        "Settling after every step", columns, tuple(rows), note, groups=groups, by_cell=True
    )


def _settling(step: Step, limit: float | None) -> Cell:
    if not np.isfinite(step.settling):
        return Cell("not within 50 ms", "fail")
    return Cell(
        units.quantity(step.settling, "s"),
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
        "run-up", "displacement", "time", x, level[inside][None], (units.axis_name(name),), "s", "m"
    )
