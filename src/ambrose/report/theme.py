"""The look that all figures share: one colour and one dash per operating point, quiet axes, no
frame, no grid noise.

The colours are Okabe & Ito's (Color Universal Design, 2008), told apart by colour-blind readers;
the dashes do the same in a black-and-white print.
"""

from __future__ import annotations

import html
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from ambrose.report.plain_figure import PlainFigure

_bare = ContextVar("bare", default=False)

INK = "#1c2329"
MUTED = "#66717b"
FAINT = "#e4e8eb"
LIMIT = "#a3341f"
FONT = "Helvetica Neue, Helvetica, Arial, Liberation Sans, sans-serif"

_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#000000", "#cc79a7", "#56b4e9", "#e69f00")
# Found by search: of any two, normal, protanopic and deuteranopic readers see more than twice what
# they told apart at least.
_CANDIDATES = (
    "#183078",
    "#606078",
    "#a8a800",
    "#601818",
    "#7878f0",
    "#906000",
    "#c090a8",
    "#4848c0",
)
_FAMILY = ("#cdbbdf", "#a98cc8", "#8259ae", "#5a2d8a", "#300a52")
_FAMILY_DASHES = ("2px,2px", "6px,3px", "solid", "10px,3px,2px,3px", "12px,3px")
_DASHES = ("solid", "7px,3px", "2px,2px", "10px,3px,2px,3px", "solid", "7px,3px", "2px,2px")
_SYMBOLS = (
    "x-thin",
    "circle-open",
    "triangle-up-open",
    "square-open",
    "diamond-open",
    "cross-thin",
    "star-open",
)


@dataclass(frozen=True, slots=True)
class Style:
    """How one operating point (or model) is drawn everywhere."""

    colour: str
    dash: str
    symbol: str
    width: float = 1.8

    @property
    def line(self) -> dict[str, Any]:
        """The line as plotly takes it."""
        return {"color": self.colour, "dash": self.dash, "width": self.width}


def styles(labels: Sequence[str]) -> dict[str, Style]:
    """One style per label, by the label's place in the list: the same list gives the same colours
    in every figure.
    """
    looks = itertools.cycle(zip(_COLOURS, _DASHES, _SYMBOLS, strict=True))
    return {label: Style(*look) for label, look in zip(dict.fromkeys(labels), looks, strict=False)}


def candidate_styles(labels: Sequence[str]) -> dict[str, Style]:
    """One style per controller where several are overlaid: other colours than those of the
    operating points, eight of them.
    """
    looks = itertools.cycle(
        zip(_CANDIDATES, itertools.cycle(_DASHES[:3]), itertools.cycle(_SYMBOLS), strict=False)
    )
    return {
        label: Style(*look, 1.9) for label, look in zip(dict.fromkeys(labels), looks, strict=False)
    }


def family_styles(labels: Sequence[str]) -> dict[str, Style]:
    """Styles of a family over a parameter, in its order: from pale to dark in one hue, every dash
    its own.
    """
    unique = list(dict.fromkeys(labels))
    last = max(len(unique) - 1, 1)
    return {
        label: Style(
            _FAMILY[round(i * (len(_FAMILY) - 1) / last)],
            _FAMILY_DASHES[i % len(_FAMILY_DASHES)],
            "x-thin",
            1.7,
        )
        for i, label in enumerate(unique)
    }


def overlay_styles(labels: Sequence[str]) -> dict[str, Style]:
    """For "is it the same?": the first label broad and pale, the others thin and dark on top of
    it.
    """
    thin = [(INK, "solid", "x-thin"), *zip(_COLOURS, _DASHES, _SYMBOLS, strict=True)]
    looks = [Style("#a9bccb", "solid", "circle-open", 5.0), *(Style(*look, 1.3) for look in thin)]
    return dict(zip(dict.fromkeys(labels), looks, strict=False))


def plain(text: str) -> str:
    """Text for a figure: plotly reads a little HTML, so nothing of the user's may pass for
    markup.
    """
    return html.escape(text, quote=False)


def dress(figure: Any, height: int, *, legend: bool, lines: int = 0) -> Any:
    """Give a figure the common look; ``height`` [px] of what lies inside the axes, ``lines`` of
    words above it but the first.

    Returns the same figure. Its meta tells the page the room [px] between legend and axes.
    """
    room = 24 + 16 * lines
    top = room + (28 if legend else 2)
    if not isinstance(figure, PlainFigure):
        figure.layout.template = _template()
    figure.update_layout(
        height=height + top + 48,
        margin={"l": 62, "r": 18, "t": top, "b": 48},
        meta={"room": room},
        separators=".\u202f",
        font={"family": FONT, "size": 13, "color": INK},
        paper_bgcolor="white",
        plot_bgcolor="white",
        showlegend=legend,
        hovermode="closest",
        hoverlabel={
            "bgcolor": "white",
            "bordercolor": MUTED,
            "font": {"family": FONT, "size": 12, "color": INK},
        },
        legend={
            "orientation": "h",
            "x": 0,
            "xanchor": "left",
            "y": 0.995,
            "yanchor": "top",
            "yref": "container",
            "font": {"size": 13},
            "itemwidth": 34,
            "traceorder": "normal",
        },
        dragmode="zoom",
    )
    return figure


@contextmanager
def bare() -> Iterator[None]:
    """Figures of one plot area that are made within are ``PlainFigure``: for who draws them without
    plotly, and at once.
    """
    token = _bare.set(True)
    try:
        yield
    finally:
        _bare.reset(token)


@cache
def _template() -> Any:
    """plotly's own template with our axes: once for all axes and figures, many times faster than
    one by one.
    """
    from plotly.graph_objects import Figure

    axis = {
        "showline": True,
        "linecolor": INK,
        "linewidth": 1,
        "ticks": "outside",
        "ticklen": 4,
        "tickcolor": INK,
        "gridcolor": FAINT,
        "gridwidth": 1,
        "zeroline": False,
        "automargin": True,
        "exponentformat": "none",
        "separatethousands": True,
        "title": {"font": {"size": 13, "color": INK}, "standoff": 6},
    }
    return (
        Figure(layout={"template": "plotly"})
        .update_layout(template={"layout": {"xaxis": axis, "yaxis": axis}})
        .layout.template
    )


def heading(
    figure: Any, place: Mapping[str, int], text: str, size: int = 13, **annotation: Any
) -> None:
    """Words (plotly's HTML) above the upper left corner of a plot area; place: {"row": ..., "col":
    ...}.
    """
    figure.add_annotation(
        xref="x domain",
        yref="y domain",
        x=0,
        y=1,
        xanchor="left",
        yanchor="bottom",
        showarrow=False,
        text=text,
        font={"size": size, "color": INK},
        **annotation,
        **place,
    )


def subplots(rows: int, cols: int, **options: Any) -> Any:
    """A figure with a grid of plots, as plotly's make_subplots."""
    if _bare.get() and rows == cols == 1:
        return PlainFigure()
    from plotly.subplots import make_subplots

    return make_subplots(rows=rows, cols=cols, **options)


def note(
    figure: Any,
    place: Mapping[str, int],
    text: str,
    x: Any,
    y: Any,
    xanchor: str,
    yanchor: str,
    *,
    colour: str = MUTED,
    **annotation: Any,
) -> None:
    """Small words (plotly's HTML) at a point, without an arrow."""
    figure.add_annotation(
        text=text,
        x=x,
        y=y,
        xanchor=xanchor,
        yanchor=yanchor,
        showarrow=False,
        font={"size": 12, "color": colour},
        **place,
        **annotation,
    )


def scatter(
    figure: Any,
    place: Mapping[str, int],
    x: Any,
    y: Any,
    label: str | None = None,
    *,
    shown: bool = False,
    **trace: Any,
) -> None:
    """Add a trace: a line unless ``mode`` says otherwise. label: its group in the legend and,
    without ``name``, its entry.
    """
    text = None if label is None else plain(label)
    known: dict[str, Any] = {
        "mode": "lines",
        "name": text,
        "legendgroup": text,
        "showlegend": shown,
    }
    figure.add_trace({"type": "scatter", "x": x, "y": y, **known, **trace}, **place)


def guide(figure: Any, place: Mapping[str, int], x: Any, y: Any, **line: Any) -> None:
    """A line that is no data: without entry in the legend and without hover."""
    scatter(figure, place, x, y, line=line, hoverinfo="skip")


def band(
    figure: Any, place: Mapping[str, int], x: Any, low: Any, high: Any, colour: str, name: str = ""
) -> None:
    """The area between two lines over x (n,), in the legend where it has a name."""
    scatter(
        figure,
        place,
        np.float32(np.r_[x, x[::-1]]),
        np.float32(np.r_[high, low[::-1]]),
        shown=bool(name),
        name=name,
        fill="toself",
        fillcolor=colour,
        line={"width": 0},
        hoverinfo="skip",
    )


def decades(low: float, high: float) -> dict[str, Any]:
    """Axis properties of a logarithmic axis over [low, high], both > 0."""
    span = math.log10(high / low)
    return {
        "type": "log",
        "range": [math.log10(low), math.log10(high)],
        # decades only on long axes, 1-2-5 on short ones
        "nticks": max(3, math.ceil(span / (0.9 if span >= 3 else 0.5))),
        "minor": {"ticks": "outside", "ticklen": 2, "tickcolor": MUTED, "dtick": "D1"},
        "exponentformat": "SI"
        if low > 1e-2 and high >= 1e5
        else "none"
        if low > 1e-5 and high < 1e6
        else "power",
    }
