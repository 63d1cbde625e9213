"""One page from one record: what happened, judged against the machine's limits, and the pictures to
see why.

write(record_report(trace, machine), "run.html")           a simulation
write(record_report(read_record("run.h5"), machine), ...)  a measurement, or a record from a file
"""

from __future__ import annotations

import numpy as np

from ambrose.judge.checks import Curve
from ambrose.machine.machine import Machine
from ambrose.record.record import Record
from ambrose.report import units
from ambrose.report.figures.curves import figure
from ambrose.report.figures.orbits import orbit_figure
from ambrose.report.figures.rotor_animation import rotor_animation
from ambrose.report.figures.stations import largest, rotor_speed, stations, window
from ambrose.report.figures.waterfall import waterfall_figure
from ambrose.report.page import Figure, Report, Section, Verdict
from ambrose.report.record.curves import radius_curve, signal_curves, zoomed_curves
from ambrose.report.record.verdicts import record_verdicts, signals_table
from ambrose.rig.scenario import Scenario
from ambrose.rig.trace import Trace

_CAPTIONS = {
    "radius": "The decisive picture: how near the shaft comes to the touchdown bearings, and "
    "whether the motion dies out, "
    "stays or grows.",
    "u": "What the controller asks for, after its limit. Flat tops at the limit mean that the "
    "loop is open there.",
    "i": "What flows in the coils beside the bias.",
    "f_magnet": "Force of every magnet pair on the rotor; its mean carries the weight and the "
    "static loads.",
    "y": "As measured, with noise and run-out.",
    "p": "Pressure across the seals.",
    "speed": "As driven.",
}
_DRIVEN = "What was done to the machine."
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
_MOTION = (
    "Press play: the axis of the rotor over three revolutions (at standstill: three periods) "
    "around the largest motion, seen "
    "obliquely from the front; between the known places it is drawn straight. Blue are bearings."
)


def record_report(
    source: Record | Trace,
    machine: Machine,
    *,
    scenario: Scenario | None = None,
    title: str = "",
    date: str = "",
) -> Report:
    """The report of one record of this machine.

    source: a Record, or a Trace whose outcome then leads the page. scenario: gives the speed of a
    run-up that the record does not hold as a signal. Curves of long records are thinned to the
    extremes of every thousandth of the time, so no peak is lost. Raises InvalidInput where the
    record holds no displacements.
    """
    trace = source if isinstance(source, Trace) else None
    record = source.record if isinstance(source, Trace) else source
    places, speed = stations(record, machine), rotor_speed(record, scenario)
    label = record.point.label or "record"
    motion = [
        _over_time(radius_curve(record, places, machine), label),
        Figure("Orbits", orbit_figure(record, places, speed), _ORBITS),
    ]
    spectra = waterfall_figure(record, places, speed)
    if spectra is not None:
        motion.append(Figure("Waterfall: whirl over time and frequency", spectra, _WATERFALL))
    if len(places) > 1:
        motion.append(
            Figure("The rotor in motion", rotor_animation(record, places, machine, speed), _MOTION)
        )
    curves = {curve.name: _over_time(curve, label) for curve in signal_curves(record, machine)}
    first = "record.u" if "record.u" in curves else "record.i"
    effort = [curves.pop(name) for name in (first, "record.f_magnet") if name in curves]
    near = zoomed_curves(record, machine, window(record, places, speed, largest(places)[1]))
    if near:
        effort.insert(1, Figure("Currents around the largest motion", figure(near), _NEAR))
    sections = (
        Section("Motion", "", tuple(motion)),
        Section("Currents and forces", "", tuple(effort)),
        Section("Everything else", "", tuple(curves.values()), (signals_table(record),)),
    )
    verdicts = record_verdicts(record, machine, places, trace)
    name = trace.scenario if trace is not None else dict(record.notes).get("scenario", "")
    return Report(
        title or (f"Record of a run: {name}" if name else "Record of a run"),
        machine,
        tuple(section for section in sections if section.figures or section.tables),
        verdicts,
        _facts(record, speed),
        date,
        result=_result(verdicts),
    )


def _result(verdicts: tuple[Verdict, ...]) -> Verdict | None:
    known = [verdict for verdict in verdicts if verdict.passed is not None]
    failed = [verdict.label.lower() for verdict in known if not verdict.passed]
    if not known:
        return None
    words = (
        f"the run fails in: {', '.join(failed)}"
        if failed
        else "the run stays within all limits of the machine"
    )
    return Verdict("Result", not failed, words)


def _over_time(curve: Curve, label: str) -> Figure:
    kind = curve.name.partition(".")[2]
    return Figure(curve.title, figure([(label, curve)]), _CAPTIONS.get(kind, _DRIVEN))


def _pressure(record: Record) -> str:
    """That of the operating point, or from the lowest to the highest where the record holds one
    that changes.
    """
    found = (
        record["p_seal"] if "p_seal" in record.signals else np.array([record.point.seal_pressure])
    )
    ends = [units.quantity(float(value), "Pa") for value in (found.min(), found.max())]
    return " to ".join(dict.fromkeys(ends))


def _facts(record: Record, speed: np.ndarray) -> tuple[tuple[str, str], ...]:
    """What the head of the page tells about the record."""
    k = record.values.shape[1]
    rpm = [units.number(value * units.RPM, 4) for value in (float(speed[0]), float(speed[-1]))]
    changes = float(np.ptp(speed)) > 0
    rate = units.number(record.sample_rate_hz, 6)
    return (
        (
            "Record",
            f"{units.number((k - 1) / record.sample_rate_hz, 4)} s at {rate} Hz, "
            f"{len(record.signals)} signals",
        ),
        ("Operating point", record.point.label),
        ("Speed", f"{rpm[0]} to {rpm[1]} rpm" if changes else f"{rpm[0]} rpm"),
        ("Seal pressure", _pressure(record)),
        *(
            (key.replace("_", " "), text)
            for key, text in record.notes
            if key not in {"outcome", "complete", "scenario"}
        ),
    )
