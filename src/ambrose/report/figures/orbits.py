"""Orbits: the paths of the shaft's centre in the bearings and at the other known places, with the
touchdown circles.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from ambrose.record.record import Record
from ambrose.report import theme, units
from ambrose.report.figures.axes import drawn
from ambrose.report.figures.stations import NEAR, Station, largest, window

_CLOUD, _LINE = 2500, 900  # points
_SECTORS = 72  # directions whose farthest point is kept
_MOST, _PER_ROW = 8, 4
_SIDE, _GAP = 225, 58  # [px]
_ALL = "#c3ccd4"
_PEAK = "#d55e00"
_END = "#0072b2"


def orbit_figure(record: Record, places: Sequence[Station], speed: np.ndarray) -> Any:
    """One panel per station, all to one scale: all samples as a pale cloud, the largest motion, the
    end of the record.

    places: from stations.stations. speed (k,) [rad/s]. Returns a plotly Figure.
    """
    shown = tuple(places)[:_MOST]
    columns = len(shown) if len(shown) in {3, 5} else min(_PER_ROW, max(len(shown), 3))
    rows = math.ceil(len(shown) / columns)
    reach = 1.08 * max(float(station.radius.max()) for station in shown) or 1e-6
    gaps = [station.gap for station in shown if station.gap is not None]
    if gaps and min(gaps) <= NEAR * reach:
        reach = max(reach, 1.08 * min(gaps))
    factor, unit = units.scale("m", reach)
    total = rows * _SIDE + (rows - 1) * _GAP
    figure = theme.subplots(
        rows=rows,
        cols=columns,
        horizontal_spacing=0.05,
        vertical_spacing=_GAP / total if rows > 1 else 0.0,
    )
    centre = largest(shown)[1]
    peak, last = window(record, shown, speed, centre), window(record, shown, speed, len(speed) - 1)
    spans = [(_span(record, "largest", peak), _PEAK, peak)]
    if last.start > (peak.start + peak.stop) / 2:
        spans.append((_span(record, "end", last), _END, last))
    for i, station in enumerate(shown):
        place = {"row": i // columns + 1, "col": i % columns + 1}
        _panel(figure, station, place, spans, factor, unit, reach, first=i == 0)
    theme.dress(figure, total, legend=True)
    figure.update_layout(legend={"itemsizing": "constant"})
    bound = reach * factor
    figure.update_xaxes(range=[-bound, bound], constrain="domain", nticks=5)
    figure.update_yaxes(range=[-bound, bound], constrain="domain", nticks=5)
    for i in range(len(shown)):
        x = figure.get_subplot(i // columns + 1, i % columns + 1).xaxis.plotly_name.replace(
            "axis", ""
        )
        figure.update_yaxes(scaleanchor=x, row=i // columns + 1, col=i % columns + 1)
    return figure


def _span(record: Record, word: str, part: slice) -> str:
    time = record.time[part]
    factor, unit = units.seconds_or_milliseconds(float(record.time[-1] - record.time[0]))
    return (
        f"{word}: {units.number(time[0] * factor, 4)} to {units.number(time[-1] * factor, 4)} "
        f"{unit}"
    )


def _panel(
    figure: Any,
    station: Station,
    place: dict[str, int],
    spans: Sequence[tuple[str, str, slice]],
    factor: float,
    unit: str,
    reach: float,
    *,
    first: bool,
) -> None:
    def add(x: np.ndarray, y: np.ndarray, name: str, **look: Any) -> None:
        hover = f"x %{{x:.4g}} · y %{{y:.4g}} {unit}<extra>{name}</extra>"
        theme.scatter(
            figure, place, drawn(x), drawn(y), name, shown=first, hovertemplate=hover, **look
        )

    if station.bearing:
        _own_axes(figure, station, place, reach * factor)
    kept = _cloud(station)
    add(
        station.x[kept] * factor,
        station.y[kept] * factor,
        "all",
        mode="markers",
        marker={"size": 2.5, "color": _ALL},
    )
    for name, colour, part in spans:
        step = max(1, (part.stop - part.start) // _LINE)
        x, y = (row[part][::step] * factor for row in (station.x, station.y))
        add(x, y, name, line={"color": colour, "width": 1.6})
    words = f"{units.number(float(station.radius.max()) * factor)} {unit}"
    if station.gap is not None:
        if station.gap <= reach:
            turn = np.linspace(0, 2 * np.pi, 181)
            line = {"color": theme.LIMIT, "width": 1.4, "dash": "1.5px,2px"}
            circle = station.gap * factor * np.array([np.cos(turn), np.sin(turn)])
            add(circle[0], circle[1], "touchdown circle", line=line)
        share = float(station.radius.max()) / station.gap
        words += f" · {percent(share)} of gap"
    theme.heading(figure, place, f"<b>{station.title}</b> [{unit}]<br>{words}", 12, align="left")


def percent(share: float) -> str:
    """A share as text, with a decimal where it is small."""
    return f"{share:.0%}" if share >= 0.1 else f"{share:.1%}"


def _own_axes(figure: Any, station: Station, place: dict[str, int], bound: float) -> None:
    """The actuator axes as faint lines through the centre, named at their ends."""
    for i, name in enumerate("ζη"):
        angle = station.angle + i * np.pi / 2
        end = (
            np.array([np.cos(angle), np.sin(angle)])
            * bound
            / max(abs(np.cos(angle)), abs(np.sin(angle)))
        )
        theme.guide(
            figure, place, [-end[0], end[0]], [-end[1], end[1]], color=theme.FAINT, width=1.2
        )
        figure.add_annotation(
            x=0.9 * end[0],
            y=0.9 * end[1],
            text=name,
            showarrow=False,
            font={"size": 12, "color": theme.MUTED},
            xshift=(-9, 9)[i] * np.sin(angle),
            yshift=(9, -9)[i] * np.cos(angle),
            **place,
        )


def _cloud(station: Station) -> np.ndarray:
    """Numbers of the samples drawn as a cloud: spread over the record, and the farthest in every
    direction.
    """
    k = len(station.x)
    if k <= _CLOUD:
        return np.arange(k)
    spread = np.unique(
        (np.arange(_CLOUD) + np.modf(np.arange(_CLOUD) * 0.6180339887)[0]) * k / _CLOUD
    ).astype(int)
    sector = ((np.arctan2(station.y, station.x) / (2 * np.pi) + 0.5) * _SECTORS).astype(
        int
    ) % _SECTORS
    order = np.lexsort((station.radius, sector))
    far = order[np.flatnonzero(np.diff(sector[order], append=-1))]
    return np.unique(np.concatenate([np.clip(spread, 0, k - 1), far]))
