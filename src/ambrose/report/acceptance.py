"""The page that is signed on site: measured sensitivity, closed and open loop of every axis over what was predicted.

write(acceptance_report(accept(machine, controller, records)), "acceptance.html")
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ambrose.evaluation.acceptance import Acceptance, MeasuredLoop
from ambrose.machine.criteria import SENSITIVITY
from ambrose.machine.file.toml import machine_hash
from ambrose.report import tables, theme, units
from ambrose.report.figures.axes import axes_of, drawn, set_ranges
from ambrose.report.figures.limits import draw_limits, limit_levels
from ambrose.report.page import Cell, Figure, Report, Section, Table
from ambrose.verification.checks import Curve
from ambrose.verification.criteria import zone_lines

_MEASURED, _BAND = "#0072b2", "rgba(0,114,178,0.25)"
_LOOKS = (theme.Style(theme.INK, "solid", "x-thin", 1.3), theme.Style("#d55e00", "7px,3px", "x-thin", 1.6))  # of the models
_COLUMNS, _HEIGHT = 2, 230  # panels side by side, [px] of one
_NYQUIST = 2.6  # from the critical point to the edge of the picture
_SENSITIVITY = (
    "Modulus of the output sensitivity of every axis with the other loops closed (ISO 14839-3), and the largest singular value "
    "of the whole matrix, which is stricter. Blue with its 95 % band: measured. Thin: what the machine file predicted, and "
    "with the magnets at the static load of the record. Limits judge the band's upper edge."
)
_CLOSED = "Modulus of the complementary sensitivity 1 − S of every axis: reference to displacement."
_OPEN = (
    "Open loop 1/S − 1 of every axis with the other loops closed, about the critical point −1. Circles: the borders of the "
    "zones, |S| = 3, 4 and 5; a loop that stays outside the largest is in zone A."
)


def acceptance_report(accepted: Acceptance, *, date: str = "") -> Report:
    """The page of an acceptance; date: ISO (today if empty)."""
    limit = accepted.machine.requirements.sensitivity_peak
    sections = [section for loop in accepted.points for section in _sections(loop, limit, len(accepted.points) > 1)]
    sections.append(Section("All checks", "", (), tuple(tables.checks_table(loop.checks) for loop in accepted.points)))
    verdicts = [tables.verdict(loop.checks) for loop in accepted.points]
    digest = getattr(accepted.controller, "digest", "")
    rows = (
        ("Machine file", accepted.machine.name, Cell("", detail=machine_hash(accepted.machine))),
        ("Controller", f"{accepted.timing}", Cell("", detail=digest)),
        ("Records", ", ".join(accepted.records) or "given in the program", ""),
    )
    sections.append(Section("What was measured", "", (), (Table("", ("", "What", "Hash"), rows, "", (20, 40, 40)),)))
    return Report("Acceptance of the magnetic bearing loop", accepted.machine, tuple(sections), tuple(verdicts), (), date)


def _sections(loop: MeasuredLoop, requirement: float | None, several: bool) -> list[Section]:
    where = f", {loop.checks.label}" if several else ""
    names = [units.axis_name(axis) for axis in loop.axes]
    diagonal = {label: np.einsum("wii->wi", S) for label, S in loop.predicted}
    S = {
        label: np.column_stack([np.abs(diagonal[label]), np.linalg.norm(full, 2, axis=(1, 2))])
        for label, full in loop.predicted
    }
    sensitivity = _panels(
        [*names, "σ max"], loop.omega, np.column_stack([loop.modulus, loop.sigma]),
        np.column_stack([loop.modulus - loop.half, loop.low]), np.column_stack([loop.modulus + loop.half, loop.high]), S,
        zone_lines(SENSITIVITY, requirement),
    )  # fmt: skip
    T = np.abs(1 - np.einsum("wii->wi", loop.S))
    closed = {label: np.abs(1 - own) for label, own in diagonal.items()}
    figures = (
        Figure(f"Sensitivity{where}", sensitivity, _SENSITIVITY),
        Figure(f"Open loop{where}", _nyquist(loop, names, diagonal), _OPEN),
        Figure(f"Closed loop{where}", _panels(names, loop.omega, T, T - loop.half, T + loop.half, closed, ()), _CLOSED),
    )
    return [Section(f"Measured over predicted{where}", "", figures)]


def _grid(count: int, titles: Sequence[str]) -> tuple[Any, list[dict[str, int]]]:
    rows = -(-count // _COLUMNS)
    words = [f"<b>{theme.plain(title)}</b>" for title in titles]
    figure = theme.subplots(
        rows=rows, cols=_COLUMNS, horizontal_spacing=0.09, vertical_spacing=min(0.28 / rows, 0.2), subplot_titles=words
    )
    return figure, [{"row": i // _COLUMNS + 1, "col": i % _COLUMNS + 1} for i in range(count)]


def _panels(
    titles: Sequence[str], omega: np.ndarray, value: np.ndarray, low: np.ndarray, high: np.ndarray,
    models: dict[str, np.ndarray], limits: Sequence[tuple[str, float]],
) -> Any:  # fmt: skip
    """Moduli (w, n) with their intervals over frequency, a panel each, models (w, n) over them."""
    figure, places = _grid(len(titles), titles)
    f, looks = omega / units.TWO_PI, dict(zip(models, _LOOKS, strict=False))
    curves = [("measured", Curve("acceptance", "", "frequency", omega, value.T, tuple(titles), "rad/s", "-", tuple(limits)))]
    axes = axes_of(curves)
    levels, line = limit_levels(curves, axes), {"color": _MEASURED, "width": 1.8}
    for i, place in enumerate(places):
        theme.band(figure, place, f, np.maximum(low[:, i], axes.y_range[0] / 10), high[:, i], _BAND, "95 %" if i == 0 else "")
        theme.scatter(figure, place, drawn(f), drawn(value[:, i]), "measured", shown=i == 0, line=line)
        for label, rows in models.items():
            theme.scatter(figure, place, drawn(f), drawn(rows[:, i]), label, shown=i == 0, line=looks[label].line)
        draw_limits(figure, place, levels, axes, size=(410, _HEIGHT - 60), named=i == 0)
    theme.dress(figure, _HEIGHT * places[-1]["row"], legend=True)
    set_ranges(figure, axes)
    figure.update_xaxes(title_text=axes.x_text, row=places[-1]["row"])
    return figure


def _nyquist(loop: MeasuredLoop, titles: Sequence[str], models: dict[str, np.ndarray]) -> Any:
    figure, places = _grid(len(titles), titles)
    turn = np.linspace(0, 2 * np.pi, 90)
    for i, place in enumerate(places):
        L = loop.loops[:, i]
        for limit in SENSITIVITY.limits:
            x, y = -1 + np.cos(turn) / limit.value, np.sin(turn) / limit.value
            theme.guide(figure, place, x, y, color=theme.LIMIT, width=1.2, dash="1.5px,2px")
        look = {"color": _MEASURED, "width": 1.8}
        hover = "%{customdata:.4g} Hz<extra>measured</extra>"
        at = loop.omega / units.TWO_PI
        theme.scatter(figure, place, L.real, L.imag, "measured", shown=i == 0, line=look, customdata=at, hovertemplate=hover)
        for (label, S), style in zip(models.items(), _LOOKS, strict=False):
            own = 1 / S[:, i] - 1
            theme.scatter(figure, place, own.real, own.imag, label, shown=i == 0, line=style.line)
        point = {"color": theme.INK, "size": 6, "symbol": "cross"}
        theme.scatter(figure, place, [-1], [0], mode="markers", marker=point, hoverinfo="skip")
        figure.update_xaxes(range=[-1 - _NYQUIST, -1 + _NYQUIST], **place)
        figure.update_yaxes(range=[-_NYQUIST * 0.75, _NYQUIST * 0.75], **place)
    return theme.dress(figure, (_HEIGHT + 60) * places[-1]["row"], legend=True)
