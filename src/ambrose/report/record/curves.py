"""The signals of a record over time as Curves: thinned without losing a peak, with the machine's
limits.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ambrose.judge.checks import Curve
from ambrose.machine.machine import Machine
from ambrose.record.record import Record
from ambrose.report.figures.stations import Station
from ambrose.rig.trace import Trace

_BINS = 1000  # of a thinned curve, each with its lowest and highest value
_DRIVEN = (
    ("e", "Current excitation"),
    ("r", "Reference"),
    ("d", "Output disturbance"),
    ("f", "Applied forces"),
)
_Limits = tuple[tuple[str, float], ...]


def radius_curve(record: Record, places: Sequence[Station], machine: Machine) -> Curve:
    """Distance of the shaft's centre from the middle of every bearing (of every station, where no
    bearing is known).
    """
    shown = [station for station in places if station.bearing] or list(places)
    time, values = thinned(record.time, np.array([station.radius for station in shown]))
    labels = tuple(station.name for station in shown)
    limits = tightest("touchdown gap", [station.gap for station in shown])[:1]
    return Curve(
        "record.radius",
        "Distance from the middle of the bearing",
        "time",
        time,
        values,
        labels,
        "s",
        "m",
        limits,
    )


def signal_curves(record: Record, machine: Machine) -> list[Curve]:
    """Currents against their limit, magnet forces, what was driven, and what varied of the
    operating point.
    """
    curves: list[Curve | None] = []
    currents, forces = (
        _current_limits(machine),
        tightest("largest force", [bearing.max_force for bearing in machine.bearings]),
    )
    for kind, title, unit, limits in (
        ("u", "Controller output", "A", currents),
        ("i", "Control currents in the coils", "A", currents),
        ("f_magnet", "Magnet forces", "N", forces),
        ("y", "Displacements at the sensors", "m", ()),
    ):
        names = _at_axes(record, machine, kind)
        curves.append(_signals(record, kind, title, names, unit, limits))
    for kind, title in _DRIVEN:
        names = [
            n
            for n in record.signals
            if n.startswith(f"{kind}_") and not n.startswith("f_magnet_") and record[n].any()
        ]
        unit = record.units[record.signals.index(names[0])] if names else ""
        curves.append(_signals(record, kind, title, names, unit, (), whole=True))
    for kind, title in (("p", "Seal pressure"), ("speed", "Rotor speed")):
        names = [n for n in record.signals if n.partition("_")[0] == kind and np.ptp(record[n]) > 0]
        curves.append(
            _signals(record, kind, title, names, "Pa" if kind == "p" else "rad/s", (), whole=True)
        )
    return [curve for curve in curves if curve is not None]


def zoomed_curves(record: Record, machine: Machine, part: slice) -> list[tuple[str, Curve]]:
    """Controller outputs and coil currents in these samples, as (label, Curve) pairs for one
    figure.
    """
    pairs = []
    for kind, label in (("u", "controller output"), ("i", "coil current")):
        if names := _at_axes(record, machine, kind):
            labels = tuple(name.removeprefix(f"{kind}_") for name in names)
            time, values = record.time[part], record.select(names).values[:, part]
            limits = _current_limits(machine)
            pairs.append(
                (
                    label,
                    Curve(
                        "record.near", "Currents", "time", time, values, labels, "s", "A", limits
                    ),
                )
            )
    return pairs


def thinned(
    time: np.ndarray, values: np.ndarray, bins: int = _BINS
) -> tuple[np.ndarray, np.ndarray]:
    """Times (n,) and values (p, n): the lowest and the highest value of every bin, in the order in
    which they occur.
    """
    k = len(time)
    size = -(-k // bins)
    if size <= 2:
        return time, values
    starts = np.arange(0, k, size)
    parts = np.pad(values, ((0, 0), (0, -k % size)), mode="edge").reshape(
        len(values), len(starts), size
    )
    low = parts.min(axis=2)
    high = parts.max(axis=2)
    rising = parts.argmin(axis=2) < parts.argmax(axis=2)
    result = np.empty((len(values), 2 * len(starts)))
    result[:, 0::2], result[:, 1::2] = np.where(rising, low, high), np.where(rising, high, low)
    step = time[1] - time[0]
    middle = time[starts] + step * (np.diff(starts, append=k) - 1) / 2
    at = np.empty(2 * len(starts))
    at[0::2], at[1::2] = time[starts], middle
    return at, result


def _signals(
    record: Record,
    kind: str,
    title: str,
    names: Sequence[str],
    unit: str,
    limits: _Limits,
    *,
    whole: bool = False,
) -> Curve | None:
    if not names:
        return None
    labels = tuple(name if whole else name.removeprefix(f"{kind}_") for name in names)
    time, values = thinned(record.time, record.select(names).values)
    return Curve(f"record.{kind}", title, "time", time, values, labels, "s", unit, limits)


def trace_curves(trace: Trace, machine: Machine) -> tuple[Curve, ...]:
    """The displacements [m] and currents [A] of a trace at the control axes, those that its record
    holds.

    The curves are named "<scenario>.<kind in words>", so that traces of one scenario at several
    operating points share figures, and carry the touchdown gap or the largest control current of
    the bearings as limits.
    """
    curves = []
    gaps = tightest("touchdown gap", [bearing.touchdown_gap for bearing in machine.bearings])
    for kind, words, unit, limits in (
        ("y", "displacement", "m", gaps),
        ("i", "current", "A", _current_limits(machine)),
    ):
        if names := _at_axes(trace.record, machine, kind):
            time, values = trace.record.time, trace.record.select(names).values
            labels = tuple(name.removeprefix(f"{kind}_") for name in names)
            name, title = f"{trace.scenario}.{words}", f"{trace.scenario}: {words}"
            curves.append(Curve(name, title, "time", time, values, labels, "s", unit, limits))
    return tuple(curves)


def _at_axes(record: Record, machine: Machine, kind: str) -> list[str]:
    """The record's signals of that kind at the control axes, in the machine's order."""
    return [name for axis in machine.axes if (name := f"{kind}_{axis}") in record.signals]


def _current_limits(machine: Machine) -> _Limits:
    return tightest(
        "largest control current", [bearing.max_current for bearing in machine.bearings]
    )


def tightest(words: str, values: Sequence[float | None]) -> _Limits:
    """The smallest of several limits, on both sides; none where none is known."""
    known = [value for value in values if value is not None]
    return ((words, min(known)), (words, -min(known))) if known else ()
