"""Small multiples: a grid of panels with common axes, so that the eye compares columns; the same
look as every other figure.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ambrose.judge.checks import Curve
from ambrose.report import theme, units
from ambrose.report.figures.axes import (
    Axes,
    axes_of,
    beyond,
    draw_limits,
    drawn,
    limit_levels,
    set_ranges,
)
from ambrose.report.figures.curves import mark_peak

Labelled = tuple[tuple[str, Curve], ...]

_WIDTH = 900  # [px], of all panels of a row together, about
_LEAST_GAP, _TITLE_GAP = 16, 40  # [px] between rows, without and with titles between them
_LINE, _CHARACTER = 16, 7.0  # [px] height of a line of notes; width of a character


@dataclass(frozen=True, slots=True, eq=False)
class Panel:
    """One plot area: (label, Curve) pairs, every line drawn in its label's style.

    title stands above its left corner, beneath it the notes, (label, text) pairs, each in its
    label's colour. side: what its row shows, beside the axis of the first panel of the row.
    """

    title: str
    curves: Labelled
    notes: tuple[tuple[str, str], ...] = ()
    side: str = ""


def panel_figure(
    rows: Sequence[Sequence[Panel]],
    style: Mapping[str, theme.Style],
    *,
    height: int = 260,
    view: Labelled = (),
    span: tuple[float, float] | None = None,
    mark_peaks: bool = False,
) -> tuple[Any, str]:
    """The plotly figure of a grid of panels, and what lies beyond its view in words ("" when
    nothing).

    rows: the panels, row by row, the curves all of one kind and unit; a row may end early. height
    [px] of a row. view: the curves that choose the range of y where not all are to (default: all).
    span: the visible range of x (SI unit; default: all). mark_peaks: a circle at every line's
    maximum.
    """
    everything = tuple(pair for row in rows for panel in row for pair in panel.curves)
    axes = axes_of(everything, view=view)
    if span is not None:
        axes = replace(axes, x_range=(span[0] * axes.x_factor, span[1] * axes.x_factor))
    columns = max(len(row) for row in rows)
    width = _WIDTH // columns
    above = [max(_lines_above(panel, width) for panel in row) for row in rows]
    gaps = [_LEAST_GAP if lines == 0 else _TITLE_GAP + _LINE * (lines - 1) for lines in above[1:]]
    total = height * len(rows) + sum(gaps)
    figure = theme.subplots(
        rows=len(rows),
        cols=columns,
        horizontal_spacing=0.028,
        specs=[[{} if j < len(row) else None for j in range(columns)] for row in rows],
    )
    _set_heights(figure, rows, height / total, [gap / total for gap in gaps])
    levels = limit_levels(everything, axes)
    in_legend: set[str] = set()
    for i, row in enumerate(rows):
        for j, panel in enumerate(row):
            place = {"row": i + 1, "col": j + 1}
            _draw(figure, panel, place, axes, style, in_legend, mark_peaks=mark_peaks)
            draw_limits(figure, place, levels, axes, size=(width, height), named=i == j == 0)
            _words(figure, panel, place, style, width, above[i])
    theme.dress(figure, total, legend=len(in_legend) > 1, lines=max(0, above[0] - 1))
    _scale(figure, rows, axes)
    return figure, beyond(everything, axes)


def _draw(
    figure: Any,
    panel: Panel,
    place: dict[str, int],
    axes: Axes,
    style: Mapping[str, theme.Style],
    in_legend: set[str],
    *,
    mark_peaks: bool,
) -> None:
    for label, curve in panel.curves:
        look = style[label]
        grid = _abscissae(curve.x * axes.x_factor)
        for name, row in zip(curve.labels, curve.y, strict=True):
            y = row * axes.y_factor
            words = "<br>".join(
                theme.plain(units.axis_name(part)) for part in dict.fromkeys((label, name))
            )
            hover = f"{words}<br>%{{x:.4g}} · %{{y:.4g}} {axes.y_unit}<extra></extra>"
            theme.scatter(
                figure,
                place,
                y=drawn(y),
                label=label,
                shown=label not in in_legend,
                line=look.line,
                hovertemplate=hover,
                **grid,
            )
            in_legend.add(label)
            if mark_peaks:
                mark_peak(figure, place, curve.x * axes.x_factor, y, look)


def _abscissae(x: np.ndarray) -> dict[str, Any]:
    """x as plotly takes it: start and step where the steps are equal, which halves the weight of a
    time response.
    """
    if len(x) > 2:
        step = (x[-1] - x[0]) / (len(x) - 1)
        if np.allclose(x, x[0] + step * np.arange(len(x)), rtol=0, atol=1e-6 * abs(step)):
            return {"x": None, "x0": float(x[0]), "dx": float(step)}
    return {"x": drawn(x)}


def _set_heights(
    figure: Any, rows: Sequence[Sequence[Panel]], height: float, gaps: Sequence[float]
) -> None:
    """Rows of one height, each gap its own (fractions of the whole)."""
    top = 1.0
    for i, row in enumerate(rows):
        for j in range(len(row)):
            figure.get_subplot(i + 1, j + 1).yaxis.domain = (max(top - height, 0.0), top)
        top -= height + (gaps[i] if i < len(gaps) else 0.0)


def _wrapped(panel: Panel, width: int) -> list[list[tuple[str, str]]]:
    """The notes of a panel of that width [px] in lines."""
    lines: list[list[tuple[str, str]]] = []
    used = math.inf
    for label, text in panel.notes:
        if used + len(text) + 3 > width / _CHARACTER:
            lines.append([])
            used = 0
        lines[-1].append((label, text))
        used += len(text) + 3
    return lines


def _lines_above(panel: Panel, width: int) -> int:
    return bool(panel.title) + len(_wrapped(panel, width))


def _words(
    figure: Any,
    panel: Panel,
    place: dict[str, int],
    style: Mapping[str, theme.Style],
    width: int,
    above: int,
) -> None:
    """Title and notes above the panel; above: lines that the panels of its row have there."""
    lines: list[str] = []
    for line in _wrapped(panel, width):
        parts = [
            '<span style="color: '
            f'{style[label].colour if label in style else theme.MUTED}">{theme.plain(text)}</span>'
            for label, text in line
        ]
        lines.append(" · ".join(parts))
    lines = [f"<b>{theme.plain(panel.title)}</b>", *lines] if panel.title else lines
    for i, text in enumerate(lines):
        theme.heading(figure, place, text, yshift=1 + _LINE * (above - 1 - i))


def _scale(figure: Any, rows: Sequence[Sequence[Panel]], axes: Axes) -> None:
    set_ranges(figure, axes)
    unit = f"[{axes.y_unit}]" if axes.y_unit else ""
    for i, row in enumerate(rows):
        for j, panel in enumerate(row):
            x, y = figure.get_subplot(i + 1, j + 1)
            x.showticklabels = bottom = i == len(rows) - 1 or j >= len(rows[i + 1])
            y.showticklabels = j == 0
            side = theme.plain(" ".join(part for part in (panel.side, unit) if part))
            if bottom:
                x.title.text = axes.x_text
            if j == 0 and side:
                y.title.text = side
            if i or j:
                x.matches, y.matches = "x", "y"
