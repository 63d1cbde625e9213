"""The page of a bias campaign: K_i and K_s of every axis over the bias current, by both methods
(P2, Fig. 4 and table 2).

write(bias_page(identify_over_bias(machine, records, controllers)), "bias.html")
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from ambrose.annexes.site.bias import BiasCampaign
from ambrose.core.checks import InvalidInput
from ambrose.model.effects import magnet
from ambrose.report import tables, theme, units
from ambrose.report.page import Cell, Figure, Page, Row, Section, Table, numbers

_QUANTITIES = (
    ("force_per_current", "Force per current K_i", "N/A"),
    ("negative_stiffness", "Negative stiffness K_s", "N/m"),
)
_CAPTION = (
    "Circles: from closed-loop records, small motion at the working point; squares: chord over "
    "static loads; 95 % bars. Line: "
    "the machine file before, where it has coefficients. Without iron K_i grows with the bias and "
    "K_s with its square; what "
    "bends down at high bias is iron that saturates."
)
_METHODS = (
    ("small motion", False, "circle", "#0072b2"),
    ("static loads", True, "square-open", "#d55e00"),
)
_COLUMNS, _HEIGHT = 2, 190


def bias_page(done: BiasCampaign, *, date: str = "") -> Page:
    """The page of a bias campaign; date: ISO (today if empty)."""
    section = Section(
        "K_i and K_s over bias current", "", tuple(_figures(done)), tuple(bias_tables(done))
    )
    facts = (
        tables.machine_fact(done.given),
        ("Records", ", ".join(done.names)),
        ("Bias currents", ", ".join(f"{row.bias:g} A" for row in done.rows)),
    )
    good = "nothing found in records and residuals"
    return Page(
        "Magnets over bias current",
        done.given,
        (*tables.doubtful(done.findings), section),
        (tables.without_findings("Records", done.findings, good),),
        facts,
        date,
        result=tables.believed("identified", done.findings),
    )


def _figures(done: BiasCampaign) -> Iterator[Figure]:
    for quantity, name, unit in _QUANTITIES:
        yield Figure(
            name, _picture(done, quantity, unit), _CAPTION if quantity == _QUANTITIES[0][0] else ""
        )


def _picture(done: BiasCampaign, quantity: str, unit: str) -> Any:
    axes = [(b, way) for b in done.given.bearings for way in ("zeta", "eta")]
    titles = [f"<b>{theme.plain(units.axis_name(f'{b.name}_{way}'))}</b>" for b, way in axes]
    rows = -(-len(axes) // _COLUMNS)
    gaps = {"horizontal_spacing": 0.12, "vertical_spacing": 0.3 / rows}
    picture = theme.subplots(rows=rows, cols=_COLUMNS, subplot_titles=titles, **gaps)

    # one scale for all axes, of the largest value found
    every = [row.values(static) for row in done.rows for static in (False, True)]
    found = [value for values in every for path, (value, _) in values.items() if quantity in path]
    factor, shown = units.scale(unit, max(map(abs, found), default=0.0))
    span = np.linspace(min(row.bias for row in done.rows), max(row.bias for row in done.rows), 30)
    for k, (bearing, way) in enumerate(axes):
        place, first = {"row": k // _COLUMNS + 1, "col": k % _COLUMNS + 1}, k == 0
        path = f"bearing.{bearing.name}.{quantity}.{way}"
        line = np.array([_file(bearing, quantity, way, float(bias)) for bias in span])
        if np.isfinite(line).any():
            look = {"color": theme.MUTED, "width": 1.2}
            theme.scatter(
                picture, place, span, line * factor, "machine file before", shown=first, line=look
            )
        for label, static, symbol, colour in _METHODS:
            points = [
                (row.bias, *row.values(static)[path])
                for row in done.rows
                if path in row.values(static)
            ]
            if points:
                x, y, half = np.array(points).T
                error = {"type": "data", "array": half * factor, "thickness": 1.4, "width": 3}
                marker = {"symbol": symbol, "size": 7, "color": colour}
                theme.scatter(
                    picture,
                    place,
                    x,
                    y * factor,
                    label,
                    shown=first,
                    mode="markers",
                    marker=marker,
                    error_y=error,
                )
        picture.update_yaxes(title_text=f"[{shown}]", rangemode="tozero", **place)
    theme.dress(picture, _HEIGHT * rows, legend=True)
    picture.update_xaxes(title_text="Bias current [A]", row=rows)
    return picture


def _file(bearing: Any, quantity: str, way: str, bias: float) -> float:
    try:
        return float(
            getattr(magnet.linearised(bearing, bias), quantity)[("zeta", "eta").index(way)]
        )
    except InvalidInput:
        return float("nan")


def bias_tables(done: BiasCampaign) -> Iterator[Table]:
    """Every quantity of every axis at every bias."""
    for quantity, name, unit in _QUANTITIES:
        rows: list[Row] = []
        for row in done.rows:
            for static, method in ((False, "small motion"), (True, "static loads")):
                cells: list[str | Cell] = []
                for bearing in done.given.bearings:
                    for way in ("zeta", "eta"):
                        value, half = row.values(static).get(
                            f"bearing.{bearing.name}.{quantity}.{way}", (np.nan, np.nan)
                        )
                        factor, shown = units.scale(unit, value)
                        cells += numbers(
                            ""
                            if np.isnan(value)
                            else units.plus_minus(value * factor, half * factor, shown)
                        )
                if any(not isinstance(cell, Cell) or cell.text for cell in cells):
                    rows.append((f"{row.bias:g} A, {method}", *cells))
        if rows:
            axes = [
                units.axis_name(f"{b.name}_{way}")
                for b in done.given.bearings
                for way in ("zeta", "eta")
            ]
            yield Table(name, ("Bias", *axes), tuple(rows), "With 95 %.")
