"""One page from one identification: what was found, whether to believe it, and the pictures to see
why.

write(identification_report(done), "identified.html")
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ambrose.core.checks import InvalidInput
from ambrose.identification.result import LoopIdentification
from ambrose.identification.seal.result import COEFFICIENTS, SealFit, averaged, line
from ambrose.identification.validation.agreement import Agreement
from ambrose.identification.youla.identify import ResidualIdentification
from ambrose.machine.machine import Machine
from ambrose.report import units
from ambrose.report.figures import residual_response
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
from ambrose.report.identification.tables import (
    compared_table,
    findings_table,
    fit_table,
    parameters_table,
    repeats_table,
    residual_tests_table,
    seal_lines_table,
    seal_table,
    turning_table,
)
from ambrose.report.page import Figure, Report, Section, Table, Verdict

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


def identification_report(
    checked: LoopIdentification,
    *,
    compared: Sequence[Agreement] | None = None,
    title: str = "",
    date: str = "",
) -> Report:
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
    remarks = " ".join(f"{remark[:1].upper()}{remark[1:]}." for remark in checked.remarks)
    change = Figure("Change from the start", change_figure(result), _CHANGE)
    sections = [Section("Parameters", remarks, (change,), tuple(parameters), True)]
    if seal is not None:
        tables = (seal_table(seal), *((seal_lines_table(seal),) if len(seal.pressures) > 2 else ()))
        sections.append(Section("Seal", "", (seal_figure(seal),), tables))
    if checked.doubts:
        sections.insert(
            0, Section("What makes this doubtful", "", (), (findings_table(checked.doubts),))
        )
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
    return Report(
        title or _TITLES[checked.method],
        machine,
        tuple(sections),
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
        picture = residual_response.residual_figure(residual)
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
