"""The commissioning in the comparison's page: what was identified, what runs as code, and how it
does on the rig.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ambrose.identification.result import LoopIdentification
from ambrose.report import units
from ambrose.report.identification.figures import change_figure
from ambrose.report.identification.tables import findings_table, parameters_table
from ambrose.report.page import Cell, Figure, Row, Section, Table
from ambrose.report.record.figure import record_figure
from ambrose.rig.candidate import Candidate
from ambrose.rig.trace import Trace

_WORDS = (
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
    shown = (
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
    return Section("Commissioned on the rig", _WORDS, figures, shown, True)


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
    return Cell(trace.text, "pass" if trace.outcome == "completed" else "fail"), Cell(
        largest, "number"
    )
