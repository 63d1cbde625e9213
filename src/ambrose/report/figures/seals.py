"""Identification of seals in pictures: frequency responses with coherence, coefficients over
frequency and over pressure.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import FrequencyResponse
from ambrose.identification.frf_spectral import Frf
from ambrose.identification.parameters import COVERAGE
from ambrose.identification.seal.by_pressure import COEFFICIENTS, Line, SealFit
from ambrose.report import theme
from ambrose.report.figures.bode import phase

_NAMES = {
    "K": "K, direct stiffness",
    "k": "k, cross-coupled stiffness",
    "C": "C, direct damping",
    "c": "c, cross-coupled damping",
}
_MEASURED, _BAND = "#0072b2", "rgba(0,114,178,0.22)"
_CONFIDENCE, _PREDICTION = "rgba(0,114,178,0.30)", "rgba(0,114,178,0.12)"
_MARK = {"dash": "dash", "color": theme.MUTED, "width": 1.2}
_TRUTH = theme.Style(theme.INK, "2px,3px", "x", 1.4)

Truth = Callable[[float], np.ndarray]  # pressure [Pa] -> K, k, C, c


def response_figure(
    measured: Mapping[str, Frf],
    models: Mapping[str, Mapping[str, FrequencyResponse]],
    *,
    valid_to: Mapping[str, float] | None = None,
    points: bool = False,
    unit: str = "m/A",
) -> Any:
    """Magnitude, phase and, where it is known, coherence of measured responses, a column for each,
    models on the same lines and their error.

    The error is |model - measured| over |measured|; the pale band is the measurement's own, 95 %.

    measured: title -> Frf of one input and one output; models: title -> label -> response.
    valid_to: title -> frequency [rad/s] marked by a dashed line. points: draw the measured lines as
    points (stepped sines). unit: SI, of the values. Raises InvalidInput.
    """
    if not measured:
        raise InvalidInput("no measured response was given; a figure needs at least one")
    titles = [f"<b>{theme.plain(title)}</b>" for title in measured]
    # an analyser's file need not hold the coherence
    rows = 4 if any(np.isfinite(item.coherence).any() for item in measured.values()) else 3
    figure = theme.subplots(
        rows=rows,
        cols=len(measured),
        row_heights=[0.4, 0.22, 0.22, 0.16][:rows],
        shared_xaxes=True,
        shared_yaxes="rows",
        horizontal_spacing=0.02,
        vertical_spacing=0.04,
        subplot_titles=titles,
    )
    labels = list(dict.fromkeys(label for each in models.values() for label in each))
    look = dict(zip(labels, theme.candidate_styles(labels).values(), strict=True))
    sizes = [np.abs(item.values[:, 0, 0]) for item in measured.values()]
    factor, unit = theme.scale(unit, float(max(size.max() for size in sizes)))
    for column, (title, item) in enumerate(measured.items(), 1):
        if item.values.shape[1:] != (1, 1):
            raise InvalidInput(
                f"the response {title!r} has {item.values.shape[1:]} entries, but must have one; "
                "select() it"
            )
        _measured(figure, item, factor, column, points)
        for label, model in models.get(title, {}).items():
            _modelled(figure, item, model, label, look[label], factor, column)
        if valid_to and title in valid_to:
            for row in range(1, rows + 1):
                figure.add_vline(x=valid_to[title] / theme.TWO_PI, row=row, col=column, line=_MARK)
    theme.dress(figure, 620 if rows == 4 else 520, legend=True)
    _response_axes(figure, measured, sizes, factor, unit, rows)
    return figure


def _measured(figure: Any, item: Frf, factor: float, column: int, points: bool) -> None:
    f, value = item.omega / theme.TWO_PI, item.values[:, 0, 0]
    size, angle = np.abs(value), phase(value)
    half = item.radius()[:, 0, 0]
    slack = np.degrees(np.arcsin(np.minimum(half / np.maximum(size, 1e-300), 1.0)))
    low = np.maximum(size - half, 1e-3 * size) * factor
    theme.band(figure, {"row": 1, "col": column}, f, low, (size + half) * factor, _BAND)
    theme.band(figure, {"row": 2, "col": column}, f, angle - slack, angle + slack, _BAND)
    theme.band(
        figure, {"row": 3, "col": column}, f, np.full(len(f), 1e-3), 100 * half / size, _BAND
    )
    look = theme.Style(_MEASURED, "solid", "circle", 1.3)
    coherence = ((4, item.coherence[:, 0]),) if np.isfinite(item.coherence).any() else ()
    for row, y in ((1, size * factor), (2, angle), *coherence):
        place, in_legend = {"row": row, "col": column}, column == 1 and row == 1
        _line(figure, place, f, y, "measured, with 95 %", look, shown=in_legend, points=points)


def _modelled(
    figure: Any,
    item: Frf,
    model: FrequencyResponse,
    label: str,
    look: theme.Style,
    factor: float,
    column: int,
) -> None:
    f, value = model.omega / theme.TWO_PI, model.values[:, 0, 0]
    in_legend = not any(
        trace.name == theme.plain(label) and trace.showlegend for trace in figure.data
    )
    _line(
        figure, {"row": 1, "col": column}, f, np.abs(value) * factor, label, look, shown=in_legend
    )
    near = phase(item.values[:, 0, 0])
    angle = phase(value)
    if len(angle) == len(near):
        angle = angle + 360 * np.round((near - angle) / 360)  # the branch of the measured phase
    _line(figure, {"row": 2, "col": column}, f, angle, label, look)
    if len(angle) == len(near):
        _line(
            figure,
            {"row": 3, "col": column},
            f,
            100 * np.abs(value / item.values[:, 0, 0] - 1),
            label,
            look,
        )


def _response_axes(
    figure: Any,
    measured: Mapping[str, Frf],
    sizes: Sequence[np.ndarray],
    factor: float,
    unit: str,
    rows: int,
) -> None:
    low = min(float(np.quantile(size, 0.02)) for size in sizes) * factor / 2
    high = max(float(size.max()) for size in sizes) * factor * 1.6
    f = np.concatenate([item.omega for item in measured.values()]) / theme.TWO_PI
    figure.update_xaxes(**theme.decades(float(f.min()), float(f.max())))
    figure.update_xaxes(title_text="Frequency [Hz]", row=rows)
    angles = np.concatenate([phase(item.values[:, 0, 0]) for item in measured.values()])
    turn = [90 * np.floor(float(angles.min()) / 90), 90 * np.ceil(float(angles.max()) / 90)]
    for column in range(1, len(measured) + 1):
        figure.update_yaxes(**theme.decades(low, high), row=1, col=column)
        figure.update_yaxes(**theme.decades(0.03, 30), row=3, col=column)
    figure.update_yaxes(title_text=f"[{unit}]" if unit else "Magnitude", row=1, col=1)
    figure.update_yaxes(
        title_text="Phase [°]",
        range=turn,
        dtick=90 if turn[1] - turn[0] <= 450 else 180,
        row=2,
        col=1,
    )
    figure.update_yaxes(title_text="Error [%]", row=3, col=1)
    if rows == 4:
        figure.update_yaxes(title_text="Coherence", range=[0, 1.05], dtick=0.5, row=4, col=1)


def frequency_figure(
    fit: SealFit,
    constants: SealFit | None = None,
    *,
    truth: Truth | None = None,
    valid_to: float | None = None,
) -> Any:
    """K, k, C, c over frequency, a colour for each pressure, with 95 % bars (P4, Fig. 12).

    constants: one row per pressure, drawn as lines (seal_result.averaged). truth: pressure -> K, k,
    C, c, dashed. valid_to [rad/s]: marked; coefficients beyond do not choose the view. The grey
    crosses are what was found without pressure and taken off. Raises InvalidInput for a fit without
    frequencies.
    """
    if np.isnan(fit.frequency).any():
        raise InvalidInput("the fit has no frequencies; draw it with pressure_figure")
    figure = _four_panels()
    labels = [theme.quantity(float(p), "Pa") for p in fit.pressures]
    style = theme.styles(labels)
    for number, letter in enumerate(COEFFICIENTS):
        place = {"row": number // 2 + 1, "col": number % 2 + 1}
        factor, unit = theme.coefficient_scale(letter)
        shift = np.linspace(-0.6, 0.6, len(labels)) if len(labels) > 1 else np.zeros(1)
        if fit.systematic.any():
            one = fit.at(float(fit.pressures[0]))
            look = theme.Style("#9aa5ad", "solid", "x-thin", 1.0)
            f, error = one.frequency / theme.TWO_PI, one.systematic[:, number] * factor
            _points(
                figure,
                place,
                f,
                error,
                None,
                "model's error, taken off",
                look,
                unit,
                shown=number == 0,
            )
        for label, pressure, move in zip(labels, fit.pressures.tolist(), shift, strict=True):
            one = fit.at(pressure)
            values, deviations = one.column(letter)
            f = one.frequency / theme.TWO_PI
            bars = COVERAGE * deviations * factor
            _points(
                figure,
                place,
                f + move,
                values * factor,
                bars,
                label,
                style[label],
                unit,
                shown=number == 0,
            )
            ends = np.array([0.0, f.max()])
            if constants is not None:
                level = np.full(2, constants.at(pressure).column(letter)[0][0] * factor)
                _line(figure, place, ends, level, label, style[label])
            if truth is not None:
                level = np.full(2, truth(pressure)[number] * factor)
                in_legend = bool(number == 0 and pressure == fit.pressures[-1])
                _line(figure, place, ends, level, "truth", _TRUTH, shown=in_legend)
        if valid_to is not None:
            figure.add_vline(x=valid_to / theme.TWO_PI, **place, line=_MARK)
        inside = fit.frequency <= (np.inf if valid_to is None else valid_to * 1.01)
        figure.update_yaxes(
            title_text=f"[{unit}]", range=_view(fit.rows(inside), letter, factor), **place
        )
    theme.dress(figure, 520, legend=True)
    figure.update_xaxes(title_text="Frequency [Hz]", row=2)
    figure.update_xaxes(range=[0, float(fit.frequency.max()) / theme.TWO_PI * 1.03])
    return figure


def pressure_figure(
    fit: SealFit,
    lines: Mapping[str, Line],
    *,
    nominal: float | None = None,
    truth: Truth | None = None,
) -> Any:
    """K, k, C, c over pressure with 95 % bars, regression lines, their confidence and prediction
    bands (P5, Fig. 7).

    lines: coefficient -> Line. nominal [Pa]: the design pressure, dashed. truth: pressure -> K, k,
    C, c.
    """
    figure = _four_panels()
    factor_x, unit_x = theme.scale("Pa")
    top = max(float(fit.pressure.max()), nominal or 0.0) * 1.05
    span = np.linspace(0.0, top, 60)
    for number, letter in enumerate(COEFFICIENTS):
        place = {"row": number // 2 + 1, "col": number % 2 + 1}
        factor, unit = theme.coefficient_scale(letter)
        first = number == 0
        if letter in lines:
            line = lines[letter]
            middle = line.at(span)
            for half, colour, name in (
                (line.prediction(span), _PREDICTION, "next measurement, 95 %"),
                (line.confidence(span), _CONFIDENCE, "true line, 95 %"),
            ):
                low, high = (middle - half) * factor, (middle + half) * factor
                theme.band(figure, place, span * factor_x, low, high, colour, name if first else "")
            ink = theme.Style(theme.INK, "solid", "x", 1.5)
            _line(figure, place, span * factor_x, middle * factor, "regression", ink, shown=first)
        if truth is not None:
            values = np.array([truth(float(p))[number] for p in span]) * factor
            _line(figure, place, span * factor_x, values, "truth", _TRUTH, shown=first)
        values, deviations = fit.column(letter)
        look = theme.Style(_MEASURED, "solid", "circle", 1.5)
        bars = COVERAGE * deviations * factor
        _points(
            figure,
            place,
            fit.pressure * factor_x,
            values * factor,
            bars,
            "identified, 95 %",
            look,
            unit,
            shown=first,
        )
        if nominal is not None:
            figure.add_vline(x=nominal * factor_x, **place, line=_MARK)
        figure.update_yaxes(title_text=f"[{unit}]", **place)
    theme.dress(figure, 520, legend=True)
    figure.update_xaxes(title_text=f"Pressure difference [{unit_x}]", row=2)
    figure.update_xaxes(range=[0, top * factor_x])
    return figure


def _four_panels() -> Any:
    titles = [f"<b>{_NAMES[letter]}</b>" for letter in COEFFICIENTS]
    return theme.subplots(
        rows=2,
        cols=2,
        subplot_titles=titles,
        shared_xaxes=True,
        horizontal_spacing=0.1,
        vertical_spacing=0.1,
    )


def _view(fit: SealFit, letter: str, factor: float) -> list[float]:
    values, deviations = fit.column(letter)
    low, high = (
        float((values - 3 * deviations).min()) * factor,
        float((values + 3 * deviations).max()) * factor,
    )
    low, high = min(low, 0.0), max(high, 0.0)
    margin = 0.08 * (high - low)
    return [low - margin, high + margin]


def _line(
    figure: Any,
    place: Mapping[str, int],
    x: np.ndarray,
    y: np.ndarray,
    name: str,
    look: theme.Style,
    *,
    shown: bool = False,
    points: bool = False,
) -> None:
    theme.scatter(
        figure,
        place,
        np.float32(x),
        np.float32(y),
        name,
        shown=shown,
        mode="lines+markers" if points else "lines",
        marker={"size": 4},
        line=look.line,
        hovertemplate=f"{theme.plain(name)}: %{{x:.4g}} · %{{y:.4g}}<extra></extra>",
    )


def _points(
    figure: Any,
    place: Mapping[str, int],
    x: np.ndarray,
    y: np.ndarray,
    bars: np.ndarray | None,
    name: str,
    look: theme.Style,
    unit: str,
    *,
    shown: bool,
) -> None:
    error = (
        None
        if bars is None
        else {"type": "data", "array": np.float32(bars), "thickness": 1.2, "width": 2}
    )
    theme.scatter(
        figure,
        place,
        np.float32(x),
        np.float32(y),
        name,
        shown=shown,
        mode="markers",
        error_y=error,
        marker={
            "color": look.colour,
            "symbol": look.symbol,
            "size": 6,
            "line": {"color": look.colour, "width": 1.2},
        },
        hovertemplate=f"{theme.plain(name)}: %{{x:.4g}} · %{{y:.4g}} {unit}<extra></extra>",
    )
