"""Figures as SVG, and those that the workbench alone has: Bode figures of one part, loci around
-1.
"""

from __future__ import annotations

import html
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any
from xml.sax.saxutils import escape, quoteattr

import numpy as np

from ambrose.report import theme
from ambrose.report.figures.bode import phase
from ambrose.report.page import least_width

# A figure as SVG, drawn for a width: for pages without the drawing library, such as the
# workbench's.
#
# It knows what our figures use: lines, markers and filled areas in plot areas of one grid, straight
# shapes, words without arrows, axes that are linear or logarithmic. Colours of the theme become the
# page's own, so that a picture is dark on dark paper.


_VARIABLES = {
    theme.INK: "--ink",
    theme.MUTED: "--muted",
    theme.FAINT: "--faint",
    theme.LIMIT: "--limit",
    "#000000": "--ink",
    "white": "--paper",
    "#0072b2": "--line",
    "#d55e00": "--line2",
    "#009e73": "--line3",
    "#cc79a7": "--line4",
    "#dfe4e8": "--steel",
    "#c9d0d6": "--steel",
    "#b9c3cb": "--laminations",
}
_LETTER = 0.55  # mean width of a letter over its height
_WIDE_LETTER = 0.58  # of words that may not be cut off
_ROW = 18  # [px] of the legend
_SOME = 100  # points of a line that goes to and fro; from here on they are thinned
_MANY = 800  # points of a line over x; from here on they are thinned before they are drawn
_TICK = 12  # [px], height of the numbers at the axes


def svg(figure: Any, width: int, label: str, key: str) -> str:
    """The figure as the text of an SVG.

    figure: a plotly Figure; width [px], or what the figure needs at least; label: in words, for
    those who do not see it; key: a word of its own among the pictures of a screen.
    """
    return "".join(drawing(figure, width, key).text(label))


def drawing(figure: Any, width: int, key: str) -> Drawing:
    """``svg`` before it is text, for who places something on it."""
    layout = figure.layout.to_plotly_json()
    traces = [trace.to_plotly_json() for trace in figure.data]
    return Drawing(layout, traces, max(width, least_width(figure)), key)


class Drawing:
    """Where everything stands: margins, plot areas and scales, in px from the upper left corner."""

    def __init__(
        self, layout: dict[str, Any], traces: list[dict[str, Any]], width: int, key: str
    ) -> None:
        self.key = key
        self.layout = layout
        self.traces = traces
        self.width = width
        margin = layout.get("margin") or {}
        self.left = float(margin.get("l", 62))
        self.inside = max(width - self.left - float(margin.get("r", 18)), 60.0)
        self.legend = list(_legend(traces, width, self.left)) if layout.get("showlegend") else []
        lines = 1 + max([row for row, _, _ in self.legend], default=-1)
        room = (layout.get("meta") or {}).get("room", 24)
        self.top = room + 2.0 + _ROW * lines
        below = float(margin.get("b", 48))
        height = float(layout.get("height") or 400)
        self.tall = height - float(margin.get("t", 24)) - below
        self.height = self.top + self.tall + below
        self.axes = {
            name.replace("axis", ""): dict(axis)
            for name, axis in layout.items()
            if re.fullmatch(r"[xy]axis\d*", name)
        }
        for name, axis in self.axes.items():
            axis.setdefault("domain", (0.0, 1.0))
            axis["ends"] = [float(end) for end in axis.get("range") or self._reach(name, axis)]
        for name, axis in self.axes.items():
            if str(axis.get("scaleanchor", "")) in self.axes:
                self._to_scale(name, str(axis["scaleanchor"]))

    def _reach(self, name: str, axis: dict[str, Any]) -> tuple[float, float]:
        """The range of an axis that states none: all that is drawn on it."""
        letter = name[0]
        shared = {name, str(axis.get("matches", name))}
        values = [
            _numbers(trace[letter])
            for trace in self.traces
            if str(trace.get(f"{letter}axis", letter)) in shared
        ]
        flat = np.concatenate([*values, np.zeros(0)])
        flat = flat[np.isfinite(flat)]
        if axis.get("type") == "log":
            flat = np.log10(flat[flat > 0])
        if not flat.size:
            return 0.0, 1.0
        low, high = float(flat.min()), float(flat.max())
        room = 0.04 * (high - low) or 1.0
        return low - room, high + room

    def _to_scale(self, name: str, other: str) -> None:
        """One unit is as long on both axes: the range that has room to spare is widened."""
        one, two = self.unit(name), self.unit(other)
        unit = min(one, two)
        for axis, had in ((self.axes[name], one), (self.axes[other], two)):
            low, high = axis["ends"]
            more = (high - low) * (had / unit - 1.0) / 2.0
            axis["ends"] = [low - more, high + more]

    def unit(self, name: str) -> float:
        """px of one unit of an axis, of a logarithmic one of a decade."""
        axis = self.axes[name]
        start, end = axis["domain"]
        low, high = axis["ends"]
        size = self.inside if name[0] == "x" else self.tall
        return float((end - start) * size / abs(high - low))

    def at(self, name: str, values: Any) -> np.ndarray:
        """px of values on an axis ("x2"), of fractions of a plot area ("x2 domain") or of all
        ("paper").
        """
        axis, _, domain = name.partition(" ")
        numbers = _numbers(values)
        if axis.startswith("paper"):
            share = numbers
            start, end = 0.0, 1.0
        else:
            known = self.axes[axis]
            start, end = known["domain"]
            if domain:
                share = numbers
            else:
                low, high = known["ends"]
                if known.get("type") == "log":
                    numbers = np.log10(np.where(numbers > 0, numbers, np.nan))
                share = (numbers - low) / (high - low)
        place = start + share * (end - start)
        upright = axis.startswith("y") or axis == "paper-y"
        return self.top + (1 - place) * self.tall if upright else self.left + place * self.inside

    def text(self, label: str) -> Iterator[str]:
        """The parts of the SVG, from back to front."""
        size = f'width="{self.width}" height="{self.height:.0f}"'
        yield (
            f'<svg xmlns="http://www.w3.org/2000/svg" {size} viewBox="0 0 {self.width} '
            f'{self.height:.0f}" role="img" aria-label={quoteattr(label)} font-size="13" '
            f"font-family={quoteattr(theme.FONT)}>"
        )
        yield from self._clips()
        for name in self._areas():
            yield from self._axes(*name)
        for shape in self.layout.get("shapes") or ():
            yield self._shape(shape)
        for trace in self.traces:
            yield from self._trace(trace)
        for note in self.layout.get("annotations") or ():
            yield self._note(note)
        for row, x, trace in self.legend:
            y = 14 + _ROW * row
            yield _line([x, x + 26], [y - 4, y - 4], trace.get("line") or {})
            text = _plain(str(trace.get("name")))
            tall = min(13.0, (self.width - x - 34) / max(_WIDE_LETTER * len(text), 1.0))
            yield _words(text, x + 32, y, "start", size=round(tall, 1))
        yield "</svg>"

    def _areas(self) -> list[tuple[str, str]]:
        """The plot areas, as pairs of axes."""
        pairs = [(str(t.get("xaxis", "x")), str(t.get("yaxis", "y"))) for t in self.traces]
        return [pair for pair in dict.fromkeys(pairs) if set(pair) <= set(self.axes)]

    def box(self, x: str, y: str) -> tuple[float, float, float, float]:
        """Left, top, width and height of a plot area."""
        left, right = self.at(f"{x} domain", [0, 1])
        bottom, top = self.at(f"{y} domain", [0, 1])
        return float(left), float(top), float(right - left), float(bottom - top)

    def _clips(self) -> Iterator[str]:
        for x, y in self._areas():
            left, top, wide, tall = self.box(x, y)
            yield (
                f'<clipPath id="{self.key}-{x}{y}"><rect x="{left:.1f}" y="{top:.1f}" '
                f'width="{wide:.1f}" height="{tall:.1f}"/></clipPath>'
            )

    def _axes(self, x: str, y: str) -> Iterator[str]:
        """Grid, ticks, numbers and titles of a plot area."""
        left, top, wide, tall = self.box(x, y)
        bottom = top + tall
        for name in (x, y):
            axis = self.axes[name]
            along = name[0] == "x"
            other = y if along else x
            if axis.get("visible") is False or axis.get("anchor", other) != other:
                continue
            numbered = axis.get("showticklabels", True)
            room = wide / 55 if along else tall / 26
            for value, text in _ticks(axis, room):
                place = float(self.at(name, [value])[0])
                xs = [place, place] if along else [left, left + wide]
                ys = [top, bottom] if along else [place, place]
                if axis.get("showgrid", True):
                    yield _line(xs, ys, {"color": theme.FAINT, "width": 1})
                if numbered and along:
                    yield _words(text, place, bottom + 15, "middle", size=_TICK)
                elif numbered:
                    yield _words(text, left - 6, place + 4, "end", size=_TICK)
            xs = [left, left + wide] if along else [left, left]
            ys = [bottom, bottom] if along else [top, bottom]
            yield _line(xs, ys, {"color": theme.INK, "width": 1})
            title = str(((axis.get("title") or {}).get("text")) or "")
            if title and along:
                yield _words(_plain(title), left + wide / 2, bottom + 34, "middle")
            elif title:
                middle = top + tall / 2
                turned = f' transform="rotate(-90 {left - 46:.1f} {middle:.1f})"'
                yield _words(_plain(title), left - 46, middle, "middle", more=turned)

    def _shape(self, shape: dict[str, Any]) -> str:
        x, y = str(shape.get("xref", "x")), str(shape.get("yref", "y"))
        xs = self.at(x, [shape["x0"], shape["x1"]])
        ys = self.at("paper-y" if y == "paper" else y, [shape["y0"], shape["y1"]])
        if shape.get("type") == "rect":
            xs, ys = xs[[0, 1, 1, 0, 0]], ys[[0, 0, 1, 1, 0]]
        fill = str(shape.get("fillcolor") or "none") if shape.get("type") == "rect" else "none"
        return _line(xs, ys, shape.get("line") or {}, fill)

    def _trace(self, trace: dict[str, Any]) -> Iterator[str]:
        x, y = str(trace.get("xaxis", "x")), str(trace.get("yaxis", "y"))
        if (x, y) not in self._areas() or trace.get("visible") is False:
            return
        xs, ys = self.at(x, trace["x"]), self.at(y, trace["y"])
        yield f'<g clip-path="url(#{self.key}-{x}{y})">'
        mode = str(trace.get("mode", "lines"))
        if trace.get("fill") == "tozeroy":
            base = float(self.at(y, [0.0])[0])
            around = [*ys, base, base]
            yield _line([*xs, xs[-1], xs[0]], around, {"width": 0}, str(trace.get("fillcolor")))
        if "lines" in mode:
            if mode == "lines" and not trace.get("fill"):
                xs, ys = _thinned(xs, ys)
            filled = trace.get("fill") == "toself"
            fill = str(trace.get("fillcolor") or "none") if filled else "none"
            yield _line(xs, ys, trace.get("line") or {}, fill)
        yield "</g>"
        if "markers" in mode:
            yield from _markers(xs, ys, trace.get("marker") or {})
        if "text" in mode:
            texts = np.broadcast_to(np.atleast_1d(trace.get("text", "")), xs.shape)
            for px, py, word in zip(xs, ys, texts, strict=True):
                yield _words(_plain(str(word)), float(px), float(py) - 8, "middle")

    def _note(self, note: dict[str, Any]) -> str:
        x, y = str(note.get("xref", "x")), str(note.get("yref", "y"))
        # on an axis in logarithms a place is stated as its logarithm
        known = self.axes.get(y, {})
        height = 10 ** float(note["y"]) if known.get("type") == "log" else note["y"]
        known = self.axes.get(x, {})
        along = 10 ** float(note["x"]) if known.get("type") == "log" else note["x"]
        px = float(self.at(x, [along])[0]) + float(note.get("xshift") or 0)
        py = float(self.at("paper-y" if y == "paper" else y, [height])[0])
        py -= float(note.get("yshift") or 0)
        font = note.get("font") or {}
        size = float(font.get("size") or 13)
        raw = str(note.get("text") or "")
        lines = [_plain(line) for line in re.split(r"<br ?/?>", raw)]
        anchor = {"left": "start", "right": "end"}.get(str(note.get("xanchor")), "middle")
        tall = 1.2 * size * len(lines)
        up = {"bottom": tall, "top": 0.0}.get(str(note.get("yanchor")), tall / 2)
        colour = str(font.get("color") or theme.INK)
        bold = ' font-weight="600"' if raw.startswith("<b>") else ""
        return "".join(
            _words(
                line,
                px,
                py - up + 1.2 * size * i + size,
                anchor,
                size=size,
                colour=colour,
                more=bold + (' class="halo"' if note.get("bgcolor") else ""),
            )
            for i, line in enumerate(lines)
        )


def _legend(
    traces: Sequence[dict[str, Any]], width: int, left: float
) -> Iterator[tuple[int, float, dict[str, Any]]]:
    """Row, place and trace of every entry, as many in a row as there is room for."""
    row = 0
    x = left
    for trace in traces:
        if not trace.get("showlegend", True) or not trace.get("name"):
            continue
        long = 50 + 13 * _LETTER * len(_plain(str(trace["name"])))
        if x > left and x + long > width:
            row += 1
            x = left
        yield row, x, trace
        x += long


def _numbers(values: Any) -> np.ndarray:
    if isinstance(values, np.ndarray):
        return values.astype(float)
    return np.array([np.nan if value is None else value for value in values], dtype=float)


def _ticks(axis: dict[str, Any], room: float) -> list[tuple[float, str]]:
    """Values and words of the ticks of an axis, no more than there is room for."""
    low, high = sorted(axis["ends"])
    given = axis.get("tickvals")
    if given is not None:
        words = axis.get("ticktext")
        texts = [f"{value:g}" for value in given] if words is None else [str(w) for w in words]
        return [(float(v), _plain(t)) for v, t in zip(given, texts, strict=False)]
    if axis.get("type") == "log":
        steps = (1.0,) if high - low > 2.5 else (1.0, 2.0, 5.0)
        every = max(1, math.ceil((high - low) / max(room, 1.0)))
        powers = range(math.floor(low), math.ceil(high) + 1, every)
        values = [step * 10.0**power for power in powers for step in steps]
        return [(v, _short(v)) for v in values if low - 1e-9 <= math.log10(v) <= high + 1e-9]
    step = float(axis.get("dtick") or 0) or _rounded((high - low) / max(room, 2.0))
    first = math.ceil(low / step - 1e-9)
    count = min(math.floor(high / step + 1e-9) - first + 1, 50)
    return [((first + i) * step, _short((first + i) * step)) for i in range(count)]


def _rounded(value: float) -> float:
    """1, 2 or 5 times a power of ten, at least the value."""
    power = 10.0 ** math.floor(math.log10(max(value, 1e-300)))
    return next(step * power for step in (1.0, 2.0, 5.0, 10.0) if step * power >= value * 0.999)


def _short(value: float) -> str:
    """A number at an axis, with plain signs."""
    text = f"{value:.6g}" if value == 0 or 1e-4 <= abs(value) < 1e6 else f"{value:.0e}"
    return text.replace("-", "\u2212")


def _plain(text: str) -> str:
    """plotly's words without its markup: what was escaped for it is itself again."""
    return html.unescape(re.sub(r"</?[a-z][^<>]*>", "", text))


def _paint(colour: str) -> str:
    """A colour as the page has it."""
    variable = _VARIABLES.get(colour)
    if variable:
        return f"var({variable})"
    return colour if re.fullmatch(r"[\w#(),. %]+", colour) else "currentColor"


def _line(xs: Any, ys: Any, line: dict[str, Any], fill: str = "none") -> str:
    """A path through points (n,); it is broken where one is not finite."""
    width = line.get("width", 1.5)
    points = np.clip(np.stack([xs, ys], axis=1).astype(float), -1e5, 1e5)
    drawn = np.isfinite(points).all(axis=1)
    begins = drawn.copy()
    begins[1:] &= ~drawn[:-1]
    pens = np.where(begins, "M", "L")[drawn].tolist()
    # a path of hundreds of points, many times a second: one format for all of it
    numbers = points[drawn].ravel().tolist()
    words = "".join(f"{pen}%.1f %.1f" for pen in pens) % tuple(numbers)
    stroke = _paint(str(line.get("color") or theme.INK)) if width else "none"
    dash = _dash(str(line.get("dash") or "solid"))
    return (
        f'<path d="{words}" fill="{_paint(fill)}" stroke="{stroke}" '
        f'stroke-width="{float(width):g}"{dash}/>'
    )


def _thinned(xs: np.ndarray, ys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A line over ascending x with at most the lowest and the highest point of every pixel; another
    one with no points that are nearer together than a pixel.
    """
    if len(xs) < _SOME:
        return xs, ys
    if not (np.diff(xs) >= 0).all():
        steps = np.hypot(np.diff(xs), np.diff(ys))
        way = np.cumsum(np.where(steps < 9.0, steps, 9.0))  # also into and out of what is not drawn
        kept = np.diff(np.floor(way), prepend=[-1.0, 0.0]) > 0
        kept[-1] = True
        return xs[kept], ys[kept]
    if len(xs) < _MANY or not np.isfinite(ys).all():
        return xs, ys
    starts = np.flatnonzero(np.diff(np.floor(xs), prepend=-np.inf))
    low, high = np.minimum.reduceat(ys, starts), np.maximum.reduceat(ys, starts)
    middle = xs[starts]
    return np.repeat(middle, 2), np.stack([low, high], axis=1).ravel()


def _dash(text: str) -> str:
    named = {"dash": "6,3", "dot": "2,2", "dashdot": "6,3,2,3"}.get(text, text)
    numbers = named.replace("px", "")
    return f' stroke-dasharray="{numbers}"' if re.fullmatch(r"[\d., ]+", numbers) else ""


def _markers(xs: np.ndarray, ys: np.ndarray, marker: dict[str, Any]) -> Iterator[str]:
    sizes = np.broadcast_to(_numbers(np.atleast_1d(marker.get("size", 6))), xs.shape)
    colour = marker.get("color")
    fill = colour if isinstance(colour, str) else theme.INK
    line = marker.get("line") or {}
    symbol = str(marker.get("symbol") or "circle")
    hollow = symbol.endswith(("-open", "-thin"))
    edge = line.get("color") if isinstance(line.get("color"), str) else fill
    width = float(line.get("width") or (1.2 if hollow else 0))
    look = {"color": edge, "width": width}
    for x, y, size in zip(xs, ys, sizes, strict=True):
        if not (math.isfinite(x) and math.isfinite(y)):
            continue
        r = float(size) / 2
        paint = "none" if hollow else fill
        if symbol.startswith("circle"):
            yield (
                f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{r:g}" fill="{_paint(paint)}" '
                f'stroke="{_paint(str(edge))}" stroke-width="{width:g}"/>'
            )
            continue
        corners = _CORNERS.get(symbol.split("-", maxsplit=1)[0], _CORNERS["square"])
        for part in corners:
            yield _line([x + r * a for a, _ in part], [y + r * b for _, b in part], look, paint)


# corners of a marker, in strokes, for a half size of one
_CORNERS: dict[str, list[list[tuple[float, float]]]] = {
    "square": [[(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)]],
    "diamond": [[(0, -1), (1, 0), (0, 1), (-1, 0), (0, -1)]],
    "triangle": [[(0, -1), (1, 0.8), (-1, 0.8), (0, -1)]],
    "x": [[(-1, -1), (1, 1)], [(-1, 1), (1, -1)]],
    "cross": [[(-1, 0), (1, 0)], [(0, -1), (0, 1)]],
    "star": [[(-1, 0), (1, 0)], [(0, -1), (0, 1)], [(-0.7, -0.7), (0.7, 0.7)]],
}


def _words(
    text: str,
    x: float,
    y: float,
    anchor: str,
    *,
    size: float = 13,
    colour: str = theme.INK,
    more: str = "",
) -> str:
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" font-size="{size:g}" '
        f'fill="{_paint(colour)}"{more}>{escape(text)}</text>'
    )


_HEIGHT = 320  # [px]
_VIEW = ((-3.2, 1.2), (-1.8, 1.8))
_NEAR = 6.0  # from zero, beyond which nothing is seen
_BODE_DECADES, _LATE = 6, -720.0  # that a magnitude shows, and the lowest phase [degrees]


def bode_figure(
    curves: Mapping[str, tuple[np.ndarray, np.ndarray]],
    style: Mapping[str, theme.Style],
    part: str,
    unit: str = "",
) -> Any:
    """One part, "size" or "phase", of gains over frequency: omega (w,) [rad/s] and gain (w,) of
    every label. Returns a plotly Figure.
    """
    figure = theme.subplots(rows=1, cols=1)
    place = {"row": 1, "col": 1}
    value = np.abs if part == "size" else phase
    drawn = {label: value(gain) for label, (_, gain) in curves.items()}
    top = max(float(y.max()) for y in drawn.values())
    factor, shown_unit = theme.scale(unit, top) if part == "size" else (1.0, "°")
    for label, y in drawn.items():
        x, line = curves[label][0] / (2 * np.pi), style[label].line
        theme.scatter(figure, place, x, factor * y, label, shown=True, line=line)
    ends = [curves[label][0][[0, -1]] / (2 * np.pi) for label in curves]
    span = [min(low for low, _ in ends), max(high for _, high in ends)]
    # where a loop may not be both
    level = [-180.0] * 2 if part == "phase" else [1.0] * 2
    if not unit:
        theme.guide(figure, place, span, level, color=theme.MUTED, width=1.2, dash="2px,3px")
    theme.dress(figure, _HEIGHT - 80, legend=len(curves) > 1)
    figure.update_xaxes(title_text="Frequency [Hz]", **theme.decades(*span))
    least = min(float(y.min()) for y in drawn.values())
    if part == "size":
        low = max(least / 1.3, 1.5 * top / 10**_BODE_DECADES)
        figure.update_yaxes(**theme.decades(low * factor, 1.5 * top * factor))
    else:
        low, high = max(90 * np.floor(least / 90), _LATE), max(90 * np.ceil(top / 90), 0.0)
        step = 90 if high - low <= 450 else 180
        figure.update_yaxes(range=[low - 8, high + 8], dtick=step)
    words = "Magnitude" if part == "size" else "Phase"
    figure.update_yaxes(title_text=f"{words} [{shown_unit}]" if shown_unit else words)
    return figure


def nyquist_figure(
    loci: Sequence[tuple[str, np.ndarray]],
    peak: float | None = None,
    style: Mapping[str, theme.Style] | None = None,
) -> Any:
    """Loci of several loops in the plane, near -1; style: of the labels, else by their order.

    loci: label and L (w, a), a curve for each axis in the look of the label. peak: a sensitivity
    that is not to be exceeded; |1/(1 + L)| = peak is the circle of radius 1/peak around -1. Returns
    a plotly Figure.
    """
    figure = theme.subplots(rows=1, cols=1)
    place = {"row": 1, "col": 1}
    style = theme.styles([label for label, _ in loci]) if style is None else style
    for label, values in loci:
        for i in range(values.shape[1]):
            # what lies outside the view, and so do the points around it, is no part of the picture
            inside = np.abs(values[:, i]) < _NEAR
            near = inside.copy()
            near[1:] |= inside[:-1]
            near[:-1] |= inside[1:]
            L = np.where(near, values[:, i], np.nan)
            theme.scatter(
                figure, place, L.real, L.imag, label, shown=i == 0, line=style[label].line
            )
    turn = np.linspace(0, 2 * np.pi, 73)
    theme.guide(figure, place, np.cos(turn), np.sin(turn), color=theme.FAINT, width=1.2)
    if peak is not None:
        x, y = np.cos(turn) / peak - 1, np.sin(turn) / peak
        theme.guide(figure, place, x, y, color=theme.LIMIT, width=1.2, dash="1.5px,2px")
        words = f"|S| = {peak:g}"
        at = 1 / peak + 0.03
        theme.note(figure, place, words, -1, at, "center", "bottom", colour=theme.LIMIT)
    marker = {"color": theme.LIMIT, "size": 7, "symbol": "x-thin", "line": {"width": 2}}
    theme.scatter(figure, place, [-1], [0], mode="markers", marker=marker)
    theme.dress(figure, _HEIGHT, legend=len(loci) > 1)
    figure.update_xaxes(title_text="Real part", range=list(_VIEW[0]))
    figure.update_yaxes(title_text="Imaginary part", range=list(_VIEW[1]), scaleanchor="x")
    return figure
