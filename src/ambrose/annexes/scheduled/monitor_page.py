"""The page of a seal monitor: each parameter against time with its interval, the width of that by
its parts, and what it says.

write(monitor_page(monitor(machine, controller, record), machine), "page.html")
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ambrose.annexes.scheduled.seal_monitor.history import SealHistory
from ambrose.machine.machine import Machine
from ambrose.report import tables, theme, units
from ambrose.report.page import Cell, Figure, Page, Row, Section, Table, Verdict, numbers

_LINE = "#0072b2"
_BAND = "rgba(0,114,178,0.22)"
_LIMIT = "#d55e00"
_CAPTION = (
    "The estimate over a fading window, with its 95 % interval; dashed: the range of the machine "
    "file's tolerances. Below, the "
    "half width of the interval by its parts: noise, what the model takes as known (magnets, "
    "amplifiers), the seal's change."
)


def monitor_page(history: SealHistory, machine: Machine, *, date: str = "") -> Page:
    """The page; date: ISO (today if empty)."""
    pictures = tuple(
        Figure(path, _figure(history, i), _CAPTION if i == 0 else "")
        for i, path in enumerate(history.paths)
        if history.known_at.any()
    )
    notes = tables.capitalised((*history.findings, *history.notes), ". ", "") + "."
    facts = (
        tables.machine_fact(machine),
        ("Seal", history.seal),
        ("Memory", units.quantity(history.window, "s")),
        ("Changes followed", f"up to {history.rate:g} of the reference per second"),
    )
    verdicts = (tables.without_findings("Seal", history.findings, "nothing to report", see=", "),)
    section = Section(
        "The seal against time", units.prose(notes), pictures, (monitor_table(history),)
    )
    result = Verdict(
        "Result",
        not history.findings,
        "the seal is within its range" if not history.findings else "look at the seal",
    )
    return Page("Seal monitor", machine, (section,), verdicts, facts, date, result=result)


def monitor_table(history: SealHistory) -> Table:
    """Every parameter: last estimate, lowest and highest, trend, range."""
    rows: list[Row] = []
    known = np.flatnonzero(history.known_at)
    for i, (path, unit, limit) in enumerate(
        zip(history.paths, history.units, history.limits, strict=True)
    ):
        texts = ["nothing can be said", "", ""]
        if len(known):
            x = history.values[known, i]
            half = history.half_widths[known, i]
            trend = history.trend(i)
            ends = [
                f"{units.quantity(float(v), unit)} ± {units.quantity(float(h), unit, 2)}"
                for v, h in ((x[k], half[k]) for k in (-1, int(np.argmin(x)), int(np.argmax(x))))
            ]
            slope = (
                ""
                if trend is None
                else f"{units.quantity(trend[0], unit)}/s ± {units.quantity(trend[1], unit, 2)}/s"
            )
            texts = [ends[0], f"{ends[1]} … {ends[2]}", slope]
        texts.append(
            ""
            if limit is None
            else f"{units.quantity(limit[0], unit)} … {units.quantity(limit[1], unit)}"
        )
        rows.append((Cell(path), *numbers(*texts)))
    columns = ("Parameter", "Last", "Lowest … highest", "Trend", "Range")
    return Table("Estimates", columns, tuple(rows), "Intervals of 95 %.")


def _figure(history: SealHistory, i: int) -> Any:
    figure = theme.subplots(
        rows=2, cols=1, row_heights=[0.66, 0.34], shared_xaxes=True, vertical_spacing=0.06
    )
    known, unit = history.known_at, history.units[i]
    factor, shown_unit = units.scale(unit, float(np.nanmax(np.abs(history.values[:, i]))))
    x = history.values[known, i] * factor
    half = history.half_widths[known, i] * factor
    t = history.time[known]
    top, below = {"row": 1, "col": 1}, {"row": 2, "col": 1}
    theme.band(figure, top, t, x - half, x + half, _BAND)
    figure.add_scatter(
        x=t, y=x, name="estimate, with 95 %", line={"color": _LINE, "width": 1.6}, **top
    )
    if history.paths[i].endswith(".pressure") and history.measured is not None:
        style = {"color": theme.INK, "width": 1.2, "dash": "dot"}
        figure.add_scatter(
            x=history.time, y=history.measured * factor, name="measured pressure", line=style, **top
        )
    for level in history.limits[i] or ():
        figure.add_hline(
            y=level * factor, line={"dash": "dash", "color": _LIMIT, "width": 1.2}, **top
        )
    for instant in history.restarts:
        figure.add_vline(x=instant, line={"dash": "dot", "color": theme.MUTED, "width": 1}, **top)
    parts = (
        ("whole", history.half_widths, _LINE),
        ("noise", history.noise, "#009e73"),
        ("known", history.known, "#e69f00"),
        ("change", history.change, "#cc79a7"),
    )
    for name, rows, colour in parts:
        figure.add_scatter(
            x=t, y=rows[known, i] * factor, name=name, line={"color": colour, "width": 1.3}, **below
        )
    theme.dress(figure, 480, legend=True)
    low, high = float((x - half).min()), float((x + half).max())
    room = [level * factor for level in history.limits[i] or ()]
    low, high = min([low, *room]), max([high, *room])
    figure.update_yaxes(
        title_text=shown_unit, range=[low - 0.06 * (high - low), high + 0.06 * (high - low)], **top
    )
    figure.update_yaxes(title_text=f"± {shown_unit}", rangemode="tozero", **below)
    figure.update_xaxes(title_text="time [s]", **below)
    return figure
