"""Bode diagrams: magnitude and phase of a system or a measured response, a line for each axis."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import FrequencyResponse, frequency_response
from ambrose.core.statespace import StateSpace, poles
from ambrose.identification import frf_spectral as frf
from ambrose.identification.youla import ResidualIdentification
from ambrose.judge.checks import Curve
from ambrose.judge.loop_response import add_poles
from ambrose.law.pid import (
    DERIVATIVE_FILTER,
    chain,
    channel_chains,
    channel_names,
    section_matrix,
    section_text,
    theta_system,
)
from ambrose.machine.criteria import SENSITIVITY
from ambrose.machine.part import PidSettings, Section
from ambrose.record.record import signal_dimension
from ambrose.report import theme
from ambrose.report.figures.curves import (
    Axes,
    axes_of,
    beyond,
    draw_limits,
    drawn,
    limit_levels,
    mark_peak,
    set_ranges,
)

# Small multiples: a grid of panels with common axes, so that the eye compares columns; the same
# look as every other figure.


Labelled = tuple[tuple[str, Curve], ...]

_WIDTH = 900  # [px], of all panels of a row together, about
_LEAST_GAP, _TITLE_GAP = 16, 40  # [px] between rows, without and with titles between them
_LINE, _CHARACTER = 16, 7.0  # [px] height of a line of notes; width of a character


@dataclass(frozen=True, slots=True, eq=False)
class Panel:
    """One plot area: (label, Curve) pairs, every line drawn in its label's style.

    title stands above its left corner, beneath it the notes, (label, text) pairs, each in its
    label's colour. side: what its row shows, beside the axis of the first panel of the row.
    """

    title: str
    curves: Labelled
    notes: tuple[tuple[str, str], ...] = ()
    side: str = ""


def panel_figure(
    rows: Sequence[Sequence[Panel]],
    style: Mapping[str, theme.Style],
    *,
    height: int = 260,
    view: Labelled = (),
    span: tuple[float, float] | None = None,
    mark_peaks: bool = False,
) -> tuple[Any, str]:
    """The plotly figure of a grid of panels, and what lies beyond its view in words ("" when
    nothing).

    rows: the panels, row by row, the curves all of one kind and unit; a row may end early. height
    [px] of a row. view: the curves that choose the range of y where not all are to (default: all).
    span: the visible range of x (SI unit; default: all). mark_peaks: a circle at every line's
    maximum.
    """
    everything = tuple(pair for row in rows for panel in row for pair in panel.curves)
    axes = axes_of(everything, view=view)
    if span is not None:
        axes = replace(axes, x_range=(span[0] * axes.x_factor, span[1] * axes.x_factor))
    columns = max(len(row) for row in rows)
    width = _WIDTH // columns
    above = [max(_lines_above(panel, width) for panel in row) for row in rows]
    gaps = [_LEAST_GAP if lines == 0 else _TITLE_GAP + _LINE * (lines - 1) for lines in above[1:]]
    total = height * len(rows) + sum(gaps)
    figure = theme.subplots(
        rows=len(rows),
        cols=columns,
        horizontal_spacing=0.028,
        specs=[[{} if j < len(row) else None for j in range(columns)] for row in rows],
    )
    _set_heights(figure, rows, height / total, [gap / total for gap in gaps])
    levels = limit_levels(everything, axes)
    in_legend: set[str] = set()
    for i, row in enumerate(rows):
        for j, panel in enumerate(row):
            place = {"row": i + 1, "col": j + 1}
            _draw(figure, panel, place, axes, style, in_legend, mark_peaks=mark_peaks)
            draw_limits(figure, place, levels, axes, size=(width, height), named=i == j == 0)
            _words(figure, panel, place, style, width, above[i])
    theme.dress(figure, total, legend=len(in_legend) > 1, lines=max(0, above[0] - 1))
    _scale(figure, rows, axes)
    return figure, beyond(everything, axes)


def _draw(
    figure: Any,
    panel: Panel,
    place: dict[str, int],
    axes: Axes,
    style: Mapping[str, theme.Style],
    in_legend: set[str],
    *,
    mark_peaks: bool,
) -> None:
    for label, curve in panel.curves:
        look = style[label]
        grid = _abscissae(curve.x * axes.x_factor)
        for name, row in zip(curve.labels, curve.y, strict=True):
            y = row * axes.y_factor
            words = "<br>".join(
                theme.plain(theme.axis_name(part)) for part in dict.fromkeys((label, name))
            )
            hover = f"{words}<br>%{{x:.4g}} · %{{y:.4g}} {axes.y_unit}<extra></extra>"
            theme.scatter(
                figure,
                place,
                y=drawn(y),
                label=label,
                shown=label not in in_legend,
                line=look.line,
                hovertemplate=hover,
                **grid,
            )
            in_legend.add(label)
            if mark_peaks:
                mark_peak(figure, place, curve.x * axes.x_factor, y, look)


def _abscissae(x: np.ndarray) -> dict[str, Any]:
    """x as plotly takes it: start and step where the steps are equal, which halves the weight of a
    time response.
    """
    if len(x) > 2:
        step = (x[-1] - x[0]) / (len(x) - 1)
        if np.allclose(x, x[0] + step * np.arange(len(x)), rtol=0, atol=1e-6 * abs(step)):
            return {"x": None, "x0": float(x[0]), "dx": float(step)}
    return {"x": drawn(x)}


def _set_heights(
    figure: Any, rows: Sequence[Sequence[Panel]], height: float, gaps: Sequence[float]
) -> None:
    """Rows of one height, each gap its own (fractions of the whole)."""
    top = 1.0
    for i, row in enumerate(rows):
        for j in range(len(row)):
            figure.get_subplot(i + 1, j + 1).yaxis.domain = (max(top - height, 0.0), top)
        top -= height + (gaps[i] if i < len(gaps) else 0.0)


def _wrapped(panel: Panel, width: int) -> list[list[tuple[str, str]]]:
    """The notes of a panel of that width [px] in lines."""
    lines: list[list[tuple[str, str]]] = []
    used = math.inf
    for label, text in panel.notes:
        if used + len(text) + 3 > width / _CHARACTER:
            lines.append([])
            used = 0
        lines[-1].append((label, text))
        used += len(text) + 3
    return lines


def _lines_above(panel: Panel, width: int) -> int:
    return bool(panel.title) + len(_wrapped(panel, width))


def _words(
    figure: Any,
    panel: Panel,
    place: dict[str, int],
    style: Mapping[str, theme.Style],
    width: int,
    above: int,
) -> None:
    """Title and notes above the panel; above: lines that the panels of its row have there."""
    lines: list[str] = []
    for line in _wrapped(panel, width):
        parts = [
            '<span style="color: '
            f'{style[label].colour if label in style else theme.MUTED}">{theme.plain(text)}</span>'
            for label, text in line
        ]
        lines.append(" · ".join(parts))
    lines = [f"<b>{theme.plain(panel.title)}</b>", *lines] if panel.title else lines
    for i, text in enumerate(lines):
        theme.heading(figure, place, text, yshift=1 + _LINE * (above - 1 - i))


def _scale(figure: Any, rows: Sequence[Sequence[Panel]], axes: Axes) -> None:
    set_ranges(figure, axes)
    unit = f"[{axes.y_unit}]" if axes.y_unit else ""
    for i, row in enumerate(rows):
        for j, panel in enumerate(row):
            x, y = figure.get_subplot(i + 1, j + 1)
            x.showticklabels = bottom = i == len(rows) - 1 or j >= len(rows[i + 1])
            y.showticklabels = j == 0
            side = theme.plain(" ".join(part for part in (panel.side, unit) if part))
            if bottom:
                x.title.text = axes.x_text
            if j == 0 and side:
                y.title.text = side
            if i or j:
                x.matches, y.matches = "x", "y"


# A filter bank as it is built: per channel the chain of its sections, above the Bode diagram of
# each.


_ACROSS = 3  # blocks in a line: what a telephone shows
# height of a block, of a line of blocks and of a channel's name [px]
_BLOCK = 66
_LINE_FILTER_CHAINS = 82
_HEADING = 26
_ARROW = 0.045  # of the width, between blocks
_FILL = {"gain": "#eef1f3", "pid": "#e3edf5", "notch": "#f7e6dc", "phase-bump": "#e2f1ec"}
_OTHER = "#f3edf4"


def filter_figure(
    settings: PidSettings, axes: tuple[str, ...], sample_time: float | None = None
) -> Any:
    """The chains of a [controller] and their responses, channels that are the same drawn once.
    Returns a plotly Figure.

    sample_time [s]: half of its rate is marked. Raises InvalidInput for settings that describe no
    controller.
    """
    groups: dict[tuple[float, tuple[Section, ...]], list[str]] = {}
    for name, found in zip(
        channel_names(settings, axes), channel_chains(settings, axes), strict=True
    ):
        groups.setdefault(found, []).append(theme.axis_name(name))
    systems = {
        ", ".join(names): theta_system(
            chain(gain, [section_matrix(item) for item in sections]), (names[0],)
        )
        for (gain, sections), names in groups.items()
    }
    omega = np.unique(np.concatenate([grid_of(system) for system in systems.values()]))
    lines = [
        Line(name, omega, frequency_response(system, omega).values[:, 0, 0])
        for name, system in systems.items()
    ]
    picture = bode_figure(lines, "A/m", sample_time=sample_time)
    looks = theme.styles(list(systems))
    rows: list[tuple[str, list[tuple[str, list[str], str]]]] = []
    for name, (gain, sections) in zip(systems, groups, strict=True):
        blocks = [("gain", [theme.quantity(gain, "A/m")], f"gain {gain / 1e3:.6g} A/mm")]
        rows.append(
            (
                name,
                blocks
                + [
                    (item.kind, _numbers(item), f"{item.kind}: {section_text(item)}")
                    for item in sections
                ],
            )
        )
    _draw_of_filter_chains(picture, rows, {name: looks[name].colour for name in systems})
    return picture


def _numbers(section: Section) -> list[str]:
    """What stands in a block under the section's kind."""

    def hertz(rate: float | None) -> str:
        return theme.quantity(rate or 0.0, "rad/s")

    def damped(rate: float | None, damping: float | None) -> str:
        return f"{hertz(rate)}, {theme.number(damping or 0.0)}"

    if section.kind == "pid":
        times = (("i", section.integral_time), ("d", section.derivative_time))
        words = [f"T<sub>{key}</sub> {theme.quantity(value, 's')}" for key, value in times if value]
        if section.derivative_time:
            corner = 1 / (
                (section.derivative_filter or DERIVATIVE_FILTER) * section.derivative_time
            )
            words.append(f"× {hertz(corner)}")
        return words
    if section.kind == "notch":
        zeros, poles = (
            damped(section.zero_frequency, section.zero_damping),
            damped(section.pole_frequency, section.pole_damping),
        )
        return [f"○ {zeros}", f"× {poles}"]
    if section.kind == "phase-bump":
        return [
            theme.quantity(section.phase or 0.0, "rad"),
            f"at {damped(section.frequency, section.damping)}",
        ]
    if section.kind == "lead-lag":
        return [f"○ {hertz(section.zero_frequency)}", f"× {hertz(section.pole_frequency)}"]
    if section.kind == "low-pass":
        return [f"× {damped(section.frequency, section.damping)}"]
    above, below = section.numerator or (), section.denominator or ()
    if not (np.roots(above).size or np.roots(below).size):
        return [f"times {theme.number(float(above[-1] / below[-1]))}"]
    return [f"○ {_roots(above)}", f"× {_roots(below)}"]


def _roots(coefficients: tuple[float, ...]) -> str:
    """Frequency and damping of a pair of roots, or each of two real ones; a dash for none."""
    roots = np.roots(coefficients)
    if len(roots) == 2 and roots[0].imag:
        size = float(abs(roots[0]))
        return f"{theme.quantity(size, 'rad/s')}, {theme.number(float(-roots[0].real) / size)}"
    return ", ".join(theme.quantity(float(-root.real), "rad/s") for root in roots) or "none"


def _draw_of_filter_chains(
    picture: Any, rows: list[tuple[str, list[tuple[str, list[str], str]]]], colours: dict[str, str]
) -> None:
    """The chains above the axes, in the margin: it grows by their height, and so does the room
    under the page's legend.
    """
    layout = picture.layout
    inside = layout.height - layout.margin.t - layout.margin.b
    height = (
        sum(_HEADING + _LINE_FILTER_CHAINS * -(-len(blocks) // _ACROSS) for _, blocks in rows) + 10
    )
    room, width = layout.meta["room"], (1 - (_ACROSS - 1) * _ARROW) / _ACROSS
    top = float(height + room - 16)

    def y(pixels: float) -> float:
        return 1 + (top - pixels) / inside

    paper = {"xref": "paper", "yref": "paper"}
    shapes = []
    notes = []
    down = 0.0

    def write(text: str, x: float, pixels: float, size: int, colour: str, **more: Any) -> None:
        words = {"text": text, "font": {"size": size, "color": colour}, "showarrow": False}
        notes.append(
            {
                **paper,
                "x": x,
                "y": y(pixels),
                "xanchor": "center",
                "yanchor": "middle",
                **words,
                **more,
            }
        )

    for name, blocks in rows:
        write(
            f"<b>{theme.plain(name)}</b>",
            0.0,
            down,
            13,
            colours[name],
            xanchor="left",
            yanchor="top",
        )
        down += _HEADING
        for i, (kind, numbers, full) in enumerate(blocks):
            column = i % _ACROSS
            down += _LINE_FILTER_CHAINS if i and not column else 0.0
            left, middle = column * (width + _ARROW), down + _BLOCK / 2
            box = {
                "x0": left,
                "x1": left + width,
                "y0": y(down),
                "y1": y(down + _BLOCK),
                "fillcolor": _FILL.get(kind, _OTHER),
            }
            shapes.append(
                {**paper, **box, "type": "rect", "line": {"color": theme.MUTED, "width": 1}}
            )
            write(
                "<br>".join([f"<b>{kind}</b>", *numbers]),
                left + width / 2,
                middle,
                11,
                theme.INK,
                hovertext=full,
            )
            if i + 1 < len(blocks) and column + 1 < _ACROSS:
                write("→", left + width + _ARROW / 2, middle, 13, theme.MUTED)
        down += _LINE_FILTER_CHAINS
    picture.update_layout(
        height=layout.height + height,
        margin={"t": layout.margin.t + height},
        meta={"room": room + height},
        shapes=[*layout.shapes, *shapes],
        annotations=[*layout.annotations, *notes],
    )


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
    low = 0.1 * theme.TWO_PI
    high = float(np.clip(3 * moduli.max(initial=0.0), 5e3 * theme.TWO_PI, 1e5 * theme.TWO_PI))
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
            f"{theme.axis_name(response.inputs[j])} → {theme.axis_name(response.outputs[i])}",
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
        return theme.axis_name(axis)
    return f"{theme.axis_name(source)} → {theme.axis_name(target)}"


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
    factor, shown_unit = theme.scale(unit, top)
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
                drawn(line.omega / theme.TWO_PI),
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
        **theme.decades(float(omega.min()) / theme.TWO_PI, float(omega.max()) / theme.TWO_PI)
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


# Loops as they were measured, a panel for each axis: moduli with their bands, open loops about the
# critical point, the residual system of an identification.


_MEASURED, _BAND = "#0072b2", "rgba(0,114,178,0.25)"
# of the models
_LOOKS = (
    theme.Style(theme.INK, "solid", "x-thin", 1.3),
    theme.Style("#d55e00", "7px,3px", "x-thin", 1.6),
)
_COLUMNS, _HEIGHT_MEASURED = 2, 230  # panels side by side, [px] of one
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
    f, looks = omega / theme.TWO_PI, dict(zip(models, _LOOKS, strict=False))
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
        draw_limits(figure, place, levels, axes, size=(410, _HEIGHT_MEASURED - 60), named=named)
    theme.dress(figure, _HEIGHT_MEASURED * places[-1]["row"], legend=True)
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
        at = omega / theme.TWO_PI
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
    return theme.dress(figure, (_HEIGHT_MEASURED + 60) * places[-1]["row"], legend=True)


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
    f = measured.omega / theme.TWO_PI
    axes = [name.removeprefix("alpha_u_") for name in factors.alpha]
    figure = theme.subplots(
        rows=1,
        cols=len(axes),
        shared_yaxes=True,
        horizontal_spacing=0.02,
        subplot_titles=[f"<b>{theme.plain(theme.axis_name(axis))}</b>" for axis in axes],
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
