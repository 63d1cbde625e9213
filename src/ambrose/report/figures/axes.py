"""Units, scales and visible ranges of the axes that a set of curves shares, and the limits drawn on
them. Data are never changed, only the view is chosen.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ambrose.judge.checks import Curve
from ambrose.report import theme, units

# of a logarithmic view below its top; models differ where they are small
_DECADES, _OVERLAY_DECADES = 4.0, 7.0
# decades below the lowest limit: what is read against limits needs the room around them
_BELOW_LIMITS = 2.0
# a time response this much larger than all others (an unstable loop's) does not set the view
_RUNAWAY = 8.0


@dataclass(frozen=True, slots=True)
class Axes:
    """How x and y are shown: factors from SI, texts, logarithmic or not, and the visible ranges
    (shown units).
    """

    x_factor: float
    x_text: str
    y_factor: float
    y_unit: str
    log_x: bool
    log_y: bool
    x_range: tuple[float, float]
    y_range: tuple[float, float]
    cut: bool  # part of the data lies outside the view


def drawn(values: ArrayLike) -> np.ndarray:
    """Coordinates as the page carries them: every point, to seven digits (half the weight of
    sixteen).
    """
    return np.asarray(values, dtype=np.float32)


def is_map(curve: Curve) -> bool:
    """Whether this is a Campbell map: frequencies over speed."""
    return curve.kind == "speed" and curve.y_unit == "rad/s"


def axes_of(
    curves: Sequence[tuple[str, Curve]],
    *,
    overlay: bool = False,
    view: Sequence[tuple[str, Curve]] = (),
) -> Axes:
    """The common axes of curves of one kind and unit; ``view``: those that choose the range of y
    (default: all).
    """
    first = curves[0][1]
    x = np.concatenate([curve.x for _, curve in curves])
    everything = _finite(curves)
    rows = _finite(view) if view else everything
    y, whole = np.concatenate(rows), np.concatenate(everything)
    log = first.kind == "frequency"
    log_x = log and x.size > 0 and float(x.min()) > 0
    log_y = log and y.size > 0 and float(y.min()) > 0 and first.y_unit != "rad"
    limits = [value for _, curve in curves for _, value in curve.limits]
    if log_y:
        low, high = _logarithmic(y, limits, _OVERLAY_DECADES if overlay else _DECADES)
    else:
        low, high = _linear(_without_runaways(rows) if first.kind == "time" else y, limits)
    cut = bool(whole.size) and (float(whole.min()) < low or float(whole.max()) > high)
    factor, y_unit = units.scale(first.y_unit, max(abs(low), abs(high)))
    x_factor, x_text = _x_scale(first.kind, x)
    ranges = _x_range(x * x_factor, log_x), (low * factor, high * factor)
    return Axes(x_factor, x_text, factor, y_unit, log_x, log_y, *ranges, cut)


def set_ranges(figure: Any, axes: Axes) -> None:
    """Show these ranges, logarithmic or not, in every panel."""
    figure.update_xaxes(
        **(theme.decades(*axes.x_range) if axes.log_x else {"range": list(axes.x_range)})
    )
    figure.update_yaxes(
        **(theme.decades(*axes.y_range) if axes.log_y else {"range": list(axes.y_range)})
    )


def _finite(curves: Sequence[tuple[str, Curve]]) -> list[np.ndarray]:
    return [row[np.isfinite(row)] for row in (curve.y.ravel() for _, curve in curves)]


def _x_scale(kind: str, x: np.ndarray) -> tuple[float, str]:
    if kind == "time":
        factor, unit = units.seconds_or_milliseconds(float(np.ptp(x)) if x.size else 0.0)
        return factor, f"Time [{unit}]"
    if kind == "speed":
        return units.RPM, "Rotational speed [rpm]"
    return units.scale("rad/s")[0], "Frequency [Hz]"


def _x_range(x: np.ndarray, log: bool) -> tuple[float, float]:
    low, high = (float(x.min()), float(x.max())) if x.size else (0.0, 1.0)
    if low < high:
        return low, high
    return (low / 2, high * 2) if log else (low - 0.5, high + 0.5)


def _logarithmic(y: np.ndarray, limits: Sequence[float], decades: float) -> tuple[float, float]:
    """The upper decades of the data, and the limits that lie not far above them."""
    top = float(y.max())
    high = 1.5 * max([top, *(value for value in limits if value <= 30 * top)])
    below = min((value for value in limits if value > 0), default=0.0) / 10**_BELOW_LIMITS
    return max(float(y.min()) / 1.3, high / 10**decades, min(below, high / 10)), high


def _linear(y: np.ndarray, limits: Sequence[float]) -> tuple[float, float]:
    """The data from zero, and the limits that are not far beyond them."""
    if y.size == 0:
        return 0.0, 1.0
    low, high = min(0.0, float(y.min())), max(0.0, float(y.max()))
    reach = max(-low, high)
    near = [value for value in limits if abs(value) <= 4 * reach]
    low, high = min([low, *near]), max([high, *near])
    margin = 0.06 * (high - low) or 1.0
    return (low - margin if low < 0 else 0.0), (high + margin if high > 0 else 0.0)


def _without_runaways(rows: Sequence[np.ndarray]) -> np.ndarray:
    """The responses but for those that are far larger than all the others."""
    ordered = sorted((row for row in rows if row.size), key=lambda row: float(np.abs(row).max()))
    while len(ordered) > 1 and np.abs(ordered[-1]).max() > _RUNAWAY * np.abs(ordered[-2]).max() > 0:
        ordered.pop()
    return np.concatenate(ordered) if ordered else np.zeros(0)


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
