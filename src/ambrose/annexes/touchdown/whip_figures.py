"""Pictures of whip: what it needs over its frequency, and its edge over friction and mount."""

from __future__ import annotations

from typing import Any

import numpy as np

from ambrose.annexes.touchdown.analysis import Landing, WhipMap
from ambrose.report import theme

_ONE = {"row": 1, "col": 1}
_TURN = 2 * np.pi  # rad


def needed_figure(result: Landing) -> Any:
    """Friction that whip needs over its frequency, beside what the bearings have."""
    figure = theme.subplots(rows=1, cols=1)
    looks = theme.styles([curve.kind for curve in result.curves])
    shown = {whip.kind for whip in result.whips}
    for curve in result.curves:
        if curve.kind in shown:
            theme.scatter(
                figure,
                _ONE,
                np.float32(curve.frequency / _TURN),
                np.float32(curve.friction),
                curve.kind,
                shown=True,
                mode="lines",
                line=looks[curve.kind].line,
                hovertemplate="%{x:.4g} Hz: %{y:.3g}<extra></extra>",
            )
    ends = np.array([curve.frequency[[0, -1]] for curve in result.curves]) / _TURN
    low, high = float(ends.min()), float(ends.max())
    for mu in sorted({bearing.friction for bearing in result.fallen.bearings}):
        theme.guide(figure, _ONE, [low, high], [mu, mu], color=theme.INK, width=1, dash="dot")
        theme.note(figure, _ONE, f"friction {mu:g}", np.log10(low), mu, "left", "bottom")
    turn = result.point.speed / _TURN
    theme.guide(figure, _ONE, [turn, turn], [0, 1], color=theme.MUTED, width=1, dash="dash")
    theme.note(figure, _ONE, "speed", np.log10(turn), 1, "left", "top")
    theme.dress(figure, 280, legend=True)
    figure.update_xaxes(title_text="Whip frequency [Hz]", **theme.decades(low, high))
    figure.update_yaxes(title_text="Friction needed", range=[0, 1])
    return figure


def map_figure(item: WhipMap, quantity: str) -> Any:
    """The edge over friction and mount stiffness at the mount's own damping, with the machine's
    place. quantity: "frequency" or "force".
    """
    import plotly.graph_objects as go

    middle = len(item.damping) // 2
    values = getattr(item, quantity)[middle]
    scale = _TURN if quantity == "frequency" else 1e3
    there = np.isfinite(values) & (values > 0)
    shown = np.full(values.shape, np.nan)
    shown[there] = np.log10(values[there] / scale)
    figure = theme.subplots(rows=1, cols=1)
    low, high = (np.nanmin(shown), np.nanmax(shown)) if there.any() else (0.0, 1.0)
    ticks = np.linspace(low, high, 5)
    unit = "Hz" if quantity == "frequency" else "kN"
    figure.add_trace(
        go.Heatmap(
            x=np.float32(item.friction),
            y=np.float32(item.stiffness / 1e6),
            z=np.float32(shown),
            customdata=np.float32(np.where(there, values / scale, 0)),
            colorscale="Viridis",
            colorbar={
                "thickness": 12,
                "tickvals": ticks.tolist(),
                "ticktext": [f"{10**v:.3g}" for v in ticks],
                "title": {"text": unit},
            },
            hovertemplate="friction %{x:.3g}, %{y:.3g} N/um: %{customdata:.4g} "
            + unit
            + "<extra></extra>",
        ),
        **_ONE,
    )
    if item.place is not None:
        mu, stiffness, _ = item.place
        theme.scatter(
            figure,
            _ONE,
            [mu],
            [stiffness / 1e6],
            mode="markers",
            marker={
                "symbol": "diamond",
                "size": 13,
                "color": "white",
                "line": {"color": "black", "width": 2},
            },
            hovertemplate="this machine<extra></extra>",
        )
        theme.note(
            figure,
            _ONE,
            "this machine",
            np.log10(mu),
            np.log10(stiffness / 1e6) + 0.06,
            "center",
            "bottom",
            colour="black",
            bgcolor="rgba(255,255,255,0.8)",
        )
    theme.dress(figure, 300, legend=False)
    figure.update_xaxes(
        title_text="Friction", **theme.decades(float(item.friction[0]), float(item.friction[-1]))
    )
    span = theme.decades(float(item.stiffness[0]) / 1e6, float(item.stiffness[-1]) / 1e6)
    figure.update_yaxes(title_text="Mount stiffness [N/um]", **span)
    return figure
