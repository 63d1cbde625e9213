"""The look that all figures share: one colour and one dash per operating point, quiet axes, no frame, no grid noise.

The colours are Okabe & Ito's (Color Universal Design, 2008), told apart by colour-blind readers; the dashes do the same
in a black-and-white print.
"""

from __future__ import annotations

import html
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

INK = "#1c2329"
MUTED = "#66717b"
FAINT = "#e4e8eb"
LIMIT = "#a3341f"
FONT = "Helvetica Neue, Helvetica, Arial, Liberation Sans, sans-serif"

_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#000000", "#cc79a7", "#56b4e9", "#e69f00")
_CANDIDATES = (("#4a545d", "solid"), ("#b07d00", "8px,3px"), ("#b0307a", "10px,3px,2px,3px"), ("#4b2a8c", "2px,2px"))
_FAMILY = ("#cdbbdf", "#a98cc8", "#8259ae", "#5a2d8a", "#300a52")
_FAMILY_DASHES = ("2px,2px", "6px,3px", "solid", "10px,3px,2px,3px", "12px,3px")
_DASHES = ("solid", "7px,3px", "2px,2px", "10px,3px,2px,3px", "solid", "7px,3px", "2px,2px")
_SYMBOLS = ("x-thin", "circle-open", "triangle-up-open", "square-open", "diamond-open", "cross-thin", "star-open")


@dataclass(frozen=True, slots=True)
class Style:
    """How one operating point (or model) is drawn everywhere."""

    colour: str
    dash: str
    symbol: str
    width: float = 1.8


def styles(labels: Sequence[str]) -> dict[str, Style]:
    """One style per label, by the label's place in the list: the same list gives the same colours in every figure."""
    unique = list(dict.fromkeys(labels))
    size = len(_COLOURS)
    return {label: Style(_COLOURS[i % size], _DASHES[i % size], _SYMBOLS[i % size]) for i, label in enumerate(unique)}


def candidate_styles(labels: Sequence[str]) -> dict[str, Style]:
    """One style per controller where several are overlaid: other colours than those of the operating points."""
    unique = list(dict.fromkeys(labels))
    size = len(_CANDIDATES)
    return {label: Style(*_CANDIDATES[i % size], _SYMBOLS[i % size], 1.9) for i, label in enumerate(unique)}


def family_styles(labels: Sequence[str]) -> dict[str, Style]:
    """Styles of a family over a parameter, in its order: from pale to dark in one hue, every dash its own."""
    unique = list(dict.fromkeys(labels))
    last = max(len(unique) - 1, 1)
    return {
        label: Style(_FAMILY[round(i * (len(_FAMILY) - 1) / last)], _FAMILY_DASHES[i % len(_FAMILY_DASHES)], "x-thin", 1.7)
        for i, label in enumerate(unique)
    }


def overlay_styles(labels: Sequence[str]) -> dict[str, Style]:
    """For "is it the same?": the first label broad and pale, the others thin and dark on top of it."""
    unique = list(dict.fromkeys(labels))
    result = {
        label: Style(colour, dash, symbol, 1.3) for label, (colour, dash, symbol) in zip(unique, _overlay(), strict=False)
    }
    if unique:
        result[unique[0]] = Style("#a9bccb", "solid", "circle-open", 5.0)
    return result


def _overlay() -> list[tuple[str, str, str]]:
    return [("#a9bccb", "solid", "circle-open"), (INK, "solid", "x-thin"), *zip(_COLOURS, _DASHES, _SYMBOLS, strict=True)]


def plain(text: str) -> str:
    """Text for a figure: plotly reads a little HTML, so nothing of the user's may pass for markup."""
    return html.escape(text, quote=False)


def dress(figure: Any, height: int, *, legend: bool) -> Any:
    """Give a figure the common look; ``height`` [px] of what lies inside the axes. Returns the same figure."""
    figure.update_layout(
        template="none",
        height=height + (52 if legend else 26) + 48,
        margin={"l": 62, "r": 18, "t": 52 if legend else 26, "b": 48},
        separators=".\u202f",
        font={"family": FONT, "size": 13, "color": INK},
        paper_bgcolor="white",
        plot_bgcolor="white",
        showlegend=legend,
        hovermode="closest",
        hoverlabel={"bgcolor": "white", "bordercolor": MUTED, "font": {"family": FONT, "size": 12, "color": INK}},
        legend={
            "orientation": "h", "x": 0, "xanchor": "left", "y": 1, "yanchor": "bottom", "yref": "container",
            "font": {"size": 13}, "itemwidth": 34, "traceorder": "normal",
        },
        dragmode="zoom",
    )  # fmt: skip
    if legend:
        figure.update_layout(legend={"y": 0.995, "yanchor": "top"})
    axis = {
        "showline": True, "linecolor": INK, "linewidth": 1, "ticks": "outside", "ticklen": 4, "tickcolor": INK,
        "gridcolor": FAINT, "gridwidth": 1, "zeroline": False, "automargin": True,
        "exponentformat": "none", "separatethousands": True,
        "title": {"font": {"size": 13, "color": INK}, "standoff": 6},
    }  # fmt: skip
    figure.update_xaxes(**axis)
    figure.update_yaxes(**axis)
    return figure


def heading(figure: Any, place: Mapping[str, int], text: str, size: int = 13, **annotation: Any) -> None:
    """Words (plotly's HTML) above the upper left corner of a plot area; place: {"row": ..., "col": ...}."""
    figure.add_annotation(
        xref="x domain", yref="y domain", x=0, y=1, xanchor="left", yanchor="bottom", showarrow=False, text=text,
        font={"size": size, "color": INK}, **annotation, **place,
    )  # fmt: skip


def guide(figure: Any, place: Mapping[str, int], x: Any, y: Any, **line: Any) -> None:
    """A line that is no data: without entry in the legend and without hover."""
    import plotly.graph_objects as go

    figure.add_trace(go.Scatter(x=x, y=y, mode="lines", line=line, showlegend=False, hoverinfo="skip"), **place)


def decades(low: float, high: float) -> dict[str, Any]:
    """Axis properties of a logarithmic axis over [low, high], both > 0."""
    span = math.log10(high / low)
    return {
        "type": "log",
        "range": [math.log10(low), math.log10(high)],
        "nticks": max(3, math.ceil(span / (0.9 if span >= 3 else 0.5))),  # decades only on long axes, 1-2-5 on short ones
        "minor": {"ticks": "outside", "ticklen": 2, "tickcolor": MUTED, "dtick": "D1"},
        "exponentformat": "SI" if low > 1e-2 and high >= 1e5 else "none" if low > 1e-5 and high < 1e6 else "power",
    }
