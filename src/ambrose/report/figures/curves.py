"""Curves as plotly figures: operating points or models overlaid, one small panel per axis where
there are several.

Figures convert from SI to the units of the page; they are never downsampled, and a view that hides
part of the data says so.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ambrose.core.checks import InvalidInput, check_positive, invalid
from ambrose.core.realisation import invariant_zeros
from ambrose.core.statespace import as_statespace, poles as poles_of
from ambrose.judge.campbell import ONCE
from ambrose.judge.checks import Curve
from ambrose.report import theme

# Units, scales and visible ranges of the axes that a set of curves shares, and the limits drawn on
# them. Data are never changed, only the view is chosen.


# of a logarithmic view below its top; models differ where they are small
_DECADES, _OVERLAY_DECADES = 4.0, 7.0
# decades below the lowest limit: what is read against limits needs the room around them
_BELOW_LIMITS = 2.0
# a time response this much larger than all others (an unstable loop's) does not set the view
_RUNAWAY = 8.0
_MODES = 10.0  # times the highest speed: modes above it leave the view of a map


@dataclass(frozen=True, slots=True)
class Axes:
    """How x and y are shown: factors from SI, texts, logarithmic or not, and the visible ranges
    (shown units).
    """

    x_factor: float
    x_text: str
    y_factor: float
    y_unit: str
    log_x: bool
    log_y: bool
    x_range: tuple[float, float]
    y_range: tuple[float, float]
    cut: bool  # part of the data lies outside the view


def drawn(values: ArrayLike) -> np.ndarray:
    """Coordinates as the page carries them: every point, to seven digits (half the weight of
    sixteen).
    """
    return np.asarray(values, dtype=np.float32)


def is_map(curve: Curve) -> bool:
    """Whether this is a Campbell map: frequencies over speed."""
    return curve.kind == "speed" and curve.y_unit == "rad/s"


def axes_of(
    curves: Sequence[tuple[str, Curve]],
    *,
    overlay: bool = False,
    view: Sequence[tuple[str, Curve]] = (),
) -> Axes:
    """The common axes of curves of one kind and unit; ``view``: those that choose the range of y
    (default: all).
    """
    first = curves[0][1]
    x = np.concatenate([curve.x for _, curve in curves])
    everything = _finite(curves)
    rows = _finite(view) if view else everything
    y, whole = np.concatenate(rows), np.concatenate(everything)
    log = first.kind == "frequency"
    log_x = log and x.size > 0 and float(x.min()) > 0
    log_y = log and y.size > 0 and float(y.min()) > 0 and first.y_unit != "rad"
    limits = [value for _, curve in curves for _, value in curve.limits]
    if log_y:
        low, high = _logarithmic(y, limits, _OVERLAY_DECADES if overlay else _DECADES)
    else:
        if first.kind == "time":
            y = _without_runaways(rows)
        elif is_map(first):
            y = _near_the_speed(rows, float(x.max(initial=0.0)))
        low, high = _linear(y, limits)
    cut = bool(whole.size) and (float(whole.min()) < low or float(whole.max()) > high)
    factor, y_unit = theme.scale(first.y_unit, max(abs(low), abs(high)))
    x_factor, x_text = _x_scale(first.kind, x)
    ranges = _x_range(x * x_factor, log_x), (low * factor, high * factor)
    return Axes(x_factor, x_text, factor, y_unit, log_x, log_y, *ranges, cut)


def set_ranges(figure: Any, axes: Axes) -> None:
    """Show these ranges, logarithmic or not, in every panel."""
    figure.update_xaxes(
        **(theme.decades(*axes.x_range) if axes.log_x else {"range": list(axes.x_range)})
    )
    figure.update_yaxes(
        **(theme.decades(*axes.y_range) if axes.log_y else {"range": list(axes.y_range)})
    )


def _finite(curves: Sequence[tuple[str, Curve]]) -> list[np.ndarray]:
    return [row[np.isfinite(row)] for row in (curve.y.ravel() for _, curve in curves)]


def _x_scale(kind: str, x: np.ndarray) -> tuple[float, str]:
    if kind == "time":
        factor, unit = theme.seconds_or_milliseconds(float(np.ptp(x)) if x.size else 0.0)
        return factor, f"Time [{unit}]"
    if kind == "speed":
        return theme.RPM, "Rotational speed [rpm]"
    return theme.scale("rad/s")[0], "Frequency [Hz]"


def _x_range(x: np.ndarray, log: bool) -> tuple[float, float]:
    low, high = (float(x.min()), float(x.max())) if x.size else (0.0, 1.0)
    if low < high:
        return low, high
    return (low / 2, high * 2) if log else (low - 0.5, high + 0.5)


def _logarithmic(y: np.ndarray, limits: Sequence[float], decades: float) -> tuple[float, float]:
    """The upper decades of the data, and the limits that lie not far above them."""
    top = float(y.max())
    high = 1.5 * max([top, *(value for value in limits if value <= 30 * top)])
    below = min((value for value in limits if value > 0), default=0.0) / 10**_BELOW_LIMITS
    return max(float(y.min()) / 1.3, high / 10**decades, min(below, high / 10)), high


def _linear(y: np.ndarray, limits: Sequence[float]) -> tuple[float, float]:
    """The data from zero, and the limits that are not far beyond them."""
    if y.size == 0:
        return 0.0, 1.0
    low, high = min(0.0, float(y.min())), max(0.0, float(y.max()))
    reach = max(-low, high)
    near = [value for value in limits if abs(value) <= 4 * reach]
    low, high = min([low, *near]), max([high, *near])
    margin = 0.06 * (high - low) or 1.0
    return (low - margin if low < 0 else 0.0), (high + margin if high > 0 else 0.0)


def _without_runaways(rows: Sequence[np.ndarray]) -> np.ndarray:
    """The responses but for those that are far larger than all the others."""
    ordered = sorted((row for row in rows if row.size), key=lambda row: float(np.abs(row).max()))
    while len(ordered) > 1 and np.abs(ordered[-1]).max() > _RUNAWAY * np.abs(ordered[-2]).max() > 0:
        ordered.pop()
    return np.concatenate(ordered) if ordered else np.zeros(0)


def _near_the_speed(rows: Sequence[np.ndarray], top: float) -> np.ndarray:
    """The modes of a map that are not far above the highest speed; all where none is near."""
    y = np.concatenate(rows)
    near = y[y <= _MODES * top]
    return near if near.size else y


BEYOND = "beyond the view: "


def limit_levels(curves: Sequence[tuple[str, Curve]], axes: Axes) -> list[tuple[float, str]]:
    """Every level once (shown unit), with the names of all limits that lie there: "zone A/B,
    required 3".
    """
    names: dict[float, list[str]] = {}
    for text, value in dict.fromkeys(limit for _, curve in curves for limit in curve.limits):
        names.setdefault(value * axes.y_factor, []).append(text)
    return [
        (level, f"{', '.join(texts)} {amount(level, axes)}")
        for level, texts in sorted(names.items())
    ]


def amount(level: float, axes: Axes) -> str:
    """A value of the y axis (shown unit) as text."""
    return theme.join(theme.number(level), axes.y_unit)


def draw_limits(
    figure: Any,
    place: dict[str, int],
    levels: Sequence[tuple[float, str]],
    axes: Axes,
    *,
    size: tuple[int, int],
    named: bool,
) -> None:
    """Limits inside the view as thin lines with their names on them, side by side where they would
    overprint.

    place: {"row": ..., "col": ...} of the plot area; size: its approximate width and height [px].
    """
    low, high = (math.log10(v) for v in axes.y_range) if axes.log_y else axes.y_range
    # height [px], left and right end (fractions of the width) of the names so far
    taken: list[tuple[float, float, float]] = []
    for level, words in levels:
        if not axes.y_range[0] <= level <= axes.y_range[1]:
            continue
        theme.guide(
            figure,
            place,
            list(axes.x_range),
            [level, level],
            color=theme.LIMIT,
            width=1.2,
            dash="1.5px,2px",
        )
        if not named:
            continue
        y = math.log10(level) if axes.log_y else level
        at = (y - low) / (high - low) * size[1]
        width, right = (len(words) * 6.5 + 12) / size[0], 1.0
        for pixel, start, end in sorted(taken, key=lambda item: -item[2]):
            if abs(pixel - at) < 15 and start < right and right - width < end:
                right = start
        taken.append((at, right - width, right))
        # a line just above does not strike it through
        clear = {"bgcolor": "rgba(255, 255, 255, 0.85)", "borderpad": 0}
        where: dict[str, Any] = {"xref": "x domain", "yshift": -1, **clear}
        theme.note(
            figure,
            place,
            theme.plain(words),
            right,
            y,
            "right",
            "bottom",
            colour=theme.LIMIT,
            **where,
        )


def beyond(curves: Sequence[tuple[str, Curve]], axes: Axes) -> str:
    """What lies outside the view, limits and parts of curves: "beyond the view: touchdown gap 250
    µm"; empty when nothing.
    """
    outside = [
        item
        for item in limit_levels(curves, axes)
        if not axes.y_range[0] <= item[0] <= axes.y_range[1]
    ]
    texts = [
        words
        for level, words in outside
        if level >= 0 or -level not in {other for other, _ in outside}
    ]
    if axes.cut:
        modes = is_map(curves[0][1])
        texts.append(f"modes above {amount(axes.y_range[1], axes)}" if modes else "some curves")
    return BEYOND + ", ".join(texts) if texts else ""


# Poles in pictures: of closed loops, the slow ones in the s-plane and all of them as damping ratio
# against natural frequency; of several systems, poles and zeros side by side.


# the left picture ends at the widest gap after so many slow poles of an operating point
_FEWEST, _MOST = 4, 16
# damping ratios beyond this are shown logarithmically, below it linearly: 0 and instability stay
# visible
_FINE = 1e-3
_TICKS = (-1.0, -0.1, -0.01, -0.001, 0.0, 0.001, 0.01, 0.1, 1.0)


def pole_figure(curves: Sequence[tuple[str, Curve]], style: Mapping[str, theme.Style]) -> Any:
    """A figure of curves of kind "poles" (x real, y imaginary part [rad/s]); conjugates are drawn
    once, above the axis.
    """
    figure = theme.subplots(rows=1, cols=2, column_widths=[0.42, 0.58], horizontal_spacing=0.1)
    everything = [(label, _upper_half(curve)) for label, curve in curves]
    reach = max((_slow_radius(poles) for _, poles in everything), default=1.0)
    for label, poles in everything:
        look = style[label]
        ratio = -poles.real / np.where(np.abs(poles) > 0, np.abs(poles), np.inf)
        frequency = np.abs(poles) / theme.TWO_PI
        marker = {
            "color": look.colour,
            "symbol": look.symbol,
            "size": 9,
            "line": {"width": 1.6, "color": look.colour},
        }
        hover = (
            f"{theme.plain(label)}<br>%{{customdata[0]:.5g}} Hz, damping ratio "
            "%{customdata[1]:.3g}<extra></extra>"
        )
        name = theme.plain(label) + _least_damped(frequency, ratio)
        common: dict[str, Any] = {
            "name": name,
            "mode": "markers",
            "marker": marker,
            "hovertemplate": hover,
        }
        data, away = drawn(np.column_stack([frequency, ratio])), frequency > 0
        for column, x, y, kept in (
            (1, poles.real, poles.imag / theme.TWO_PI, slice(None)),
            (2, frequency, _fold(ratio), away),
        ):
            place = {"row": 1, "col": column}
            theme.scatter(
                figure,
                place,
                drawn(x[kept]),
                drawn(y[kept]),
                label,
                shown=column == 1,
                customdata=data[kept],
                **common,
            )
    theme.dress(figure, 310, legend=True)
    _axes(figure, everything, reach)
    return figure


def _upper_half(curve: Curve) -> np.ndarray:
    """The poles with a non-negative imaginary part (n,) [rad/s], complex."""
    poles = (np.broadcast_to(curve.x, curve.y.shape) + 1j * curve.y).ravel()
    poles = poles[np.isfinite(poles)]
    return poles[poles.imag >= 0]


def _slow_radius(poles: np.ndarray) -> float:
    """The radius [rad/s] of the left picture: the slow poles and every unstable one."""
    if poles.size == 0:
        return 1.0
    size = np.maximum(np.sort(np.abs(poles)), 1e-9)
    first, last = min(_FEWEST, size.size) - 1, min(_MOST, size.size) - 1
    gaps = size[first + 1 : last + 1] / size[first:last]
    edge = size[first + int(np.argmax(gaps))] if gaps.size else size[last]
    return 1.2 * float(max(edge, np.abs(poles[poles.real > 0]).max(initial=0.0)))


def _least_damped(frequency: np.ndarray, ratio: np.ndarray) -> str:
    moving = frequency > 0
    if not moving.any():
        return ""
    i = int(np.argmin(np.where(moving, ratio, np.inf)))
    return (
        f" · least damping ratio {theme.number(float(ratio[i]))} at "
        f"{theme.number(float(frequency[i]))} Hz"
    )


def _fold(ratio: np.ndarray) -> np.ndarray:
    """Logarithmic far from zero, linear near it, odd: negative damping can be shown."""
    return np.arcsinh(np.asarray(ratio) / _FINE)


def _axes(figure: Any, everything: Sequence[tuple[str, np.ndarray]], reach: float) -> None:
    poles = np.concatenate([p for _, p in everything]) if everything else np.zeros(0)
    frequency = np.abs(poles[np.abs(poles) > 0]) / theme.TWO_PI
    inside = int((np.abs(poles) <= reach).sum())
    right = max(0.06 * reach, 1.15 * float(poles.real.max(initial=0.0)))
    figure.update_xaxes(title_text="Real part [1/s]", range=[-reach, right], row=1, col=1)
    figure.update_yaxes(
        title_text="Imaginary part [Hz]",
        range=[-0.03 * reach / theme.TWO_PI, reach / theme.TWO_PI],
        row=1,
        col=1,
    )
    low, high = (
        (float(frequency.min()) / 1.5, float(frequency.max()) * 1.5)
        if frequency.size
        else (0.1, 1.0)
    )
    figure.update_xaxes(
        title_text="Natural frequency [Hz]", **theme.decades(low, high), row=1, col=2
    )
    unstable = bool((poles.real > 0).any())
    ticks = [t for t in _TICKS if t >= 0 or unstable]
    figure.update_yaxes(
        title_text="Damping ratio",
        tickvals=[float(_fold(np.array(t))) for t in ticks],
        ticktext=[theme.number(t) for t in ticks],
        range=[float(_fold(np.array(-1.3 if unstable else -0.0006))), float(_fold(np.array(1.6)))],
        row=1,
        col=2,
    )
    boundary = {"color": theme.LIMIT, "width": 1}
    figure.add_vline(x=0, line=boundary, row=1, col=1)
    figure.add_hline(y=0, line=boundary, row=1, col=2)
    figure.add_vrect(
        x0=0,
        x1=10 * reach,
        fillcolor=theme.LIMIT,
        opacity=0.07,
        line_width=0,
        layer="below",
        row=1,
        col=1,
    )
    figure.add_hrect(
        y0=-20, y1=0, fillcolor=theme.LIMIT, opacity=0.07, line_width=0, layer="below", row=1, col=2
    )
    left, right_half = {"row": 1, "col": 1}, {"row": 1, "col": 2}
    ends = {"xref": "x domain", "yref": "y domain"}
    theme.note(
        figure,
        left,
        f"slow poles ({inside} of {poles.size} in view)",
        0,
        1.0,
        "left",
        "bottom",
        **ends,
    )
    origin = int(poles.size - frequency.size)
    words = "all poles" if origin == 0 else f"all poles but {origin} at the origin"
    theme.note(figure, right_half, words, 0, 1.0, "left", "bottom", **ends)
    if unstable:
        theme.note(
            figure,
            right_half,
            "unstable",
            1,
            0,
            "right",
            "top",
            xref="x domain",
            yref="y2",
            colour=theme.LIMIT,
        )


_MOST_SYSTEMS = 4  # panels that stay legible side by side


def pole_zero_map(systems: Mapping[str, Any], reach: float | None = None) -> Any:
    """A plotly figure with one panel per continuous system: poles as crosses, invariant zeros as
    circles.

    systems: title -> system (minimal, or its hidden poles show as pole and zero in one place).
    reach [rad/s]: the largest modulus shown, the same in all panels (None: up to the widest gap
    between the moduli beyond all unstable ones). Raises InvalidInput for sampled systems, and for
    more than four.
    """
    if not 1 <= len(systems) <= _MOST_SYSTEMS:
        raise invalid(
            "the number of systems", len(systems), f"1 to {_MOST_SYSTEMS}", "draw several maps"
        )
    by_title = {title: as_statespace(system) for title, system in systems.items()}
    for title, system in by_title.items():
        if system.dt is not None:
            raise InvalidInput(
                f"system {title!r} is sampled; a pole-zero map shows continuous systems"
            )
    points = {
        title: (poles_of(system), invariant_zeros(system)) for title, system in by_title.items()
    }
    radius = _reach(points) if reach is None else check_positive(reach, "reach", "in rad/s")
    titles = [theme.plain(title) for title in points]
    figure = theme.subplots(rows=1, cols=len(points), horizontal_spacing=0.3 / (2 + len(points)))
    for column, (title, (crosses, circles)) in enumerate(points.items(), 1):
        _panel(figure, column, theme.plain(title), crosses, circles, radius)
    for kind in ("poles", "zeros"):  # one entry in the legend, of a panel that has some
        traces = [trace for trace in figure.data if trace.name == kind]
        max(traces, key=lambda trace: len(trace.x)).showlegend = True
    theme.dress(figure, 340, legend=True)
    for column, (title, (crosses, _)) in enumerate(zip(titles, points.values(), strict=True), 1):
        verdict, unstable = _where(crosses), bool((crosses.real > 0).any())
        hidden = int((np.abs(crosses) > radius).sum())
        verdict += f" ({hidden} beyond the edge)" if hidden else ""
        figure.add_annotation(
            text=f"<b>{title}</b><br>{verdict}",
            xref="x domain",
            yref="y domain",
            x=0,
            y=1.02,
            xanchor="left",
            yanchor="bottom",
            showarrow=False,
            align="left",
            row=1,
            col=column,
            font={"size": 13, "color": theme.LIMIT if unstable else theme.INK},
        )
    figure.update_layout(margin_t=70)
    return figure


def _panel(
    figure: Any, column: int, title: str, crosses: np.ndarray, circles: np.ndarray, radius: float
) -> None:
    place = {"row": 1, "col": column}
    kinds = (("poles", crosses, "x-thin", theme.INK), ("zeros", circles, "circle-open", "#0072b2"))
    for kind, values, symbol, colour in kinds:
        inside = values[np.abs(values) <= radius]
        unstable = inside.real > 0
        colours = [theme.LIMIT if bad and kind == "poles" else colour for bad in unstable]
        theme.scatter(
            figure,
            place,
            drawn(inside.real),
            drawn(inside.imag),
            kind,
            mode="markers",
            marker={
                "symbol": symbol,
                "size": 10,
                "color": colours,
                "line": {"width": 1.8, "color": colours},
            },
            hovertemplate=f"{title}<br>%{{x:.5g}} %{{y:+.5g}}j rad/s<extra>{kind}</extra>",
        )
    edge = 1.08 * radius
    figure.update_xaxes(title_text="Real part [rad/s]", range=[-edge, edge], **place)
    figure.update_yaxes(
        title_text="Imaginary part [rad/s]" if column == 1 else None, range=[-edge, edge], **place
    )
    figure.add_vline(x=0, line={"color": theme.LIMIT, "width": 1}, **place)
    figure.add_vrect(
        x0=0, x1=edge, fillcolor=theme.LIMIT, opacity=0.07, line_width=0, layer="below", **place
    )
    if not circles.size:
        theme.note(
            figure,
            place,
            "no finite zero",
            0.98,
            0.02,
            "right",
            "bottom",
            xref="x domain",
            yref="y domain",
        )


def _reach(points: Mapping[str, tuple[np.ndarray, np.ndarray]]) -> float:
    """The radius [rad/s]: before the widest gap between neighbouring moduli beyond every unstable
    pole.
    """
    everything = np.concatenate([crosses for crosses, _ in points.values()])
    moduli = np.sort(np.abs(everything[np.abs(everything) > 0]))
    if not moduli.size:
        return 1.0
    least = float(np.abs(everything[everything.real > 0]).max(initial=moduli[0]))
    outer = moduli[moduli >= least]
    if outer.size < 2:
        return 1.1 * float(moduli[-1])
    return 1.1 * float(outer[int(np.argmax(outer[1:] / outer[:-1]))])


def describe(title: str, system: Any) -> str:
    """One sentence on where the poles lie, for a text or a table: how many right of the axis, and
    the rightmost.
    """
    values = poles_of(system)
    if not values.size:
        return f"{title}: no pole"
    rightmost = values[int(np.argmax(values.real))]
    return (
        f"{title}: {_where(values)}, rightmost {theme.number(rightmost.real)} "
        f"{rightmost.imag:+.3g}j rad/s"
    )


def _where(values: np.ndarray) -> str:
    count = int((values.real > 0).sum())
    return (
        f"{count} of {values.size} poles right of the axis"
        if count
        else f"all {values.size} poles left of the axis"
    )


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
        raise InvalidInput("a figure has no curves; give at least one (label, Curve)")
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
            wanted = f"{first.kind} in {first.y_unit or '-'} over {first.x_unit}, as the first"
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
            if name not in panel.names or (name == ONCE and is_map(curve)):
                continue  # the line of the speed itself is part of the map's furniture
            y = values * axes.y_factor
            words = f"{theme.plain(label)}<br>{theme.plain(theme.axis_name(name))}"
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
        _map_furniture(figure, panel, axes, named=not _crowded(panel, axes))
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
    return f" · within {_AGREEMENT:.0%} up to {theme.quantity(float(curve.x[apart[0]]), 'rad/s')}"


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
    where = theme.join(
        theme.number(float(curve.x[largest]) * axes.x_factor),
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


def _map_furniture(figure: Any, panel: Panel, axes: Axes, *, named: bool) -> None:
    """On a map over speed: the synchronous line (frequency = speed), dotted and grey, as no mode
    is; named: on the line, where no name stands at its end.
    """
    place = {"row": panel.row, "col": panel.column}
    high = min(axes.x_range[1] / 60, axes.y_range[1])
    low = min(axes.x_range[0] / 60, high)
    theme.guide(
        figure,
        place,
        [low * 60, high * 60],
        [low, high],
        color=theme.MUTED,
        width=1.6,
        dash="2px,3px",
    )
    if named or ONCE not in panel.names:
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
            theme.plain(theme.axis_name(name)),
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
        # out to where the names at the lines' ends reach: on a phone the unit stands to the left
        room = figure.layout["margin"]["r"] - theme.RIGHT
        text, place = theme.plain(words), {"xref": "paper", "yref": "paper", "xshift": room}
        theme.note(figure, {}, text, 1, 1, "right", "bottom", **place)


def _panel_title(figure: Any, panel: Panel, axes: Axes, *, many: bool) -> None:
    """The unit (and the line's name where there are several panels) above the panel's upper left
    corner.
    """
    words = [theme.plain(theme.axis_name(panel.names[0]))] if many else []
    if axes.y_unit:
        words.append(f"[{axes.y_unit}]")
    text = f"<b>{words[0]}</b> {' '.join(words[1:])}" if many else " ".join(words)
    theme.heading(figure, {"row": panel.row, "col": panel.column}, text, yshift=1)
