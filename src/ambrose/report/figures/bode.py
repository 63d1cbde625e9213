"""Bode diagrams: magnitude and phase of a system or a measured response, a line for each axis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import FrequencyResponse
from ambrose.core.statespace import StateSpace, poles
from ambrose.judge.loop_response import add_poles
from ambrose.record.record import signal_dimension
from ambrose.report import theme, units
from ambrose.report.figures.axes import drawn

# entries drawn one by one; of a larger matrix that is not square only the largest singular value
_MOST = 8
_NONE = 1e-9  # a gain this small beside the largest is none
_DECADES = 6.0  # of magnitude that are shown
_HEIGHT = 430  # [px]
_CROSS = theme.Style("#9aa5ad", "solid", "x", 1.3)


class Line(NamedTuple):
    """One line of the diagram: gain (w,) at omega (w,) [rad/s], complex, or real and positive where
    it has no phase.
    """

    name: str
    omega: np.ndarray
    gain: np.ndarray


def grid_of(system: StateSpace, points: int = 600) -> np.ndarray:
    """Frequencies [rad/s] that show a system: 0.1 Hz to 5 kHz (beyond for faster poles), dense
    around resonances; below half the sample rate.
    """
    values = poles(system)
    if system.dt is not None:
        with np.errstate(divide="ignore"):
            values = np.log(values.astype(complex)) / system.dt
    moduli = np.abs(values[np.isfinite(values)])
    low = 0.1 * units.TWO_PI
    high = float(np.clip(3 * moduli.max(initial=0.0), 5e3 * units.TWO_PI, 1e5 * units.TWO_PI))
    if system.dt is not None:
        high = 0.999 * np.pi / system.dt
        low = min(low, high / 100)
    return add_poles(np.geomspace(low, high, points), values[np.isfinite(values)])


def entries(response: FrequencyResponse) -> list[Line]:
    """The lines of one transfer matrix: the direct entries of a square one and the largest of the
    others; else every entry, or the largest singular value where there are many.
    """
    values, omega = response.values, response.omega
    if values.ndim != 3:
        raise InvalidInput(
            f"the response is a stack of shape {values.shape[:-3]}; draw its members one by one"
        )
    outputs, inputs = values.shape[1:]
    if outputs == inputs:
        lines = _merged([Line(_direct(response, i), omega, values[:, i, i]) for i in range(inputs)])
        cross = np.abs(values[:, ~np.eye(inputs, dtype=bool)]).max(axis=1, initial=0.0)
        if cross.max(initial=0.0) > _NONE * np.abs(values).max():
            lines.append(Line("largest cross coupling", omega, cross))
        return lines
    if outputs * inputs > _MOST:
        return [Line("largest singular value", omega, response.max_singular_value())]
    names = [(i, j) for i in range(outputs) for j in range(inputs)]
    return [
        Line(
            f"{units.axis_name(response.inputs[j])} → {units.axis_name(response.outputs[i])}",
            omega,
            values[:, i, j],
        )
        for i, j in names
    ]


def _merged(lines: Sequence[Line]) -> list[Line]:
    """Lines that are the same become one, which has all their names: four equal axes are no four
    lines.
    """
    result: list[Line] = []
    for line in lines:
        scale = _NONE * np.abs(line.gain).max(initial=0.0)
        same = next(
            (
                i
                for i, other in enumerate(result)
                if np.abs(other.gain - line.gain).max(initial=0.0) <= scale
            ),
            None,
        )
        if same is None:
            result.append(line)
        else:
            result[same] = result[same]._replace(name=f"{result[same].name}, {line.name}")
    return result


def _direct(response: FrequencyResponse, i: int) -> str:
    """ "A ζ" for a pair such as err_A_zeta and u_A_zeta, else both names."""
    source, target = response.inputs[i], response.outputs[i]
    axis = target.partition("_")[2]
    if axis and axis == source.partition("_")[2]:
        return units.axis_name(axis)
    return f"{units.axis_name(source)} → {units.axis_name(target)}"


def unit_of(response: FrequencyResponse) -> str:
    """The SI unit of all entries, "A/m", by the prefixes of the signals' names; "" where they do
    not tell.
    """
    try:
        output, input = (
            signal_dimension(n.replace("err_", "y_", 1)).unit
            for n in (response.outputs[0], response.inputs[0])
        )
    except InvalidInput:
        return ""
    return f"{output}/{input}" if output != input else ""


def bode_figure(
    lines: Sequence[Line],
    unit: str = "",
    *,
    sample_time: float | None = None,
    style: Mapping[str, theme.Style] | None = None,
) -> Any:
    """Magnitude and, of complex gains, phase over frequency. sample_time [s]: half of its rate is
    marked. Returns a Figure.
    """
    phased = [line for line in lines if np.iscomplexobj(line.gain)]
    looks = dict(theme.styles([line.name for line in phased])) if style is None else dict(style)
    figure = theme.subplots(
        rows=2 if phased else 1,
        cols=1,
        row_heights=[0.62, 0.38] if phased else None,
        shared_xaxes=True,
        vertical_spacing=0.06,
    )
    sizes = [np.abs(line.gain) for line in lines]
    top = max(float(size.max(initial=0.0)) for size in sizes) or 1.0
    factor, shown_unit = units.scale(unit, top)
    for line, size in zip(lines, sizes, strict=True):
        look = looks.get(line.name, _CROSS)
        pictures = [(1, size * factor, shown_unit)]
        if line in phased:
            pictures.append((2, phase(line.gain), "°"))
        for row, y, name in pictures:
            hover = f"{theme.plain(line.name)}<br>%{{x:.4g}} Hz · %{{y:.4g}} {name}<extra></extra>"
            theme.scatter(
                figure,
                {"row": row, "col": 1},
                drawn(line.omega / units.TWO_PI),
                drawn(y),
                line.name,
                shown=row == 1,
                line=look.line,
                hovertemplate=hover,
            )
    theme.dress(figure, _HEIGHT if phased else 300, legend=True)
    omega = np.concatenate([line.omega for line in lines])
    low = max(
        min(float(size[size > 0].min(initial=top)) for size in sizes) / 1.3, top / 10**_DECADES
    )
    figure.update_xaxes(
        **theme.decades(float(omega.min()) / units.TWO_PI, float(omega.max()) / units.TWO_PI)
    )
    figure.update_xaxes(title_text="Frequency [Hz]", row=2 if phased else 1, col=1)
    figure.update_yaxes(
        title_text=f"Magnitude [{shown_unit}]" if shown_unit else "Magnitude",
        **theme.decades(low * factor, 1.5 * top * factor),
        row=1,
        col=1,
    )
    if phased:
        figure.update_yaxes(
            title_text="Phase [°]", row=2, col=1, **_degrees([phase(line.gain) for line in phased])
        )
    if sample_time is not None:
        figure.add_vline(
            x=0.5 / sample_time, line={"color": theme.LIMIT, "width": 1.2, "dash": "1.5px,2px"}
        )
    return figure


def phase(gain: np.ndarray) -> np.ndarray:
    """The phase [°] of gain (w,), unwrapped, begun within -270 to 90: what begins around -180 stays
    on one side.
    """
    angle = np.degrees(np.unwrap(np.angle(gain)))
    return angle - 360.0 * np.ceil((angle[0] - 90.0) / 360.0) if len(angle) else angle


def _degrees(angles: Sequence[np.ndarray]) -> dict[str, Any]:
    """Range and ticks of an axis of phases."""
    low = 90 * np.floor(min(float(angle.min()) for angle in angles) / 90)
    high = 90 * np.ceil(max(float(angle.max()) for angle in angles) / 90)
    high = max(high, low + 90)
    step = next((step for step in (90, 180, 360, 720) if (high - low) / step <= 5), 1440)
    return {"range": [low - 8, high + 8], "dtick": step, "tick0": 0}
