"""Poles in pictures: of closed loops, the slow ones in the s-plane and all of them as damping ratio
against natural frequency; of several systems, poles and zeros side by side.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, check_positive, invalid
from ambrose.core.realisation.zeros import invariant_zeros
from ambrose.core.statespace import as_statespace
from ambrose.core.statespace import poles as poles_of
from ambrose.judge.checks import Curve
from ambrose.report import theme, units
from ambrose.report.figures.axes import drawn

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
        frequency = np.abs(poles) / units.TWO_PI
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
            (1, poles.real, poles.imag / units.TWO_PI, slice(None)),
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
        f" · least damping ratio {units.number(float(ratio[i]))} at "
        f"{units.number(float(frequency[i]))} Hz"
    )


def _fold(ratio: np.ndarray) -> np.ndarray:
    """Logarithmic far from zero, linear near it, odd: negative damping can be shown."""
    return np.arcsinh(np.asarray(ratio) / _FINE)


def _axes(figure: Any, everything: Sequence[tuple[str, np.ndarray]], reach: float) -> None:
    poles = np.concatenate([p for _, p in everything]) if everything else np.zeros(0)
    frequency = np.abs(poles[np.abs(poles) > 0]) / units.TWO_PI
    inside = int((np.abs(poles) <= reach).sum())
    right = max(0.06 * reach, 1.15 * float(poles.real.max(initial=0.0)))
    figure.update_xaxes(title_text="Real part [1/s]", range=[-reach, right], row=1, col=1)
    figure.update_yaxes(
        title_text="Imaginary part [Hz]",
        range=[-0.03 * reach / units.TWO_PI, reach / units.TWO_PI],
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
        ticktext=[units.number(t) for t in ticks],
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
        f"{title}: {_where(values)}, rightmost {units.number(rightmost.real)} "
        f"{rightmost.imag:+.3g}j rad/s"
    )


def _where(values: np.ndarray) -> str:
    count = int((values.real > 0).sum())
    return (
        f"{count} of {values.size} poles right of the axis"
        if count
        else f"all {values.size} poles left of the axis"
    )
