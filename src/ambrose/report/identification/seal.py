"""The page of a seal by frequency and pressure: what was found, what was taken off, lines over
pressure.

    write(seal_page(identify_by_frequency(machine, records)), "seal.html")
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ambrose.identification.parameters import COVERAGE
from ambrose.identification.seal.by_frequency import SealByFrequency
from ambrose.identification.seal.result import COEFFICIENTS
from ambrose.report import tables, units
from ambrose.report.figures.seals import frequency_figure
from ambrose.report.identification.page import seal_figure, seal_tables
from ambrose.report.page import Cell, Figure, Page, Row, Section, Table, Verdict, numbers

_FREQUENCY = (
    "Every pressure and frequency by itself, with 95 % bars; lines: the means over frequency. "
    "Grey crosses: what shows without "
    "pressure beyond the machine file's seal, from bearings and couplings a little off, and is "
    "taken off all points."
)


def seal_page(done: SealByFrequency, *, date: str = "") -> Page:
    """The page of a seal; date: ISO (today if empty)."""
    fit, doubts = done.fit, done.findings
    f = fit.frequency / units.TWO_PI
    figures = (
        Figure("Coefficients over frequency", frequency_figure(fit, done.constants), _FREQUENCY),
        seal_figure(fit),
    )
    section = Section("Seal", "", figures, tuple(frequency_tables(done)), folded=True)
    base = (
        "taken off: records without pressure were given"
        if done.reference
        else "none: the machine file is taken as exact"
    )
    verdicts = (
        tables.without_findings(
            "Records", doubts, "channels, limits and scatter as they should be"
        ),
        Verdict("Baseline without pressure", None, base),
    )
    facts = (
        tables.machine_fact(done.given),
        ("Records", ", ".join(done.records)),
        ("Method", fit.method),
        ("Pressures", ", ".join(units.quantity(float(p), "Pa") for p in fit.pressures)),
        ("Frequencies", f"{len(np.unique(f))} from {f.min():.4g} to {f.max():.4g} Hz"),
    )
    title = f"Seal {units.axis_name(fit.seal)} by frequency and pressure"
    return Page(
        title,
        done.given,
        (*tables.doubtful(doubts), section),
        verdicts,
        facts,
        date,
        result=tables.believed("identified", doubts),
    )


def frequency_tables(done: SealByFrequency) -> Iterator[Table]:
    """Means by pressure, lines over it, then every row."""
    yield from seal_tables(done.constants)
    rows: list[Row] = []
    for i in range(len(done.fit)):
        cells: list[str | Cell] = [
            units.quantity(float(done.fit.pressure[i]), "Pa", 4),
            units.quantity(float(done.fit.frequency[i]), "rad/s", 4),
        ]
        for j, letter in enumerate(COEFFICIENTS):
            factor, unit = units.coefficient_scale(letter)
            half = COVERAGE * float(done.fit.deviations[i, j]) * factor
            cells += numbers(units.plus_minus(float(done.fit.values[i, j]) * factor, half, unit))
        rows.append(tuple(cells))
    yield Table(
        "Every pressure and frequency", ("Pressure", "Frequency", *COEFFICIENTS), tuple(rows)
    )
