"""Curves against frequency, speed and time: operating points overlaid, one small panel per axis where there are several."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ambrose.report import theme, units
from ambrose.verify.checks import Curve

Labelled = Sequence[tuple[str, Curve]]

_ENVELOPE = re.compile(r"max|worst|sigma|σ|envelope|largest|all axes", re.IGNORECASE)
_MOST_PANELS = 8
_MOST_DECADES = 4.0  # a logarithmic view reaches this far below its top; the rest is a double-click away, and said so
_OVERLAY_DECADES = 7.0  # models are compared over a longer range: they differ where the plant is small
_AGREEMENT = 0.05  # the legend says up to where an overlaid model stays this close to the reference
_MAIN_HEIGHT, _ONLY_HEIGHT, _SMALL_HEIGHT, _GAP = 280, 320, 140, 68  # [px]


@dataclass(frozen=True, slots=True)
class Axes:
    """How x and y are shown: factors from SI, texts, logarithmic or not, and the visible range of y (shown units)."""

    x_factor: float
    x_text: str
    y_factor: float
    y_unit: str
    log_x: bool
    log_y: bool
    x_range: tuple[float, float]
    y_range: tuple[float, float]
    cut: bool  # part of the data lies below the view


@dataclass(frozen=True, slots=True)
class Panel:
    """One plot area: its lines by name, its place in the grid."""

    names: tuple[str, ...]
    row: int
    column: int
    main: bool


def line_figure(curves: Labelled, style: Mapping[str, theme.Style], *, overlay: bool = False) -> Any:
    """A figure of curves of kind "frequency", "speed" or "time"; all of one kind and unit (see plots.figure)."""
    from plotly.subplots import make_subplots

    panels, specs, heights = _arrange(curves)
    axes = _axes(curves, _OVERLAY_DECADES if overlay else _MOST_DECADES)
    total = sum(heights) + _GAP * (len(heights) - 1)
    figure = make_subplots(
        rows=len(heights), cols=len(specs[0]), specs=specs, row_heights=[h / sum(heights) for h in heights],
        horizontal_spacing=0.035 if len(specs[0]) > 2 else 0.06, vertical_spacing=_GAP / total,
    )  # fmt: skip
    legend = len(dict.fromkeys(label for label, _ in curves)) > 1 or _peak_known(curves)
    for panel in panels:
        _draw(figure, panel, curves, axes, style, first=panel is panels[0], overlay=overlay)
    theme.dress(figure, total, legend=legend)
    _scale_axes(figure, panels, axes, len(heights))
    for panel in panels:
        _limits(figure, panel, curves, axes, named=panel.main or not panels[0].main)
        _panel_title(figure, panel, axes, many=len(panels) > 1)
    if axes.cut:
        _note(figure, "curves continue below the view: double-click to see all")
    return figure


def _arrange(curves: Labelled) -> tuple[list[Panel], list[list[Any]], list[int]]:
    """Which lines share a panel, the grid for make_subplots, and the heights of its rows [px]."""
    names = list(dict.fromkeys(name for _, curve in curves for name in curve.labels))
    together = curves[0][1].kind == "speed" or len(names) == 1 or len(names) > _MOST_PANELS
    if together:
        return [Panel(tuple(names), 1, 1, True)], [[{}]], [_ONLY_HEIGHT]
    envelope = [name for name in names if _ENVELOPE.search(name)][:1]
    rest = [name for name in names if name not in envelope]
    columns = min(4, len(rest)) if envelope else 2
    specs: list[list[Any]] = []
    panels: list[Panel] = []
    if envelope:
        specs.append([{"colspan": columns}] + [None] * (columns - 1))
        panels.append(Panel((envelope[0],), 1, 1, True))
    for i, name in enumerate(rest):
        if i % columns == 0:
            specs.append([None] * columns)
        specs[-1][i % columns] = {}
        panels.append(Panel((name,), len(specs), i % columns + 1, False))
    heights = [_MAIN_HEIGHT] * len(envelope) + [_SMALL_HEIGHT] * (len(specs) - len(envelope))
    return panels, specs, heights


def _axes(curves: Labelled, decades: float) -> Axes:
    first = curves[0][1]
    x = np.concatenate([curve.x for _, curve in curves])
    y = np.concatenate([curve.y.ravel() for _, curve in curves])
    y = y[np.isfinite(y)]
    top = float(np.abs(y).max(initial=0.0))
    y_factor, y_unit = units.scale(first.y_unit, top)
    if first.kind == "time":
        x_factor, unit = units.seconds_or_milliseconds(float(np.ptp(x)) if x.size else 0.0)
        x_text = f"Time [{unit}]"
    elif first.kind == "speed":
        x_factor, x_text = units.RPM, "Rotational speed [rpm]"
    else:
        x_factor, x_text = units.scale("rad/s")[0], "Frequency [Hz]"
    log_x = first.kind == "frequency" and x.size > 0 and float(x.min()) > 0
    log_y = first.kind == "frequency" and y.size > 0 and float(y.min()) > 0 and first.y_unit != "rad"
    limits = [value for _, curve in curves for _, value in curve.limits]
    low, high, cut = _view(y * y_factor, [value * y_factor for value in limits], decades if log_y else None)
    x_low, x_high = (float(x.min()) * x_factor, float(x.max()) * x_factor) if x.size else (0.0, 1.0)
    if x_low == x_high:
        x_low, x_high = (x_low / 2, x_low * 2) if log_x else (x_low - 0.5, x_low + 0.5)
    return Axes(x_factor, x_text, y_factor, y_unit, log_x, log_y, (x_low, x_high), (low, high), cut)


def _view(y: np.ndarray, limits: Sequence[float], decades: float | None) -> tuple[float, float, bool]:
    """The visible range: the data, on a logarithmic axis (``decades`` given) its upper part, and the limits near them."""
    log = decades is not None
    if y.size == 0:
        return 0.1 if log else 0.0, 1.0, False
    low, high = float(y.min()), float(y.max())
    if decades is not None:
        high = max([high, *(v for v in limits if high < v <= 30 * high)]) * 1.5
        floor = high / 10**decades
        return max(low / 1.3, floor), high, low < floor
    reach = max(abs(low), abs(high))
    high = max([high, *(v for v in limits if high < v <= 4 * reach)])
    low = min([low, *(v for v in limits if -4 * reach <= v < low)])
    margin = 0.06 * (high - low) or 0.5 * reach or 1.0
    return (low - margin if low < 0 else min(0.0, low)), high + margin, False


def _draw(
    figure: Any, panel: Panel, curves: Labelled, axes: Axes, style: Mapping[str, theme.Style], *, first: bool, overlay: bool
) -> None:
    import plotly.graph_objects as go

    shown: set[str] = set()
    for label, curve in curves:
        look = style[label]
        x = curve.x * axes.x_factor
        for name, values in zip(curve.labels, curve.y, strict=True):
            if name not in panel.names:
                continue
            y = values * axes.y_factor
            words = f"{theme.plain(label)}<br>{theme.plain(units.axis_name(name))}"
            hover = f"{words}<br>%{{x:.4g}} · %{{y:.4g}} {axes.y_unit}<extra></extra>"
            figure.add_trace(
                go.Scatter(
                    x=x, y=y, mode="lines", legendgroup=theme.plain(label), showlegend=first and label not in shown,
                    name=theme.plain(label) + _legend_text(name, label, values, curves, axes, overlay=overlay),
                    line={"color": look.colour, "dash": _dash(name, look, curve), "width": look.width if panel.main else 1.4},
                    hovertemplate=hover,
                ),
                row=panel.row, col=panel.column,
            )  # fmt: skip
            shown.add(label)
            if panel.main and len(panel.names) == 1 and _peaked(curve) and not overlay:
                _mark_peak(figure, panel, x, y, look)
    if curves[0][1].kind == "speed":
        _speed_furniture(figure, panel, curves, axes)


def _dash(name: str, look: theme.Style, curve: Curve) -> str:
    """On a Campbell map the dash tells backward from forward whirl, elsewhere it tells operating points apart."""
    if curve.kind == "speed" and len(curve.labels) > 1:
        return "6px,3px" if "backward" in name.lower() else "solid"
    return look.dash


def _peaked(curve: Curve) -> bool:
    return curve.kind == "frequency" and curve.y_unit != "rad"


def _peak_known(curves: Labelled) -> bool:
    return any(_peaked(curve) for _, curve in curves)


def _legend_text(name: str, label: str, values: np.ndarray, curves: Labelled, axes: Axes, *, overlay: bool) -> str:
    """What the legend adds to the label: the peak, or how far an overlaid model agrees with the reference."""
    if not overlay:
        return _peak_text(values, curves[[other for other, _ in curves].index(label)][1], axes)
    reference = curves[0][1]
    curve = next(curve for other, curve in curves if other == label)
    if (
        label == curves[0][0]
        or curve.kind != "frequency"
        or name not in reference.labels
        or not np.array_equal(curve.x, reference.x)
    ):
        return ""
    wanted = reference.y[reference.labels.index(name)]
    apart = np.flatnonzero(~(np.abs(values - wanted) <= _AGREEMENT * np.abs(wanted)))
    if not apart.size:
        return f" · within {_AGREEMENT:.0%} everywhere"
    return f" · within {_AGREEMENT:.0%} up to {units.quantity(float(curve.x[apart[0]]), 'rad/s')}"


def _peak_text(values: np.ndarray, curve: Curve, axes: Axes) -> str:
    """For the legend: where and how high the peak is. Empty for a map or when nothing is finite."""
    if curve.kind == "speed" or not np.isfinite(values).any():
        return ""
    largest = int(np.nanargmax(np.where(np.isfinite(values), np.abs(values), -1.0)))
    size = units.join(units.number(abs(float(values[largest])) * axes.y_factor), axes.y_unit)
    if not _peaked(curve):
        return f" · largest {size}" if len(curve.labels) == 1 else ""
    return f" · peak {size} at {units.quantity(float(curve.x[largest]), 'rad/s')}"


def _mark_peak(figure: Any, panel: Panel, x: np.ndarray, y: np.ndarray, look: theme.Style) -> None:
    import plotly.graph_objects as go

    if not np.isfinite(y).any():
        return
    i = int(np.nanargmax(y))
    marker = {"color": "white", "size": 7, "line": {"color": look.colour, "width": 1.6}}
    figure.add_trace(
        go.Scatter(x=[x[i]], y=[y[i]], mode="markers", marker=marker, showlegend=False, hoverinfo="skip"),
        row=panel.row, col=panel.column,
    )  # fmt: skip


def _speed_furniture(figure: Any, panel: Panel, curves: Labelled, axes: Axes) -> None:
    """On a map over speed: the synchronous line (frequency = speed) and the names of the lines at their right ends."""
    import plotly.graph_objects as go

    place = {"row": panel.row, "col": panel.column}
    first = curves[0][1]
    if first.y_unit == "rad/s":
        high = min(axes.x_range[1] / 60, axes.y_range[1])
        low = min(axes.x_range[0] / 60, high)
        line = {"color": theme.MUTED, "width": 1, "dash": "2px,3px"}
        ends = {"x": [low * 60, high * 60], "y": [low, high]}
        figure.add_trace(go.Scatter(**ends, mode="lines", line=line, showlegend=False, hoverinfo="skip"), **place)
        figure.add_annotation(
            x=high * 33, y=high * 0.55, text="1× speed", showarrow=False, xanchor="left", yanchor="top", xshift=5,
            font={"size": 12, "color": theme.MUTED}, **place,
        )  # fmt: skip
    if 1 < len(panel.names) <= 16:
        for level, name in _spread(
            [(float(row[-1]) * axes.y_factor, n) for n, row in zip(first.labels, first.y, strict=True)], axes
        ):
            figure.add_annotation(
                xref="x domain", x=1.0, y=level, text=theme.plain(units.axis_name(name)), showarrow=False, xanchor="left",
                xshift=5, font={"size": 12, "color": theme.INK}, **place,
            )  # fmt: skip


def _spread(ends: Sequence[tuple[float, str]], axes: Axes) -> list[tuple[float, str]]:
    """Names near their lines' ends, pushed apart so that they do not overprint."""
    step = (axes.y_range[1] - axes.y_range[0]) * 14.5 / _ONLY_HEIGHT
    placed: list[tuple[float, str]] = []
    for level, name in sorted(end for end in ends if math.isfinite(end[0]) and end[0] <= axes.y_range[1]):
        placed.append((max(level, placed[-1][0] + step) if placed else level, name))
    return placed


def _scale_axes(figure: Any, panels: Sequence[Panel], axes: Axes, rows: int) -> None:
    x: dict[str, Any] = {"range": list(axes.x_range)}
    y: dict[str, Any] = {"range": list(axes.y_range)}
    if axes.log_x:
        x = theme.decades(*axes.x_range)
    if axes.log_y:
        y = theme.decades(*axes.y_range)
    figure.update_xaxes(**x)
    figure.update_yaxes(**y)
    for panel in panels:
        place = {"row": panel.row, "col": panel.column}
        bottom = panel.main or (not panels[0].main and panel.row == rows)
        figure.update_xaxes(
            title_text=axes.x_text if bottom else None, matches="x" if panel is not panels[0] else None, **place
        )
        if not panel.main:
            figure.update_yaxes(showticklabels=panel.column == 1, **place)
    small = [panel for panel in panels if not panel.main]
    for panel in small[1:]:
        reference = figure.get_subplot(small[0].row, small[0].column).yaxis.plotly_name
        figure.update_yaxes(matches=reference.replace("axis", ""), row=panel.row, col=panel.column)
    if rows == 1 and panels[0].main and len(panels[0].names) > 1:
        figure.update_layout(margin={"r": 125})


def _limits(figure: Any, panel: Panel, curves: Labelled, axes: Axes, *, named: bool) -> None:
    """Limits as thin lines with their names on them; one outside the view is named at its edge."""
    import plotly.graph_objects as go

    place = {"row": panel.row, "col": panel.column}
    hidden = []
    for text, value in dict.fromkeys(limit for _, curve in curves for limit in curve.limits):
        level = value * axes.y_factor
        words = f"{theme.plain(text)} {units.join(units.number(level), axes.y_unit)}"
        if not axes.y_range[0] <= level <= axes.y_range[1]:
            hidden.append(words)
            continue
        line = {"color": theme.LIMIT, "width": 1.2, "dash": "1.5px,2px"}
        ends = {"x": list(axes.x_range), "y": [level, level]}
        figure.add_trace(go.Scatter(**ends, mode="lines", line=line, showlegend=False, hoverinfo="skip"), **place)
        if named:
            figure.add_annotation(
                xref="x domain", x=1.0, y=math.log10(level) if axes.log_y else level, text=words, showarrow=False,
                xanchor="right", yanchor="bottom", yshift=-2, font={"size": 12, "color": theme.LIMIT}, **place,
            )  # fmt: skip
    if hidden and (panel.main or panel.row == panel.column == 1):
        figure.add_annotation(
            xref="x domain", yref="y domain", x=1.0, y=1.0, text="outside the view: " + ", ".join(hidden), showarrow=False,
            xanchor="right", yanchor="bottom", font={"size": 12, "color": theme.LIMIT}, **place,
        )  # fmt: skip


def _panel_title(figure: Any, panel: Panel, axes: Axes, *, many: bool) -> None:
    """The unit (and the line's name where there are several panels) above the panel's upper left corner."""
    words = [theme.plain(units.axis_name(panel.names[0]))] if many else []
    if axes.y_unit:
        words.append(f"[{axes.y_unit}]")
    figure.add_annotation(
        xref="x domain", yref="y domain", x=0, y=1, xanchor="left", yanchor="bottom", yshift=1, showarrow=False,
        text=f"<b>{words[0]}</b> {' '.join(words[1:])}" if many else " ".join(words),
        font={"size": 13, "color": theme.INK}, row=panel.row, col=panel.column,
    )  # fmt: skip


def _note(figure: Any, text: str) -> None:
    figure.add_annotation(
        xref="paper", yref="paper", x=1, y=0, xanchor="right", yanchor="top", yshift=-30, text=text, showarrow=False,
        font={"size": 11, "color": theme.MUTED},
    )  # fmt: skip
