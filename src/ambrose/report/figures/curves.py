"""Curves as plotly figures: operating points or models overlaid, one small panel per axis where
there are several.

Figures convert from SI to the units of the page; they are never downsampled, and a view that hides
part of the data says so.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, invalid
from ambrose.judge.checks import Curve
from ambrose.report import theme, units
from ambrose.report.figures.axes import (
    Axes,
    amount,
    axes_of,
    beyond,
    draw_limits,
    drawn,
    is_map,
    limit_levels,
    set_ranges,
)
from ambrose.report.figures.poles import pole_figure

Labelled = Sequence[tuple[str, Curve]]

_ENVELOPE = re.compile(r"max|worst|sigma|σ|envelope|largest|all axes", re.IGNORECASE)
_KINDS = ("frequency", "speed", "time", "poles")
_MOST_PANELS = 8  # of a figure
_MOST_NAMES = 16  # beside the ends of the lines of one panel
_AGREEMENT = 0.05  # the legend says up to where an overlaid model stays this close to the reference
# [px]
_MAIN_HEIGHT = 280
_ONLY_HEIGHT = 320
_SMALL_HEIGHT = 140
_GAP = 68


@dataclass(frozen=True, slots=True)
class Panel:
    """One plot area: its lines by name, its place in the grid."""

    names: tuple[str, ...]
    row: int
    column: int
    main: bool


def figure(
    curves: Sequence[tuple[str, Curve]], *, order: Sequence[str] = (), overlay: bool = False
) -> Any:
    """One figure of the same curve at several operating points (or of several models).

    curves: (label, Curve) pairs, all of one kind and one unit. order: the labels in the order that
    fixes their colours, the same for every figure of a report (default: as they come). overlay:
    compare models, the first label is the reference drawn broad and pale. Several lines per curve
    become small panels; a line named "max..." or "worst..." gets the large one. Returns a plotly
    Figure. Raises InvalidInput.
    """
    _check_curves(curves)
    labels = [*order, *(label for label, _ in curves)]
    style = theme.overlay_styles(labels) if overlay else theme.styles(labels)
    return (
        pole_figure(curves, style)
        if curves[0][1].kind == "poles"
        else line_figure(curves, style, overlay=overlay)
    )


def _check_curves(curves: Sequence[tuple[str, Curve]]) -> None:
    if not curves:
        raise InvalidInput(
            "a figure was asked for without curves; give at least one (label, Curve)"
        )
    first = curves[0][1]
    if first.kind not in _KINDS:
        raise invalid(
            f"the kind of curve {first.name}",
            repr(first.kind),
            f"one of {', '.join(_KINDS)}",
            "set Curve.kind",
        )
    for label, curve in curves:
        where = f"curve {curve.name} at {label}"
        if (curve.kind, curve.x_unit, curve.y_unit) != (first.kind, first.x_unit, first.y_unit):
            form = f"{curve.kind} in {curve.y_unit or '-'} over {curve.x_unit}"
            wanted = f"{first.kind} in {first.y_unit or '-'} over {first.x_unit} like the first one"
            raise invalid(where, form, wanted, "put different quantities into different figures")
        shape = (len(curve.labels), len(curve.x))
        if np.shape(curve.y) != shape or np.iscomplexobj(curve.y):
            form = (
                f"of shape {np.shape(curve.y)}{' and complex' if np.iscomplexobj(curve.y) else ''}"
            )
            raise invalid(
                f"y of {where}",
                form,
                f"real, of shape {shape} (lines, points)",
                "give magnitudes, one row per label",
            )


def line_figure(
    curves: Labelled, style: Mapping[str, theme.Style], *, overlay: bool = False
) -> Any:
    """A figure of curves of kind "frequency", "speed" or "time"; all of one kind and unit (see
    figure).
    """
    panels, specs, heights = _arrange(curves)
    axes = axes_of(curves, overlay=overlay)
    total = sum(heights) + _GAP * (len(heights) - 1)
    figure = theme.subplots(
        rows=len(heights),
        cols=len(specs[0]),
        specs=specs,
        row_heights=[h / sum(heights) for h in heights],
        horizontal_spacing=0.042 if len(specs[0]) > 2 else 0.06,
        vertical_spacing=_GAP / total,
    )
    several = len(dict.fromkeys(label for label, _ in curves)) > 1
    # a legend of one label is there for the peak, which tells nothing of lines that have names
    legend = several or (_peaked(curves[0][1]) and not _crowded(panels[0], axes))
    for panel in panels:
        _draw(figure, panel, curves, axes, style, first=panel is panels[0], overlay=overlay)
    theme.dress(figure, total, legend=legend)
    _scale_axes(figure, panels, axes, len(heights))
    levels = limit_levels(curves, axes)
    for panel in panels:
        size = (860, _MAIN_HEIGHT) if panel.main else (410, _SMALL_HEIGHT)
        named = panel.main or not panels[0].main
        draw_limits(
            figure, {"row": panel.row, "col": panel.column}, levels, axes, size=size, named=named
        )
        _panel_title(figure, panel, axes, many=len(panels) > 1)
    _beyond(figure, curves, axes)
    return figure


def _arrange(curves: Labelled) -> tuple[list[Panel], list[list[Any]], list[int]]:
    """Which lines share a panel, the grid for make_subplots, and the heights of its rows [px]."""
    names = list(dict.fromkeys(name for _, curve in curves for name in curve.labels))
    together = is_map(curves[0][1]) or len(names) == 1 or len(names) > _MOST_PANELS
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


def _draw(
    figure: Any,
    panel: Panel,
    curves: Labelled,
    axes: Axes,
    style: Mapping[str, theme.Style],
    *,
    first: bool,
    overlay: bool,
) -> None:
    place = {"row": panel.row, "col": panel.column}
    in_legend: set[str] = set()
    for label, curve in curves:
        look = style[label]
        x = curve.x * axes.x_factor
        for name, values in zip(curve.labels, curve.y, strict=True):
            if name not in panel.names:
                continue
            y = values * axes.y_factor
            words = f"{theme.plain(label)}<br>{theme.plain(units.axis_name(name))}"
            hover = f"{words}<br>%{{x:.4g}} · %{{y:.4g}} {axes.y_unit}<extra></extra>"
            theme.scatter(
                figure,
                place,
                drawn(x),
                drawn(y),
                label,
                shown=first and label not in in_legend,
                hovertemplate=hover,
                name=theme.plain(label) + _legend_text(panel, label, curves, axes, overlay=overlay),
                line={
                    "color": look.colour,
                    "dash": _dash(name, look, curve),
                    "width": look.width if panel.main else 1.4,
                },
            )
            in_legend.add(label)
            if panel.main and len(panel.names) == 1 and _peaked(curve) and not overlay:
                mark_peak(figure, place, x, y, look)
    if is_map(curves[0][1]):
        _map_furniture(figure, panel, axes)
    if _crowded(panel, axes):
        _name_ends(figure, panel, curves[0][1], axes)


def _dash(name: str, look: theme.Style, curve: Curve) -> str:
    """Of modes over speed the dash tells backward from forward whirl, elsewhere it tells operating
    points apart.
    """
    if curve.kind == "speed" and len(curve.labels) > 1:
        return "6px,3px" if "backward" in name.lower() else "solid"
    return look.dash


def _peaked(curve: Curve) -> bool:
    return curve.kind in {"frequency", "speed"} and curve.y_unit not in {"rad", "rad/s"}


def _legend_text(panel: Panel, label: str, curves: Labelled, axes: Axes, *, overlay: bool) -> str:
    """What the legend adds to the label: the peak, or how far an overlaid model agrees with the
    reference.
    """
    curve = next(curve for other, curve in curves if other == label)
    rows = [
        row
        for name, row in zip(curve.labels, curve.y, strict=True)
        if name in panel.names or not panel.main
    ]
    if not overlay:
        return _peak_text(np.array(rows), curve, axes)
    reference = curves[0][1]
    if label == curves[0][0] or curve.kind != "frequency" or curve.labels != reference.labels:
        return ""
    if not np.array_equal(curve.x, reference.x):
        return ""
    near = np.abs(curve.y - reference.y) <= _AGREEMENT * np.abs(reference.y)
    apart = np.flatnonzero(~near.all(axis=0))
    if not apart.size:
        return f" · within {_AGREEMENT:.0%} everywhere"
    return f" · within {_AGREEMENT:.0%} up to {units.quantity(float(curve.x[apart[0]]), 'rad/s')}"


def _peak_text(rows: np.ndarray, curve: Curve, axes: Axes) -> str:
    """For the legend: where and how high the peak of these lines (k, n) is; nothing where they
    start highest.
    """
    if is_map(curve) or curve.y_unit == "rad" or not np.isfinite(rows).any():
        return ""
    size = np.where(np.isfinite(rows), np.abs(rows), -1.0).max(axis=0)
    largest = int(size.argmax())
    text = amount(float(size[largest]) * axes.y_factor, axes)
    if curve.kind == "time":
        return f" · largest {text}"
    if largest == 0 < len(size) - 1:
        return ""
    where = units.join(
        units.number(float(curve.x[largest]) * axes.x_factor),
        "rpm" if curve.kind == "speed" else "Hz",
    )
    return f" · {'peak' if largest < len(size) - 1 else 'up to'} {text} at {where}"


def mark_peak(
    figure: Any, place: dict[str, int], x: np.ndarray, y: np.ndarray, look: theme.Style
) -> None:
    """A circle at the maximum of a line, unless it lies at one of its ends; x, y (n,) in shown
    units.
    """
    if not np.isfinite(y).any():
        return
    i = int(np.nanargmax(y))
    if i in {0, len(y) - 1}:
        return
    marker = {"color": "white", "size": 7, "line": {"color": look.colour, "width": 1.6}}
    theme.scatter(figure, place, [x[i]], [y[i]], mode="markers", marker=marker, hoverinfo="skip")


def _map_furniture(figure: Any, panel: Panel, axes: Axes) -> None:
    """On a map over speed: the synchronous line (frequency = speed)."""
    place = {"row": panel.row, "col": panel.column}
    high = min(axes.x_range[1] / 60, axes.y_range[1])
    low = min(axes.x_range[0] / 60, high)
    theme.guide(
        figure,
        place,
        [low * 60, high * 60],
        [low, high],
        color=theme.MUTED,
        width=1,
        dash="2px,3px",
    )
    theme.note(figure, place, "1× speed", high * 33, high * 0.55, "left", "top", xshift=5)


def _name_ends(figure: Any, panel: Panel, curve: Curve, axes: Axes) -> None:
    """The names of a panel's lines at their right ends."""
    ends = [
        (float(row[-1]) * axes.y_factor, name)
        for name, row in zip(curve.labels, curve.y, strict=True)
    ]
    for level, name in _spread(ends, axes):
        theme.note(
            figure,
            {"row": panel.row, "col": panel.column},
            theme.plain(units.axis_name(name)),
            1.0,
            level,
            "left",
            "auto",
            colour=theme.INK,
            xref="x domain",
            xshift=5,
        )


def _crowded(panel: Panel, axes: Axes) -> bool:
    """Whether one panel holds several lines that only their names tell apart."""
    return panel.main and 1 < len(panel.names) <= _MOST_NAMES and not axes.log_y


def _spread(ends: Sequence[tuple[float, str]], axes: Axes) -> list[tuple[float, str]]:
    """Names near their lines' ends, pushed apart so that they do not overprint."""
    step = (axes.y_range[1] - axes.y_range[0]) * 14.5 / _ONLY_HEIGHT
    placed: list[tuple[float, str]] = []
    for level, name in sorted(
        end for end in ends if math.isfinite(end[0]) and end[0] <= axes.y_range[1]
    ):
        placed.append((max(level, placed[-1][0] + step) if placed else level, name))
    return placed


def _scale_axes(figure: Any, panels: Sequence[Panel], axes: Axes, rows: int) -> None:
    set_ranges(figure, axes)
    for panel in panels:
        place = {"row": panel.row, "col": panel.column}
        bottom = panel.main or (not panels[0].main and panel.row == rows)
        figure.update_xaxes(
            title_text=axes.x_text if bottom else None,
            matches="x" if panel is not panels[0] else None,
            **place,
        )
        if not panel.main:
            figure.update_yaxes(showticklabels=panel.column == 1, **place)
    small = [panel for panel in panels if not panel.main]
    for panel in small[1:]:
        reference = figure.get_subplot(small[0].row, small[0].column).yaxis.plotly_name
        figure.update_yaxes(matches=reference.replace("axis", ""), row=panel.row, col=panel.column)
    if rows == 1 and panels[0].main and len(panels[0].names) > 1:
        figure.update_layout(margin={"r": 125})


def _beyond(figure: Any, curves: Labelled, axes: Axes) -> None:
    """One line, upper right, that names what lies outside the view."""
    words = beyond(curves, axes)
    if words:
        theme.note(
            figure, {}, theme.plain(words), 1, 1, "right", "bottom", xref="paper", yref="paper"
        )


def _panel_title(figure: Any, panel: Panel, axes: Axes, *, many: bool) -> None:
    """The unit (and the line's name where there are several panels) above the panel's upper left
    corner.
    """
    words = [theme.plain(units.axis_name(panel.names[0]))] if many else []
    if axes.y_unit:
        words.append(f"[{axes.y_unit}]")
    text = f"<b>{words[0]}</b> {' '.join(words[1:])}" if many else " ".join(words)
    theme.heading(figure, {"row": panel.row, "col": panel.column}, text, yshift=1)
