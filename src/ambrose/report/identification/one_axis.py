"""The page of one axis identified from its record alone: values and where their intervals come
from, the questions that the model passed or failed, the prediction of what was not fitted.

write(generic_page(done), "axis.html")
"""

from __future__ import annotations

import math
from typing import Any

from ambrose.identification.one_axis.estimate import LEVEL
from ambrose.identification.one_axis.result import GenericIdentification, PlantValue
from ambrose.report import theme, units
from ambrose.report.page import Cell, Figure, Page, Row, Section, Subject, Table, Verdict, numbers
from ambrose.report.tables import doubtful

_PREDICTED = (
    "Broad the second half of the record as measured, thin what the plant found in the first half "
    "makes of it, one time constant 1/p ahead and with u known. A wrong pole runs away here."
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
                    units.plus_minus(*_scaled(item)),
                    _half(item.formal, item),
                    _half(item.halves, item),
                    other,
                ),
            )
        )
    note = (
        "y'' = a y + b u(t - tau), p = sqrt(a), 95 %. The interval is the larger of the formal one "
        "and of what both halves of the record differ by. Second way: instruments, "
        "without a noise model. Without an actuator the delay holds all lags."
    )
    columns = ("Quantity", "Value", "Formal", "Halves", "Second way")
    return Table("Plant", columns, tuple(rows), note)


def _factor(item: PlantValue) -> tuple[float, str]:
    return (1e3, "ms") if item.unit == "s" else (1.0, item.unit)


def _scaled(item: PlantValue) -> tuple[float, float, str]:
    factor, unit = _factor(item)
    return item.value * factor, item.half_width * factor, unit


def _half(value: float, item: PlantValue) -> str:
    return f"± {units.number(value * _factor(item)[0], 2)}"


def _shown(value: float, item: PlantValue) -> str:
    factor, _ = _factor(item)
    return units.fixed(value * factor, item.half_width * factor)


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
            f"chance {units.number(tried.white, 2)}; its past tells "
            f"{units.number(100 * tried.white_share, 2)} %",
            _mark(tried.white >= LEVEL if direct else None),
        ),
        (
            "Residual free of the excitation",
            f"chance {units.number(tried.follows, 2)}; "
            f"{units.number(100 * tried.follows_share, 2)} % follows",
            _mark(tried.follows >= LEVEL),
        ),
        (
            "Both ways agree",
            "not known" if tried.agree is None else f"chance {units.number(tried.agree, 2)}",
            _mark(None if tried.agree is None or not direct else tried.agree >= 0.001),
        ),
        (
            "Straight",
            f"chance of the curvature seen {units.number(tried.curved, 2)}",
            _mark(True if tried.curved >= 0.001 else None),
        ),
        (
            "Driven from outside",
            f"gain over its deviation {units.number(tried.outside, 3)}, by the {outside}",
            _mark(tried.outside >= 5),
        ),
        (
            "Coherence about the pole",
            f"{units.number(done.coherence_in_band, 2)}; by chance {units.number(done.chance, 2)}",
            _mark(None),
        ),
        (
            f"Second half, {units.number(1e3 * ahead.horizon, 3)} ms ahead",
            f"error {units.quantity(ahead.error, 'm')}, promised "
            f"{units.quantity(ahead.expected, 'm')}; staying where it is "
            f"{units.quantity(ahead.still, 'm')}",
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
                f"{units.number(row.expected, 4)} {row.unit}",
                units.plus_minus(row.found, row.half_width, row.unit),
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
    count = len(done.findings)
    facts = (
        ("Record", done.record.name),
        ("Columns", ", ".join(f"{what}: {name}" for what, name in done.record.columns)),
        ("Samples", f"{len(done.record.position)} at {done.record.rate:.6g} Hz"),
    )
    good = "identified, and nothing speaks against it"
    return Page(
        "One axis, from its record alone",
        Subject(done.record.name),
        (*doubtful(done.findings), *sections),
        verdicts,
        facts,
        date,
        result=Verdict("Result", not count, "to be doubted; see below" if count else good),
    )


def _predicted(done: GenericIdentification) -> str:
    ahead = done.estimate.prediction
    error, promised = units.quantity(ahead.error, "m"), units.quantity(ahead.expected, "m")
    return f"the second half, from the first: error {error}, promised {promised}"


def prediction_figure(done: GenericIdentification) -> Any:
    """Measured and predicted displacement over the beginning of the second half."""
    ahead = done.estimate.prediction
    figure = theme.subplots(rows=1, cols=1)
    place = {"row": 1, "col": 1}
    factor, unit = units.scale("m", float(abs(ahead.measured).max()))
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
