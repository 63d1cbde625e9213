"""Where a record's collar stands along the shaft: its thrust magnets' coefficients are those of
that place.

A controller without integral action lets the process thrust push the collar off, to where its
static stiffness holds it. k_i goes with 1/g^2 and k_s with 1/g^3 of either gap, and the two magnets
of a loaded pair do not make up for each other: 12 um of a gap of 400 um are two per cent of k_s.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from ambrose.core.checks import InvalidInput
from ambrose.identification.findings import WARNING, Code, Finding
from ambrose.machine.axial import AxialMachine, Condition
from ambrose.machine.description import OperatingPoint, Operation
from ambrose.model.axial.found import with_found
from ambrose.model.axial.magnet import at_point, force
from ambrose.record.record import Record

_APART = 0.01  # of the smaller gap: places of two records that are one
_OTHER = 0.1  # of the largest process thrust: a force that the magnets found do not carry


def at_place(machine: AxialMachine, records: Sequence[Record]) -> AxialMachine:
    """The axis with the collar where the displacements' means in the records put it, at the
    records' operating points; as it is where these are zero.

    Raises InvalidInput for records of one point whose collars stand at different places.
    """
    (axis,) = machine.axes
    gain = machine.thrust.sensor.gain
    allowed = _APART * min(machine.thrust.gap)
    places: dict[tuple[float, float], tuple[int, float]] = {}
    for number, record in enumerate(records, 1):
        if f"y_{axis}" not in record.signals:
            continue
        # y = gain (x - place): what the mean adds to the place where the sensor reads zero
        moved = float(record[f"y_{axis}"].mean()) / gain
        at = (record.point.speed, record.point.seal_pressure)
        first, before = places.setdefault(at, (number, moved))
        if abs(moved - before) > allowed:
            raise InvalidInput(
                f"the collar stands {1e6 * before:+.4g} um off the sensor's zero in record {first} "
                f"and {1e6 * moved:+.4g} um in record {number}: its coefficients are others there; "
                "identify the records one by one"
            )
    points, conditions = list(machine.operation.points), list(machine.conditions)
    for (speed, pressure), (_, moved) in places.items():
        if not moved:
            continue
        at_record = OperatingPoint(speed, pressure)
        known = machine.condition(at_record)
        stands = Condition(known.label, known.load, known.place + moved)
        # the first at this speed and pressure is the one that a record means
        same = [(item.speed, item.seal_pressure) == (speed, pressure) for item in points]
        if any(same):
            conditions[same.index(True)] = replace(stands, label=conditions[same.index(True)].label)
        else:
            points.append(at_record)
            conditions.append(stands)
    if conditions == list(machine.conditions):
        return machine
    operation = Operation(tuple(points), design_point=machine.operation.design_point)
    return replace(machine, operation=operation, conditions=tuple(conditions))


def thrust_findings(
    machine: AxialMachine,
    values: dict[str, float],
    point: OperatingPoint,
    records: Sequence[Record],
) -> Iterator[Finding]:
    """A warning where the magnets that were found, {quantity: value}, would carry another force
    with the recorded mean current than the thrust of the operating point.
    """
    (axis,), at = machine.axes, machine.condition(point)
    part, nominal = machine.thrust, at_point(machine, point)
    k_i = values.get("force_per_current", nominal.force_per_current)
    k_s = values.get("negative_stiffness", nominal.stiffness)
    try:
        part = with_found(part, at.load, at.place, k_i, k_s)
    except InvalidInput:
        return  # said where the machine is written
    largest = max(abs(item.load) for item in machine.conditions)
    for number, record in enumerate(records, 1):
        name = next((f"{kind}_{axis}" for kind in "iu" if f"{kind}_{axis}" in record.signals), "")
        if not name or record.point.speed != point.speed:
            continue
        current = float(np.mean(record[name]))
        carried = -force(part, current, at.place) + part.coupling_stiffness * at.place
        if abs(carried - at.load) > _OTHER * max(largest, abs(carried)):
            yield Finding(
                Code.OTHER_LOAD,
                WARNING,
                f"record {number} was taken under another thrust than its operating point states",
                f"a mean current of {current:.3g} A carries {carried:,.3g} N, the point states "
                f"{at.load:,.3g} N, and k_i and k_s are found for the stated one",
                "correct the point's [[thrust_bearing.load]], or the speed of the record by which "
                "its point is told",
            )
