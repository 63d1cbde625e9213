"""Poles of closed loops: the slow ones in the s-plane, and all of them as damping ratio against
natural frequency.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ambrose.judge.checks import Curve
from ambrose.report import theme, units
from ambrose.report.figures.axes import drawn

# the left picture ends at the widest gap after so many slow poles of an operating point
_FEWEST, _MOST = 4, 16
# damping ratios beyond this are shown logarithmically, below it linearly: 0 and instability stay
# visible
_FINE = 1e-3
_TICKS = (-1.0, -0.1, -0.01, -0.001, 0.0, 0.001, 0.01, 0.1, 1.0)


def pole_figure(curves: Sequence[tuple[str, Curve]], style: Mapping[str, theme.Style]) -> Any:
    """A figure of curves of kind "poles" (x real, y imaginary part [rad/s]); conjugates are drawn
    once, above the axis.
    """
    figure = theme.subplots(rows=1, cols=2, column_widths=[0.42, 0.58], horizontal_spacing=0.1)
    everything = [(label, _upper_half(curve)) for label, curve in curves]
    reach = max((_slow_radius(poles) for _, poles in everything), default=1.0)
    for label, poles in everything:
        look = style[label]
        ratio = -poles.real / np.where(np.abs(poles) > 0, np.abs(poles), np.inf)
        frequency = np.abs(poles) / units.TWO_PI
        marker = {
            "color": look.colour,
            "symbol": look.symbol,
            "size": 9,
            "line": {"width": 1.6, "color": look.colour},
        }
        hover = (
            f"{theme.plain(label)}<br>%{{customdata[0]:.5g}} Hz, damping ratio "
            "%{customdata[1]:.3g}<extra></extra>"
        )
        name = theme.plain(label) + _least_damped(frequency, ratio)
        common: dict[str, Any] = {
            "name": name,
            "mode": "markers",
            "marker": marker,
            "hovertemplate": hover,
        }
        data, away = drawn(np.column_stack([frequency, ratio])), frequency > 0
        for column, x, y, kept in (
            (1, poles.real, poles.imag / units.TWO_PI, slice(None)),
            (2, frequency, _fold(ratio), away),
        ):
            place = {"row": 1, "col": column}
            theme.scatter(
                figure,
                place,
                drawn(x[kept]),
                drawn(y[kept]),
                label,
                shown=column == 1,
                customdata=data[kept],
                **common,
            )
    theme.dress(figure, 310, legend=True)
    _axes(figure, everything, reach)
    return figure


def _upper_half(curve: Curve) -> np.ndarray:
    """The poles with a non-negative imaginary part (n,) [rad/s], complex."""
    poles = (np.broadcast_to(curve.x, curve.y.shape) + 1j * curve.y).ravel()
    poles = poles[np.isfinite(poles)]
    return poles[poles.imag >= 0]


def _slow_radius(poles: np.ndarray) -> float:
    """The radius [rad/s] of the left picture: the slow poles and every unstable one."""
    if poles.size == 0:
        return 1.0
    size = np.maximum(np.sort(np.abs(poles)), 1e-9)
    first, last = min(_FEWEST, size.size) - 1, min(_MOST, size.size) - 1
    gaps = size[first + 1 : last + 1] / size[first:last]
    edge = size[first + int(np.argmax(gaps))] if gaps.size else size[last]
    return 1.2 * float(max(edge, np.abs(poles[poles.real > 0]).max(initial=0.0)))


def _least_damped(frequency: np.ndarray, ratio: np.ndarray) -> str:
    moving = frequency > 0
    if not moving.any():
        return ""
    i = int(np.argmin(np.where(moving, ratio, np.inf)))
    return (
        f" · least damping ratio {units.number(float(ratio[i]))} at "
        f"{units.number(float(frequency[i]))} Hz"
    )


def _fold(ratio: np.ndarray) -> np.ndarray:
    """Logarithmic far from zero, linear near it, odd: negative damping can be shown."""
    return np.arcsinh(np.asarray(ratio) / _FINE)


def _axes(figure: Any, everything: Sequence[tuple[str, np.ndarray]], reach: float) -> None:
    poles = np.concatenate([p for _, p in everything]) if everything else np.zeros(0)
    frequency = np.abs(poles[np.abs(poles) > 0]) / units.TWO_PI
    inside = int((np.abs(poles) <= reach).sum())
    right = max(0.06 * reach, 1.15 * float(poles.real.max(initial=0.0)))
    figure.update_xaxes(title_text="Real part [1/s]", range=[-reach, right], row=1, col=1)
    figure.update_yaxes(
        title_text="Imaginary part [Hz]",
        range=[-0.03 * reach / units.TWO_PI, reach / units.TWO_PI],
        row=1,
        col=1,
    )
    low, high = (
        (float(frequency.min()) / 1.5, float(frequency.max()) * 1.5)
        if frequency.size
        else (0.1, 1.0)
    )
    figure.update_xaxes(
        title_text="Natural frequency [Hz]", **theme.decades(low, high), row=1, col=2
    )
    unstable = bool((poles.real > 0).any())
    ticks = [t for t in _TICKS if t >= 0 or unstable]
    figure.update_yaxes(
        title_text="Damping ratio",
        tickvals=[float(_fold(np.array(t))) for t in ticks],
        ticktext=[units.number(t) for t in ticks],
        range=[float(_fold(np.array(-1.3 if unstable else -0.0006))), float(_fold(np.array(1.6)))],
        row=1,
        col=2,
    )
    boundary = {"color": theme.LIMIT, "width": 1}
    figure.add_vline(x=0, line=boundary, row=1, col=1)
    figure.add_hline(y=0, line=boundary, row=1, col=2)
    figure.add_vrect(
        x0=0,
        x1=10 * reach,
        fillcolor=theme.LIMIT,
        opacity=0.07,
        line_width=0,
        layer="below",
        row=1,
        col=1,
    )
    figure.add_hrect(
        y0=-20, y1=0, fillcolor=theme.LIMIT, opacity=0.07, line_width=0, layer="below", row=1, col=2
    )
    left, right_half = {"row": 1, "col": 1}, {"row": 1, "col": 2}
    ends = {"xref": "x domain", "yref": "y domain"}
    theme.note(
        figure,
        left,
        f"slow poles ({inside} of {poles.size} in view)",
        0,
        1.0,
        "left",
        "bottom",
        **ends,
    )
    origin = int(poles.size - frequency.size)
    words = "all poles" if origin == 0 else f"all poles but {origin} at the origin"
    theme.note(figure, right_half, words, 0, 1.0, "left", "bottom", **ends)
    if unstable:
        theme.note(
            figure,
            right_half,
            "unstable",
            1,
            0,
            "right",
            "top",
            xref="x domain",
            yref="y2",
            colour=theme.LIMIT,
        )
