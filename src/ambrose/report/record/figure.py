"""A record at a glance: its signals over time, grouped by what they are, and the orbits where both
axes were measured.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ambrose.record.record import Record
from ambrose.report import theme, units
from ambrose.report.figures.axes import drawn
from ambrose.report.record.curves import thinned

_GROUPS = (  # what is shown, the first of them that the record holds
    ("Displacement", ("y", "q")),
    ("Current", ("u", "i")),
    ("Magnet force", ("f_magnet",)),
    ("Excitation", ("e", "r", "d")),
    ("Applied force", ("f",)),
    ("Rotor speed", ("speed",)),
    ("Seal pressure", ("p",)),
)
_SIDES = {"zeta": "eta", "x": "y"}
# [px]
_ROW = 130
_ORBIT = 230
_GAP = 62
_MOST_ORBITS, _MOST_LINES = 4, 8
_ORBIT_POINTS = 4000


def record_figure(record: Record) -> Any:
    """Displacements, currents and what was driven over time, thinned without losing a peak;
    beneath, one orbit per station.
    """
    groups = _grouped(record)
    orbits = _orbits(groups[0][1]) if groups and groups[0][0] == "Displacement" else []
    columns = max(len(orbits), 1)
    specs: list[list[Any]] = [[{"colspan": columns}, *[None] * (columns - 1)] for _ in groups]
    heights = [_ROW] * len(groups)
    if orbits:
        specs.append([{} for _ in orbits])
        heights.append(_ORBIT)
    total = sum(heights) + _GAP * (len(heights) - 1)
    figure = theme.subplots(
        rows=len(heights),
        cols=columns,
        specs=specs,
        row_heights=[height / sum(heights) for height in heights],
        vertical_spacing=_GAP / total,
        horizontal_spacing=0.08,
    )
    axes = list(dict.fromkeys(_axis(name) for _, names in groups for name in names))
    style = theme.styles(axes)
    seconds, second = units.seconds_or_milliseconds(float(record.time[-1] - record.time[0]))
    named: set[str] = set()
    for row, (title, names) in enumerate(groups, 1):
        _signals(figure, record, row, title, names, style, seconds, named)
    for column, (station, pair) in enumerate(orbits, 1):
        _orbit(figure, record, len(heights), column, station, pair)
    theme.dress(figure, total, legend=len(named) > 1)
    for row in range(1, len(groups) + 1):
        last = row == len(groups)
        figure.update_xaxes(
            matches="x" if row > 1 else None,
            showticklabels=last,
            title_text=f"Time [{second}]" if last else None,
            range=[float(record.time[0]) * seconds, float(record.time[-1]) * seconds],
            row=row,
            col=1,
        )
    _square(figure, len(heights), len(orbits))
    return figure


def _grouped(record: Record) -> list[tuple[str, list[str]]]:
    """(title, signals) of every group that the record holds; constant ones are left out where
    others move.
    """
    groups = []
    for title, kinds in _GROUPS:
        chosen = next(
            (names for kind in kinds if (names := [n for n in record.signals if _kind(n) == kind])),
            [],
        )
        moving = [name for name in chosen if np.ptp(record[name]) > 0]
        if title in {"Displacement", "Current"}:
            moving = chosen
        if moving:
            groups.append((title, moving[:_MOST_LINES]))
    return groups or [("Signals", list(record.signals[:_MOST_LINES]))]


def _kind(name: str) -> str:
    return "f_magnet" if name.startswith("f_magnet_") else name.partition("_")[0]


def _axis(name: str) -> str:
    """The place of a signal: "y_A_zeta" -> "A_zeta"."""
    return name.removeprefix(f"{_kind(name)}_")


def _signals(
    figure: Any,
    record: Record,
    row: int,
    title: str,
    names: list[str],
    style: dict[str, theme.Style],
    seconds: float,
    named: set[str],
) -> None:
    unit = record.units[record.signals.index(names[0])]
    time, values = thinned(record.time, record.select(names).values)
    factor, shown = units.scale(unit, float(np.abs(values).max()))
    for name, line in zip(names, values, strict=True):
        axis = _axis(name)
        look, label = style[axis], units.axis_name(axis)
        theme.scatter(
            figure,
            {"row": row, "col": 1},
            drawn(time * seconds),
            drawn(line * factor),
            label,
            shown=label not in named,
            line={"color": look.colour, "dash": look.dash, "width": 1.4},
            hovertemplate=f"{theme.plain(units.axis_name(name))}<br>%{{x:.4g}} · %{{y:.4g}} "
            f"{shown}<extra></extra>",
        )
        named.add(label)
    theme.heading(figure, {"row": row, "col": 1}, f"<b>{title}</b> [{shown}]")


def _orbits(names: list[str]) -> list[tuple[str, tuple[str, str]]]:
    """(station, its two signals) of every station whose displacement is known in two directions."""
    pairs = []
    for name in names:
        head, _, side = name.rpartition("_")
        other = f"{head}_{_SIDES.get(side, '')}"
        if other in names:
            pairs.append((_axis(head), (name, other)))
    return pairs[:_MOST_ORBITS]


def _orbit(
    figure: Any, record: Record, row: int, column: int, station: str, pair: tuple[str, str]
) -> None:
    place = {"row": row, "col": column}
    x, y = record[pair[0]], record[pair[1]]
    step = max(1, len(x) // _ORBIT_POINTS)
    factor, unit = units.scale("m", float(max(np.abs(x).max(), np.abs(y).max())))
    theme.scatter(
        figure,
        place,
        drawn(x[::step] * factor),
        drawn(y[::step] * factor),
        line={"color": theme.INK, "width": 0.8},
        hovertemplate=f"%{{x:.4g}} · %{{y:.4g}} {unit}<extra></extra>",
    )
    first, second = (units.axis_name(name.rpartition("_")[2]) for name in pair)
    words = f"<b>{theme.plain(units.axis_name(station))}</b>, {second} over {first} [{unit}]"
    theme.heading(figure, place, words)


def _square(figure: Any, row: int, count: int) -> None:
    """Both directions of an orbit to one scale."""
    for column in range(1, count + 1):
        name = figure.get_subplot(row, column).xaxis.plotly_name.replace("axis", "")
        figure.update_xaxes(constrain="domain", nticks=5, row=row, col=column)
        figure.update_yaxes(constrain="domain", nticks=5, scaleanchor=name, row=row, col=column)
