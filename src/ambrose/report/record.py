"""The page of a record: what happened, judged against the machine's limits, and the pictures to see
why; and a record at a glance, in one figure.

    write(record_page(trace, machine), "run.html")              a simulation
    write(record_page(read_record("run.h5"), machine), ...)     a measurement, or a record of a file
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ambrose.judge.checks import Curve
from ambrose.machine.machine import Machine
from ambrose.record.record import Record
from ambrose.report import theme
from ambrose.report.figures.curves import drawn, figure
from ambrose.report.figures.motion import (
    Station,
    largest,
    orbit_figure,
    percent,
    rotor_animation,
    rotor_speed,
    stations,
    waterfall_figure,
    window,
)
from ambrose.report.page import Cell, Figure, Page, Row, Section, Table, Verdict, numbers
from ambrose.rig.engine.record import LEVITATED_WITHIN, Lift
from ambrose.rig.scenario import Scenario
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
    stations = [station for station in places if station.bearing] or list(places)
    time, values = thinned(record.time, np.array([station.radius for station in stations]))
    labels = tuple(station.name for station in stations)
    limits = tightest("touchdown gap", [station.gap for station in stations])[:1]
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
        tightest("largest force", [bearing.max_force for bearing in machine.axis_bearings]),
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
    gaps = tightest("touchdown gap", [bearing.touchdown_gap for bearing in machine.axis_bearings])
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
        "largest control current", [bearing.max_current for bearing in machine.axis_bearings]
    )


def tightest(words: str, values: Sequence[float | tuple[float, float] | None]) -> _Limits:
    """The smallest of several limits, a pair's lesser, on both sides; none where none is known."""
    known = [min(np.atleast_1d(value)) for value in values if value is not None]
    return ((words, min(known)), (words, -min(known))) if known else ()


_GROUPS = (  # what is shown, the first of them that the record holds
    ("Displacement", ("y", "q")),
    ("Current", ("u", "i")),
    ("Magnet force", ("f_magnet",)),
    ("Excitation", ("e", "r", "d")),
    ("Applied force", ("f",)),
    ("Rotor speed", ("speed",)),
    ("Seal pressure", ("p",)),
)
_SIDES = {"zeta": "eta", "x": "y"}
# [px]
_ROW = 130
_ORBIT = 230
_GAP = 62
_MOST_ORBITS, _MOST_LINES = 4, 8
_ORBIT_POINTS = 4000


def record_figure(record: Record) -> Any:
    """Displacements, currents and what was driven over time, thinned without losing a peak;
    beneath, one orbit per station.
    """
    groups = _grouped(record)
    orbits = _orbits(groups[0][1]) if groups and groups[0][0] == "Displacement" else []
    columns = max(len(orbits), 1)
    specs: list[list[Any]] = [[{"colspan": columns}, *[None] * (columns - 1)] for _ in groups]
    heights = [_ROW] * len(groups)
    if orbits:
        specs.append([{} for _ in orbits])
        heights.append(_ORBIT)
    total = sum(heights) + _GAP * (len(heights) - 1)
    figure = theme.subplots(
        rows=len(heights),
        cols=columns,
        specs=specs,
        row_heights=[height / sum(heights) for height in heights],
        vertical_spacing=_GAP / total,
        horizontal_spacing=0.08,
    )
    axes = list(dict.fromkeys(_axis(name) for _, names in groups for name in names))
    style = theme.styles(axes)
    seconds, second = theme.seconds_or_milliseconds(float(record.time[-1] - record.time[0]))
    named: set[str] = set()
    for row, (title, names) in enumerate(groups, 1):
        _signals_over_time(figure, record, row, title, names, style, seconds, named)
    for column, (station, pair) in enumerate(orbits, 1):
        _orbit(figure, record, len(heights), column, station, pair)
    theme.dress(figure, total, legend=len(named) > 1)
    for row in range(1, len(groups) + 1):
        last = row == len(groups)
        figure.update_xaxes(
            matches="x" if row > 1 else None,
            showticklabels=last,
            title_text=f"Time [{second}]" if last else None,
            range=[float(record.time[0]) * seconds, float(record.time[-1]) * seconds],
            row=row,
            col=1,
        )
    _square(figure, len(heights), len(orbits))
    return figure


def _grouped(record: Record) -> list[tuple[str, list[str]]]:
    """(title, signals) of every group that the record holds; constant ones are left out where
    others move.
    """
    groups = []
    for title, kinds in _GROUPS:
        chosen = next(
            (names for kind in kinds if (names := [n for n in record.signals if _kind(n) == kind])),
            [],
        )
        moving = [name for name in chosen if np.ptp(record[name]) > 0]
        if title in {"Displacement", "Current"}:
            moving = chosen
        if moving:
            groups.append((title, moving[:_MOST_LINES]))
    return groups or [("Signals", list(record.signals[:_MOST_LINES]))]


def _kind(name: str) -> str:
    return "f_magnet" if name.startswith("f_magnet_") else name.partition("_")[0]


def _axis(name: str) -> str:
    """The place of a signal: "y_A_zeta" -> "A_zeta"."""
    return name.removeprefix(f"{_kind(name)}_")


def _signals_over_time(
    figure: Any,
    record: Record,
    row: int,
    title: str,
    names: list[str],
    style: dict[str, theme.Style],
    seconds: float,
    named: set[str],
) -> None:
    unit = record.units[record.signals.index(names[0])]
    time, values = thinned(record.time, record.select(names).values)
    factor, shown_unit = theme.scale(unit, float(np.abs(values).max()))
    for name, line in zip(names, values, strict=True):
        axis = _axis(name)
        look, label = style[axis], theme.axis_name(axis)
        theme.scatter(
            figure,
            {"row": row, "col": 1},
            drawn(time * seconds),
            drawn(line * factor),
            label,
            shown=label not in named,
            line={"color": look.colour, "dash": look.dash, "width": 1.4},
            hovertemplate=f"{theme.plain(theme.axis_name(name))}<br>%{{x:.4g}} · %{{y:.4g}} "
            f"{shown_unit}<extra></extra>",
        )
        named.add(label)
    theme.heading(figure, {"row": row, "col": 1}, f"<b>{title}</b> [{shown_unit}]")


def _orbits(names: list[str]) -> list[tuple[str, tuple[str, str]]]:
    """(station, its two signals) of every station whose displacement is known in two directions."""
    pairs = []
    for name in names:
        head, _, side = name.rpartition("_")
        other = f"{head}_{_SIDES.get(side, '')}"
        if other in names:
            pairs.append((_axis(head), (name, other)))
    return pairs[:_MOST_ORBITS]


def _orbit(
    figure: Any, record: Record, row: int, column: int, station: str, pair: tuple[str, str]
) -> None:
    place = {"row": row, "col": column}
    x, y = record[pair[0]], record[pair[1]]
    step = max(1, len(x) // _ORBIT_POINTS)
    factor, unit = theme.scale("m", float(max(np.abs(x).max(), np.abs(y).max())))
    theme.scatter(
        figure,
        place,
        drawn(x[::step] * factor),
        drawn(y[::step] * factor),
        line={"color": theme.INK, "width": 0.8},
        hovertemplate=f"%{{x:.4g}} · %{{y:.4g}} {unit}<extra></extra>",
    )
    first, second = (theme.axis_name(name.rpartition("_")[2]) for name in pair)
    words = f"<b>{theme.plain(theme.axis_name(station))}</b>, {second} over {first} [{unit}]"
    theme.heading(figure, place, words)


def _square(figure: Any, row: int, count: int) -> None:
    """Both directions of an orbit to one scale."""
    for column in range(1, count + 1):
        name = figure.get_subplot(row, column).xaxis.plotly_name.replace("axis", "")
        figure.update_xaxes(constrain="domain", nticks=5, row=row, col=column)
        figure.update_yaxes(constrain="domain", nticks=5, scaleanchor=name, row=row, col=column)


_AT_LIMIT = 0.999  # of the limit: reached, but for rounding
_LAST = 20  # the last part of a record, of so many: at the limit there is not to come off it
_KINDS = (
    ("y", "Displacements at the sensors"),
    ("q", "Displacements of the rotor"),
    ("u", "Controller outputs"),
    ("i", "Control currents in the coils"),
    ("f_magnet", "Magnet forces"),
    ("", "Other signals"),
)


def run_result(trace: Trace, machine: Machine) -> Verdict:
    """How a run turned out, its outcome and the machine's limits: the verdict that leads its page,
    and that ``simulate`` ends with.
    """
    rows: tuple[Verdict, ...] = (Verdict(_OUTCOME, trace.passed, theme.prose(trace.text)),)
    if trace.passed:  # else nothing makes it good
        rows = record_verdicts(trace.record, machine, stations(trace.record, machine), trace)
    result = _result(rows)
    assert result is not None  # the outcome is known
    return result


def record_verdicts(
    record: Record, machine: Machine, places: Sequence[Station], trace: Trace | None
) -> tuple[Verdict, ...]:
    """The outcome of a simulation, the clearance, currents and forces against their limits; those
    that can be judged.

    What reaches a limit that it is held to, as a controller's output is, and comes off it, is
    information; what passes it, or stays at it, fails.
    """
    verdicts = []
    if trace is not None:
        verdicts.append(Verdict(_OUTCOME, trace.passed, theme.prose(trace.text)))
    elif outcome := dict(record.notes).get("outcome"):
        verdicts.append(Verdict(_OUTCOME, None, theme.prose(outcome)))
    if dict(record.notes).get("complete") == "false":
        verdicts.append(
            Verdict("Record", None, "the run was interrupted; the record ends before its time")
        )
    judged = [station for station in places if station.gap is not None]
    first = levitated(record, judged, trace)
    verdicts += _clearance(record, judged, first)
    kind, title = (
        ("u", "Controller output")
        if f"u_{machine.axes[0]}" in record.signals
        else ("i", "Control current")
    )
    verdicts += _against(
        record,
        machine,
        kind,
        title,
        "A",
        [b.max_current for b in machine.axis_bearings],
        first or 0,
    )
    verdicts += _against(
        record,
        machine,
        "f_magnet",
        "Magnet forces",
        "N",
        [b.max_force for b in machine.axis_bearings],
        first or 0,
    )
    return tuple(verdicts)


def levitated(record: Record, judged: Sequence[Station], trace: Trace | None) -> int | None:
    """The first sample from which the rotor is levitated: 0 unless it starts in contact with a
    touchdown bearing; None: never. A run of the rig has said so itself.
    """
    if trace is not None and trace.levitated_at is not None:
        return int(np.searchsorted(record.time, trace.levitated_at - 0.5 / record.sample_rate_hz))
    if not judged:
        return 0
    share = np.max([station.radius / (station.gap or np.inf) for station in judged], axis=0)
    if share[0] < _AT_LIMIT:
        return 0
    start = Lift().follow(record.time, share)
    return None if start is None else int(np.searchsorted(record.time, start))


def _clearance(record: Record, judged: Sequence[Station], first: int | None) -> list[Verdict]:
    if not judged:
        return []
    if first is None:
        words = f"the rotor is never levitated, within {percent(LEVITATED_WITHIN)} of the gap"
        return [Verdict("Touchdown", False, words)]
    worst = max(
        judged, key=lambda station: float(station.radius[first:].max()) / (station.gap or 1.0)
    )
    gap, radius = worst.gap or 1.0, worst.radius[first:]
    share, end = float(radius.max()) / gap, float(radius[-max(1, len(radius) // 20) :].max())
    place = f"sensor {worst.name}" if worst.at_sensor else f"bearing {worst.name}"
    value, limit = theme.pair(float(radius.max()), gap, "m")
    words = (
        f"{value} ({percent(share)} of the gap of {limit}) at {place} at t = "
        f"{_moment(record, first + int(radius.argmax()))}; at the end {theme.quantity(end, 'm')}"
    )
    if first:
        words = (
            f"levitated, within {percent(LEVITATED_WITHIN)} of the gap, since t = "
            f"{_moment(record, first)}; from then on {words}"
        )
    if share >= 1:
        words += f"; beyond the gap for {np.mean(radius >= gap):.1%} of the time"
    return [Verdict("Touchdown", share < 1, words, share)]


def _against(
    record: Record,
    machine: Machine,
    kind: str,
    title: str,
    unit: str,
    limits: Sequence[float | None],
    first: int,
) -> list[Verdict]:
    """The signal that comes closest to its bearing's limit, of every axis in ``limits``, from the
    sample ``first`` on.
    """
    by_axis = dict(zip(machine.axes, np.array(limits, dtype=float), strict=True))
    shares = {
        axis: np.abs(record[f"{kind}_{axis}"][first:]) / limit
        for axis, limit in by_axis.items()
        if f"{kind}_{axis}" in record.signals and np.isfinite(limit)
    }
    if not shares:
        return []
    axis = max(shares, key=lambda name: float(shares[name].max()))
    share = shares[axis]
    peak, limit = theme.pair(float(share.max() * by_axis[axis]), float(by_axis[axis]), unit)
    words = "once lifted, " if first else ""
    most = float(share.max())
    words += (
        f"{peak} ({percent(most)} of {limit}) at {theme.axis_name(axis)} at t = "
        f"{_moment(record, first + int(share.argmax()))}"
    )
    if most < _AT_LIMIT:
        return [Verdict(title, True, words, most)]
    full = {name: row >= _AT_LIMIT for name, row in shares.items()}
    for name, row in full.items():
        if row.any():
            seconds = theme.quantity(float(row.sum()) / record.sample_rate_hz, "s")
            words += (
                f"; at the limit {theme.axis_name(name)} for {seconds} ({100 * row.mean():.2g} %)"
            )
    if most > 1 + (1 - _AT_LIMIT):
        return [Verdict(title, False, words, most)]
    last = -max(1, len(share) // _LAST)
    stays = any(row[last:].any() for row in full.values())
    ends = "still at it at the end" if stays else REACHED
    return [Verdict(title, False if stays else None, f"{words}; {ends}", most)]


_OUTCOME = "Outcome"
REACHED = "reached its limit and came off it"


def _moment(record: Record, sample: int) -> str:
    return theme.quantity(float(record.time[sample]), "s", 4)


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
            factor, shown_unit = theme.scale(unit, float(np.abs(values).max()))
            figures = (values.mean(), values.std(), values.min(), values.max())
            rows.append(
                (
                    theme.axis_name(name),
                    shown_unit,
                    *numbers(*(theme.number(float(value) * factor) for value in figures)),
                )
            )
    columns = ("Signal", "Unit", "Mean", "Standard deviation", "Lowest", "Highest")
    return Table("Signals", columns, tuple(rows), "", (28, 10, 14, 20, 14, 14))


_CAPTIONS = {
    "radius": "The decisive picture: how near the shaft comes to the touchdown bearings, and "
    "whether the motion dies out, "
    "stays or grows.",
    "u": "Commanded current, after its limit. Flat tops at the limit mean that the "
    "loop is open there.",
    "i": "Current in the coils without the bias.",
    "f_magnet": "Force of every magnet pair on the rotor; its mean carries the weight and the "
    "static loads.",
    "y": "As measured, with noise and run-out.",
    "p": "Pressure across the seals.",
    "speed": "As driven.",
}
_DRIVEN_WORDS = "What was done to the machine."
_ORBITS = (
    "Path of the shaft's centre, all panels to one scale: pale all samples, orange the largest "
    "motion, blue the end of the "
    "record. An orbit that opens from orange to blue grows; a circle is whirl, a line is "
    "vibration in one direction."
)
_WATERFALL = (
    "Amplitude of the whirl over time: above zero it turns with the rotor (forward), below "
    "against it. Dashed are once and, "
    "dotted, twice the speed: ridges on them are forced by unbalance, ridges that keep their "
    "frequency are natural modes. A "
    "forward ridge below 1× that darkens is the sign of seal whirl."
)
_NEAR = (
    "The same three revolutions (at standstill: periods) as in the moving picture. Flat tops are "
    "the limit of the controller's "
    "output; a coil current with straight flanks, or one that lags behind, shows the amplifier."
)
_NEAR_ALONG = (
    "Three periods of the strongest motion. Flat tops are the limit of the controller's output; a "
    "coil current with straight flanks, or one that lags behind, shows the amplifier."
)
_MOTION = (
    "Press play: the axis of the rotor over three revolutions (at standstill: three periods) "
    "around the largest motion, seen "
    "obliquely from the front; between the known places it is drawn straight. Blue are bearings."
)


def record_page(
    source: Record | Trace,
    machine: Machine,
    *,
    scenario: Scenario | None = None,
    title: str = "",
    date: str = "",
) -> Page:
    """The report of one record of this machine.

    source: a Record, or a Trace whose outcome then leads the page. scenario: gives the speed of a
    run-up that the record does not hold as a signal. Curves of long records are thinned to the
    extremes of every thousandth of the time, so no peak is lost. Raises InvalidInput where the
    record holds no displacements.
    """
    trace, record = (source, source.record) if isinstance(source, Trace) else (None, source)
    places, speed = stations(record, machine), rotor_speed(record, scenario)
    label = record.point.label or "record"
    along = not machine.lateral
    motion = [_over_time(radius_curve(record, places, machine), label)]
    if not along:  # along the shaft nothing goes around
        motion += _around(record, places, machine, speed)
    curves = {curve.name: _over_time(curve, label) for curve in signal_curves(record, machine)}
    first = "record.u" if "record.u" in curves else "record.i"
    effort = [curves.pop(name) for name in (first, "record.f_magnet") if name in curves]
    turning = np.zeros_like(speed) if along else speed
    near = zoomed_curves(record, machine, window(record, places, turning, largest(places)[1]))
    if near:
        words = _NEAR_ALONG if along else _NEAR
        effort.insert(1, Figure("Currents around the largest motion", figure(near), words))
    sections = (
        Section("Motion", "", tuple(motion)),
        Section("Currents and forces", "", tuple(effort)),
        Section("Along the shaft", "", () if along else _along(record, machine, label)),
        Section("Everything else", "", tuple(curves.values()), (signals_table(record),)),
    )
    verdicts = record_verdicts(record, machine, places, trace)
    name = trace.scenario if trace is not None else dict(record.notes).get("scenario", "")
    return Page(
        title or (f"Record of a run: {name}" if name else "Record of a run"),
        machine,
        tuple(section for section in sections if section.figures or section.tables),
        verdicts,
        (*(trace.laws if trace else ()), *_facts(record, speed)),
        date,
        result=_result(verdicts),
    )


def _along(record: Record, machine: Machine, label: str) -> tuple[Figure, ...]:
    """The collar between its stops, currents and forces, where a record of all axes has them."""
    if len(machine.groups) < 2:
        return ()
    part = machine.axial
    kinds = {f"{kind}_{axis}" for kind in "qy" for axis in part.axes}
    if not kinds & set(record.signals):
        return ()
    curves = [radius_curve(record, stations(record, part), part), *signal_curves(record, part)]
    own = {"record.radius", "record.u", "record.i", "record.f_magnet"}
    return tuple(_over_time(curve, label) for curve in curves if curve.name in own)


def _around(
    record: Record, places: Sequence[Station], machine: Machine, speed: np.ndarray
) -> list[Figure]:
    """What goes around the bearings' middle: orbits, whirl over time, the rotor in motion."""
    figures = [Figure("Orbits", orbit_figure(record, places, speed), _ORBITS)]
    spectra = waterfall_figure(record, places, speed)
    if spectra is not None:
        figures.append(Figure("Waterfall: whirl over time and frequency", spectra, _WATERFALL))
    if len(places) > 1:
        figures.append(
            Figure("The rotor in motion", rotor_animation(record, places, machine, speed), _MOTION)
        )
    return figures


def _result(verdicts: tuple[Verdict, ...]) -> Verdict | None:
    """Whether the run is good: what failed first, or what came nearest to its limit."""
    known = [verdict for verdict in verdicts if verdict.passed is not None]
    if not known:
        return None
    failed = [verdict for verdict in known if not verdict.passed]
    shares = [verdict for verdict in verdicts if verdict.share is not None]
    decisive = (*failed[:1], *sorted(shares, key=lambda verdict: -(verdict.share or 0.0))[:1])
    words = "The run fails." if failed else "The run stays within all limits of the machine."
    if decisive:
        one = decisive[0]
        what = one.label if failed else f"Closest to its limit: {one.label.lower()}"
        words += f" {what}, {one.text.partition('; ')[0]}."
    if len(failed) > 1 and failed[0].label != _OUTCOME:  # what failed it exceeds the limits, too
        words += f" Failed too: {', '.join(verdict.label.lower() for verdict in failed[1:])}."
    elif not failed and decisive and decisive[0].text.endswith(REACHED):
        words += f" It {REACHED}."
    return Verdict("Result", not failed, words)


def _over_time(curve: Curve, label: str) -> Figure:
    kind = curve.name.partition(".")[2]
    return Figure(curve.title, figure([(label, curve)]), _CAPTIONS.get(kind, _DRIVEN_WORDS))


def _pressure(record: Record) -> str:
    """That of the operating point, or from the lowest to the highest where the record holds one
    that changes.
    """
    pressure = (
        record["p_seal"] if "p_seal" in record.signals else np.array([record.point.seal_pressure])
    )
    ends = [theme.quantity(float(value), "Pa") for value in (pressure.min(), pressure.max())]
    return " to ".join(dict.fromkeys(ends))


def _facts(record: Record, speed: np.ndarray) -> tuple[tuple[str, str], ...]:
    """What the head of the page tells about the record."""
    k = record.values.shape[1]
    rpm = [theme.number(value * theme.RPM, 4) for value in (float(speed[0]), float(speed[-1]))]
    changes = float(np.ptp(speed)) > 0
    rate = theme.number(record.sample_rate_hz, 6)
    return (
        (
            "Record",
            f"{theme.number((k - 1) / record.sample_rate_hz, 4)} s at {rate} Hz, "
            f"{len(record.signals)} signals",
        ),
        ("Operating point", record.point.label),
        ("Speed", f"{rpm[0]} to {rpm[1]} rpm" if changes else f"{rpm[0]} rpm"),
        ("Seal pressure", _pressure(record)),
        *(
            (f"{key[:1].upper()}{key[1:]}".replace("_", " "), text)
            for key, text in record.notes
            if key not in {"outcome", "complete", "scenario"}
        ),
    )
