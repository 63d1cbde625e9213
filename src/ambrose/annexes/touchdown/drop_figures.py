"""Pictures of drops: the orbit in slow motion, speeds and forces over time, the distribution."""

from __future__ import annotations

from typing import Any

import numpy as np

from ambrose.annexes.touchdown.analysis import Landing
from ambrose.annexes.touchdown.campaign import WHIRLS, Campaign
from ambrose.annexes.touchdown.thrust_face import AxialDrop
from ambrose.report import theme
from ambrose.report.figures.animation import add_controls

FRAMES = 160  # of the animation, at most
SHOWN = 0.12  # [s] after the first contact
_TRAIL = 40  # frames that stay visible
FRAME_TIME = 60  # [ms]
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7")


def slow_motion(result: Landing) -> Any:
    """The rotor's centre in every touchdown bearing against its clearance, with what it meets,
    which gives way: a figure with frames and a slider.
    """
    import plotly.graph_objects as go

    log, names = result.fall.log, result.fallen.names
    touched = result.fall.figures[:, 0]
    first = float(touched[touched >= 0].min()) if (touched >= 0).any() else 0.0
    window = np.flatnonzero((log[:, 0] >= 0.6 * first) & (log[:, 0] <= first + SHOWN))
    moments = window[np.unique(np.linspace(0, len(window) - 1, FRAMES).astype(int))]
    figure = theme.subplots(rows=1, cols=len(names), horizontal_spacing=0.12)
    turn = np.linspace(0, 2 * np.pi, 61)
    gap = max(bearing.clearance for bearing in result.fallen.bearings)
    deep = np.hypot(log[window, 2::8], log[window, 3::8]).max() if len(window) else gap
    reach = 1.12e6 * max(gap, float(deep))
    moving: list[int] = []
    for k, name in enumerate(names):
        place = {"row": 1, "col": k + 1}
        circle = 1e6 * result.fallen.bearings[k].clearance
        theme.guide(
            figure,
            place,
            np.float32(circle * np.cos(turn)),
            np.float32(circle * np.sin(turn)),
            color=theme.FAINT,
            width=1,
        )
        for style in ({"color": theme.LIMIT, "width": 1.6}, {"color": _COLOURS[0], "width": 1.4}):
            moving.append(len(figure.data))
            theme.scatter(figure, place, [], [], mode="lines", line=style, hoverinfo="skip")
        moving.append(len(figure.data))
        theme.scatter(
            figure,
            place,
            [],
            [],
            mode="markers",
            marker={"size": 9, "color": theme.INK},
            hoverinfo="skip",
        )
        theme.heading(figure, place, theme.plain(name))
        figure.update_xaxes(range=[-reach, reach], title_text="x [um]", **place)
        figure.update_yaxes(
            range=[-reach, reach],
            scaleanchor=f"x{k + 1 if k else ''}",
            title_text="y [um]",
            **place,
        )

    def shown(i: int) -> list[Any]:
        """The moving lines at the moment i."""
        found = []
        for k in range(len(names)):
            at = 2 + 8 * k
            x, y = 1e6 * log[moments, at], 1e6 * log[moments, at + 1]
            met = 1e6 * log[moments[i], at + 4 : at + 6]
            circle = 1e6 * result.fallen.bearings[k].clearance
            part = slice(max(i - _TRAIL, 0), i + 1)
            found += [
                go.Scatter(
                    x=np.float32(met[0] + circle * np.cos(turn)),
                    y=np.float32(met[1] + circle * np.sin(turn)),
                ),
                go.Scatter(x=np.float32(x[part]), y=np.float32(y[part])),
                go.Scatter(x=[float(np.float32(x[i]))], y=[float(np.float32(y[i]))]),
            ]
        return found

    if len(moments):
        last = shown(len(moments) - 1)
        for index, trace in zip(moving, last, strict=True):
            figure.data[index].update(x=trace.x, y=trace.y)
    labels = [f"{i}" for i in range(len(moments))]
    figure.frames = [
        go.Frame(name=label, traces=moving, data=shown(i)) for i, label in enumerate(labels)
    ]
    theme.dress(figure, 330, legend=False)
    add_controls(
        figure,
        labels,
        [f"{1e3 * t:.1f} ms" for t in log[moments, 0]],
        FRAME_TIME,
        below=44,
        left=0.24,
        margin=112,
        growth=64,
        active=len(labels) - 1,
    )
    return figure


def history_figure(result: Landing) -> Any:
    """Contact forces, and speeds of races and rotor, over the drop."""
    log, names = result.fall.log, result.fallen.names
    figure = theme.subplots(rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.1)
    looks = theme.styles(names)
    for k, name in enumerate(names):
        for row, column, scale in ((1, 4 + 8 * k, 1e-3), (2, 5 + 8 * k, 30 / np.pi)):
            if row == 2 and not result.fallen.bearings[k].race_mass:
                continue
            x, y = _coarse(log[:, 0], log[:, column] * scale)
            theme.scatter(
                figure,
                {"row": row, "col": 1},
                np.float32(1e3 * x),
                np.float32(y),
                name,
                shown=row == 1,
                mode="lines",
                line={**looks[name].line, "width": 1.2},
                hovertemplate="%{x:.4g} ms: %{y:.4g}<extra></extra>",
            )
    x, y = _coarse(log[:, 0], log[:, 1] * 30 / np.pi)
    theme.scatter(
        figure,
        {"row": 2, "col": 1},
        np.float32(1e3 * x),
        np.float32(y),
        "rotor",
        shown=True,
        mode="lines",
        line={"color": theme.INK, "width": 1.4, "dash": "dash"},
        hovertemplate="%{x:.4g} ms: %{y:.4g} rpm<extra></extra>",
    )
    theme.dress(figure, 400, legend=True)
    figure.update_yaxes(title_text="Contact force [kN]", row=1, col=1)
    figure.update_yaxes(title_text="Speed [rpm]", rangemode="tozero", row=2, col=1)
    figure.update_xaxes(title_text="Time after the loss of power [ms]", row=2, col=1)
    return figure


def axial_figure(drop: AxialDrop) -> Any:
    """Place of the collar between stop and magnet, and the stop's force, until it rests."""
    figure = theme.subplots(rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.1)
    end = drop.time[-1] if drop.settled is None else 1.3 * drop.settled
    window = drop.time <= end
    time, sign = 1e3 * drop.time[window], 1.0 if drop.thrust > 0 else -1.0
    for row, values, unit in ((1, 1e6 * drop.place, "um"), (2, 1e-3 * drop.force, "kN")):
        theme.scatter(
            figure,
            {"row": row, "col": 1},
            np.float32(time),
            np.float32(values[window]),
            mode="lines",
            line={"color": _COLOURS[0], "width": 1.4},
            hovertemplate=f"%{{x:.4g}} ms: %{{y:.4g}} {unit}<extra></extra>",
        )
    ends = [0.0, float(time[-1])]
    for words, at, style in (
        ("stop", drop.way, {"color": theme.MUTED, "width": 1.4, "dash": "dash"}),
        ("magnet", drop.gap, {"color": theme.LIMIT, "width": 1.6}),
    ):
        theme.scatter(
            figure,
            {"row": 1, "col": 1},
            np.array(ends, np.float32),
            np.full(2, 1e6 * sign * at, np.float32),
            words,
            shown=True,
            mode="lines",
            line=style,
            hoverinfo="skip",
        )
    theme.dress(figure, 360, legend=True)
    figure.update_yaxes(title_text="Place along the shaft [um]", row=1, col=1)
    figure.update_yaxes(title_text="Force of the stop [kN]", rangemode="tozero", row=2, col=1)
    figure.update_xaxes(title_text="Time after the loss of power [ms]", row=2, col=1)
    return figure


def _coarse(x: np.ndarray, y: np.ndarray, most: int = 1500) -> tuple[np.ndarray, np.ndarray]:
    """At most so many points, the largest value of each stretch among them."""
    if len(x) <= most:
        return x, y
    width = -(-len(x) // most)
    count = len(x) // width
    chosen = y[: count * width].reshape(count, width).argmax(axis=1) + width * np.arange(count)
    return x[chosen], y[chosen]


def distribution_figure(campaign: Campaign, names: tuple[str, ...]) -> Any:
    """How many drops have at most a force, by bearing; and turns against the spin over friction."""
    figure = theme.subplots(rows=1, cols=2, horizontal_spacing=0.14)
    looks = theme.styles(names)
    share = np.linspace(0, 1, 201)
    for k, name in enumerate(names):
        force = np.quantile(campaign.force[:, k], share) / 1e3
        theme.scatter(
            figure,
            {"row": 1, "col": 1},
            np.float32(force),
            np.float32(100 * share),
            name,
            shown=True,
            mode="lines",
            line=looks[name].line,
            hovertemplate="%{x:.4g} kN: %{y:.3g} %<extra></extra>",
        )
    figure.update_xaxes(title_text="Largest force [kN]", rangemode="tozero", row=1, col=1)
    figure.update_yaxes(title_text="Drops with at most that [%]", row=1, col=1)
    few = slice(0, 1500)
    turns, whirls = campaign.turns[few], campaign.whirls[few]
    for chosen, colour, words in (
        (~whirls, theme.MUTED, "no whirl"),
        (whirls, "#d55e00", "whirls"),
    ):
        theme.scatter(
            figure,
            {"row": 1, "col": 2},
            np.float32(campaign.cases[few][chosen, 0]),
            np.float32(np.maximum(turns[chosen], 0.1)),
            words,
            shown=True,
            mode="markers",
            marker={"size": 3, "color": colour, "opacity": 0.6},
            hovertemplate="friction factor %{x:.3g}: %{y:.3g} turns<extra></extra>",
        )
    theme.guide(
        figure, {"row": 1, "col": 2}, [0.5, 1.5], [WHIRLS] * 2, color=theme.INK, width=1, dash="dot"
    )
    top = max(2 * WHIRLS, float(turns.max()))
    figure.update_xaxes(title_text="Friction over the file's", row=1, col=2)
    figure.update_yaxes(
        title_text="Turns against the spin", row=1, col=2, **theme.decades(0.1, 1.1 * top)
    )
    theme.dress(figure, 300, legend=True)
    return figure
