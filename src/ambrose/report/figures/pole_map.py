"""Pole-zero maps: several systems side by side in the s-plane, what lies right of the axis marked
and counted.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, check_positive, invalid
from ambrose.core.realisation.zeros import invariant_zeros
from ambrose.core.statespace import as_statespace, poles
from ambrose.report import theme, units
from ambrose.report.figures.axes import drawn

_MOST = 4  # panels that stay legible side by side


def pole_zero_map(systems: Mapping[str, Any], reach: float | None = None) -> Any:
    """A plotly figure with one panel per continuous system: poles as crosses, invariant zeros as
    circles.

    systems: title -> system (minimal, or its hidden poles show as pole and zero in one place).
    reach [rad/s]: the largest modulus shown, the same in all panels (None: up to the widest gap
    between the moduli beyond all unstable ones). Raises InvalidInput for sampled systems, and for
    more than four.
    """
    if not 1 <= len(systems) <= _MOST:
        raise invalid("the number of systems", len(systems), f"1 to {_MOST}", "draw several maps")
    given = {title: as_statespace(system) for title, system in systems.items()}
    for title, system in given.items():
        if system.dt is not None:
            raise InvalidInput(
                f"system {title!r} is sampled; a pole-zero map shows continuous systems"
            )
    points = {title: (poles(system), invariant_zeros(system)) for title, system in given.items()}
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
    values = poles(system)
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
