"""The page of an identification: what was identified, whether to believe it, the tables that say so
and the pictures to see why.

    write(identification_page(identify(machine, records, controller)), "identified.html")
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ambrose.core.checks import InvalidInput
from ambrose.identification.output_error.closed_loop import ParameterEstimate
from ambrose.identification.parameters import COVERAGE, unit_of
from ambrose.identification.result import LoopIdentification
from ambrose.identification.seal.result import COEFFICIENTS, SealFit, averaged, line
from ambrose.identification.validation.agreement import Agreement
from ambrose.identification.validation.repeatability import Repeats
from ambrose.identification.youla.identify import ResidualIdentification
from ambrose.machine.machine import Machine
from ambrose.report import units
from ambrose.report.figures.measured import residual_figure as residual_response
from ambrose.report.figures.seals import pressure_figure
from ambrose.report.identification.figures import (
    change_figure,
    correlation_figure,
    frf_figure,
    overlay_figure,
    residual_figure,
    residual_tests_figure,
    telling_records,
)
from ambrose.report.page import Cell, Figure, Page, Row, Section, Table, Verdict, numbers
from ambrose.report.tables import capitalised, doubtful

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
            f"{units.fixed(100 * (value / start - 1), 100 * half / abs(start))} %" if start else ""
        )
        spread = f"{units.number(100 * float(deviation) / abs(value), 2)} %" if value else ""
        cells = numbers(
            units.quantity(start, unit, 4),
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
            units.axis_name(signal),
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
            units.axis_name(one.signal),
            f"{one.order} x" if one.order else "tone",
            f"{one.frequency:.5g} Hz",
            f"{one.amplitude * scale:.3g} ± {COVERAGE * one.standard_deviation * scale:.2g} {unit}",
            f"{np.degrees(one.phase):.0f}°" if one.amplitude > 3 * one.standard_deviation else "-",
        )
        for one in result.turning
        for scale, unit in ((1e6, "µm") if one.signal.startswith("y_") else (1.0, "A"),)
    ]
    note = (
        "Amplitude and phase (cosine, from the first sample) beside all that follows the "
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
            units.axis_name(test.signal),
            units.prose(test.excitation),
            *numbers(units.number(test.correlation, 2), units.number(test.limit, 2), str(test.lag)),
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
        scatter = (f"{units.number(share, 2)} %" for share in (float(repeats.rsd[i]), stated))
        rows.append(
            (path, *numbers(_value(mean, half, unit), _interval(mean, half, unit), *scatter))
        )
    note = (
        f"{repeats.count} records, each identified alone. Interval of the mean: Student's t. RSD: "
        "scatter of one record over "
        "the mean; where it is far above what the single records state, something else than noise "
        "changes between them."
    )
    columns = ("Parameter", "Mean", f"{100 * repeats.level:g} % interval", "RSD", "RSD stated")
    return Table("Repeats", columns, tuple(rows), note)


def seal_table(fit: SealFit) -> Table:
    """K, k, C, c at every pressure with their 95 % intervals."""
    rows: list[Row] = []
    for i, pressure in enumerate(fit.pressure.tolist()):
        cells = [Cell(units.quantity(pressure, "Pa", 4))]
        for j, letter in enumerate(COEFFICIENTS):
            factor, unit = units.coefficient_scale(letter)
            half = COVERAGE * float(fit.deviations[i, j]) * factor
            cells += numbers(units.plus_minus(float(fit.values[i, j]) * factor, half, unit))
        rows.append(tuple(cells))
    note = (
        "95 % interval of what noise leaves open, all else as identified. K and c, and k and C, "
        "act alike at one frequency."
    )
    columns = ("Pressure", *COEFFICIENTS)
    return Table(f"Seal {units.axis_name(fit.seal)} by pressure", columns, tuple(rows), note)


def seal_tables(fit: SealFit) -> tuple[Table, ...]:
    """The coefficients by pressure and, from three pressures on, the lines over it."""
    return (seal_table(fit), *([seal_lines_table(fit)] if len(fit.pressures) > 2 else []))


def seal_lines_table(fit: SealFit) -> Table:
    """The regression lines over pressure."""
    rows: list[Row] = []
    for letter in COEFFICIENTS:
        one = line(fit, letter)
        factor, unit = units.coefficient_scale(letter)
        bar, top = units.scale("Pa")[0], float(fit.pressure.max())
        half, times = float(one.confidence(0.0)), float(one.confidence(0.0) / one.deviation(0.0))
        slope = float(one.covariance[1, 1]) ** 0.5 * times / bar * factor
        width = float(max(one.prediction(0.0), one.prediction(top))) * factor
        intercept = units.plus_minus(one.intercept * factor, half * factor, unit)
        rise = units.plus_minus(
            one.slope / bar * factor, slope, f"{unit} per {units.scale('Pa')[1]}"
        )
        rows.append(
            (
                letter,
                *numbers(
                    intercept,
                    rise,
                    f"{units.number(width, 2)} {unit}",
                    units.number(one.scatter, 2),
                ),
            )
        )
    note = (
        "95 % by Student's t. Next: half-width of the band for a further measurement, at its "
        "widest up to the highest pressure "
        "measured; the machine file's tolerance is this band over all operating points. Scatter: "
        "of the points about the line "
        "over what each states; above 1 the bands are widened by it."
    )
    columns = ("Coefficient", "At zero pressure", "Slope", "Next", "Scatter")
    return Table(
        f"Seal {units.axis_name(fit.seal)}: lines over pressure", columns, tuple(rows), note
    )


def compared_table(rows: Sequence[Agreement]) -> Table:
    """What was found beside what another method had found."""
    cells: list[Row] = []
    for row in rows:
        unit = unit_of(row.path)
        difference = (
            f"{units.number(row.difference, 2)} ± {units.number(row.difference_half_width, 2)} %"
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
            else "the other states no interval"
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
    factor, name = units.scale(unit, value)
    return units.join(units.fixed(value * factor, half * factor), name)


def _interval(value: float, half: float, unit: str) -> str:
    factor, name = units.scale(unit, value)
    low, high = (units.fixed((value + side * half) * factor, half * factor) for side in (-1, 1))
    return units.join(f"{low} … {high}", name)


_TITLES = {
    "closed-loop": "Identification from closed-loop records",
    "youla": "Identification through the Youla residual",
}
_RESIDUAL = (
    "The residual system S from alpha to eps: what the machine does beyond what was expected of "
    "its model. Measured without a "
    "model (95 % band), and S at the parameters found. Where the band stands above the line, the "
    "parameters do not explain the "
    "difference; where it reaches the bottom, there is none to be seen."
)
_CHANGE = (
    "How far the records moved every parameter from the machine file's value, with the 95 % "
    "interval of what was found."
)
_TIME = (
    "Broad the measurement, thin the identified model, and what is left between them. The residual "
    "should look like noise. "
)
_WHOLE = (
    "What the model leaves, on its own scale; written above: its size beside that of the signal. "
    "It should be equally small "
    "throughout: a single burst is a knock, contact or lost samples, bursts to one side at every "
    "large motion are the magnets' "
    "curvature, a slow growth is a drift."
)
_FRF = (
    "Displacement per current command on each axis, measured in closed loop with the excitation "
    "as instrument (no bias by "
    "feedback), with its 95 % band, and the model before and after. Third row: the model's error "
    "beside the "
    "measurement's own (pale). Trust what is measured where the coherence is near 1. "
)
_SEAL = (
    "Points are the identified coefficients; from three pressures on, the line is the weighted "
    "regression, the dark band holds "
    "the true line, the pale one the next measurement. k decides stability: compare it with C "
    "times the whirl frequency."
)
_CORRELATION = (
    "Left: how errors of two parameters go together; near ±1 only their combination is known. "
    "Right: how alike their effects "
    "on the signals are (cosine between columns of the Jacobian); it is no correlation, and "
    "mostly of the other sign. Values "
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
    parameters: list[Table] = [parameters_table(result)]
    if checked.repeats is not None:
        parameters.append(repeats_table(checked.repeats))
    if compared is not None:
        parameters.append(compared_table(compared))
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
    pictures = [Figure("Residual tests", residual_tests_figure(result), _TESTS)]
    if len(result.paths) > 1:
        pictures.append(
            Figure("Correlation and column cosine", correlation_figure(result), _CORRELATION)
        )
    sections.append(
        Section(
            "Can it be believed?", "", tuple(pictures), (residual_tests_table(result),), folded=True
        )
    )
    verdicts = _verdicts(checked, seal)
    failed = [verdict.label.lower() for verdict in verdicts if verdict.passed is False]
    traced = any(not test.passed for test in result.tests)
    good = (
        "identified; what the model lacks hardly moves the values"
        if traced
        else "identified, and nothing speaks against it"
    )
    words = f"to be doubted: {', '.join(failed)}" if failed else good
    return Page(
        title or _TITLES[checked.method],
        machine,
        (*doubtful(checked.doubts), *sections),
        verdicts,
        _facts(checked),
        date,
        result=Verdict("Result", not failed, words),
    )


def seal_figure(fit: SealFit) -> Figure:
    """K, k, C, c over pressure, with the regression lines from three pressures on."""
    rows = fit if np.isnan(fit.frequency).all() else averaged(fit)
    lines = (
        {letter: line(rows, letter) for letter in COEFFICIENTS} if len(rows.pressures) > 2 else {}
    )
    return Figure(
        f"Seal {units.axis_name(fit.seal)}: coefficients against pressure",
        pressure_figure(rows, lines),
        _SEAL,
    )


def _comparisons(machine: Machine, checked: LoopIdentification) -> list[Figure]:
    figures = []
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
    worst = max(
        zip(result.paths, result.values, result.standard_deviations, strict=True), key=_relative
    )
    least = min(percent for _, _, percent in result.fit)
    sure = _relative(worst) < 0.15 and result.converged
    verdicts = [
        Verdict("Residuals", passed, units.prose(result.verdict)),
        Verdict("Fit", None, f"{least:.1f} % or better in every signal"),
        Verdict(
            "Parameters",
            sure,
            f"standard deviations up to {units.number(100 * _relative(worst), 2)} % ({worst[0]}), "
            "condition "
            f"{units.number(result.condition, 2)}, {result.iterations} iterations"
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
            f"{units.quantity(float(seal.pressure.max()), 'Pa')}"
        )
        warned = (
            f", {len(seal.warnings)} warning{'s' * (len(seal.warnings) != 1)}; see below"
            if seal.warnings
            else ""
        )
        verdicts.append(Verdict("Seal", not seal.warnings, f"K, k, C, c at {span}{warned}"))
    return tuple(verdicts)


def _relative(row: tuple[str, float, float]) -> float:
    return float(row[2]) / max(abs(float(row[1])), 1e-300)


def _facts(checked: LoopIdentification) -> tuple[tuple[str, str], ...]:
    result = checked.result
    spans = [
        f"{units.number(piece.record.values.shape[1] / piece.record.sample_rate_hz, 4)} s"
        for piece in checked.outputs
    ]
    rate = units.number(checked.outputs[0].record.sample_rate_hz, 6)
    delay, modes = checked.computing_delay, checked.bending_modes
    return (
        (
            "Records",
            f"{', '.join(checked.provenance.records) or len(spans)} ({', '.join(spans)} at {rate} "
            "Hz)",
        ),
        ("Controller", checked.provenance.controller),
        ("Operating point", result.point.label),
        ("Seal pressure", units.quantity(result.point.seal_pressure, "Pa")),
        ("Speed", f"{units.number(result.point.speed * units.RPM, 4)} rpm"),
        (
            "Model",
            f"{modes} bending mode{'s' * (modes != 1)} per plane, computing delay {delay:g} "
            f"sample{'s' * (delay != 1)}",
        ),
    )
