"""The page of a retuning, one to sign: what the machine is now, what its controller does on it,
what replaces it, how it was tried.

write(retuning_page(retune(machine, records, controller, folder)), "retuning.html")
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ambrose.annexes.site.acceptance import Acceptance, MeasuredLoop
from ambrose.annexes.site.balancing import Balancing
from ambrose.annexes.site.bias import BiasCampaign
from ambrose.annexes.site.frf import (
    ComparedResponse,
    PointResponse,
    Responses,
    heard,
    open_loop,
    summary,
)
from ambrose.annexes.site.retuning import Retuning, Switch, at_point
from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import FrequencyResponse
from ambrose.identification.frf import IN_WORDS
from ambrose.identification.frf_spectral import Frf
from ambrose.judge.checks import Check, Checks, Curve, Verification, required_line, zone_lines
from ambrose.judge.measured import MEASURED
from ambrose.law.law import law_of
from ambrose.law.loop import timing_in_words
from ambrose.machine.criteria import SENSITIVITY
from ambrose.model.effects import magnet
from ambrose.report import tables, theme, theme as units
from ambrose.report.figures.bode import Panel, nyquist, panel_figure, panels
from ambrose.report.figures.curves import figure
from ambrose.report.figures.seals import response_figure
from ambrose.report.identification import change_figure, parameters_table
from ambrose.report.page import Cell, Figure, Page, Row, Section, Table, Verdict, numbers

# The page that is signed on site: measured sensitivity, closed and open loop of every axis over
# what was predicted.
#
# write(acceptance_page(accept(machine, controller, records)), "acceptance.html")


_SENSITIVITY = (
    "Modulus of the output sensitivity of every axis with the other loops closed (ISO 14839-3), "
    "and the largest singular value of the whole matrix, which is stricter. Blue with its 95 % "
    "band: measured, and nothing where noise hides the loop. Thin: predicted by the machine "
    "file, and with the magnets at the static load of the record. The upper edge of the band "
    "must meet the limits."
)
_CLOSED = "Modulus of the complementary sensitivity 1 − S of every axis: reference to displacement."
_OPEN = (
    "Open loop 1/S − 1 of every axis with the other loops closed, about the critical point −1. "
    "Circles: the borders of the "
    "zones, |S| = 3, 4 and 5; a loop that stays outside the largest is in zone A."
)


_MEASURED = "Measured. Limits apply to the outer end of the 95 % interval."


def acceptance_page(accepted: Acceptance, *, date: str = "") -> Page:
    """The page of an acceptance; date: ISO (today if empty)."""
    limit = accepted.machine.requirements.sensitivity_peak
    sections = [
        section
        for loop in accepted.points
        for section in _sections(loop, limit, len(accepted.points) > 1)
    ]
    sections.append(
        Section(
            "All checks",
            "",
            (),
            tuple(tables.checks_table(loop.checks) for loop in accepted.points),
        )
    )
    loops = Verification(
        tuple(loop.checks for loop in accepted.points), timing=str(accepted.timing)
    )
    facts = (
        ("Controller", law_of(accepted.controller).named),
        ("Loop", timing_in_words(f"{accepted.timing}")),
        *(("Record", f"{name}, SHA-256 {sha256}") for name, sha256 in accepted.records),
        tables.unstated(accepted.machine),
    )
    table = tables.deciding_table(loops)
    decides = replace(table, note=f"{_MEASURED} {table.note}".strip())
    return Page(
        "Acceptance of the magnetic bearing loop",
        accepted.machine,
        tuple(sections),
        (),
        facts,
        date,
        result=Verdict("Result", accepted.passed, tables.deciding_verdict(loops)),
        opening=Section("", tables=(decides,)),
    )


def _sections(loop: MeasuredLoop, requirement: float | None, several: bool) -> list[Section]:
    """The three figures of one record. requirement: the machine's limit of |S|, drawn beside the
    zones of the axes; several: the point's name stands in the titles.
    """
    where = f", {loop.checks.label}" if several else ""
    names = [units.axis_name(axis) for axis in loop.axes]
    diagonal = {label: np.einsum("wii->wi", S) for label, S in loop.predicted}

    # per prediction: modulus of every axis, and sigma_max of the whole matrix in the last column
    S = {
        label: np.column_stack([np.abs(diagonal[label]), np.linalg.norm(full, 2, axis=(1, 2))])
        for label, full in loop.predicted
    }
    sensitivity = panels(
        [*names, "σ max"],
        loop.omega,
        np.column_stack([loop.modulus, loop.sigma]),
        np.column_stack([loop.modulus - loop.half, loop.low]),
        np.column_stack([loop.modulus + loop.half, loop.high]),
        S,
        [zone_lines(SENSITIVITY, requirement)] * len(names) + [required_line(requirement)],
        loop.told,
    )

    # T_ii = 1 - S_ii has the error of S_ii; the open loop of an axis is 1/S_ii - 1
    clear = loop.told[:, :-1]
    T = np.abs(1 - np.einsum("wii->wi", loop.S))
    opened = {label: 1 / S_ii - 1 for label, S_ii in diagonal.items()}
    closed = {label: np.abs(1 - S_ii) for label, S_ii in diagonal.items()}
    none: list[tuple[tuple[str, float], ...]] = [()] * len(names)
    figures = (
        Figure(f"Sensitivity{where}", sensitivity, _SENSITIVITY),
        Figure(f"Open loop{where}", nyquist(names, loop.omega, loop.loops, opened, clear), _OPEN),
        Figure(
            f"Closed loop{where}",
            panels(names, loop.omega, T, T - loop.half, T + loop.half, closed, none, clear),
            _CLOSED,
        ),
    )
    return [Section(f"Measured over predicted{where}", "", figures)]


# A balancing as tables: the masses to add, and 1x before and after.


def balancing_tables(result: Balancing) -> tuple[Table, Table]:
    """Corrections, then 1x of every sensor axis at every speed, now and as predicted."""
    rows: list[Row] = []
    for plane, radius, u, limit, mass, angle in zip(
        result.planes,
        result.radii,
        result.correction,
        result.uncertainty,
        result.masses,
        result.angles,
        strict=True,
    ):
        share = min(float(limit / abs(u)), 1.0) if u else 1.0
        spread = (
            "any"
            if share >= 1
            else f"{np.degrees(angle):.1f}° ± {np.degrees(np.arcsin(share)):.1f}°"
        )
        cells = numbers(
            units.quantity(radius, "m"),
            f"{1e3 * mass:.4g} ± {1e3 * limit / radius:.2g} g",
            spread,
            units.quantity(abs(u), "kg m"),
            units.quantity(float(limit), "kg m"),
        )
        rows.append((plane, *cells))
    note = (
        "Degrees from the key mark in the direction of spin; to remove mass, take the opposite "
        "angle. Left at most: remaining unbalance of the plane (95 %)."
    )
    columns = ("Plane", "Radius", "Add", "At", "Unbalance", "Left at most")
    masses = Table("Correction masses", columns, tuple(rows), note)
    shown: list[Row] = [
        (
            Cell(units.axis_name(row.axis)),
            *numbers(
                f"{row.speed * units.RPM:.5g} rpm",
                units.quantity(abs(row.before), "m"),
                units.quantity(abs(row.after), "m"),
                units.quantity(abs(row.after) + row.radius, "m"),
            ),
        )
        for row in result.rows
    ]
    what = (
        "of the measured y, less its run-out"
        if result.quantity == "y"
        else "of y - G u, less run-out (no controller is known)"
    )
    head = ("Axis", "Speed", "Now", "Predicted", "At most (95 %)")
    return masses, Table(
        "1x, zero to peak",
        head,
        tuple(shown),
        f"What unbalance makes {what}; run-out, which a monitor shows as well, is not in it.",
    )


def in_words(result: Balancing) -> list[str]:
    """How it was found, and what the balance quality becomes, in lines of text."""
    lines = [
        f"Coefficients: {result.method}; condition of the matrix {units.number(result.condition)}; "
        f"their error, by the misfit: {units.number(100 * result.model_error, 2)} %",
        "1x is zero in every row: there is nothing to lower"
        if result.remaining is None
        else f"1x falls to {units.number(100 * result.remaining, 2)} % or less (95 %)",
    ]
    now, then = result.grade(np.abs(result.correction)), result.grade(result.uncertainty)
    if now is not None and then is not None and result.allowed is not None:
        allowed = f"G{1e3 * result.allowed.grade:g} at {result.allowed.speed * units.RPM:.5g} rpm"
        lines.append(
            f"Balance quality (ISO 21940-11) now G{1e3 * now:.3g}, then G{1e3 * then:.3g} or "
            f"better; to be {allowed}"
        )
    if result.runout_found and result.runout.any():
        runout = ", ".join(
            f"{1e6 * abs(r):.3g} µm at {np.degrees(np.angle(r)):.0f}°" for r in result.runout
        )
        lines.append(f"Run-out at 1x, by the speeds: {runout}")
    if result.scale is not None:
        scale = result.scale
        lines.append(
            f"The model's coefficients are {abs(scale):.3f} times the measured, turned by "
            f"{np.degrees(np.angle(scale)):.1f}°"
        )
    return [*lines, *(f"note: {note}" for note in result.notes)]


# The page of a bias campaign: K_i and K_s of every axis over the bias current, by both methods (P2,
# Fig. 4 and table 2).
#
# write(bias_page(identify_over_bias(machine, records, controllers)), "bias.html")


_QUANTITIES = (
    ("force_per_current", "Force per current K_i", "N/A"),
    ("negative_stiffness", "Negative stiffness K_s", "N/m"),
)
_CAPTION = (
    "Circles: from closed-loop records, small motion at the working point; squares: chord over "
    "static loads; 95 % bars. Line: the machine file before identification, where it has "
    "coefficients. Without iron K_i grows with the bias and "
    "K_s with its square; what "
    "bends down at high bias is iron that saturates."
)
_METHODS = (
    ("small motion", False, "circle", "#0072b2"),
    ("static loads", True, "square-open", "#d55e00"),
)
_COLUMNS, _HEIGHT = 2, 190


def bias_page(done: BiasCampaign, *, date: str = "") -> Page:
    """The page of a bias campaign; date: ISO (today if empty)."""
    section = Section(
        "K_i and K_s over bias current", "", tuple(_figures(done)), tuple(bias_tables(done))
    )
    facts = (
        ("Records", ", ".join(done.names)),
        ("Bias currents", ", ".join(f"{row.bias:g} A" for row in done.rows)),
    )
    good = "nothing found in records and residuals"
    return Page(
        "Magnets over bias current",
        done.given,
        (*tables.doubtful(done.findings), section),
        (tables.without_findings("Records", done.findings, good),),
        facts,
        date,
        result=tables.believed(
            f"Magnets identified at {len(done.rows)} bias currents", done.findings
        ),
    )


def _figures(done: BiasCampaign) -> Iterator[Figure]:
    """K_i and K_s over the bias current, a figure each."""
    for quantity, name, unit in _QUANTITIES:
        yield Figure(
            name, _picture(done, quantity, unit), _CAPTION if quantity == _QUANTITIES[0][0] else ""
        )


def _picture(done: BiasCampaign, quantity: str, unit: str) -> Any:
    """One coefficient over the bias current: a panel per axis, both methods and the file's line."""
    axes = [(b, way) for b in done.given.bearings for way in ("zeta", "eta")]
    titles = [f"<b>{theme.plain(units.axis_name(f'{b.name}_{way}'))}</b>" for b, way in axes]
    rows = -(-len(axes) // _COLUMNS)
    gaps = {"horizontal_spacing": 0.12, "vertical_spacing": 0.3 / rows}
    picture = theme.subplots(rows=rows, cols=_COLUMNS, subplot_titles=titles, **gaps)

    # one scale for all axes, of the largest value found
    every = [row.values(static) for row in done.rows for static in (False, True)]
    sizes = [
        abs(value) for values in every for path, (value, _) in values.items() if quantity in path
    ]
    factor, shown = units.scale(unit, max(sizes, default=0.0))
    span = np.linspace(min(row.bias for row in done.rows), max(row.bias for row in done.rows), 30)
    for k, (bearing, way) in enumerate(axes):
        place, first = {"row": k // _COLUMNS + 1, "col": k % _COLUMNS + 1}, k == 0
        path = f"bearing.{bearing.name}.{quantity}.{way}"
        line = np.array([_by_file(bearing, quantity, way, float(bias)) for bias in span])
        if np.isfinite(line).any():
            look = {"color": theme.MUTED, "width": 1.2}
            theme.scatter(
                picture, place, span, line * factor, "machine file before", shown=first, line=look
            )
        for label, static, symbol, colour in _METHODS:
            points = [
                (row.bias, *row.values(static)[path])
                for row in done.rows
                if path in row.values(static)
            ]
            if points:
                x, y, half = np.array(points).T
                error = {"type": "data", "array": half * factor, "thickness": 1.4, "width": 3}
                marker = {"symbol": symbol, "size": 7, "color": colour}
                theme.scatter(
                    picture,
                    place,
                    x,
                    y * factor,
                    label,
                    shown=first,
                    mode="markers",
                    marker=marker,
                    error_y=error,
                )
        picture.update_yaxes(title_text=f"[{shown}]", rangemode="tozero", **place)
    theme.dress(picture, _HEIGHT * rows, legend=True)
    picture.update_xaxes(title_text="Bias current [A]", row=rows)
    return picture


def _by_file(bearing: Any, quantity: str, way: str, bias: float) -> float:
    """The machine file's coefficient along zeta or eta at a bias current [A]; NaN where there is
    none.
    """
    try:
        return float(
            getattr(magnet.linearised(bearing, bias), quantity)[("zeta", "eta").index(way)]
        )
    except InvalidInput:
        return float("nan")


def bias_tables(done: BiasCampaign) -> Iterator[Table]:
    """Every quantity of every axis at every bias."""
    for quantity, name, unit in _QUANTITIES:
        rows: list[Row] = []
        for row in done.rows:
            for static, method in ((False, "small motion"), (True, "static loads")):
                cells: list[str | Cell] = []
                for bearing in done.given.bearings:
                    for way in ("zeta", "eta"):
                        value, half = row.values(static).get(
                            f"bearing.{bearing.name}.{quantity}.{way}", (np.nan, np.nan)
                        )
                        factor, shown = units.scale(unit, value)
                        cells += numbers(
                            ""
                            if np.isnan(value)
                            else units.plus_minus(value * factor, half * factor, shown)
                        )
                if any(not isinstance(cell, Cell) or cell.text for cell in cells):
                    rows.append((f"{row.bias:g} A, {method}", *cells))
        if rows:
            axes = [
                units.axis_name(f"{b.name}_{way}")
                for b in done.given.bearings
                for way in ("zeta", "eta")
            ]
            yield Table(name, ("Bias", *axes), tuple(rows), "With 95 %.")


# The page of measured frequency responses: open and closed loop and plant, with bands and
# coherence, over the model's.
#
# write(frf_page(respond(machine, records)), "response.html")


_COLUMNS_FRF_PAGE = 4  # axes of one figure
_HARDLY = 0.1  # of the largest: entries that are no more are left to the table of numbers
_CLOSED_FRF_PAGE = (
    "Displacement per excitation with the loop closed: magnitude with its 95 % band, phase, the "
    "model's error and the measurement's own (pale), and the coherence. Where the coherence "
    "falls, noise or "
    "nonlinearity is as large as the answer."
)
_PLANT = (
    "Displacement per current command u + e, from the same records: free of the bias of feedback, "
    "since the excitation is "
    "known without noise. The model is the machine file's, with the magnets at the load in the "
    "records."
)
_SENSITIVITY_FRF_PAGE = (
    "Modulus of the sensitivity of every axis driven by itself, the other loops closed, with its "
    "95 % band and the zones; nothing where noise hides it."
)
_OPEN_FRF_PAGE = (
    "Open loop 1/S − 1 of every axis driven by itself, the others closed, about the critical "
    "point −1; the circles are the "
    "borders of the zones, |S| = 3, 4 and 5."
)


def frf_page(found: Responses, *, date: str = "") -> Page:
    """The page of frequency responses; date: ISO (today if empty)."""
    several = len(found.points) > 1
    sections = [
        section
        for point in found.points
        for section in _point_sections(found, point, f", {point.label}" if several else "")
    ]
    methods = ", ".join(dict.fromkeys(IN_WORDS[point.loop.method] for point in found.points))
    facts = (
        ("Records", ", ".join(found.records)),
        ("Controller", found.controller),
        ("Method", methods),
        ("Loop", timing_in_words(str(found.timing))),
        ("Operating points", "; ".join(point.label for point in found.points)),
    )
    good = "nothing found in channels and limits"
    return Page(
        "Measured frequency responses",
        found.machine,
        (*tables.doubtful(found.findings), *sections),
        (tables.without_findings("Records", found.findings, good),),
        facts,
        date,
        result=tables.believed("Frequency responses measured", found.findings),
    )


def _point_sections(found: Responses, point: PointResponse, where: str) -> Iterator[Section]:
    """Figures and tables of one operating point; where: its name, behind every title."""
    pictures = [*_closed(point.of("motion")[0], where), *_sensitivities(found, point, where)]
    for item in point.of("plant"):
        pairs = [(f"v_{axis}", f"y_{axis}") for axis in found.machine.axes]
        pictures += _bode(item, pairs, f"Plant{where}", _PLANT, "m/A")
    yield Section(
        f"Open and closed loop{where}",
        units.prose(tables.capitalised(point.notes)),
        tuple(pictures),
        tuple(response_tables(found, point)),
    )


def _closed(item: ComparedResponse, where: str) -> Iterator[Figure]:
    """The answers of each excitation's own axes: all that come near the largest."""
    frf, unit = item.measured, {"e": "m/A", "r": "-", "f": "m/N"}[item.measured.inputs[0][0]]
    pairs = [
        (source, frf.outputs[i]) for j, source in enumerate(frf.inputs) for i in _answers(frf, j)
    ]
    yield from _bode(item, pairs, f"Closed loop{where}", _CLOSED_FRF_PAGE, unit)


def _answers(frf: Frf, j: int) -> list[int]:
    """Outputs that answer to input j: its own axis, else those near the largest."""
    axis = frf.inputs[j][2:]
    same_axis = [i for i, name in enumerate(frf.outputs) if name[2:] == axis]
    if same_axis:
        return same_axis
    size = np.median(np.abs(frf.values[:, :, j]), axis=0)
    return [int(i) for i in np.flatnonzero(size > _HARDLY * size.max())]


def _bode(
    item: ComparedResponse,
    pairs: Sequence[tuple[str, str]],
    title: str,
    caption: str,
    unit: str,
) -> Iterator[Figure]:
    """Magnitude, phase and coherence of the (input, output) pairs of a response, a few to a figure;
    caption: below the first; unit: output over input.
    """
    groups = [pairs[k : k + _COLUMNS_FRF_PAGE] for k in range(0, len(pairs), _COLUMNS_FRF_PAGE)]
    points = len(item.measured.omega) < 40
    for number, group in enumerate(groups, 1):
        measured = {_named(*pair): item.measured.select(*pair) for pair in group}
        models: Mapping[str, Mapping[str, FrequencyResponse]] = {}
        if item.model is not None:
            model = item.model
            # v_ of the measurement is u_ of a plant
            inputs = dict(zip(item.measured.inputs, model.inputs, strict=True))
            models = {_named(s, t): {"model": model.select(inputs[s], t)} for s, t in group}
        name = f"{title} ({number} of {len(groups)})" if len(groups) > 1 else title
        yield Figure(
            name,
            response_figure(measured, models, points=points, unit=unit),
            caption if number == 1 else "",
        )


def _named(source: str, target: str) -> str:
    """A path by its axis, or from one axis to another."""
    same = source[2:] == target[2:]
    return (
        units.axis_name(target[2:])
        if same
        else f"{units.axis_name(source)} → {units.axis_name(target)}"
    )


def _sensitivities(found: Responses, point: PointResponse, where: str) -> Iterator[Figure]:
    """Sensitivity and open loop of every axis that was driven by itself."""
    items = point.of("sensitivity")
    if not items:
        return
    names, omega = (
        [units.axis_name(item.measured.inputs[0][2:]) for item in items],
        items[0].measured.omega,
    )
    S = np.column_stack([item.measured.values[:, 0, 0] for item in items])
    half = np.column_stack([item.measured.radius()[:, 0, 0] for item in items])
    L = np.column_stack([open_loop(item.measured).values[:, 0, 0] for item in items])
    models = [item.model.values[:, 0, 0] for item in items if item.model is not None]
    predicted = {"model": np.column_stack(models)} if len(models) == len(items) else {}
    limits = zone_lines(SENSITIVITY, found.machine.requirements.sensitivity_peak)
    size, drawn = np.abs(S), np.column_stack([heard(item.measured) for item in items])
    moduli = {label: np.abs(value) for label, value in predicted.items()}
    yield Figure(
        f"Sensitivity{where}",
        panels(names, omega, size, size - half, size + half, moduli, [limits] * len(names), drawn),
        _SENSITIVITY_FRF_PAGE,
    )
    yield Figure(
        f"Open loop{where}",
        nyquist(names, omega, L, {k: 1 / v - 1 for k, v in predicted.items()}, drawn),
        _OPEN_FRF_PAGE,
    )


def response_tables(found: Responses, point: PointResponse) -> Iterator[Table]:
    """What every axis driven by itself tells, and how far the model holds."""
    rows: list[Row] = []
    silent = []
    for row in summary(point):
        low, high = row["peak_95"] or (float("nan"), float("nan"))
        predicted = "" if row["predicted"] is None else units.number(row["predicted"])
        margin = (
            "no unit gain"
            if row["phase_margin"] is None
            else units.quantity(row["phase_margin"], "rad")
        )
        crossing = (
            "" if row["unit_gain_at"] is None else units.quantity(row["unit_gain_at"], "rad/s")
        )
        texts = (
            units.number(row["peak"]) if row["peak"] else "not told",
            f"{units.number(low)} … {units.number(high)}" if row["peak"] else "",
            units.quantity(row["at"], "rad/s") if row["peak"] else "",
            predicted,
            margin,
            crossing,
        )
        rows.append((units.axis_name(row["axis"]), *numbers(*texts)))
        if row["silent"]:
            silent.append(f"{units.axis_name(row['axis'])}: {row['silent']}")
    if rows:
        hidden = f" Excite there, noise hides it: {'; '.join(silent)}." if silent else ""
        columns = ("Axis", "Largest |S|", "95 %", "At", "Model", "Phase margin", "Unit gain at")
        yield Table(
            "Each axis, the other loops closed",
            columns,
            tuple(rows),
            f"Over the lines that tell something.{hidden}",
        )
    held: list[Row] = []
    for item in point.responses:
        validity, agreement = item.validity, item.agreement
        if validity is None or agreement is None:
            continue
        frf = item.measured
        for j, source in enumerate(frf.inputs):
            for i in _answers(frf, j):
                reach, share = float(validity.valid_to[i, j]), float(agreement[i, j])
                coherence = float(np.median(frf.coherence[:, i]))
                words = (_KINDS[item.what], _named(source, frf.outputs[i]))
                cells = (
                    units.quantity(reach, "rad/s") if reach else "nowhere",
                    f"{100 * share:.0f} %",
                    f"{coherence:.3f}",
                )
                held.append((*words, *numbers(*cells)))
    if held:
        head = ("Response", "Of", "Model holds to", "Lines that agree", "Median coherence")
        note = "Within 10 % and 10°, widened by the measurement's own 95 % circle."
        yield Table("Agreement of model and measurement", head, tuple(held), note)


_KINDS = {"motion": "closed loop", "sensitivity": "sensitivity", "plant": "plant"}


_SENSITIVITY_PAGE = "sensitivity.output"
# what a person asks of a loop: checks and what they are called
_COMPARED = (
    ("stability.abscissa", "slowest decay"),
    ("sensitivity.output.max", "largest output sensitivity"),
    ("margin.disk.output", "disk margin, all outputs"),
    ("control.max", "largest gain from error to current"),
    ("unbalance.orbit_0p", "unbalance orbit"),
    ("unbalance.current_0p", "unbalance current"),
    ("impulse.current_0p", "current after a pulse"),
)
_OUTCOMES = {True: "pass", False: "fail", None: "none"}
_AROUND = 0.1  # s about a change of controllers that is drawn


def retuning_page(done: Retuning, *, date: str = "") -> Page:
    """The page of a retuning; date: ISO (today if empty)."""
    sections = [_steps(done)]
    if done.identification is not None:
        sections.append(_machine(done))
    sections += _before_and_after(done)
    if done.switches:
        sections.append(_switches(done))
    if done.acceptance is not None:
        checks = tuple(tables.checks_table(loop.checks) for loop in done.acceptance.points)
        sections.append(Section("As measured after the change", "", (), checks))
    sections += _provenance(done)
    step = done.stopped_at
    last = done.steps[-1] if step is None and done.steps else step
    identified = done.identification
    words = done.outcome.capitalize() if last is None else f"{last.title}: {_first(last.words)}"
    if step is None and done.steps:
        words = (
            f"{done.outcome.capitalize()}: {units.prose('; '.join(done.decided.split('; ')[:2]))}"
        )
    result = Verdict("", done.passed, words)
    return Page(
        "Retuning of the magnetic bearing loop",
        done.machine,
        tuple(sections),
        (),
        (
            ("Running controller", done.running.named),
            ("New controller", "" if done.new is None else done.new.named),
            ("Records", "" if identified is None else identified.provenance.of_records),
            ("Loop", timing_in_words(str(done.timing))),
        ),
        date,
        result=result,
        opening=_verdicts(done),
    )


def _first(words: str) -> str:
    """The first clause of what a step found."""
    return units.prose(words.partition("; ")[0])


def _verdicts(done: Retuning) -> Section:
    marks = {True: "passed", False: "failed", None: "for information"}
    rows = tuple(
        (step.title, Cell(marks[step.passed], _OUTCOMES[step.passed]), _first(step.words))
        for step in done.steps
    )
    return Section("", tables=(Table("", ("Step", "Verdict", "Result"), rows, "", (34, 24, 42)),))


def _steps(done: Retuning) -> Section:
    rows = tuple(
        (step.title, units.prose(step.words), ", ".join(step.files)) for step in done.steps
    )
    table = Table("In full", ("Step", "Result", "Files"), rows, "", (20, 60, 20), folded=True)
    return Section("Steps", tables=(table,))


def _machine(done: Retuning) -> Section:
    assert done.identification is not None  # asked before
    result = done.identification.result
    change = Figure(
        "Change from the machine file",
        change_figure(result),
        "With 95 % intervals: the tolerances over which the controllers are checked.",
    )
    remarks = tables.capitalised(done.identification.remarks)
    return Section("The machine as it is", remarks, (change,), (parameters_table(result),), True)


def _before_and_after(done: Retuning) -> Iterator[Section]:
    """The loop with the running and with the new controller, and both over the intervals."""
    before, after = done.before, done.after
    if before is None:
        return
    both = [("running", before)] + ([] if after is None else [("new", after)])
    curves = [
        (f"{label}, {checks.label}" if len(before.points) > 1 else label, curve)
        for label, verification in both
        for checks in verification.points
        for curve in checks.curves
        if curve.name == _SENSITIVITY_PAGE
    ]
    caption = (
        "On the identified machine, at every operating point with a stable loop; the limits are "
        "the machine file's and the zones of ISO 14839-3."
    )
    pictures = (Figure("Output sensitivity", figure(curves), caption),) if curves else ()
    boxes = [
        tables.checks_table(replace(checks, label=f"{label}: {checks.label}"))
        for label, verification in both
        for checks in verification.boxes
    ]
    yield Section("The loop before and after", "", pictures, (_compared(before, after),), True)
    if boxes:
        text = (
            "Found by search: can occur. Proved: not exceeded for any parameter values within "
            "their intervals, at any frequency. On a frequency grid: nothing is known between "
            "its lines."
        )
        yield Section("Over the identified intervals", text, (), tuple(boxes), folded=True)


def _compared(before: Verification, after: Verification | None) -> Table:
    """What a person asks of a loop, ``_COMPARED``, at every operating point."""
    columns = ("Operating point", "Quantity", "Running", *(() if after is None else ("New",)))
    rows: list[Row] = []
    for old in before.points:
        pair = [old] if after is None else [old, at_point(after, old.label)]
        label, ways = old.label, [checks.label.endswith(MEASURED) for checks in pair]
        if any(ways) and not all(ways):  # the responses tell one of the two
            label = f"{old.label.removesuffix(MEASURED)}, " + ", ".join(
                f"{name} {'measured' if way else 'by the model'}"
                for name, way in zip(("running", "new"), ways, strict=True)
            )
        for name, words in _COMPARED:
            named = [_check_named(checks, name) for checks in pair]
            if any(check is not None for check in named):
                cells = map(_cell, named, [checks.stable for checks in pair])
                rows.append((label, words, *cells))
    return Table("Point by point", columns, tuple(rows), "", by_cell=True)


def _check_named(checks: Checks, name: str) -> Check | None:
    return next((check for check in checks.checks if check.name == name), None)


def _cell(check: Check | None, stable: bool) -> Cell:
    if check is None:
        return Cell("not measured") if stable else Cell("unstable", "fail")
    unit = "1/s" if check.name == "stability.abscissa" else check.unit
    text = units.quantity(check.value, unit)
    return Cell(text, "fail" if check.passed is False else "number")


def _switches(done: Retuning) -> Section:
    pictures = []
    for run in done.switches:
        words = "To the new controller" if run.forward else "And back to the running one"
        picture, beyond = _moved(run)
        caption = (
            "Displacements about their mean on the nonlinear rig with the identified machine; "
            f"the controllers change at the dashed instant. {beyond}"
        )
        pictures.append(Figure(words, picture, caption))
    rows = tuple(
        (
            "to the new one" if run.forward else "the way back",
            Cell(run.trace.outcome, _OUTCOMES[run.passed]),
            *numbers(
                units.quantity(run.before, "m"),
                units.quantity(run.bump, "m"),
                units.quantity(run.allowed, "m"),
            ),
        )
        for run in done.switches
    )
    columns = ("Change", "Outcome", "Largest before", "After", "Allowed (assumed)")
    return Section("The change, tried", "", tuple(pictures), (Table("On the rig", columns, rows),))


def _moved(run: Switch) -> tuple[object, str]:
    """The displacements about the change of controllers as a picture, and what lies beyond it."""
    record = run.trace.record
    names = tuple(name for name in record.signals if name.startswith("y_"))
    y = np.array([record[name] for name in names])
    middle = record.values.shape[1] // 2
    part = slice(
        max(middle - round(_AROUND * record.sample_rate_hz / 5), 0),
        middle + round(_AROUND * record.sample_rate_hz),
    )
    y = y - y[:, middle // 2 : middle].mean(axis=1, keepdims=True)
    panels = []
    for name, row in zip(names, y, strict=True):
        time, motion = record.time[part], row[None, part]
        curve = Curve("retuning", "", "time", time, motion, (name,), "s", "m")
        panels.append(Panel(units.axis_name(name), (("displacement", curve),)))
    rows = [panels[i : i + 2] for i in range(0, len(panels), 2)]
    style = {"displacement": theme.Style("#0072b2", "solid", "circle-open", 1.2)}
    return panel_figure(rows, style, height=130)


def _provenance(done: Retuning) -> list[Section]:
    rows = list[tuple[str, str, Cell]]()
    delivery = done.delivery
    if delivery is not None and delivery.difference is not None:
        change = delivery.difference
        text = f"{len(change.changes)} entries"
        sums = f"CRC-32 {change.checksum_before} to {change.checksum}"
        rows.append(("Difference of parameters", text, Cell("", detail=sums)))
    table = Table("", ("", "What", "Hash"), tuple(rows), "", (25, 35, 40))
    return [Section("What it rests on", "", (), (table,))] if rows else []
