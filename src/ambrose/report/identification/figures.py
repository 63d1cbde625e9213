"""Pictures of an identification: parameters against their start, measured over model in time and
over frequency, correlations, residual tests.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import FrequencyResponse
from ambrose.identification.frf import spectral as frf
from ambrose.identification.frf.validity import compare, model_response
from ambrose.identification.output_error.closed_loop import ParameterEstimate
from ambrose.identification.parameters import COVERAGE, plant_at
from ambrose.identification.result import LoopIdentification
from ambrose.identification.validation.simulated_output import SimulatedOutput
from ambrose.judge.checks import Curve
from ambrose.machine.machine import Machine
from ambrose.machine.parameters import TIMING, parse_parameter
from ambrose.record.record import Record
from ambrose.report import theme, units
from ambrose.report.figures.panels import Panel, panel_figure
from ambrose.report.figures.seals import response_figure
from ambrose.report.record import thinned

_PERIODS = 6  # of the strongest frequency in the telling window
_DECADES = 4.0  # of the magnitude of a frequency response that are shown
_ROW, _LEAST = 26, 120  # [px]
_DIVERGING = (
    (0.0, "#b2182b"),
    (0.25, "#f4a582"),
    (0.5, "#f7f7f7"),
    (0.75, "#92c5de"),
    (1.0, "#2166ac"),
)
_MODE = {"frequency": "ω", "damping": "D"}
_SYMBOLS = {"force_per_current": "Kᵢ", "negative_stiffness": "Kₛ", "stiffness": "k", "damping": "d"}
_AMPLIFIER = {
    "natural_frequency": "ω₀",
    "damping": "d",
    "bandwidth": "ω_b",
    "eddy_bandwidth": "ω_e",
}


def short(path: str) -> str:
    """A parameter as it is called among people: "Kᵢ A ζ", "seal center k", "bending 1 ω"."""
    if path in TIMING:
        return f"delay of the {path.partition('.')[0]}"
    parameter = parse_parameter(path)
    component = units.axis_name(parameter.component) if parameter.component else ""
    if parameter.table == "bearing":
        return _joined(_SYMBOLS[parameter.quantity], parameter.name, component)
    if parameter.table == "seal":
        return (
            f"{_once('seal', parameter.name)} "
            f"{parameter.quantity}{'_' + parameter.component if parameter.component else ''}"
        )
    if parameter.table == "amplifier":
        return f"amplifier {_AMPLIFIER[parameter.quantity]}"
    if parameter.table == "rotor":
        return _joined(_words(parameter.name), _MODE[parameter.quantity])

    # a coupling, or a part of any other registered effect
    symbol = _SYMBOLS.get(parameter.quantity, parameter.quantity)
    kind = _once(_words(parameter.table), parameter.name)
    return _joined(kind, symbol if "_" in symbol[1:2] else _words(symbol), component)


def _joined(*parts: str) -> str:
    return " ".join(part for part in parts if part)


def _words(name: str) -> str:
    return name.replace("_", " ")


def _once(kind: str, name: str) -> str:
    return kind if name == kind else f"{kind} {name}"


def change_figure(result: ParameterEstimate) -> Any:
    """Every parameter's change from its start [%] with its 95 % interval; those without a start
    value are left out.
    """
    import plotly.graph_objects as go

    nonzero = [i for i, start in enumerate(result.start) if start]
    names = [theme.plain(short(result.paths[i])) for i in nonzero]
    value = np.array([100 * (result.values[i] / result.start[i] - 1) for i in nonzero])
    half = np.array(
        [100 * COVERAGE * result.standard_deviations[i] / abs(result.start[i]) for i in nonzero]
    )
    figure = go.Figure()
    theme.scatter(
        figure,
        {},
        value,
        names,
        mode="markers",
        marker={"size": 8, "color": "#0072b2"},
        error_x={"type": "data", "array": half, "color": "#0072b2", "thickness": 2, "width": 6},
        hovertemplate="%{y}: %{x:.3g} ± %{error_x.array:.2g} %<extra></extra>",
    )
    figure.add_vline(x=0, line={"color": theme.INK, "width": 1})
    for name, at, width in zip(names, value, half, strict=True):
        text = f"{units.fixed(float(at), float(width))} ± {units.number(float(width), 2)} %"
        figure.add_annotation(
            x=1,
            xref="x domain",
            y=name,
            text=text,
            showarrow=False,
            xanchor="left",
            xshift=8,
            font={"size": 12},
        )
    theme.dress(figure, max(_LEAST, _ROW * len(names)), legend=False)
    figure.update_layout(margin={"r": 130})
    figure.update_yaxes(autorange="reversed", title_text=None, showgrid=True)
    figure.update_xaxes(title_text="Change from the start value [%]")
    return figure


def overlay_figure(piece: SimulatedOutput) -> tuple[Any, str]:
    """Measured over model and what is left between them, in a window around the largest motion; and
    the words for it.
    """
    part = _telling(piece)
    time = piece.record.time[part]
    rows = _in_pairs([_panel(piece, i, time, part) for i in range(len(piece.signals))])
    style = theme.overlay_styles(["measured", "model", "residual"])
    figure, beyond = panel_figure(rows, style, height=190)
    span = f"{units.number(float(time[0]), 4)} to {units.number(float(time[-1]), 4)} s"
    return figure, f"Shown are {span}, around the largest motion.{' ' + beyond if beyond else ''}"


def _panel(piece: SimulatedOutput, i: int, time: np.ndarray, part: slice) -> Panel:
    unit = piece.record.units[piece.record.signals.index(piece.signals[i])]
    curves = tuple(
        (
            label,
            Curve(
                "identification.time",
                "",
                "time",
                time,
                values[i : i + 1, part],
                (piece.signals[i],),
                "s",
                unit,
            ),
        )
        for label, values in (
            ("measured", piece.measured),
            ("model", piece.model),
            ("residual", piece.residual),
        )
    )
    spread = float(np.linalg.norm(piece.measured[i] - piece.measured[i].mean()))
    left = float(np.linalg.norm(piece.residual[i])) / max(spread, 1e-300)
    return Panel(
        units.axis_name(piece.signals[i]), curves, (("", f"fit {100 * (1 - left):.1f} %"),)
    )


def _telling(piece: SimulatedOutput) -> slice:
    """Some periods of the strongest frequency around the largest sample, not at the very
    beginning.
    """
    x = piece.measured - piece.measured.mean(axis=1, keepdims=True)
    k, rate = x.shape[1], piece.record.sample_rate_hz
    power = np.sum(np.abs(np.fft.rfft(x[:, : min(k, 65536)], axis=1)) ** 2, axis=0)
    strongest = max(int(np.argmax(power[1:])) + 1, 1) * rate / min(k, 65536)
    length = int(np.clip(_PERIODS * rate / strongest, 40, min(0.5 * rate, k)))
    begin = min(k // 10, k - length)
    middle = begin + int(
        np.argmax(
            np.abs(x / np.maximum(x.std(axis=1, keepdims=True), 1e-300))[:, begin:].max(axis=0)
        )
    )
    first = int(np.clip(middle - length // 2, 0, k - length))
    return slice(first, first + length)


def residual_figure(piece: SimulatedOutput) -> tuple[Any, str]:
    """The residual over the whole record, on its own scale: does it stay equally small
    throughout?
    """
    panels = []
    for i, signal in enumerate(piece.signals):
        unit = piece.record.units[piece.record.signals.index(signal)]
        at, thin = thinned(piece.record.time, piece.residual[i : i + 1])
        curve = Curve("identification.residual", "", "time", at, thin, (signal,), "s", unit)
        sizes = (float(np.std(piece.residual[i])), float(np.std(piece.measured[i])))
        words = " of ".join(units.quantity(size, unit, 2) for size in sizes) + " rms"
        panels.append(Panel(units.axis_name(signal), (("residual", curve),), (("", words),)))
    style = {"residual": theme.Style("#0072b2", "solid", "circle-open", 1.0)}
    return panel_figure(_in_pairs(panels), style, height=120)


def _in_pairs(panels: Sequence[Panel]) -> list[Sequence[Panel]]:
    return [panels[i : i + 2] for i in range(0, len(panels), 2)]


def correlation_figure(result: ParameterEstimate) -> Any:
    """The parameters' correlation, and beside it the cosine between the Jacobian's columns, which
    is something else.
    """
    import plotly.graph_objects as go

    names = [theme.plain(short(path)) for path in result.paths]
    size = max(220, 30 * len(names))
    titles = (
        "<b>Correlation of the parameters</b>",
        "<b>Cosine between the Jacobian's columns</b>",
    )
    figure = theme.subplots(
        rows=1, cols=2, subplot_titles=titles, horizontal_spacing=0.04, shared_yaxes=True
    )
    for column, matrix in enumerate((result.correlation, result.column_cosine), 1):
        texts = [
            [f"{value:.2f}" if i != j and abs(value) >= 0.1 else "" for j, value in enumerate(row)]
            for i, row in enumerate(matrix)
        ]
        figure.add_trace(
            go.Heatmap(
                z=matrix,
                x=names,
                y=names,
                zmin=-1,
                zmax=1,
                colorscale=_DIVERGING,
                text=texts,
                texttemplate="%{text}",
                textfont={"size": 10.5},
                showscale=column == 2,
                colorbar={"thickness": 12, "len": 1.0, "outlinewidth": 0},
                hovertemplate="%{y} and %{x}: %{z:.3f}<extra></extra>",
                xgap=1,
                ygap=1,
            ),
            row=1,
            col=column,
        )
    figure.update_annotations(font={"size": 13})
    theme.dress(figure, size, legend=False)
    figure.update_yaxes(autorange="reversed", showgrid=False, ticks="", showline=False)
    figure.update_xaxes(tickangle=-60, showgrid=False, ticks="", showline=False)
    return figure


def residual_tests_figure(result: ParameterEstimate) -> Any:
    """Largest correlation of each residual with each excitation, over its 99 % limit: above 1 the
    model misses something.
    """
    import plotly.graph_objects as go

    rows = list(dict.fromkeys(test.signal for test in result.tests))
    columns = list(dict.fromkeys(test.excitation for test in result.tests))
    ratio = np.full((len(rows), len(columns)), np.nan)
    for test in result.tests:
        i, j = rows.index(test.signal), columns.index(test.excitation)
        ratio[i, j] = np.nanmax([ratio[i, j], abs(test.correlation) / test.limit])
    figure = go.Figure(
        go.Heatmap(
            z=ratio,
            x=[theme.plain(units.prose(name)) for name in columns],
            y=[theme.plain(units.axis_name(n)) for n in rows],
            zmin=0,
            zmax=2,
            colorscale=((0.0, "#ffffff"), (0.499, "#d9e8f3"), (0.501, "#f4c7a8"), (1.0, "#b2182b")),
            text=[[f"{value:.2f}{' ✗' if value > 1 else ''}" for value in row] for row in ratio],
            texttemplate="%{text}",
            textfont={"size": 13, "color": theme.INK},
            showscale=False,
            xgap=2,
            ygap=2,
            hovertemplate="residual of %{y}, excitation %{x}: %{z:.2f} times its "
            "limit<extra></extra>",
        )
    )
    theme.dress(figure, max(_LEAST, 38 * len(rows)), legend=False)
    figure.update_yaxes(
        autorange="reversed", showgrid=False, ticks="", showline=False, title_text="Residual of"
    )
    figure.update_xaxes(showgrid=False, ticks="", showline=False, title_text="Excitation")
    return figure


def telling_records(
    pieces: Sequence[SimulatedOutput], most: int = 2
) -> list[tuple[int, SimulatedOutput]]:
    """The records worth showing, with their numbers: the worst explained one, and the first."""
    order = sorted(
        range(len(pieces)),
        key=lambda n: (
            -float(np.linalg.norm(pieces[n].residual) / np.linalg.norm(pieces[n].measured))
        ),
    )
    return [(n + 1, pieces[n]) for n in sorted(dict.fromkeys([order[0], 0][:most]))]


def frf_figure(machine: Machine, checked: LoopIdentification) -> tuple[Any, str] | None:
    """The plant from the amplifiers' command u + e to the displacements, axis by axis, measured,
    identified and as it was.

    Measured by the joint input-output method, or None where the records do not allow it (u_ or some
    excitations are missing, or several excitations are the same). The first four axes are shown.
    With the figure: up to where the model agrees, in words.
    """
    result, axes = checked.result, machine.axes[:4]
    at = (result.point.seal_pressure, result.point.speed)
    records = [
        o.record
        for o in checked.outputs
        if (o.record.point.seal_pressure, o.record.point.speed) == at
    ]
    whole = _measured(records, machine.axes)
    if whole is None:
        return None
    whole = _visible(whole)
    models = {}
    for label, theta in (("identified", result.values), ("start", result.start)):
        values = dict(zip(result.paths, theta.tolist(), strict=True))
        models[label] = model_response(
            whole, plant_at(machine, result.point, values, checked.bending_modes).system
        )
    validity = compare(whole, models["identified"])
    names = {axis: units.axis_name(axis) for axis in axes}
    measured = {names[axis]: whole.select(f"v_{axis}", f"y_{axis}") for axis in axes}
    beside: Mapping[str, Mapping[str, FrequencyResponse]] = {
        names[axis]: {
            label: model.select(f"u_{axis}", f"y_{axis}") for label, model in models.items()
        }
        for axis in axes
    }
    reach = {
        names[axis]: float(validity.valid_to[i, i])
        for i, axis in enumerate(machine.axes)
        if axis in axes
    }
    figure = response_figure(
        measured, beside, valid_to={name: end for name, end in reach.items() if end > 0}
    )
    figure.update_annotations(font={"size": 13})
    low = min(reach.values())
    words = (
        "On every axis the identified model agrees within 10 % and 10° up to "
        f"{units.quantity(low, 'rad/s')} (dashed)."
        if low > 0
        else "The identified model leaves the measured response by more than 10 % or 10° from the "
        "first frequencies on."
    )
    return figure, words


def _measured(records: Sequence[Record], axes: Sequence[str]) -> frf.Frf | None:
    if not records:
        return None
    shortest = min(record.values.shape[1] / record.sample_rate_hz for record in records)
    inputs, outputs = [f"v_{axis}" for axis in axes], [f"y_{axis}" for axis in axes]
    try:
        return frf.closed_loop(records, inputs, outputs, segment=min(0.5, shortest / 8))
    except InvalidInput:
        return None


def _visible(measured: frf.Frf) -> frf.Frf:
    """The lines up to the last at which every axis still responds within some decades of its
    largest.
    """
    sizes = np.abs(np.diagonal(measured.values, axis1=1, axis2=2))
    visible = np.flatnonzero((sizes > sizes.max(axis=0) / 10**_DECADES).all(axis=1))
    return measured.between(
        float(measured.omega[0]), float(measured.omega[visible[-1] if len(visible) else -1])
    )
