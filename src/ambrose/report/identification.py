"""The page of a seal by frequency and pressure: what was found, what was taken off, lines over
pressure.

    write(seal_page(identify_by_frequency(machine, records)), "seal.html")
"""

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import FrequencyResponse
from ambrose.identification import frf_spectral as frf
from ambrose.identification.findings import Code
from ambrose.identification.frf import compare, model_response
from ambrose.identification.frf_spectral import Frf
from ambrose.identification.one_axis.estimate import LEVEL
from ambrose.identification.one_axis.identify import GenericIdentification, PlantValue
from ambrose.identification.output_error.closed_loop import ParameterEstimate
from ambrose.identification.parameters import COVERAGE, plant_at, unit_of
from ambrose.identification.result import LoopIdentification, ResponseFit, StaticIdentification
from ambrose.identification.seal.by_frequency import SealByFrequency
from ambrose.identification.seal.by_pressure import COEFFICIENTS, SealFit, averaged, line
from ambrose.identification.static_load import StaticLoad
from ambrose.identification.validation.plausibility import Agreement
from ambrose.identification.validation.repeatability import Repeats, SimulatedOutput
from ambrose.identification.youla import ResidualIdentification
from ambrose.judge.checks import Curve
from ambrose.law.law import law_of
from ambrose.machine.machine import Machine
from ambrose.machine.parameters import TIMING, parse_parameter
from ambrose.record.record import Record
from ambrose.record.response import QUANTITIES
from ambrose.report import tables, theme
from ambrose.report.figures.bode import Panel, panel_figure, residual_figure as residual_response
from ambrose.report.figures.seals import frequency_figure, pressure_figure, response_figure
from ambrose.report.page import Cell, Figure, Page, Row, Section, Subject, Table, Verdict, numbers
from ambrose.report.record import thinned
from ambrose.report.tables import believed, capitalised, doubtful, without_findings

# Pictures of an identification: parameters against their start, measured over model in time and
# over frequency, correlations, residual tests.


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
    component = theme.axis_name(parameter.component) if parameter.component else ""
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
        text = f"{theme.fixed(float(at), float(width))} ± {theme.number(float(width), 2)} %"
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
    span = f"{theme.number(float(time[0]), 4)} to {theme.number(float(time[-1]), 4)} s"
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
        theme.axis_name(piece.signals[i]), curves, (("", f"fit {100 * (1 - left):.1f} %"),)
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
        words = " of ".join(theme.quantity(size, unit, 2) for size in sizes) + " rms"
        panels.append(Panel(theme.axis_name(signal), (("residual", curve),), (("", words),)))
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
            x=[theme.plain(theme.prose(name)) for name in columns],
            y=[theme.plain(theme.axis_name(n)) for n in rows],
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
    names = {axis: theme.axis_name(axis) for axis in axes}
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
        f"{theme.quantity(low, 'rad/s')} (dashed)."
        if low > 0
        else "The identified model leaves the measured response by more than 10 % or 10° from the "
        "first frequencies on."
    )
    return figure, words


def responses_figure(
    fits: Sequence[ResponseFit],
    labels: tuple[str, ...] = ("identified", "start"),
    caption: str = "",
) -> Figure:
    """The response of every axis on itself, measured and modelled after and before, by their labels
    (one: after alone): of the quantity that most axes have, four axes at most.
    """
    own = [one for one in fits if one.measured.inputs == one.measured.outputs]
    ((quantity, _),) = Counter(one.quantity for one in own or fits).most_common(1)
    shown = [one for one in own or fits if one.quantity == quantity][:4]
    measured: dict[str, Frf] = {}
    models: dict[str, Mapping[str, FrequencyResponse]] = {}
    for one in shown:
        names = dict.fromkeys((*one.measured.outputs, *one.measured.inputs))
        title = " / ".join(theme.axis_name(name) for name in names)
        measured[title] = one.measured
        models[title] = {
            label: FrequencyResponse(
                values.reshape(-1, 1, 1),
                one.measured.omega,
                one.measured.inputs,
                one.measured.outputs,
            )
            for label, values in zip(labels, (one.identified, one.start), strict=False)
        }
    words, *units = QUANTITIES[quantity]
    figure = response_figure(measured, models, unit="/".join(filter(None, units)))
    figure.update_annotations(font={"size": 13})
    return Figure(f"Measured responses: {words}", figure, caption or _RESPONSES)


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


# The page of one axis identified from its record alone: values and where their intervals come from,
# the questions that the model passed or failed, the prediction of what was not fitted.
#
# write(generic_page(done), "axis.html")


_PREDICTED = (
    "Broad: second half of the record, measured. Thin: predicted one time constant 1/p ahead by "
    "the plant identified from the first half, with u known. With a wrong pole the prediction "
    "diverges."
)
_COHERENCE = (
    "Share of the displacement's power that follows what drives the loop from outside: the "
    "recorded reference, or the part of u that no linear law makes of the displacement. Dashed: "
    "what noise alone exceeds in 5 of 100; the pole is marked."
)
_WAYS = {
    "direct": "predictor with a noise model",
    "instruments": "instruments from the reference, no noise model",
}


def generic_tables(done: GenericIdentification) -> tuple[Table, ...]:
    """Values, questions and, where one was stated, the force law."""
    law = (law_table(done),) if done.law else ()
    return (values_table(done), questions_table(done), *law)


def values_table(done: GenericIdentification) -> Table:
    """Every quantity of the plant with its interval, and what the interval rests on."""
    rows: list[Row] = []
    for item in done.values:
        other = "" if item.second is None else _shown(item.second, item)
        rows.append(
            (
                f"{item.name} {item.symbol}",
                *numbers(
                    theme.plus_minus(*_scaled(item)),
                    _half(item.formal, item),
                    _half(item.halves, item),
                    other,
                ),
            )
        )
    note = (
        "y'' = a y + b u(t - tau), p = sqrt(a), 95 %. The interval is the larger of the formal "
        "one and of the difference between both halves of the record. Second way: instruments, "
        "without a noise model. Without an actuator the delay contains all lags."
    )
    columns = ("Quantity", "Value", "Formal", "Halves", "Second way")
    return Table("Plant", columns, tuple(rows), note)


def _factor(item: PlantValue) -> tuple[float, str]:
    return (1e3, "ms") if item.unit == "s" else (1.0, item.unit)


def _scaled(item: PlantValue) -> tuple[float, float, str]:
    factor, unit = _factor(item)
    return item.value * factor, item.half_width * factor, unit


def _half(value: float, item: PlantValue) -> str:
    return f"± {theme.number(value * _factor(item)[0], 2)}"


def _shown(value: float, item: PlantValue) -> str:
    factor, _ = _factor(item)
    return theme.fixed(value * factor, item.half_width * factor)


def questions_table(done: GenericIdentification) -> Table:
    """What was asked of the model, with the answers."""
    tried, ahead = done.estimate, done.estimate.prediction
    direct = tried.way == "direct"
    outside = "reference" if done.record.reference is not None else "part of u from outside"
    rows: list[Row] = [
        (
            "Noise model",
            f"order {2 + tried.structure.colour}, {_WAYS[tried.way]}",
            _mark(None),
        ),
        (
            "Residual white",
            f"chance {theme.number(tried.white, 2)}; its past tells "
            f"{theme.number(100 * tried.white_share, 2)} %",
            _mark(tried.white >= LEVEL if direct else None),
        ),
        (
            "Residual free of the excitation",
            f"chance {theme.number(tried.follows, 2)}; "
            f"{theme.number(100 * tried.follows_share, 2)} % follows",
            _mark(tried.follows >= LEVEL),
        ),
        (
            "Both ways agree",
            "not known" if tried.agree is None else f"chance {theme.number(tried.agree, 2)}",
            _mark(None if tried.agree is None or not direct else tried.agree >= 0.001),
        ),
        (
            "Straight",
            f"chance of the curvature seen {theme.number(tried.curved, 2)}",
            _mark(True if tried.curved >= 0.001 else None),
        ),
        (
            "Driven from outside",
            f"gain over its deviation {theme.number(tried.outside, 3)}, by the {outside}",
            _mark(tried.outside >= 5),
        ),
        (
            "Coherence about the pole",
            f"{theme.number(done.coherence_in_band, 2)}; by chance {theme.number(done.chance, 2)}",
            _mark(None),
        ),
        (
            f"Second half, {theme.number(1e3 * ahead.horizon, 3)} ms ahead",
            f"error {theme.quantity(ahead.error, 'm')}, promised "
            f"{theme.quantity(ahead.expected, 'm')}; staying where it is "
            f"{theme.quantity(ahead.still, 'm')}",
            _mark(ahead.excess <= 1.5),
        ),
    ]
    return Table("Can it be believed?", ("Question", "Answer", ""), tuple(rows))


def _mark(passed: bool | None) -> Cell:
    if passed is None:
        return Cell("", "none")
    return Cell("holds" if passed else "fails", "pass" if passed else "fail")


def law_table(done: GenericIdentification) -> Table:
    """What the stated force law expects beside what was found."""
    rows: list[Row] = [
        (
            row.name,
            *numbers(
                f"{theme.number(row.expected, 4)} {row.unit}",
                theme.plus_minus(row.found, row.half_width, row.unit),
            ),
            Cell("fits" if row.fits else "does not fit", "pass" if row.fits else "fail"),
        )
        for row in done.law
    ]
    note = "s0, i0: gap and current of the working point, taken as exact."
    return Table("Force law F = c (i/s)²", ("Consequence", "Law", "Found", ""), tuple(rows), note)


def generic_page(done: GenericIdentification, *, date: str = "") -> Page:
    """The report of one axis; date: ISO (today if empty)."""
    pictures = (
        Figure("What was not fitted", prediction_figure(done), _PREDICTED),
        Figure("Coherence", coherence_figure(done), _COHERENCE),
    )
    tables = generic_tables(done)
    sections = [
        Section("Plant", "", (), (tables[0], *tables[2:])),
        Section("Can it be believed?", "", pictures, (tables[1],), True),
    ]
    known = done.verdict == "identified"
    words = "one unstable pole pair, a gain and a delay explain the record"
    verdicts = (
        Verdict("Model", known, words if known else "not this model"),
        Verdict("Prediction", done.estimate.prediction.excess <= 1.5, _predicted(done)),
    )
    facts = (
        ("Record", done.record.name),
        ("Columns", ", ".join(f"{what}: {name}" for what, name in done.record.columns)),
        ("Samples", f"{len(done.record.position)} at {done.record.rate:.6g} Hz"),
    )
    return Page(
        "One axis, from its record alone",
        Subject(done.record.name),
        (*doubtful(done.findings), *sections),
        verdicts,
        facts,
        date,
        result=believed("Pole, gain and delay identified", done.findings),
    )


def _predicted(done: GenericIdentification) -> str:
    ahead = done.estimate.prediction
    error, promised = theme.quantity(ahead.error, "m"), theme.quantity(ahead.expected, "m")
    return f"second half predicted from the first: error {error} (expected {promised})"


def prediction_figure(done: GenericIdentification) -> Any:
    """Measured and predicted displacement over the beginning of the second half."""
    ahead = done.estimate.prediction
    figure = theme.subplots(rows=1, cols=1)
    place = {"row": 1, "col": 1}
    factor, unit = theme.scale("m", float(abs(ahead.measured).max()))
    looks = theme.overlay_styles(("measured", "predicted"))
    for label, values in (("measured", ahead.measured), ("predicted", ahead.predicted)):
        line = {"color": looks[label].colour, "width": looks[label].width}
        theme.scatter(figure, place, ahead.times, factor * values, label, shown=True, line=line)
    figure.update_xaxes(title_text="Time [s]", row=1, col=1)
    figure.update_yaxes(title_text=f"Displacement about its mean [{unit}]", row=1, col=1)
    return theme.dress(figure, 260, legend=True)


def coherence_figure(done: GenericIdentification) -> Any:
    """Coherence over frequency, what chance exceeds, and the pole."""
    figure = theme.subplots(rows=1, cols=1)
    place = {"row": 1, "col": 1}
    shown = done.frequency > 0
    frequency = done.frequency[shown]
    theme.scatter(figure, place, frequency, done.coherence[shown], line={"color": theme.INK})
    figure.add_hline(y=done.chance, line={"color": theme.MUTED, "dash": "dash"}, **place)
    if done.pole > 0:
        at = math.log10(done.pole / math.tau)
        figure.add_vline(x=10**at, line={"color": theme.MUTED}, **place)
    axis = theme.decades(float(frequency[0]), float(frequency[-1]))
    figure.update_xaxes(title_text="Frequency [Hz]", row=1, col=1, **axis)
    figure.update_yaxes(title_text="Coherence", range=[0, 1], row=1, col=1)
    return theme.dress(figure, 220, legend=False)


# The page of K_i from static loads: values beside the machine's, how straight force over current
# is, the levels.
#
# write(static_page(done), "static.html")


_LINEAR = 0.01  # probability below which the straight line is rejected
_FIGURE = (
    "Residual of magnet force over control current from the straight line, at every load level, "
    "with the cubic through the levels. Points about zero mean a straight magnet; ends that "
    "bend down are iron that "
    "saturates, a jump to one side "
    "friction or a stop; points above each other at one current were loaded across this axis. "
    "Bars: 95 % of the mean currents, "
    "as forces."
)


def static_page(
    checked: StaticIdentification, *, compared: Sequence[Agreement] | None = None, date: str = ""
) -> Page:
    """The report of static loads; compared: with another method's; date: ISO (today if empty)."""
    machine, result = checked.given, checked.result
    tables = [static_table(checked), *_agreement_tables(checked.repeats, compared)]
    picture = Figure("Force beyond the straight line", line_figure(result), _FIGURE)
    sections = [
        Section("Force per current", "", (picture,), tuple(tables), True),
        Section("Load levels", "", (), (levels_table(result),), folded=True),
    ]
    deviations = result.standard_deviations
    largest = max(map(_relative, zip(result.paths, result.values, deviations, strict=True)))
    verdicts = (
        Verdict(
            "Straightness",
            not any(finding.code == Code.CURVED for finding in result.warnings),
            theme.prose(result.verdict),
        ),
        without_findings("Loads", result.warnings, "both sides, position held"),
    )
    found = (
        f"Force per current of {len(result.paths)} axes identified, standard deviation at most "
        f"{theme.number(100 * largest, 2)} %"
    )
    facts = (
        ("Records", ", ".join(checked.provenance.records)),
        ("Operating point", result.point.label),
        (
            "Levels",
            f"{len(result.levels.loads)}, loads at "
            f"{', '.join(theme.axis_name(port) for port in result.levels.ports)}",
        ),
        ("Largest force of a magnet", theme.quantity(float(np.abs(result.forces).max()), "N")),
    )
    return Page(
        "Force per current from static loads",
        machine,
        (*doubtful(result.warnings), *sections),
        verdicts,
        facts,
        date,
        result=believed(found, result.warnings),
    )


def static_table(checked: StaticIdentification) -> Table:
    """K_i of every axis: the machine's, the line over the loads, the slope at rest."""
    result = checked.result
    rows: list[Row] = []
    for i, path in enumerate(result.paths):
        value, half = float(result.values[i]), COVERAGE * float(result.standard_deviations[i])
        rest, rest_half = float(result.at_rest[i]), COVERAGE * float(result.at_rest_deviations[i])
        before = float(result.start[i])
        cells = numbers(
            theme.quantity(before, "N/A", 4),
            theme.plus_minus(value, half, "N/A"),
            f"{theme.fixed(100 * (value / before - 1), 100 * half / before)} %",
            theme.plus_minus(rest, rest_half, "N/A"),
            f"{theme.number(100 * float(result.stiffness_share[i]), 2)} %",
            f"{theme.number(100 * (value / rest - 1), 2)} %"
            if result.linearity[i] < _LINEAR
            else "straight",
        )
        rows.append((path, *cells))
    note = (
        "Line: slope over these loads, which goes into the machine file, with 95 %. At rest: "
        "slope of a cubic at the unloaded "
        "working point, which small motion sees. By displacement: share of the magnet's force "
        "that K_s makes; K_i is as wrong "
        "as K_s by this share. Line over tangent: by how much they part where the levels are "
        "curved (99 %)."
    )
    columns = (
        "Parameter",
        "Machine",
        "Line",
        "Change",
        "At rest",
        "By displacement",
        "Line over tangent",
    )
    return Table("Force per current", columns, tuple(rows), note)


def levels_table(result: StaticLoad) -> Table:
    """Every level: loads, displacement and current of every axis."""
    levels = result.levels
    rows: list[Row] = []
    for j in range(len(levels.loads)):
        loads = ", ".join(f"{theme.number(float(load), 3)} N" for load in levels.loads[j])
        moved = ", ".join(theme.number(1e6 * float(y), 2) for y in levels.displacement[j])
        currents = ", ".join(theme.number(float(i), 3) for i in levels.current[j])
        forces = ", ".join(theme.number(float(f), 3) for f in result.forces[j])
        rows.append(
            (str(int(levels.record[j])), f"{levels.start[j]:.2f} s", loads, moved, currents, forces)
        )
    ports = ", ".join(theme.axis_name(port) for port in levels.ports)
    axes = ", ".join(theme.axis_name(axis) for axis in result.axes)
    columns = (
        "Record",
        "From",
        f"Loads {ports}",
        "Displacement [µm]",
        "Current [A]",
        "Magnet force [N]",
    )
    return Table(
        "Load levels",
        columns,
        tuple(rows),
        f"Per axis: {axes}. Forces are relative to the unloaded rotor.",
    )


def line_figure(result: StaticLoad) -> Any:
    """Magnet force less the straight line [N] over the control current [A], an axis each, with the
    cubic through the levels.
    """
    lefts = [_beyond(result, i) for i in range(len(result.axes))]
    shares = [
        100 * float(np.abs(left).max() / np.ptp(result.forces[:, i]))
        for i, left in enumerate(lefts)
    ]
    titles = [
        f"<b>{theme.axis_name(axis)}</b>, {theme.number(share, 2)} % of its range"
        for axis, share in zip(result.axes, shares, strict=True)
    ]
    figure = theme.subplots(
        rows=1, cols=len(titles), subplot_titles=titles, shared_yaxes=True, horizontal_spacing=0.02
    )
    for i, (current, left) in enumerate(zip(result.levels.current.T, lefts, strict=True)):
        place = {"row": 1, "col": i + 1}
        bars = COVERAGE * result.values[i] * result.levels.current_deviation[:, i]
        theme.scatter(
            figure,
            place,
            current,
            left,
            mode="markers",
            marker={"size": 7, "color": "#0072b2"},
            error_y={"type": "data", "array": bars, "thickness": 1.2, "width": 3},
            hovertemplate="%{x:.4g} A: %{y:.3g} N beyond the line<extra></extra>",
        )
        if len(current) > 5:
            span = np.linspace(current.min(), current.max(), 60)
            cubic = np.polynomial.Polynomial.fit(current, left, 3)
            theme.scatter(figure, place, span, cubic(span), line={"color": theme.INK, "width": 1.5})
        figure.add_hline(y=0, line={"color": theme.MUTED, "width": 1}, **place)
        figure.update_xaxes(title_text="Control current [A]", **place)
    figure.update_yaxes(title_text="Force beyond the line [N]", row=1, col=1)
    return theme.dress(figure, 300, legend=False)


def _beyond(result: StaticLoad, i: int) -> np.ndarray:
    """The magnet force (m,) [N] of an axis less its straight line over the current."""
    current, force = result.levels.current[:, i], result.forces[:, i]
    slope, level = np.polyfit(current, force, 1)
    return np.asarray(force - slope * current - level)


# The page of an identification: what was identified, whether to believe it, the tables that say so
# and the pictures to see why.
#
#     write(identification_page(identify(machine, records, controller)), "identified.html")


_UNSURE = 0.1  # half-width over value that is marked


def parameters_table(result: ParameterEstimate) -> Table:
    """Parameter, start, value, 95 % interval, relative standard deviation."""
    rows: list[Row] = []
    for path, start, value, deviation in zip(
        result.paths, result.start, result.values, result.standard_deviations, strict=True
    ):
        unit, half = unit_of(path), COVERAGE * float(deviation)
        relative = half / abs(value) if value else math.inf
        change = (
            f"{theme.fixed(100 * (value / start - 1), 100 * half / abs(start))} %" if start else ""
        )
        spread = f"{theme.number(100 * float(deviation) / abs(value), 2)} %" if value else ""
        cells = numbers(
            theme.quantity(start, unit, 4),
            _value(value, half, unit),
            _interval(value, half, unit),
            spread,
        )
        rows.append((path, *cells, Cell(change, "fail" if relative > 1 else "number")))
    note = (
        "95 % interval: 1.96 standard deviations from the colour of the residuals (sandwich "
        "covariance); it covers noise, not "
        "what was taken as known: mass +1 % moves K_i and K_s by +0.9 %, controller gain +1 % "
        "moves K_s by +2 %."
    )
    columns = ("Parameter", "Start", "Value", "95 % interval", "Std. dev.", "Change")
    return Table("Parameters", columns, tuple(rows), note)


def fit_table(result: ParameterEstimate) -> Table:
    """Goodness of fit per record and signal."""
    rows = [
        (
            str(number),
            theme.axis_name(signal),
            Cell(f"{percent:.2f} %", "fail" if percent < 50 else "number"),
        )
        for number, signal, percent in result.fit
    ]
    note = (
        "100 % (1 − |residual|/|signal − mean|). A wrong delay can still read 95 %: the residual "
        "tests decide."
    )
    return Table("Fit per signal", ("Record", "Signal", "Fit"), tuple(rows), note)


def turning_table(result: ParameterEstimate) -> Table:
    """What every signal holds at multiples of the speed and at tones."""
    rows = [
        (
            str(one.record),
            theme.axis_name(one.signal),
            f"{one.order} x" if one.order else "tone",
            f"{one.frequency:.5g} Hz",
            f"{one.amplitude * scale:.3g} ± {COVERAGE * one.standard_deviation * scale:.2g} {unit}",
            f"{np.degrees(one.phase):.0f}°" if one.amplitude > 3 * one.standard_deviation else "-",
        )
        for one in result.turning
        for scale, unit in ((1e6, "µm") if one.signal.startswith("y_") else (1.0, "A"),)
    ]
    note = (
        "Amplitude and phase (cosine, from the first sample) of what does not follow the "
        "excitation, ± 95 %. Motion that "
        "unbalance makes and run-out of the sensor's surface are one number here."
    )
    return Table(
        "Turns with the rotor",
        ("Record", "Signal", "Order", "Frequency", "Amplitude", "Phase"),
        tuple(rows),
        note,
    )


def residual_tests_table(result: ParameterEstimate) -> Table:
    """Does a residual still follow an excitation, the worst first."""
    ordered = sorted(result.tests, key=lambda test: -abs(test.correlation) / test.limit)
    rows: list[Row] = [
        (
            theme.axis_name(test.signal),
            theme.prose(test.excitation),
            *numbers(theme.number(test.correlation, 2), theme.number(test.limit, 2), str(test.lag)),
            Cell(f"{100 * test.visible:.2g} %" if np.isfinite(test.visible) else "-", "number"),
            Cell("within" if test.passed else "beyond", "pass" if test.passed else "fail"),
        )
        for test in ordered
    ]
    note = (
        "Largest correlation of the residual with the excitation over the lags, against its 99 % "
        "limit over all pairs. "
        "Sees from: share of the signal's response to this excitation above which one that the "
        "model lacks fails the test."
    )
    columns = (
        "Residual of",
        "Excitation",
        "Correlation",
        "Limit",
        "Lag [samples]",
        "Sees from",
        "",
    )
    return Table("Residual tests", columns, tuple(rows), note)


def repeats_table(repeats: Repeats) -> Table:
    """Mean, interval of the mean and scatter over repeated experiments, beside the scatter that
    each one states.
    """
    rows: list[Row] = []
    for i, path in enumerate(repeats.paths):
        unit = unit_of(path)
        mean = float(repeats.mean[i])
        half = float(repeats.half_width[i])
        stated = 100 * float(repeats.predicted[i]) / abs(mean) if mean else math.nan
        scatter = (f"{theme.number(share, 2)} %" for share in (float(repeats.rsd[i]), stated))
        rows.append(
            (path, *numbers(_value(mean, half, unit), _interval(mean, half, unit), *scatter))
        )
    note = (
        f"{repeats.count} records, each identified alone. Interval of the mean: Student's t. RSD: "
        "scatter of one record over "
        "the mean; where it is far above the deviation stated by single records, something "
        "other than noise changes between them."
    )
    columns = ("Parameter", "Mean", f"{100 * repeats.level:g} % interval", "RSD", "RSD stated")
    return Table("Repeats", columns, tuple(rows), note)


def seal_table(fit: SealFit) -> Table:
    """K, k, C, c at every pressure with their 95 % intervals."""
    rows: list[Row] = []
    for i, pressure in enumerate(fit.pressure.tolist()):
        cells = [Cell(theme.quantity(pressure, "Pa", 4))]
        for j, letter in enumerate(COEFFICIENTS):
            factor, unit = theme.coefficient_scale(letter)
            half = COVERAGE * float(fit.deviations[i, j]) * factor
            cells += numbers(theme.plus_minus(float(fit.values[i, j]) * factor, half, unit))
        rows.append(tuple(cells))
    note = (
        "95 % interval of what noise leaves open, all else as identified. K and c, and k and C, "
        "have the same effect at one frequency."
    )
    columns = ("Pressure", *COEFFICIENTS)
    return Table(f"Seal {theme.axis_name(fit.seal)} by pressure", columns, tuple(rows), note)


def seal_tables(fit: SealFit) -> tuple[Table, ...]:
    """The coefficients by pressure and, from three pressures on, the lines over it."""
    return (seal_table(fit), *([seal_lines_table(fit)] if len(fit.pressures) > 2 else []))


def seal_lines_table(fit: SealFit) -> Table:
    """The regression lines over pressure."""
    rows: list[Row] = []
    for letter in COEFFICIENTS:
        one = line(fit, letter)
        factor, unit = theme.coefficient_scale(letter)
        bar, top = theme.scale("Pa")[0], float(fit.pressure.max())
        half, times = float(one.confidence(0.0)), float(one.confidence(0.0) / one.deviation(0.0))
        slope = float(one.covariance[1, 1]) ** 0.5 * times / bar * factor
        width = float(max(one.prediction(0.0), one.prediction(top))) * factor
        intercept = theme.plus_minus(one.intercept * factor, half * factor, unit)
        rise = theme.plus_minus(
            one.slope / bar * factor, slope, f"{unit} per {theme.scale('Pa')[1]}"
        )
        rows.append(
            (
                letter,
                *numbers(
                    intercept,
                    rise,
                    f"{theme.number(width, 2)} {unit}",
                    theme.number(one.scatter, 2),
                ),
            )
        )
    note = (
        "95 % by Student's t. Next: largest half-width of the prediction band up to the highest "
        "pressure measured; the machine file's tolerance is this band over all operating "
        "points. Scatter: observed scatter about the line over the stated standard deviation; "
        "above 1 it widens the bands."
    )
    columns = ("Coefficient", "At zero pressure", "Slope", "Next", "Scatter")
    return Table(
        f"Seal {theme.axis_name(fit.seal)}: lines over pressure", columns, tuple(rows), note
    )


def _agreement_tables(
    repeats: Repeats | None, compared: Sequence[Agreement] | None
) -> tuple[Table, ...]:
    """With repeated experiments and with another method, as far as there are such."""
    with_repeats = () if repeats is None else (repeats_table(repeats),)
    return with_repeats if compared is None else (*with_repeats, compared_table(compared))


def compared_table(rows: Sequence[Agreement]) -> Table:
    """What was found beside what another method had found."""
    cells: list[Row] = []
    for row in rows:
        unit = unit_of(row.path)
        difference = (
            f"{theme.number(row.difference, 2)} ± {theme.number(row.difference_half_width, 2)} %"
            if row.other
            else ""
        )
        pair = (
            _value(row.value, row.half_width, unit),
            _value(row.other, row.other_half_width, unit),
        )
        why = (
            ("noise" if row.agree else "more than noise")
            if row.other_half_width
            else "the other result has no interval"
        )
        cells.append((row.path, *numbers(*pair, difference), why))
    note = (
        "Difference with its 95 % half-width from both intervals. Beyond noise it is one of "
        "methods: chord over loads against "
        "tangent at small motion, or a model that is wrong in one of them."
    )
    columns = ("Parameter", "Found", "Other file", "Difference", "Explained by")
    return Table("Beside the other file", columns, tuple(cells), note)


def _value(value: float, half: float, unit: str) -> str:
    factor, name = theme.scale(unit, value)
    return theme.join(theme.fixed(value * factor, half * factor), name)


def _interval(value: float, half: float, unit: str) -> str:
    factor, name = theme.scale(unit, value)
    low, high = (theme.fixed((value + side * half) * factor, half * factor) for side in (-1, 1))
    return theme.join(f"{low} … {high}", name)


_TITLES = {
    "closed-loop": "Identification from closed-loop records",
    "youla": "Identification through the Youla residual",
}
_RESIDUAL = (
    "The residual system S from alpha to eps: the difference of the machine from its model. "
    "Measured without a "
    "model (95 % band), and S at the parameters found. Where the band is above the line, the "
    "parameters do not explain the difference; where it reaches the bottom, no difference is "
    "visible."
)
_CHANGE = (
    "How far the records moved every parameter from the machine file's value, with the 95 % "
    "interval of what was found."
)
_TIME = (
    "Broad: measured. Thin: the identified model. Third: the residual. The residual "
    "should look like noise. "
)
_WHOLE = (
    "Residuals of the model, on their own scale; the title gives their size and that of the "
    "signal. They should be equally small throughout: a single burst is a knock, contact or "
    "lost samples, bursts to one side at every "
    "large motion are the magnets' "
    "curvature, a slow growth is a drift."
)
_FRF = (
    "Displacement per current command on each axis, measured in closed loop with the excitation "
    "as instrument (no bias by "
    "feedback), with its 95 % band, and the model before and after. Third row: the model's "
    "error and the measurement's own (pale). Trust what is measured where the coherence is near 1. "
)
_RESPONSES = (
    "Each axis on itself, as measured (95 % band of its noise), and the model before and after. "
    "Third row: the model's error and the measurement's own (pale). "
)
_SEAL = (
    "Points are the identified coefficients; from three pressures on, the line is the weighted "
    "regression, the dark band contains the true line, the pale one the next measurement. k "
    "decides stability: compare it with C "
    "times the whirl frequency."
)
_CORRELATION = (
    "Left: how errors of two parameters go together; near ±1 only their combination is known. "
    "Right: cosine between the parameters' effects on the signals (columns of the Jacobian); "
    "not their correlation, mostly of the other sign. Values "
    "below 0.1 carry no number."
)
_TESTS = (
    "Largest correlation of a residual with an excitation over its 99 % limit. Above 1 the model "
    "misses something that the "
    "excitation causes, even where the fit looks good."
)


def identification_page(
    checked: LoopIdentification,
    *,
    compared: Sequence[Agreement] | None = None,
    title: str = "",
    date: str = "",
) -> Page:
    """The report of an identification; compared: with what another method had found. date: ISO date
    (today if empty).
    """
    machine, result = checked.given, checked.result
    seal = None if checked.seal is None else checked.seal.fit
    parameters = [parameters_table(result), *_agreement_tables(checked.repeats, compared)]
    change = Figure("Change from the start", change_figure(result), _CHANGE)
    sections = [
        Section("Parameters", capitalised(checked.remarks), (change,), tuple(parameters), True)
    ]
    if seal is not None:
        sections.append(Section("Seal", "", (seal_figure(seal),), seal_tables(seal)))
    if checked.residual is not None:
        sections.append(_residual_section(checked.residual))
    beside = (fit_table(result), *((turning_table(result),) if result.turning else ()))
    without = (
        ""
        if checked.magnets is None
        else "Measured is, here, without the part of the magnets' nonlinearity."
    )
    sections.append(
        Section("Measured over model", without, tuple(_comparisons(machine, checked)), beside)
    )
    tested = bool(result.tests)  # not of frequency responses
    pictures = [Figure("Residual tests", residual_tests_figure(result), _TESTS)] * tested
    if len(result.paths) > 1:
        pictures.append(
            Figure("Correlation and column cosine", correlation_figure(result), _CORRELATION)
        )
    sections.append(
        Section(
            "Can it be believed?",
            capitalised((result.verdict,)),
            tuple(pictures),
            (residual_tests_table(result),) * tested,
            folded=True,
        )
    )
    verdicts = _verdicts(checked, seal)
    failed = [verdict for verdict in verdicts if verdict.passed is False]
    worst, size = _least_certain(result)
    found = (
        f"{len(result.paths)} parameters identified, standard deviation at most {size} % ({worst})"
    )
    if any(not test.passed for test in result.tests):
        found += "; the intervals include the errors of the model"
    outcome = believed(found, checked.doubts)
    if outcome.passed and failed:
        outcome = Verdict("Result", False, f"Doubtful: {failed[0].label.lower()}: {failed[0].text}")
    return Page(
        title or _TITLES[checked.method],
        machine,
        (*doubtful(checked.doubts), *sections),
        verdicts,
        _facts(checked),
        date,
        result=outcome,
    )


def seal_figure(fit: SealFit) -> Figure:
    """K, k, C, c over pressure, with the regression lines from three pressures on."""
    rows = fit if np.isnan(fit.frequency).all() else averaged(fit)
    lines = (
        {letter: line(rows, letter) for letter in COEFFICIENTS} if len(rows.pressures) > 2 else {}
    )
    return Figure(
        f"Seal {theme.axis_name(fit.seal)}: coefficients against pressure",
        pressure_figure(rows, lines),
        _SEAL,
    )


def _comparisons(machine: Machine, checked: LoopIdentification) -> list[Figure]:
    figures: list[Figure] = []
    if checked.responses:
        return [responses_figure(checked.responses)]
    several = len(checked.outputs) > 1
    for number, piece in telling_records(checked.outputs):
        where = f", record {number}" if several else ""
        picture, words = overlay_figure(piece)
        figures.append(Figure(f"Time{where}", picture, _TIME + words))
        picture, words = residual_figure(piece)
        figures.append(
            Figure(
                f"Residual over the record{where}",
                picture,
                " ".join(part for part in (_WHOLE, words) if part),
            )
        )
    response = frf_figure(machine, checked)
    if response is not None:
        figures.append(Figure("Frequency response of the plant", response[0], _FRF + response[1]))
    return figures


def _residual_section(residual: ResidualIdentification) -> Section:
    title = "How the machine differs from its model"
    try:
        picture = residual_response(residual)
    except InvalidInput as error:  # excitations that cannot be told apart leave no response to draw
        return Section(title, f"The residual's frequency response is not drawn: {error}")
    return Section(title, "", (Figure("Residual system", picture, _RESIDUAL),))


def _verdicts(checked: LoopIdentification, seal: SealFit | None = None) -> tuple[Verdict, ...]:
    result = checked.result
    passed = result.adequate
    worst, size = _least_certain(result)
    least = min(percent for _, _, percent in result.fit)
    sure = _relative(_worst(result)) < 0.15 and result.converged
    verdicts = [
        Verdict("Residuals", passed, theme.prose(result.verdict.partition("; ")[0])),
        Verdict("Fit", None, f"{least:.1f} % or better in every signal"),
        Verdict(
            "Parameters",
            sure,
            f"standard deviations up to {size} % ({worst}), condition "
            f"{theme.number(result.condition, 2)}, {result.iterations} iterations"
            + ("" if result.converged else ", NOT converged"),
        ),
    ]
    count = len(checked.doubts) - (len(seal.warnings) if seal is not None else 0)
    text = "nothing found: channels, signs, rate, controller, timing and limits are as stated"
    if count:
        text = f"{count} finding{'s' if count > 1 else ''}; see below"
    verdicts.append(Verdict("Records", count == 0, text))
    if seal is not None:
        span = (
            f"{len(seal.pressures)} pressures up to "
            f"{theme.quantity(float(seal.pressure.max()), 'Pa')}"
        )
        warned = (
            f", {len(seal.warnings)} warning{'s' * (len(seal.warnings) != 1)}; see below"
            if seal.warnings
            else ""
        )
        verdicts.append(Verdict("Seal", not seal.warnings, f"K, k, C, c at {span}{warned}"))
    return tuple(verdicts)


def _worst(result: ParameterEstimate) -> tuple[str, float, float]:
    """Path, value and deviation of the parameter with the largest relative deviation."""
    rows = zip(result.paths, result.values, result.standard_deviations, strict=True)
    return max(rows, key=_relative)


def _least_certain(result: ParameterEstimate) -> tuple[str, str]:
    """Its path, and its standard deviation in per cent."""
    worst = _worst(result)
    return worst[0], theme.number(100 * _relative(worst), 2)


def _relative(row: tuple[str, float, float]) -> float:
    return float(row[2]) / max(abs(float(row[1])), 1e-300)


def _facts(checked: LoopIdentification) -> tuple[tuple[str, str], ...]:
    result = checked.result
    spans = [
        f"{theme.number(piece.record.values.shape[1] / piece.record.sample_rate_hz, 4)} s"
        for piece in checked.outputs
    ]
    rates = [theme.number(piece.record.sample_rate_hz, 6) for piece in checked.outputs[:1]]
    what = f" ({', '.join(spans)} at {rates[0]} Hz)" if rates else " (frequency responses)"
    delay, modes = checked.computing_delay, checked.bending_modes
    law = law_of(checked.controller, functions=False)
    return (
        (
            "Records",
            f"{', '.join(checked.provenance.records) or len(spans)}{what}",
        ),
        ("Controller", law.named if law.digest else checked.provenance.controller),
        ("Operating point", result.point.label),
        ("Seal pressure", theme.quantity(result.point.seal_pressure, "Pa")),
        ("Speed", f"{theme.number(result.point.speed * theme.RPM, 4)} rpm"),
        (
            "Model",
            f"{modes} bending mode{'s' * (modes != 1)} per plane, computing delay {delay:g} "
            f"sample{'s' * (delay != 1)}",
        ),
    )


_FREQUENCY = (
    "Each pressure and frequency separately, with 95 % bars; lines: the means over frequency. "
    "Grey crosses: what shows without "
    "pressure beyond the machine file's seal, from bearings and couplings a little off, and is "
    "taken off all points."
)


def seal_page(done: SealByFrequency, *, date: str = "") -> Page:
    """The page of a seal; date: ISO (today if empty)."""
    fit, doubts = done.fit, done.findings
    f = fit.frequency / theme.TWO_PI
    figures = (
        Figure("Coefficients over frequency", frequency_figure(fit, done.constants), _FREQUENCY),
        seal_figure(fit),
    )
    section = Section("Seal", "", figures, tuple(frequency_tables(done)), folded=True)
    base = (
        "taken off: records without pressure were given"
        if done.reference
        else "none: the machine file is taken as exact"
    )
    verdicts = (
        tables.without_findings(
            "Records", doubts, "channels, limits and scatter as they should be"
        ),
        Verdict("Baseline without pressure", None, base),
    )
    facts = (
        ("Records", ", ".join(done.records)),
        ("Method", fit.method),
        ("Pressures", ", ".join(theme.quantity(float(p), "Pa") for p in fit.pressures)),
        ("Frequencies", f"{len(np.unique(f))} from {f.min():.4g} to {f.max():.4g} Hz"),
    )
    title = f"Seal {theme.axis_name(fit.seal)} by frequency and pressure"
    return Page(
        title,
        done.given,
        (*tables.doubtful(doubts), section),
        verdicts,
        facts,
        date,
        result=believed(f"Seal coefficients identified at {len(fit)} points", doubts),
    )


def frequency_tables(done: SealByFrequency) -> Iterator[Table]:
    """Means by pressure, lines over it, then every row."""
    yield from seal_tables(done.constants)
    rows: list[Row] = []
    for i in range(len(done.fit)):
        cells: list[str | Cell] = [
            theme.quantity(float(done.fit.pressure[i]), "Pa", 4),
            theme.quantity(float(done.fit.frequency[i]), "rad/s", 4),
        ]
        for j, letter in enumerate(COEFFICIENTS):
            factor, unit = theme.coefficient_scale(letter)
            half = COVERAGE * float(done.fit.deviations[i, j]) * factor
            cells += numbers(theme.plus_minus(float(done.fit.values[i, j]) * factor, half, unit))
        rows.append(tuple(cells))
    yield Table(
        "Every pressure and frequency", ("Pressure", "Frequency", *COEFFICIENTS), tuple(rows)
    )
