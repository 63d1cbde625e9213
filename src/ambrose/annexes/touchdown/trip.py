"""The state of a rotor at the moment of a trip, from a record of the rig or of a machine: a drop
then begins where the run left off.

Displacements q_<port> at all ports of the record and their slopes are fitted by the coordinates of
the fallen rotor, least squares; the phase of the unbalance is not in a record, and stays as drawn.
"""

from __future__ import annotations

import math

import numpy as np

from ambrose.annexes.touchdown.fallen import FallenRotor
from ambrose.core.checks import InvalidInput
from ambrose.machine.machine import Machine
from ambrose.record.record import Record

_AROUND = 4  # samples on either side of the trip that are fitted, at least
_TURN = 0.5  # of a turn on either side, so that the orbit of unbalance is told from the fall


def speed_at(record: Record, time: float) -> float:
    """The rotor's speed [rad/s] at a time [s] of a record: its signal, else that of its point."""
    if "speed" not in record.signals:
        return record.point.speed
    return float(np.interp(time, record.time, record["speed"]))


def state_at(
    machine: Machine, fallen: FallenRotor, record: Record, time: float
) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates and velocities (n,) of the fallen rotor at a time [s] of a record, without the
    orbit that its unbalance makes.

    Raises InvalidInput where the time is not in the record, or it has no displacements at the
    bearings (q_<axis>, else what its sensors read, y_<axis>).
    """
    at = round(time * record.sample_rate_hz)
    speed = speed_at(record, time)
    around = _AROUND
    if speed:
        around = max(around, round(_TURN * 2 * np.pi / speed * record.sample_rate_hz))
    if not around <= at < len(record.time) - around:
        raise InvalidInput(
            f"the trip at {time:g} s is not within the record, 0 to {record.time[-1]:g} s; give "
            "the time at which the power is lost"
        )
    kind = "q" if all(f"q_{axis}" in record.signals for axis in machine.axes) else "y"
    names = [f"{kind}_{axis}" for axis in machine.axes]
    missing = [name for name in names if name not in record.signals]
    if missing:
        raise InvalidInput(
            f"the record has no {', '.join(missing)}, so that nothing says where the rotor is; "
            "record displacements at every bearing"
        )
    rows = fallen.sensor_rows
    if kind == "q":
        turned = []
        for bearing, (x, y) in zip(machine.bearings, fallen.rows, strict=True):
            c, s = math.cos(bearing.angle), math.sin(bearing.angle)
            turned += [c * x + s * y, c * y - s * x]
        rows = np.array(turned)
    # around it a parabola and the orbit: a + b t + c t^2 + d cos W t + e sin W t
    window = slice(at - around, at + around + 1)
    t = record.time[window] - record.time[at]
    values = np.array([record[name][window] for name in names])
    columns = [np.ones_like(t), t, t**2, np.cos(speed * t) - 1, np.sin(speed * t)]
    shapes = np.column_stack(columns if speed else columns[:3])
    size = np.abs(shapes).max(axis=0)
    fitted = np.linalg.lstsq(shapes / size, values.T, rcond=None)[0] / size[:, None]
    # cos - 1 is zero at the trip: d, the orbit's part there, off the place; e W off the slope
    place, slope = fitted[0] - (fitted[3] if speed else 0.0), fitted[1]
    # the rigid coordinates alone: as many as there are axes
    rigid = rows[:, :4]
    q, v = np.zeros(rows.shape[1]), np.zeros(rows.shape[1])
    q[:4] = np.linalg.lstsq(rigid, place, rcond=None)[0]
    v[:4] = np.linalg.lstsq(rigid, slope, rcond=None)[0]
    return q, v
