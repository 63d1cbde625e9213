"""Limits in figures: thin named lines inside the view, and words for what lies beyond it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from ambrose.judge.checks import Curve
from ambrose.report import theme, units
from ambrose.report.figures.axes import Axes

BEYOND = "beyond the view: "


def limit_levels(curves: Sequence[tuple[str, Curve]], axes: Axes) -> list[tuple[float, str]]:
    """Every level once (shown unit), with the names of all limits that lie there: "zone A/B,
    required 3".
    """
    names: dict[float, list[str]] = {}
    for text, value in dict.fromkeys(limit for _, curve in curves for limit in curve.limits):
        names.setdefault(value * axes.y_factor, []).append(text)
    return [
        (level, f"{', '.join(texts)} {amount(level, axes)}")
        for level, texts in sorted(names.items())
    ]


def amount(level: float, axes: Axes) -> str:
    """A value of the y axis (shown unit) as text."""
    return units.join(units.number(level), axes.y_unit)


def draw_limits(
    figure: Any,
    place: dict[str, int],
    levels: Sequence[tuple[float, str]],
    axes: Axes,
    *,
    size: tuple[int, int],
    named: bool,
) -> None:
    """Limits inside the view as thin lines with their names on them, side by side where they would
    overprint.

    place: {"row": ..., "col": ...} of the plot area; size: its approximate width and height [px].
    """
    low, high = (math.log10(v) for v in axes.y_range) if axes.log_y else axes.y_range
    # height [px], left and right end (fractions of the width) of the names so far
    taken: list[tuple[float, float, float]] = []
    for level, words in levels:
        if not axes.y_range[0] <= level <= axes.y_range[1]:
            continue
        theme.guide(
            figure,
            place,
            list(axes.x_range),
            [level, level],
            color=theme.LIMIT,
            width=1.2,
            dash="1.5px,2px",
        )
        if not named:
            continue
        y = math.log10(level) if axes.log_y else level
        at = (y - low) / (high - low) * size[1]
        width, right = (len(words) * 6.5 + 12) / size[0], 1.0
        for pixel, start, end in sorted(taken, key=lambda item: -item[2]):
            if abs(pixel - at) < 15 and start < right and right - width < end:
                right = start
        taken.append((at, right - width, right))
        # a line just above does not strike it through
        clear = {"bgcolor": "rgba(255, 255, 255, 0.85)", "borderpad": 0}
        where: dict[str, Any] = {"xref": "x domain", "yshift": -1, **clear}
        theme.note(
            figure,
            place,
            theme.plain(words),
            right,
            y,
            "right",
            "bottom",
            colour=theme.LIMIT,
            **where,
        )


def beyond(curves: Sequence[tuple[str, Curve]], axes: Axes) -> str:
    """What lies outside the view, limits and parts of curves: "beyond the view: touchdown gap 250
    µm"; empty when nothing.
    """
    outside = [
        item
        for item in limit_levels(curves, axes)
        if not axes.y_range[0] <= item[0] <= axes.y_range[1]
    ]
    texts = [
        words
        for level, words in outside
        if level >= 0 or -level not in {other for other, _ in outside}
    ]
    texts += ["some curves"] if axes.cut else []
    return BEYOND + ", ".join(texts) if texts else ""
