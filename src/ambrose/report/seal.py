"""The page of a seal by frequency and pressure: what was found, what was taken off, lines over
pressure.

write(seal_report(identify_by_frequency(machine, records)), "seal.html")
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ambrose.identification.parameters import COVERAGE
from ambrose.identification.seal.by_frequency import SealByFrequency
from ambrose.identification.seal.result import COEFFICIENTS
from ambrose.machine.file.toml import machine_hash
from ambrose.report import units
from ambrose.report.figures.seals import frequency_figure
from ambrose.report.identification.page import seal_figure
from ambrose.report.identification.tables import (
    findings_table,
    plus_minus,
    seal_lines_table,
    seal_table,
)
from ambrose.report.page import Cell, Figure, Report, Row, Section, Table, Verdict, numbers

_FREQUENCY = (
    "Every pressure and frequency by itself, with 95 % bars; lines: the means over frequency. "
    "Grey crosses: what shows without "
    "pressure beyond the machine file's seal, from bearings and couplings a little off, and is "
    "taken off all points."
)


def seal_report(done: SealByFrequency, *, date: str = "") -> Report:
    """The page of a seal; date: ISO (today if empty)."""
    fit, doubts = done.fit, done.findings
    f = fit.frequency / units.TWO_PI
    figures = (
        Figure("Coefficients over frequency", frequency_figure(fit, done.constants), _FREQUENCY),
        seal_figure(fit),
    )
    sections = [Section("Seal", "", figures, tuple(seal_tables(done)), folded=True)]
    if doubts:
        sections.insert(0, Section("What makes this doubtful", "", (), (findings_table(doubts),)))
    base = (
        "taken off: records without pressure were given"
        if done.reference
        else "none: the machine file is taken as exact"
    )
    said = (
        f"{len(doubts)} finding{'s' * (len(doubts) > 1)}; see below"
        if doubts
        else "channels, limits and scatter as they should be"
    )
    verdicts = (
        Verdict("Records", not doubts, said),
        Verdict("Baseline without pressure", None, base),
    )
    facts = (
        ("Machine file", f"{done.given.name}, {machine_hash(done.given)[:12]}"),
        ("Records", ", ".join(done.records)),
        ("Method", fit.method),
        ("Pressures", ", ".join(units.quantity(float(p), "Pa") for p in fit.pressures)),
        ("Frequencies", f"{len(np.unique(f))} from {f.min():.4g} to {f.max():.4g} Hz"),
    )
    words = (
        "identified, but to be doubted: see the findings"
        if doubts
        else "identified, and nothing speaks against it"
    )
    result = Verdict("Result", not doubts, words)
    title = f"Seal {units.axis_name(fit.seal)} by frequency and pressure"
    return Report(title, done.given, tuple(sections), verdicts, facts, date, result=result)


def seal_tables(done: SealByFrequency) -> Iterator[Table]:
    """Means by pressure, lines over it, then every row."""
    mean = done.constants
    yield seal_table(mean)
    if len(mean.pressures) > 2:
        yield seal_lines_table(mean)
    rows: list[Row] = []
    for i in range(len(done.fit)):
        cells: list[str | Cell] = [
            units.quantity(float(done.fit.pressure[i]), "Pa", 4),
            units.quantity(float(done.fit.frequency[i]), "rad/s", 4),
        ]
        for j, letter in enumerate(COEFFICIENTS):
            factor, unit = units.coefficient_scale(letter)
            half = COVERAGE * float(done.fit.deviations[i, j]) * factor
            cells += numbers(plus_minus(float(done.fit.values[i, j]) * factor, half, unit))
        rows.append(tuple(cells))
    yield Table(
        "Every pressure and frequency", ("Pressure", "Frequency", *COEFFICIENTS), tuple(rows)
    )
