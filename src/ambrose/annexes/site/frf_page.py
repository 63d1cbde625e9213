"""The page of measured frequency responses: open and closed loop and plant, with bands and
coherence, over the model's.

write(frf_page(respond(machine, records)), "response.html")
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from ambrose.annexes.site.frf import PointResponse, Response, Responses, heard, open_loop, summary
from ambrose.core.frequency import FrequencyResponse
from ambrose.identification.frf.measured import IN_WORDS
from ambrose.identification.frf.spectral import Frf
from ambrose.judge.criteria import zone_lines
from ambrose.machine.criteria import SENSITIVITY
from ambrose.report import tables, units
from ambrose.report.figures.measured import nyquist, panels
from ambrose.report.figures.seals import response_figure
from ambrose.report.page import Figure, Page, Row, Section, Table, numbers

_COLUMNS = 4  # axes of one figure
_HARDLY = 0.1  # of the largest: entries that are no more are left to the table of numbers
_CLOSED = (
    "Displacement per excitation with the loop closed: magnitude with its 95 % band, phase, the "
    "model's error beside the "
    "measurement's own (pale), and the coherence. Where the coherence falls, noise or "
    "nonlinearity is as large as the answer."
)
_PLANT = (
    "Displacement per current command u + e, from the same records: free of the bias of feedback, "
    "since the excitation is "
    "known without noise. The model is the machine file's, with the magnets at the load in the "
    "records."
)
_SENSITIVITY = (
    "Modulus of the sensitivity of every axis driven by itself, the other loops closed, with its "
    "95 % band and the zones; nothing where noise hides it."
)
_OPEN = (
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
        for section in _sections(found, point, f", {point.label}" if several else "")
    ]
    methods = ", ".join(dict.fromkeys(IN_WORDS[point.loop.method] for point in found.points))
    facts = (
        tables.machine_fact(found.machine),
        ("Records", ", ".join(found.records)),
        ("Method", methods),
        ("Loop that was modelled", found.timing),
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
        result=tables.believed("measured", found.findings),
    )


def _sections(found: Responses, point: PointResponse, where: str) -> Iterator[Section]:
    pictures = [*_closed(point.of("motion")[0], where), *_loops(found, point, where)]
    for item in point.of("plant"):
        pairs = [(f"v_{axis}", f"y_{axis}") for axis in found.machine.axes]
        pictures += _bode(item, pairs, f"Plant{where}", _PLANT, "m/A", found)
    yield Section(
        f"Open and closed loop{where}",
        units.prose(tables.capitalised(point.notes)),
        tuple(pictures),
        tuple(response_tables(found, point)),
    )


def _closed(item: Response, where: str) -> Iterator[Figure]:
    """The answers of each excitation's own axes: all that come near the largest."""
    frf, unit = item.measured, {"e": "m/A", "r": "-", "f": "m/N"}[item.measured.inputs[0][0]]
    pairs = [
        (source, frf.outputs[i]) for j, source in enumerate(frf.inputs) for i in _answers(frf, j)
    ]
    yield from _bode(item, pairs, f"Closed loop{where}", _CLOSED, unit, None)


def _answers(frf: Frf, j: int) -> list[int]:
    """Outputs that answer to input j: its own axis, else those near the largest."""
    axis = frf.inputs[j][2:]
    own = [i for i, name in enumerate(frf.outputs) if name[2:] == axis]
    if own:
        return own
    size = np.median(np.abs(frf.values[:, :, j]), axis=0)
    return [int(i) for i in np.flatnonzero(size > _HARDLY * size.max())]


def _bode(
    item: Response,
    pairs: Sequence[tuple[str, str]],
    title: str,
    caption: str,
    unit: str,
    found: Responses | None,
) -> Iterator[Figure]:
    groups = [pairs[k : k + _COLUMNS] for k in range(0, len(pairs), _COLUMNS)]
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
    same = source[2:] == target[2:]
    return (
        units.axis_name(target[2:])
        if same
        else f"{units.axis_name(source)} → {units.axis_name(target)}"
    )


def _loops(found: Responses, point: PointResponse, where: str) -> Iterator[Figure]:
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
    told = {"model": np.column_stack(models)} if len(models) == len(items) else {}
    limits = zone_lines(SENSITIVITY, found.machine.requirements.sensitivity_peak)
    size, drawn = np.abs(S), np.column_stack([heard(item.measured) for item in items])
    moduli = {label: np.abs(value) for label, value in told.items()}
    yield Figure(
        f"Sensitivity{where}",
        panels(names, omega, size, size - half, size + half, moduli, [limits] * len(names), drawn),
        _SENSITIVITY,
    )
    yield Figure(
        f"Open loop{where}",
        nyquist(names, omega, L, {k: 1 / v - 1 for k, v in told.items()}, drawn),
        _OPEN,
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
        told = (
            units.number(row["peak"]) if row["peak"] else "not told",
            f"{units.number(low)} … {units.number(high)}" if row["peak"] else "",
            units.quantity(row["at"], "rad/s") if row["peak"] else "",
            predicted,
            margin,
            crossing,
        )
        rows.append((units.axis_name(row["axis"]), *numbers(*told)))
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
        yield Table("How far the model holds", head, tuple(held), note)


_KINDS = {"motion": "closed loop", "sensitivity": "sensitivity", "plant": "plant"}
