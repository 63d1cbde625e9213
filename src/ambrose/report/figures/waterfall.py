"""Waterfall: the full spectrum of the whirl over time, forward above and backward below, with the
lines of the speed.

x + i y turns forward at positive and backward at negative frequencies (Bently & Hatch, Fundamentals
of Rotating Machinery Diagnostics, 2002, ch. 8): a circular forward orbit of radius r is r at +f and
nothing at -f.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ambrose.record.record import Record
from ambrose.report import theme, units
from ambrose.report.figures.axes import drawn
from ambrose.report.figures.stations import Station

_COLUMNS, _ROWS = 240, 260  # of one picture
_DECADES = 3.0  # below the largest amplitude
_SHORTEST, _LONGEST = 32, 8192  # samples in a window
_HEIGHT, _GAP = 250, 46  # [px]
_RESONANCE = 1.6  # windows per square root of the sweep rate
_COLOURS = (
    (0.0, "#ffffff"),
    (0.3, "#dbe9f4"),
    (0.55, "#86b8da"),
    (0.8, "#1f6fae"),
    (1.0, "#1c1233"),
)


def waterfall_figure(record: Record, places: Sequence[Station], speed: np.ndarray) -> Any:
    """Amplitude [m] over time and frequency at the bearings (else at the first two stations); speed
    (k,) [rad/s].

    Returns a plotly Figure; None where the record is too short for a spectrum.
    """
    import plotly.graph_objects as go

    shown = [station for station in places if station.bearing][:2] or list(places)[:2]
    turns = speed / (2 * np.pi)
    length = _window(record, turns)
    if len(speed) < 2 * _SHORTEST or length < _SHORTEST:
        return None
    spectra = [spectrum(station, record.sample_rate_hz, length) for station in shown]
    frequency, middle, _ = spectra[0]
    sizes = [size for _, _, size in spectra]
    top = max(float(size.max()) for size in sizes)
    if top <= 0:
        return None
    reach = _reach(frequency, sizes, top, float(np.abs(turns).max()))
    factor, unit = units.scale("m", top)
    kept = np.flatnonzero(np.abs(frequency) <= reach)
    pool = max(1, int(np.ceil(len(kept) / _ROWS)))
    kept = kept[: len(kept) // pool * pool]
    rows = frequency[kept].reshape(-1, pool).mean(axis=1)
    time = record.start_time + middle / record.sample_rate_hz
    seconds, second = units.seconds_or_milliseconds(float(record.time[-1] - record.time[0]))
    total = _HEIGHT * len(shown) + _GAP * (len(shown) - 1)
    figure = theme.subplots(
        rows=len(shown), cols=1, shared_xaxes=True, vertical_spacing=_GAP / total
    )
    for i, (station, size) in enumerate(zip(shown, sizes, strict=True)):
        place = {"row": i + 1, "col": 1}
        level = size[kept].reshape(-1, pool, size.shape[1]).max(axis=1) * factor
        level = np.log10(np.maximum(level, top * factor * 10 ** (-_DECADES - 1)))
        hover = f"%{{x:.4g}} {second} · %{{y:.4g}} Hz · %{{customdata:.3g}} {unit}<extra></extra>"
        figure.add_trace(
            go.Heatmap(
                x=drawn(time * seconds),
                y=drawn(rows),
                z=drawn(level),
                customdata=drawn(10**level),
                coloraxis="coloraxis",
                hovertemplate=hover,
            ),
            **place,
        )
        _speed_lines(figure, place, record, turns, reach, seconds)
        theme.heading(figure, place, f"<b>{station.title}</b> [Hz]")
    theme.dress(figure, total, legend=False)
    high = np.log10(top * factor)
    ticks = np.arange(np.ceil(high - _DECADES), np.floor(high) + 1)
    figure.update_layout(
        margin={"r": 110},
        coloraxis={
            "colorscale": [list(pair) for pair in _COLOURS],
            "cmin": high - _DECADES,
            "cmax": high,
            "colorbar": {
                "title": {"text": f"radius [{unit}]", "side": "right"},
                "tickvals": ticks.tolist(),
                "ticktext": [units.number(10.0**t) for t in ticks],
                "thickness": 14,
                "outlinewidth": 0,
                "x": 1.03,
                "len": 0.95,
            },
        },
    )
    figure.update_yaxes(range=[-reach, reach], showgrid=False)
    figure.update_xaxes(
        showgrid=False, range=[float(record.time[0]) * seconds, float(record.time[-1]) * seconds]
    )
    _time_axis(figure, record, turns, seconds, second, len(shown))
    return figure


def spectrum(
    station: Station, rate: float, length: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frequencies (m,) [Hz] from negative to positive, middles of the windows (n,) [samples],
    amplitudes (m, n) [m].

    Hann windows, padded four times: an amplitude between two frequencies of the grid is 1 % low at
    most.
    """
    k = len(station.x)
    starts = np.unique(np.linspace(0, k - length, min(_COLUMNS, k - length + 1)).astype(int))
    weight, ramp = np.hanning(length), np.linspace(-1.0, 1.0, length)
    n = 2 ** int(np.ceil(np.log2(4 * length)))
    sizes = np.empty((n, len(starts)), dtype=np.float32)
    for j, start in enumerate(starts):
        z = station.x[start : start + length] + 1j * station.y[start : start + length]
        z = (
            z
            - (weight @ z) / weight.sum()
            - ramp * ((weight * ramp) @ z) / ((weight * ramp) @ ramp)
        )  # static and drifting part
        sizes[:, j] = np.abs(np.fft.fftshift(np.fft.fft(z * weight, n))) / weight.sum()
    return np.fft.fftshift(np.fft.fftfreq(n, 1 / rate)), starts + length / 2, sizes


def _window(record: Record, turns: np.ndarray) -> int:
    """Samples in a window: what a sweep resolves best (its rate [Hz/s] to -1/2), or an eighth of
    the record.
    """
    k = len(turns)
    duration = k / record.sample_rate_hz
    sweep = float(np.ptp(turns)) / duration
    seconds = min(_RESONANCE / np.sqrt(sweep), duration / 6) if sweep > 0 else duration / 8
    return int(
        np.clip(seconds * record.sample_rate_hz, min(_SHORTEST, k // 2), min(_LONGEST, k // 2))
    )


def _reach(frequency: np.ndarray, sizes: Sequence[np.ndarray], top: float, fastest: float) -> float:
    """The highest frequency [Hz] worth showing: twice the speed, and all that is within the visible
    decades.
    """
    visible = np.max([size.max(axis=1) for size in sizes], axis=0) > top * 10 ** (0.5 - _DECADES)
    highest = float(np.abs(frequency[visible]).max())
    return min(float(frequency.max()), 1.15 * max(highest, 2.05 * fastest, 20.0))


def _speed_lines(
    figure: Any,
    place: dict[str, int],
    record: Record,
    turns: np.ndarray,
    reach: float,
    seconds: float,
) -> None:
    """1x and 2x the speed, forward, and 1x backward."""
    if not np.any(turns):
        return
    at = np.unique(np.linspace(0, len(turns) - 1, 200).astype(int))
    for order, dash in ((1, "7px,4px"), (2, "2px,3px"), (-1, "7px,4px")):
        y = np.where(np.abs(order * turns[at]) <= reach, order * turns[at], np.nan)
        theme.guide(
            figure,
            place,
            drawn(record.time[at] * seconds),
            drawn(y),
            color="#d55e00",
            width=1.1,
            dash=dash,
        )
        end = int(np.flatnonzero(np.isfinite(y))[-1])
        figure.add_annotation(
            x=float(record.time[at[end]] * seconds),
            y=float(y[end]),
            text=f"{order}×".replace("-", "−"),
            showarrow=False,
            xanchor="left" if end == len(at) - 1 else "right",
            yanchor="middle" if end == len(at) - 1 else "top",
            xshift=3,
            font={"size": 12, "color": "#d55e00"},
            **place,
        )


def _time_axis(
    figure: Any, record: Record, turns: np.ndarray, seconds: float, second: str, rows: int
) -> None:
    """Times below the lowest picture; with a speed that changes, the speed beneath each."""
    if np.ptp(turns) == 0:
        figure.update_xaxes(title_text=f"Time [{second}]", row=rows, col=1)
        return
    low, high = float(record.time[0]), float(record.time[-1])
    step = 10 ** np.floor(np.log10((high - low) / 4))
    step *= next(m for m in (5, 2, 1) if (high - low) / (m * step) >= 4)
    ticks = np.arange(np.ceil(low / step) * step, high + step / 100, step)
    rpm = np.interp(ticks, record.time, turns * 60)
    texts = [
        f"{units.number(t * seconds)}<br>{units.number(r)}" for t, r in zip(ticks, rpm, strict=True)
    ]
    figure.update_xaxes(
        title_text=f"Time [{second}] and, beneath, rotational speed [rpm]",
        tickvals=(ticks * seconds).tolist(),
        ticktext=texts,
        row=rows,
        col=1,
    )
    figure.update_layout(height=figure.layout.height + 16, margin={"b": 64})
