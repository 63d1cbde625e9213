"""The rotor in motion: its axis through the known stations, seen obliquely, over three revolutions
around the largest motion.

Along the page runs the shaft; at every station x points towards the reader and y upwards, both
magnified alike. Light: one frame is the axis and its dots, a few numbers; the page's drawing
library plays them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ambrose.machine.machine import Machine
from ambrose.record.record import Record
from ambrose.report import theme, units
from ambrose.report.figures.axes import drawn
from ambrose.report.figures.stations import NEAR, Station, largest, window

_FRAMES, _ROUNDS = 72, 12
_FRAME_TIME = 45  # [ms]
_SIZE = 0.10  # largest displacement on the page, in rotor lengths
_OBLIQUE = np.array([-0.42, -0.30])  # where x points on the page
_HEIGHT = 300  # [px]


def rotor_animation(
    record: Record, places: Sequence[Station], machine: Machine, speed: np.ndarray
) -> Any:
    """A plotly Figure with frames, and the buttons that play them; speed (k,) [rad/s]. places: from
    stations.stations.
    """
    import plotly.graph_objects as go

    ordered = sorted(places, key=lambda station: station.position)
    centre = largest(tuple(places))[1]
    part = window(record, tuple(places), speed, centre)
    magnified = (
        _SIZE
        * machine.length
        / max(1e-9, *(float(station.radius[part].max()) for station in ordered))
    )
    moments = np.unique(np.linspace(part.start, part.stop - 1, _FRAMES).astype(int))
    paths = [_seen(station, part, magnified) for station in ordered]
    # (stations, 2, frames)
    axis = np.array([_seen(station, moments, magnified) for station in ordered])

    figure = go.Figure()
    _still(figure, ordered, paths, machine, magnified)
    names = [f"{i}" for i in range(len(moments))]
    moving = len(figure.data)
    line = {"color": theme.INK, "width": 2.5}
    marker = {
        "size": 9,
        "color": [_colour(s) for s in ordered],
        "line": {"color": "white", "width": 1},
    }
    theme.scatter(
        figure,
        {},
        drawn(axis[:, 0, 0]),
        drawn(axis[:, 1, 0]),
        mode="lines+markers",
        line=line,
        marker=marker,
        hoverinfo="skip",
    )
    figure.frames = [
        go.Frame(
            name=names[j],
            traces=[moving],
            data=[go.Scatter(x=drawn(axis[:, 0, j]), y=drawn(axis[:, 1, j]))],
        )
        for j in range(len(moments))
    ]
    theme.dress(figure, _HEIGHT, legend=False)
    reach = 1.25 * _SIZE * machine.length
    figure.update_xaxes(
        visible=False,
        range=[
            -1.6 * reach * abs(_OBLIQUE[0]) - 0.03 * machine.length,
            machine.length * 1.03 + reach * 0.6,
        ],
    )
    figure.update_yaxes(visible=False, range=[-1.7 * reach, 1.55 * reach], scaleanchor="x")
    _controls(figure, record, moments, names)
    words = f"displacements magnified {units.number(magnified, 2)} times against the shaft"
    theme.note(figure, {}, words, 0, 1, "left", "bottom", xref="paper", yref="paper")
    return figure


def _seen(station: Station, part: Any, magnified: float) -> np.ndarray:
    """Positions on the page (2, n) [m]."""
    x, y = station.x[part] * magnified, station.y[part] * magnified
    return np.array([station.position + _OBLIQUE[0] * x, _OBLIQUE[1] * x + y])


def _colour(station: Station) -> str:
    return "#0072b2" if station.bearing else theme.MUTED


def _still(
    figure: Any,
    ordered: Sequence[Station],
    paths: Sequence[np.ndarray],
    machine: Machine,
    magnified: float,
) -> None:
    """What does not move: the centre line, the orbits, the touchdown circles, the names."""
    theme.guide(
        figure,
        {},
        drawn([0, machine.length]),
        drawn([0, 0]),
        color=theme.MUTED,
        width=1,
        dash="12px,3px,3px,3px",
    )
    turn = np.linspace(0, 2 * np.pi, 121)
    for station, path in zip(ordered, paths, strict=True):
        step = max(1, path.shape[1] // 400)
        theme.guide(
            figure,
            {},
            drawn(path[0, ::step]),
            drawn(path[1, ::step]),
            color=_colour(station),
            width=1.1,
        )
        if station.gap is not None and station.gap * magnified <= NEAR * _SIZE * machine.length:
            x, y = station.gap * magnified * np.cos(turn), station.gap * magnified * np.sin(turn)
            circle = drawn([station.position + _OBLIQUE[0] * x, _OBLIQUE[1] * x + y])
            theme.guide(figure, {}, *circle, color=theme.LIMIT, width=1.2, dash="1.5px,2px")
        name, below = (
            theme.plain(units.axis_name(station.name)),
            -1.42 * 1.25 * _SIZE * machine.length,
        )
        theme.note(figure, {}, name, station.position, below, "auto", "top", colour=theme.INK)


def _controls(figure: Any, record: Record, moments: np.ndarray, names: list[str]) -> None:
    """Play, pause, and a slider of time."""
    move = {
        "frame": {"duration": _FRAME_TIME, "redraw": False},
        "transition": {"duration": 0},
        "mode": "immediate",
    }
    stop = {
        "frame": {"duration": 0, "redraw": False},
        "transition": {"duration": 0},
        "mode": "immediate",
    }
    buttons = [
        {"label": "▶ play", "method": "animate", "args": [names * _ROUNDS, move]},
        {"label": "❚❚ pause", "method": "animate", "args": [[None], stop]},
    ]
    figure.update_layout(
        updatemenus=[
            {
                "type": "buttons",
                "direction": "left",
                "buttons": buttons,
                "showactive": False,
                "pad": {"t": 14},
                "x": 0,
                "y": 0,
                "xanchor": "left",
                "yanchor": "top",
                "bgcolor": "white",
                "bordercolor": theme.MUTED,
                "font": {"size": 12},
            }
        ],
        sliders=[
            {
                "x": 0.2,
                "len": 0.8,
                "y": 0,
                "yanchor": "top",
                "pad": {"t": 4, "b": 0},
                "ticklen": 0,
                "minorticklen": 0,
                "currentvalue": {
                    "prefix": "t = ",
                    "font": {"size": 12, "color": theme.INK},
                    "xanchor": "left",
                },
                "tickcolor": "white",
                "font": {"size": 11, "color": "rgba(0, 0, 0, 0)"},
                "steps": [
                    {
                        "label": f"{record.time[m] * 1e3:.2f} ms",
                        "method": "animate",
                        "args": [[name], stop],
                    }
                    for m, name in zip(moments, names, strict=True)
                ],
            }
        ],
        margin={"b": 84},
        height=figure.layout.height + 36,
    )
