"""What synchronous blocks change over speed: current, force, orbit and sensitivity, and the margin
of convergence.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ambrose.judge.checks import Checks, Curve
from ambrose.report import theme, units
from ambrose.report.figures.axes import drawn

_BEFORE, _AFTER = "without the block", "block converged"
_ROWS = (
    ("synchronous.current_0p", "1× control current, zero to peak"),
    ("synchronous.force_0p", "1× force on the housing, zero to peak"),
    ("synchronous.orbit_0p", "Worst-case 1× orbit, zero to peak"),
    ("synchronous.sensitivity", "Largest sensitivity of an axis"),
    ("synchronous.margin", "Angle all phases may be off by"),
)
_HEIGHT, _GAP = 170, 64  # [px] of a panel, and between two


def synchronous_figure(blocks: Sequence[Checks]) -> Any:
    """One panel each for current, force, orbit, sensitivity and margin over speed; a piece of each
    line for every block.

    blocks: the checks of ``judge.synchronous.check_block`` that have curves.
    """
    rows = [
        (name, title)
        for name, title in _ROWS
        if any(_curve(block, name) is not None for block in blocks)
    ]
    total = _HEIGHT * len(rows) + _GAP * (len(rows) - 1)
    figure = theme.subplots(
        rows=len(rows), cols=1, shared_xaxes=True, vertical_spacing=_GAP / total
    )
    pressures = list(
        dict.fromkeys(
            label
            for block in blocks
            if (c := _curve(block, "synchronous.margin"))
            for label in c.labels
        )
    )
    style = theme.styles([_BEFORE, _AFTER, *pressures])
    in_legend: set[str] = set()
    for k, (name, title) in enumerate(rows, start=1):
        place = {"row": k, "col": 1}
        curves = [curve for block in blocks if (curve := _curve(block, name)) is not None]
        largest = max(float(np.nanmax(np.abs(curve.y))) for curve in curves)
        factor, unit = units.scale(curves[0].y_unit, largest)
        for curve in curves:
            _draw(figure, place, curve, factor, unit, style, in_legend)
        # zero is part of every picture: what falls is seen against it
        figure.update_yaxes(rangemode="tozero", **place)
        theme.heading(figure, place, f"<b>{title}</b>{f' [{unit}]' if unit else ''}")
    theme.dress(figure, total, legend=True)
    figure.update_xaxes(title_text="Rotational speed [Hz]", row=len(rows), col=1)
    return figure


def _curve(block: Checks, name: str) -> Curve | None:
    return next((curve for curve in block.curves if curve.name == name), None)


def _draw(
    figure: Any,
    place: dict[str, int],
    curve: Curve,
    factor: float,
    unit: str,
    style: dict[str, theme.Style],
    in_legend: set[str],
) -> None:
    """The lines of one block, and its limit."""
    x = drawn(curve.x / units.TWO_PI)
    for label, values in zip(curve.labels, curve.y, strict=True):
        look = style[label]
        words = theme.plain(label)
        theme.scatter(
            figure,
            place,
            x,
            drawn(values * factor),
            label,
            shown=label not in in_legend,
            name=words,
            hovertemplate=f"{words}<br>%{{x:.4g}} Hz · %{{y:.4g}} {unit}<extra></extra>",
            line={"color": look.colour, "dash": look.dash, "width": look.width},
        )
        in_legend.add(label)
    for words, level in curve.limits:
        if level > 0:
            ends = np.array([curve.x[0], curve.x[-1]]) / units.TWO_PI
            line = np.full(2, level * factor)
            theme.guide(
                figure,
                place,
                drawn(ends),
                drawn(line),
                color=theme.LIMIT,
                width=1.2,
                dash="7px,4px",
            )
            theme.note(
                figure,
                place,
                words,
                float(ends[-1]),
                level * factor,
                "right",
                "bottom",
                colour=theme.LIMIT,
            )
