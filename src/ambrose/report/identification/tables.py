"""An identification as tables: parameters with their intervals, fit per signal, residual tests,
findings, repeats.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ambrose.identification.findings import ERROR, Finding
from ambrose.identification.output_error.closed_loop import ParameterEstimate
from ambrose.identification.parameters import COVERAGE, unit_of
from ambrose.identification.seal.result import COEFFICIENTS, SealFit, line
from ambrose.identification.validation.agreement import Agreement
from ambrose.identification.validation.repeatability import Repeats
from ambrose.report import units
from ambrose.report.page import Cell, Row, Table, numbers

_UNSURE = 0.1  # half-width over value that is marked


def parameters_table(result: ParameterEstimate) -> Table:
    """Parameter, start, value, 95 % interval, relative standard deviation."""
    rows: list[Row] = []
    for path, start, value, deviation in zip(
        result.paths, result.start, result.values, result.standard_deviations, strict=True
    ):
        unit, half = unit_of(path), COVERAGE * float(deviation)
        relative = half / abs(value) if value else math.inf
        change = f"{fixed(100 * (value / start - 1), 100 * half / abs(start))} %" if start else ""
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


def findings_table(findings: Sequence[Finding]) -> Table:
    """Everything that makes the result doubtful."""
    rows = [
        (
            Cell(units.prose(finding.what), "fail" if finding.severity == ERROR else "none"),
            units.prose(finding.evidence),
            units.prose(finding.remedy),
        )
        for finding in findings
    ]
    return Table("Findings", ("What", "Evidence", "What to do"), tuple(rows))


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
            cells += numbers(plus_minus(float(fit.values[i, j]) * factor, half, unit))
        rows.append(tuple(cells))
    note = (
        "95 % interval of what noise leaves open, all else as identified. K and c, and k and C, "
        "act alike at one frequency."
    )
    columns = ("Pressure", *COEFFICIENTS)
    return Table(f"Seal {units.axis_name(fit.seal)} by pressure", columns, tuple(rows), note)


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
        intercept = plus_minus(one.intercept * factor, half * factor, unit)
        rise = plus_minus(one.slope / bar * factor, slope, f"{unit} per {units.scale('Pa')[1]}")
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


def plus_minus(value: float, half: float, unit: str) -> str:
    """ "3.10 ± 0.04 kN/m", all in the shown unit."""
    return f"{fixed(value, half)} ± {units.number(half, 2)} {unit}"


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
    return units.join(fixed(value * factor, half * factor), name)


def _interval(value: float, half: float, unit: str) -> str:
    factor, name = units.scale(unit, value)
    low, high = (fixed((value + side * half) * factor, half * factor) for side in (-1, 1))
    return units.join(f"{low} … {high}", name)


def fixed(value: float, half: float) -> str:
    """A number with as many digits as its half-width makes sense of: two of the half-width's."""
    if not (math.isfinite(value) and math.isfinite(half)) or half <= 0 or value == 0:
        return units.number(value, 5)
    digits = 2 + math.floor(math.log10(abs(value))) - math.floor(math.log10(half))
    return units.number(value, min(max(digits, 1), 9))
