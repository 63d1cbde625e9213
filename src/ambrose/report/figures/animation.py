"""Play, pause and a slider of time below an animated figure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ambrose.report import theme


def add_controls(
    figure: Any,
    names: Sequence[str],
    labels: Sequence[str],
    frame_time: float,
    *,
    rounds: int = 1,
    below: float,
    left: float,
    margin: float,
    growth: float,
    active: int = 0,
) -> None:
    """Buttons and slider for the frames ``names`` of a figure, with their ``labels`` on the slider.

    frame_time [ms]; rounds: how often a click plays all frames. below [px]: from the plot to the
    buttons; left: share of the width before the slider. margin, growth [px]: below the plot, and
    what the figure grows by. active: place of the frame that is shown at first.
    """
    still = {"transition": {"duration": 0}, "mode": "immediate"}
    move = {"frame": {"duration": frame_time, "redraw": False}, **still}
    stop = {"frame": {"duration": 0, "redraw": False}, **still}
    buttons = [
        {"label": "▶ play", "method": "animate", "args": [list(names) * rounds, move]},
        {"label": "❚❚ pause", "method": "animate", "args": [[None], stop]},
    ]
    steps = [
        {"label": label, "method": "animate", "args": [[name], stop]}
        for name, label in zip(names, labels, strict=True)
    ]
    menu = {
        "type": "buttons",
        "direction": "left",
        "buttons": buttons,
        "showactive": False,
        "pad": {"t": below},
        "x": 0,
        "y": 0,
        "xanchor": "left",
        "yanchor": "top",
        "bgcolor": "white",
        "bordercolor": theme.MUTED,
        "font": {"size": 12},
    }
    bar = {
        "x": left,
        "len": 1 - left,
        "y": 0,
        "yanchor": "top",
        "pad": {"t": below - 10, "b": 0},
        "ticklen": 0,
        "minorticklen": 0,
        "currentvalue": {
            "prefix": "t = ",
            "font": {"size": 12, "color": theme.INK},
            "xanchor": "left",
        },
        "tickcolor": "white",
        "font": {"size": 11, "color": "rgba(0, 0, 0, 0)"},
        "active": active,
        "steps": steps,
    }
    figure.update_layout(
        updatemenus=[menu],
        sliders=[bar],
        margin={"b": margin},
        height=figure.layout.height + growth,
    )
