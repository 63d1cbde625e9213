"""What a record says against the machine's limits: touchdown, currents and forces as verdicts, all
signals as a table.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ambrose.machine.machine import Machine
from ambrose.record.record import Record
from ambrose.report import units
from ambrose.report.figures.orbits import percent
from ambrose.report.figures.stations import Station
from ambrose.report.page import Cell, Row, Table, Verdict, numbers
from ambrose.rig.trace import Trace

_AT_LIMIT = 0.999
_CLEAR = 0.05  # [s] without contact after which a rotor that starts in contact counts as lifted
_KINDS = (
    ("y", "Displacements at the sensors"),
    ("q", "Displacements of the rotor"),
    ("u", "Controller outputs"),
    ("i", "Control currents in the coils"),
    ("f_magnet", "Magnet forces"),
    ("", "Other signals"),
)


def record_verdicts(
    record: Record, machine: Machine, places: Sequence[Station], trace: Trace | None
) -> tuple[Verdict, ...]:
    """The outcome of a simulation, the clearance, currents and forces against their limits; those
    that can be judged.
    """
    verdicts = []
    if trace is not None:
        verdicts.append(Verdict("Outcome", trace.outcome == "completed", units.prose(trace.text)))
    elif outcome := dict(record.notes).get("outcome"):
        verdicts.append(Verdict("Outcome", None, units.prose(outcome)))
    if dict(record.notes).get("complete") == "false":
        verdicts.append(
            Verdict("Record", None, "the run was interrupted; the record ends before its time")
        )
    judged = [station for station in places if station.gap is not None]
    starts = [lifted(station, record.sample_rate_hz) for station in judged]
    # None: never free of all of them
    first = None if None in starts else max((start or 0 for start in starts), default=0)
    verdicts += _clearance(record, judged, first)
    kind, title = (
        ("u", "Controller output")
        if f"u_{machine.axes[0]}" in record.signals
        else ("i", "Control current")
    )
    verdicts += _against(
        record, machine, kind, title, "A", [b.max_current for b in machine.bearings], first or 0
    )
    verdicts += _against(
        record,
        machine,
        "f_magnet",
        "Magnet forces",
        "N",
        [b.max_force for b in machine.bearings],
        first or 0,
    )
    return tuple(verdicts)


def lifted(station: Station, rate: float) -> int | None:
    """The first sample from which the rotor is free of its touchdown bearing: 0 unless it starts in
    contact; None: never.
    """
    if station.gap is None or station.radius[0] < _AT_LIMIT * station.gap:
        return 0
    free = station.radius < station.gap
    needed = max(1, round(_CLEAR * rate))
    run = np.convolve(free, np.ones(needed), "valid") >= needed - 0.5
    return int(run.argmax()) if run.any() else None


def _clearance(record: Record, judged: Sequence[Station], first: int | None) -> list[Verdict]:
    if not judged:
        return []
    if first is None:
        return [Verdict("Touchdown", False, "the rotor never gets free of the touchdown bearings")]
    worst = max(
        judged, key=lambda station: float(station.radius[first:].max()) / (station.gap or 1.0)
    )
    gap, radius = worst.gap or 1.0, worst.radius[first:]
    share, end = float(radius.max()) / gap, float(radius[-max(1, len(radius) // 20) :].max())
    place = f"sensor {worst.name}" if worst.at_sensor else f"bearing {worst.name}"
    value, limit = units.pair(float(radius.max()), gap, "m")
    words = (
        f"largest distance {value} at {place} at t = "
        f"{_moment(record, first + int(radius.argmax()))}, "
    )
    words += f"{percent(share)} of the gap of {limit}; at the end {units.quantity(end, 'm')}"
    if first:
        words = (
            f"free of the touchdown bearings since t = {_moment(record, first)}; from then on "
            f"{words}"
        )
    if share >= 1:
        words += f"; beyond the gap for {np.mean(radius >= gap):.1%} of the time"
    return [Verdict("Touchdown", share < 1, words)]


def _against(
    record: Record,
    machine: Machine,
    kind: str,
    title: str,
    unit: str,
    limits: Sequence[float | None],
    first: int,
) -> list[Verdict]:
    """The signal that comes closest to its bearing's limit, from the sample ``first`` on."""
    by_axis = dict(zip(machine.axes, np.repeat(np.array(limits, dtype=float), 2), strict=True))
    shares = {
        axis: np.abs(record[f"{kind}_{axis}"][first:]) / limit
        for axis, limit in by_axis.items()
        if f"{kind}_{axis}" in record.signals and np.isfinite(limit)
    }
    if not shares:
        return []
    axis = max(shares, key=lambda name: float(shares[name].max()))
    share = shares[axis]
    peak, limit = units.pair(float(share.max() * by_axis[axis]), float(by_axis[axis]), unit)
    words = "once lifted, " if first else ""
    words += (
        f"largest {peak} at {units.axis_name(axis)} at t = "
        f"{_moment(record, first + int(share.argmax()))}, "
    )
    words += f"{percent(float(share.max()))} of {limit}"
    if share.max() >= _AT_LIMIT:
        full = {name: float(np.mean(row >= _AT_LIMIT)) for name, row in shares.items()}
        words += "; at the limit " + ", ".join(
            f"{units.axis_name(n)} {part:.1%}" for n, part in full.items() if part > 0
        )
        words += " of the time"
    return [Verdict(title, bool(share.max() < _AT_LIMIT), words)]


def _moment(record: Record, sample: int) -> str:
    return units.quantity(float(record.time[sample]), "s", 4)


def signals_table(record: Record) -> Table:
    """Mean, deviation and extremes of every signal."""
    rows: list[Row] = []
    left = list(record.signals)
    for kind, title in _KINDS:
        names = [name for name in left if not kind or name.startswith(f"{kind}_")]
        left = [name for name in left if name not in names]
        if names:
            rows.append((Cell(title, "heading"), "", "", "", "", ""))
        for name in names:
            unit, values = record.units[record.signals.index(name)], record[name]
            factor, shown = units.scale(unit, float(np.abs(values).max()))
            figures = (values.mean(), values.std(), values.min(), values.max())
            rows.append(
                (
                    units.axis_name(name),
                    shown,
                    *numbers(*(units.number(float(value) * factor) for value in figures)),
                )
            )
    columns = ("Signal", "Unit", "Mean", "Standard deviation", "Lowest", "Highest")
    return Table("Signals", columns, tuple(rows), "", (28, 10, 14, 20, 14, 14))
