"""The look that all figures share: one colour and one dash per operating point, quiet axes, no
frame, no grid noise.

The colours are Okabe & Ito's (Color Universal Design, 2008), told apart by colour-blind readers;
the dashes do the same in a black-and-white print.
"""

from __future__ import annotations

import html
import itertools
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

# Numbers and units as people read them: the only place that leaves SI for the page.
#
# Everything arrives in SI (rad/s, m, A, N, Pa); ``scale`` says which unit is shown and by which
# factor, the rest is text.


TWO_PI = 2.0 * math.pi  # rad/s per Hz
RPM = 60.0 / TWO_PI  # rpm per rad/s

# SI unit -> shown units as (magnitude from which it is used, factor, name); the first row is the
# smallest.
_SHOWN: dict[str, tuple[tuple[float, float, str], ...]] = {
    "m": ((0.0, 1e6, "µm"), (1e-2, 1e3, "mm")),
    "rad/s": ((0.0, 1 / TWO_PI, "Hz"),),
    "rad": ((0.0, 180 / math.pi, "°"),),
    "s": ((0.0, 1e3, "ms"), (1.0, 1.0, "s")),
    "Pa": ((0.0, 1e-5, "bar"),),
    "m/N": ((0.0, 1e6, "µm/N"),),
    "m/A": ((0.0, 1e6, "µm/A"),),
    "A/m": ((0.0, 1e-3, "A/mm"),),
    "N/m": ((0.0, 1e-3, "N/mm"),),
    "m/s": ((0.0, 1e3, "mm/s"),),
    "kg m": ((0.0, 1e6, "g mm"),),
    "kg m2": ((0.0, 1.0, "kg m²"),),
    "": ((0.0, 1.0, ""),),
    "-": ((0.0, 1.0, ""),),
    "1": ((0.0, 1.0, ""),),
}

_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_GREEK = {"zeta": "ζ", "eta": "η", "sigma": "σ", "omega": "ω", "mu": "µ"}


def scale(unit: str, magnitude: float = 0.0) -> tuple[float, str]:
    """The factor and the name of the unit in which a quantity of that SI unit and magnitude is
    shown.
    """
    rows = _SHOWN.get(unit, ((0.0, 1.0, unit),))
    size = abs(magnitude) if math.isfinite(magnitude) else 0.0
    _, factor, name = max((row for row in rows if row[0] <= size), key=lambda row: row[0])
    return factor, name


def coefficient_scale(letter: str) -> tuple[float, str]:
    """Factor and unit in which a coefficient K, k, C, c of a seal is shown: what seals have."""
    return (1e-3, "kN/m") if letter in "Kk" else (1.0, "N s/m")


def number(value: float, digits: int = 3) -> str:
    """A number with that many significant digits: 0.0312, 4.1, 6 905, 1.2×10⁻⁷; never 1e-07."""
    if math.isnan(value):
        return "n/a"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    if value == 0:
        return "0"
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    power = int(exponent)
    if -4 < power < 6:
        text = f"{float(f'{value:.{digits - 1}e}'):,.{max(digits - 1 - power, 0)}f}".replace(
            ",", "\u202f"
        )
        text = text.rstrip("0").rstrip(".") if "." in text else text
    else:
        short = mantissa.rstrip("0").rstrip(".") if "." in mantissa else mantissa
        text = f"{short}×10{str(power).translate(_SUPERSCRIPTS)}"
    return text.replace("-", "−", 1) if text.startswith("-") else text


def quantity(value: float, unit: str, digits: int = 3) -> str:
    """A value of that SI unit as text with its shown unit, e.g. quantity(4.1e-5, "m") = "41 µm"."""
    factor, name = scale(unit, value)
    return join(number(value * factor, digits), name)


def join(text: str, unit: str) -> str:
    """A number's text and its unit; the degree sign sits close, all others after a no-break
    space.
    """
    return text + ("" if unit in {"", "°"} else "\u00a0") + unit


def pair(value: float, limit: float, unit: str) -> tuple[str, str]:
    """Value and limit in one shown unit, with as many digits as it takes to tell them apart (3.0004
    is not "3").
    """
    factor, name = scale(
        unit, max((abs(x) for x in (value, limit) if math.isfinite(x)), default=0.0)
    )
    for digits in range(3, 9):
        left, right = number(value * factor, digits), number(limit * factor, digits)
        if left != right or value == limit:
            break
    return join(left, name), join(number(limit * factor, max(digits, 3)), name)


def decibel(value: float) -> str:
    """A positive ratio in dB, e.g. "12.3 dB"; empty where there is none."""
    return f"{20 * math.log10(value):.1f}\u00a0dB".replace("-", "−") if 0 < value < math.inf else ""


def seconds_or_milliseconds(span: float) -> tuple[float, str]:
    """Factor and unit of a time axis of that length [s]."""
    return (1.0, "s") if span >= 1.0 else (1e3, "ms")


def axis_name(name: str) -> str:
    """A signal's name as people write it: "y_A_zeta" -> "y A ζ"."""
    words = re.split(r"[_\s]+", name.strip())
    return " ".join(_GREEK.get(word, word) for word in words)


_ALIKE = re.compile(r"((?:[\w-]+\.)+)\w+ ([+-][\d.]+)(?:, \1\w+ \2(?![\d.]))+")


def prose(text: str) -> str:
    """Text with the axes written as people do, "loop A_zeta" -> "loop A ζ", and what parameters in
    a row share named once, "seal.a.K +1, seal.a.k +1" -> "seal.a: K, k +1".
    """
    for run in _ALIKE.finditer(text):
        names = re.findall(rf"{re.escape(run[1])}(\w+) ", run[0])
        text = text.replace(run[0], f"{run[1][:-1]}: {', '.join(names)} {run[2]}")
    return re.sub(r"(?<=[A-Za-z0-9])_(zeta|eta)\b", lambda found: "\u00a0" + _GREEK[found[1]], text)


def fixed(value: float, half: float) -> str:
    """A number with as many digits as its half-width makes sense of: two of the half-width's."""
    if not (math.isfinite(value) and math.isfinite(half)) or half <= 0 or value == 0:
        return number(value, 5)
    digits = 2 + math.floor(math.log10(abs(value))) - math.floor(math.log10(half))
    return number(value, min(max(digits, 1), 9))


def plus_minus(value: float, half: float, unit: str) -> str:
    """ "3.10 ± 0.04 kN/m", all in the shown unit."""
    return f"{fixed(value, half)} ± {number(half, 2)} {unit}"


# A figure of one plot area as plain data: what our figures say to plotly's, kept without its
# validation, thirty times faster.
#
# It takes the few calls that ``theme`` and the figures make, and is read as plotly's figures are:
# ``data`` and ``layout``, each with ``to_plotly_json``. ``theme.bare`` decides who gets it.


class Plain(dict[str, Any]):
    """A dictionary that is read like an object of plotly."""

    def to_plotly_json(self) -> dict[str, Any]:
        """Itself."""
        return self


class PlainFigure:
    """One plot area with the axes x and y; rows and columns of a place are (1, 1)."""

    def __init__(self) -> None:
        self.data: list[Plain] = []
        axes = {"xaxis": {"anchor": "y"}, "yaxis": {"anchor": "x"}}
        self.layout = Plain(**axes, annotations=[], shapes=[])

    def add_trace(self, trace: dict[str, Any], **place: int) -> PlainFigure:
        """One more trace."""
        self.data.append(Plain(trace))
        return self

    def add_annotation(self, row: int = 1, col: int = 1, **note: Any) -> PlainFigure:
        """Words at a place."""
        self.layout["annotations"].append(note)
        return self

    def add_shape(self, **shape: Any) -> PlainFigure:
        """A straight shape."""
        self.layout["shapes"].append(shape)
        return self

    def update_layout(self, **values: Any) -> PlainFigure:
        """Values of the layout; those of tables are merged."""
        _merge(self.layout, values)
        return self

    def update_xaxes(self, row: int = 1, col: int = 1, **values: Any) -> PlainFigure:
        """Values of the axis along; ``title_text`` is the text of its title."""
        _merge(self.layout["xaxis"], values)
        return self

    def update_yaxes(self, row: int = 1, col: int = 1, **values: Any) -> PlainFigure:
        """Values of the axis upwards."""
        _merge(self.layout["yaxis"], values)
        return self


def _merge(table: dict[str, Any], values: dict[str, Any]) -> None:
    for key, value in values.items():
        outer, underscore, inner = key.partition("_")
        if underscore:
            _merge(table, {outer: {inner: value}})
        elif isinstance(value, dict) and isinstance(table.get(key), dict):
            _merge(table[key], value)
        else:
            table[key] = value


_bare = ContextVar("bare", default=False)

INK = "#1c2329"
MUTED = "#66717b"
FAINT = "#e4e8eb"
LIMIT = "#a3341f"
RIGHT = 18  # [px], the margin of a figure without names at its right
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
        margin={"l": 62, "r": RIGHT, "t": top, "b": 48},
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
