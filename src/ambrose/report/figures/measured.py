"""Loops as they were measured, a panel for each axis: moduli with their bands, open loops about the
critical point, the residual system of an identification.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ambrose.core.frequency import frequency_response
from ambrose.identification.frf import spectral as frf
from ambrose.identification.youla.identify import ResidualIdentification
from ambrose.judge.checks import Curve
from ambrose.machine.criteria import SENSITIVITY
from ambrose.report import theme, units
from ambrose.report.figures.axes import axes_of, draw_limits, drawn, limit_levels, set_ranges

_MEASURED, _BAND = "#0072b2", "rgba(0,114,178,0.25)"
# of the models
_LOOKS = (
    theme.Style(theme.INK, "solid", "x-thin", 1.3),
    theme.Style("#d55e00", "7px,3px", "x-thin", 1.6),
)
_COLUMNS, _HEIGHT = 2, 230  # panels side by side, [px] of one
_NYQUIST = 2.6  # from the critical point to the edge of the picture


def _grid(count: int, titles: Sequence[str]) -> tuple[Any, list[dict[str, int]]]:
    rows = -(-count // _COLUMNS)
    words = [f"<b>{theme.plain(title)}</b>" for title in titles]
    figure = theme.subplots(
        rows=rows,
        cols=_COLUMNS,
        horizontal_spacing=0.09,
        vertical_spacing=min(0.28 / rows, 0.2),
        subplot_titles=words,
    )
    return figure, [{"row": i // _COLUMNS + 1, "col": i % _COLUMNS + 1} for i in range(count)]


def _runs(told: np.ndarray) -> list[slice]:
    """The runs of neighbouring True in told (w,)."""
    edge = np.diff(np.r_[0, told, 0].astype(int))
    return list(map(slice, np.flatnonzero(edge == 1), np.flatnonzero(edge == -1)))


def panels(
    titles: Sequence[str],
    omega: np.ndarray,
    value: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    models: dict[str, np.ndarray],
    limits: Sequence[tuple[tuple[str, float], ...]],
    told: np.ndarray,
) -> Any:
    """Moduli (w, n) with their intervals over frequency, a panel each with its own limits, models
    (w, n) over them; nothing is drawn where ``told`` (w, n) is False.
    """
    value = np.where(told, value, np.nan)
    figure, places = _grid(len(titles), titles)
    f, looks = omega / units.TWO_PI, dict(zip(models, _LOOKS, strict=False))
    curves = [
        (
            "measured",
            Curve(
                "acceptance",
                "",
                "frequency",
                omega,
                value.T,
                tuple(titles),
                "rad/s",
                "-",
                (),
            ),
        )
    ]
    axes = axes_of(curves)
    line = {"color": _MEASURED, "width": 1.8}
    for i, place in enumerate(places):
        bottom = np.maximum(low[:, i], axes.y_range[0] / 10)
        for number, part in enumerate(_runs(told[:, i])):
            name = "95 %" if i == 0 and number == 0 else ""
            theme.band(figure, place, f[part], bottom[part], high[part, i], _BAND, name)
        theme.scatter(
            figure, place, drawn(f), drawn(value[:, i]), "measured", shown=i == 0, line=line
        )
        for label, rows in models.items():
            theme.scatter(
                figure,
                place,
                drawn(f),
                drawn(rows[:, i]),
                label,
                shown=i == 0,
                line=looks[label].line,
            )
        levels = limit_levels([("measured", replace(curves[0][1], limits=limits[i]))], axes)
        named = i == 0 or limits[i] != limits[i - 1]
        draw_limits(figure, place, levels, axes, size=(410, _HEIGHT - 60), named=named)
    theme.dress(figure, _HEIGHT * places[-1]["row"], legend=True)
    set_ranges(figure, axes)
    figure.update_xaxes(title_text=axes.x_text, row=places[-1]["row"])
    return figure


def nyquist(
    titles: Sequence[str],
    omega: np.ndarray,
    loops: np.ndarray,
    models: dict[str, np.ndarray],
    told: np.ndarray,
) -> Any:
    """Open loops (w, n) about the critical point, a panel each, the models' over them; around it
    the borders of the zones. Nothing is drawn of a loop where ``told`` (w, n) is False.
    """
    loops = np.where(told, loops, np.nan)
    figure, places = _grid(len(titles), titles)
    turn = np.linspace(0, 2 * np.pi, 90)
    for i, place in enumerate(places):
        L = loops[:, i]
        for limit in SENSITIVITY.limits:
            x, y = -1 + np.cos(turn) / limit.value, np.sin(turn) / limit.value
            theme.guide(figure, place, x, y, color=theme.LIMIT, width=1.2, dash="1.5px,2px")
        look = {"color": _MEASURED, "width": 1.8}
        hover = "%{customdata:.4g} Hz<extra>measured</extra>"
        at = omega / units.TWO_PI
        theme.scatter(
            figure,
            place,
            L.real,
            L.imag,
            "measured",
            shown=i == 0,
            line=look,
            customdata=at,
            hovertemplate=hover,
        )
        for (label, model), style in zip(models.items(), _LOOKS, strict=False):
            predicted = model[:, i]
            theme.scatter(
                figure, place, predicted.real, predicted.imag, label, shown=i == 0, line=style.line
            )
        point = {"color": theme.INK, "size": 6, "symbol": "cross"}
        theme.scatter(figure, place, [-1], [0], mode="markers", marker=point, hoverinfo="skip")
        figure.update_xaxes(range=[-1 - _NYQUIST, -1 + _NYQUIST], **place)
        figure.update_yaxes(range=[-_NYQUIST * 0.75, _NYQUIST * 0.75], **place)
    return theme.dress(figure, (_HEIGHT + 60) * places[-1]["row"], legend=True)


_RESIDUAL_BAND, _MEASURED = "rgba(0, 114, 178, 0.18)", "#0072b2"
_WIDE = float(np.sqrt(-np.log(0.05)))  # 95 % of a circular error lies within this times its rms


def residual_figure(result: ResidualIdentification, segment: float = 0.2) -> Any:
    """A plotly figure: |S| of every axis on itself [um/A], measured (H1 from alpha to eps, 95 %
    band) and S(theta) found.

    segment [s]: of the spectra. Where the band reaches the bottom, the axis shows no difference
    from the machine as modelled. Raises InvalidInput where the excitations of the axes cannot be
    told apart.
    """
    factors = result.factors
    measured = frf.h1(result.signals, factors.alpha, factors.eps, segment=segment)
    model = 1e6 * frequency_response(result.residual, measured.omega).values
    f = measured.omega / units.TWO_PI
    axes = [name.removeprefix("alpha_u_") for name in factors.alpha]
    figure = theme.subplots(
        rows=1,
        cols=len(axes),
        shared_yaxes=True,
        horizontal_spacing=0.02,
        subplot_titles=[f"<b>{theme.plain(units.axis_name(axis))}</b>" for axis in axes],
    )
    size, half = 1e6 * np.abs(measured.values), 1e6 * _WIDE * np.sqrt(measured.variance)
    floor = float(np.median(half)) / 10
    for i in range(len(axes)):
        first, place = i == 0, {"row": 1, "col": i + 1}
        low, high = (
            np.maximum(size[:, i, i] - half[:, i, i], floor),
            np.maximum(size[:, i, i] + half[:, i, i], floor),
        )
        theme.band(figure, place, f, low, high, _RESIDUAL_BAND, "95 % band" if first else "")
        for name, values, line in (
            ("measured, no model", size[:, i, i], {"color": _MEASURED, "width": 1.2}),
            ("S(theta) identified", np.abs(model[:, i, i]), {"color": theme.INK, "width": 1.8}),
        ):
            theme.scatter(figure, place, drawn(f), drawn(values), name, shown=first, line=line)
        figure.update_xaxes(
            title_text="Frequency [Hz]", **theme.decades(float(f[0]), float(f[-1])), **place
        )
        figure.update_yaxes(
            **theme.decades(floor, 2 * float(max(size.max(), np.abs(model).max()))), **place
        )
    figure.update_yaxes(title_text="|S| [µm/A]", row=1, col=1)
    return theme.dress(figure, 320, legend=True)
