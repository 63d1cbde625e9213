"""Measured plant beside the identified model over frequency: magnitude, phase, ratio and coherence, with confidence bands."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import frequency_response
from ambrose.core.sampling import c2d
from ambrose.core.statespace import StateSpace, select
from ambrose.identify import frf
from ambrose.identify.checked import CheckedIdentification
from ambrose.identify.frf_validity import compare
from ambrose.identify.moved_plant import plant_at
from ambrose.machine.description import Machine
from ambrose.machine.record import Record
from ambrose.plant.model import Plant
from ambrose.report import theme, units

_LINES = 260  # of a measured curve that are drawn, equally spaced over log frequency
_HEIGHTS = (0.38, 0.22, 0.24, 0.16)
_DECADES = 4.0  # of magnitude that are shown
_RATIO = 30.0  # [%] of the view
_MEASURED, _BAND, _MODEL, _START = "#0072b2", "rgba(0,114,178,0.22)", theme.INK, "#d55e00"


def frf_figure(machine: Machine, checked: CheckedIdentification, per_row: int = 4) -> tuple[Any, str] | None:
    """The plant from the amplifiers' command u + e to the displacements, axis by axis, measured, identified and as it was.

    Measured by the joint input-output method, or None where the records do not allow it (u_ or some excitations are missing, or
    several excitations are the same). With the figure: up to where the model agrees, in words.
    """
    result = checked.result
    records = [piece.record for piece in checked.pieces if _same_point(piece.record, result)]
    axes = machine.axes
    measured = _measured(records, axes)
    if measured is None:
        return None
    values = dict(zip(result.paths, result.values.tolist(), strict=True))
    start = dict(zip(result.paths, result.start.tolist(), strict=True))
    found = _sampled(plant_at(machine, result.point, values, checked.bending_modes), measured.dt)
    before = _sampled(plant_at(machine, result.point, start, checked.bending_modes), measured.dt)
    validity = compare(measured, found)
    figure = _draw(measured, [(found, "identified", _MODEL, "solid"), (before, "start", _START, "6px,3px")], axes, per_row)
    low = float(np.min(np.diag(validity.valid_to)))
    words = (
        f"On every axis the identified model agrees within 10 % and 10° up to {units.quantity(low, 'rad/s')}."
        if low > 0
        else "The identified model leaves the measured response by more than 10 % or 10° from the first frequencies on."
    )
    return figure, words


def _same_point(record: Record, result: Any) -> bool:
    return bool(record.point.seal_pressure == result.point.seal_pressure and record.point.speed == result.point.speed)


def _measured(records: Sequence[Record], axes: Sequence[str]) -> frf.Frf | None:
    if not records:
        return None
    shortest = min(record.values.shape[1] / record.sample_rate_hz for record in records)
    inputs, outputs = [f"v_{axis}" for axis in axes], [f"y_{axis}" for axis in axes]
    try:
        return frf.closed_loop(records, inputs, outputs, segment=min(0.5, shortest / 8))
    except InvalidInput:
        return None


def _sampled(plant: Plant, dt: float) -> StateSpace:
    axes = plant.axes
    return c2d(select(plant.system, [f"u_{axis}" for axis in axes], [f"y_{axis}" for axis in axes]), dt)


def _draw(measured: frf.Frf, models: Sequence[tuple[StateSpace, str, str, str]], axes: Sequence[str], per_row: int) -> Any:
    from plotly.subplots import make_subplots

    shown = axes[:per_row]
    titles = [f"<b>{theme.plain(units.axis_name(axis))}</b>" for axis in shown]
    figure = make_subplots(
        rows=4, cols=len(shown), row_heights=list(_HEIGHTS), shared_xaxes=True, shared_yaxes="rows", horizontal_spacing=0.02,
        vertical_spacing=0.035, subplot_titles=titles,
    )  # fmt: skip
    measured = _visible(measured)
    f = measured.omega / (2 * np.pi)
    kept = _spread(f)
    grid = np.geomspace(f[0], f[-1], 300)
    responses = [
        (frequency_response(model, 2 * np.pi * grid).values, name, colour, dash) for model, name, colour, dash in models
    ]
    radius = measured.radius()
    ratios = [np.abs(frequency_response(model, measured.omega).values) / np.abs(measured.values) for model, _, _, _ in models]
    factor, unit = units.scale("m/A")
    for column, _ in enumerate(shown, 1):
        i = column - 1
        value, half = measured.values[kept, i, i], radius[kept, i, i]
        _band(figure, f[kept], np.abs(value) * factor, half * factor, column)
        _phase(figure, f[kept], value, half, column)
        first = column == 1
        _line(figure, f[kept], np.abs(value) * factor, "measured, 95 %", _MEASURED, 1, column, shown=first)
        for response, name, colour, dash in responses:
            one = response[:, i, i]
            _line(figure, grid, np.abs(one) * factor, name, colour, 1, column, dash, shown=first)
            _line(figure, grid, _degrees(one), name, colour, 2, column, dash)
        for ratio, (_, name, colour, dash) in zip(ratios, models, strict=True):
            _line(figure, f[kept], 100 * (ratio[kept, i, i] - 1), name, colour, 3, column, dash)
        width = 100 * half / np.abs(value)
        _fill(figure, f[kept], -width, width, 3, column)
        _line(figure, f[kept], measured.coherence[kept, i], "coherence", _MEASURED, 4, column)
    figure.update_annotations(font={"size": 13})
    theme.dress(figure, 620, legend=True)
    _axes(figure, measured, f, factor, unit, len(shown))
    return figure


def _axes(figure: Any, measured: frf.Frf, f: np.ndarray, factor: float, unit: str, columns: int) -> None:
    sizes = np.abs(np.diagonal(measured.values, axis1=1, axis2=2)) * factor
    low, high = float(sizes.min()) / 2, float(sizes.max()) * 2
    figure.update_xaxes(**theme.decades(float(f[0]), float(f[-1])))
    figure.update_xaxes(title_text="Frequency [Hz]", row=4)
    for column in range(1, columns + 1):
        figure.update_yaxes(**theme.decades(low, high), row=1, col=column)
    figure.update_yaxes(range=[-390, -90], tickvals=[-360, -270, -180, -90], row=2)
    figure.update_yaxes(range=[-_RATIO, _RATIO], dtick=15, row=3)
    for level in (-10, 10):
        figure.add_hline(y=level, line={"color": theme.LIMIT, "width": 1, "dash": "1.5px,2px"}, row=3)
    figure.update_yaxes(range=[0, 1.05], dtick=0.5, row=4)
    figure.update_yaxes(title_text=f"y per u + e [{unit}]", row=1, col=1)
    figure.update_yaxes(title_text="Phase [°]", row=2, col=1)
    figure.update_yaxes(title_text="Model / meas. [%]", row=3, col=1)
    figure.update_yaxes(title_text="Coherence", row=4, col=1)


def _visible(measured: frf.Frf) -> frf.Frf:
    """The lines up to the last at which an axis still responds within some decades of its largest."""
    sizes = np.abs(np.diagonal(measured.values, axis1=1, axis2=2))
    seen = np.flatnonzero((sizes > sizes.max(axis=0) / 10**_DECADES).all(axis=1))
    return measured.between(float(measured.omega[0]), float(measured.omega[seen[-1] if len(seen) else -1]))


def _degrees(values: np.ndarray) -> np.ndarray:
    """Phase from -390 to -30 degrees: levitated by magnets, a plant begins at -180 and lags to about -360."""
    return (np.degrees(np.angle(values)) + 390) % 360 - 390


def _spread(f: np.ndarray) -> np.ndarray:
    """Lines about equally spaced over log frequency."""
    wanted = np.geomspace(f[0], f[-1], _LINES)
    return np.unique(np.searchsorted(f, wanted).clip(0, len(f) - 1))


def _line(
    figure: Any, x: np.ndarray, y: np.ndarray, name: str, colour: str, row: int, column: int, dash: str = "solid",
    shown: bool = False,
) -> None:  # fmt: skip
    import plotly.graph_objects as go

    width = 1.2 if colour == _MEASURED else 1.6
    hover = f"{name}: %{{x:.4g}} Hz · %{{y:.4g}}<extra></extra>"
    figure.add_trace(
        go.Scatter(
            x=np.float32(x), y=np.float32(y), mode="lines", name=name, legendgroup=name, showlegend=shown,
            line={"color": colour, "width": width, "dash": dash}, hovertemplate=hover,
        ),
        row=row, col=column,
    )  # fmt: skip


def _band(figure: Any, f: np.ndarray, size: np.ndarray, half: np.ndarray, column: int) -> None:
    low, high = np.maximum(size - half, 1e-3 * size), size + half
    _fill(figure, f, low, high, 1, column)


def _phase(figure: Any, f: np.ndarray, value: np.ndarray, half: np.ndarray, column: int) -> None:
    angle = _degrees(value)
    spread = np.degrees(np.arcsin(np.minimum(half / np.maximum(np.abs(value), 1e-300), 1.0)))
    _fill(figure, f, angle - spread, angle + spread, 2, column)
    _line(figure, f, angle, "measured, 95 %", _MEASURED, 2, column)


def _fill(figure: Any, f: np.ndarray, low: np.ndarray, high: np.ndarray, row: int, column: int) -> None:
    import plotly.graph_objects as go

    figure.add_trace(
        go.Scatter(
            x=np.float32(np.r_[f, f[::-1]]), y=np.float32(np.r_[high, low[::-1]]), fill="toself", fillcolor=_BAND,
            line={"width": 0}, mode="lines", showlegend=False, hoverinfo="skip",
        ),
        row=row, col=column,
    )  # fmt: skip
