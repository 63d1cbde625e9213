"""What turns once with the rotor in a steady record: speed, the time of the key mark, and the
phasors of signals.

Angles count from the rotor's key mark, which points along the global x at angle zero, in the
direction of spin.
"""

from __future__ import annotations

import numpy as np

from ambrose.core.checks import InvalidInput, invalid
from ambrose.identification.frf.phasors import Phasors, Step, phasors
from ambrose.identification.output_error.synchronous import synchronous_of
from ambrose.record.record import Record

UNBALANCE = "unbalance turns across it"  # why no axis along the shaft is balanced
# [rad] by which what turns may leave the stated speed over the record, where no mark is recorded
_OFF = 0.5
_STEADY = 0.1  # [rad] by which the angle may leave a straight line over the time


def revolution(record: Record, settle: float = 0.3) -> Step:
    """The steady turning of a record: its frequency is the speed [rad/s], its start a time [s] at
    which the mark is at angle zero, its stop the record's end.

    The angle comes from the signal ``angle`` [rad] or from the rising edges of ``key``, one per
    turn; without either the record (its time zero) begins at the mark, and the speed is the one
    that it states. What is before ``settle`` [s] is left out. Raises InvalidInput for a rotor at
    rest, and where the speed changes.
    """
    time = record.time
    if not np.ptp(time) > settle:
        raise invalid(
            "the record",
            f"{np.ptp(time):g} s long",
            f"longer than the {settle:g} s left out",
            "record longer",
        )

    # angle over time: from the edges of the key, the angle signal, or the record's own speed
    steady = record.between(time[0] + settle, np.inf)
    if "key" in record.signals:
        at, angle = _edges(steady)
    else:
        at = steady.time
        angle = (
            np.unwrap(steady["angle"]) if "angle" in record.signals else _own_angle(record, steady)
        )
    if len(at) < 3:
        raise invalid(
            "the record",
            f"{np.ptp(time):g} s long",
            f"at least three turns after {settle:g} s",
            "record longer",
        )

    # angle = speed (t - t_0) + offset by least squares; what is left of it is drift
    speed, offset = np.polyfit(at - at[0], angle, 1)
    drift = float(np.ptp(angle - speed * (at - at[0])))
    if speed <= 0:
        raise invalid(
            "the speed of the record",
            f"{speed:g} rad/s",
            "positive",
            "unbalance shows in a rotor that turns",
        )
    if drift > _STEADY:
        raise invalid(
            "the speed of the record",
            f"off a steady one by {drift:.2g} rad",
            "steady",
            "record at a held speed",
        )

    # the mark passes where the line is zero; then the first such time not before the record's start
    zero = at[0] - offset / speed
    turns = np.ceil((time[0] - zero) * speed / (2 * np.pi) - 1e-9)
    return Step(float(speed), float(zero + turns * 2 * np.pi / speed), float(time[-1] + record.dt))


def once_per_turn(
    record: Record, turn: Step, signals: tuple[str, ...], settle: float = 0.3
) -> Phasors:
    """The 1x phasors of ``signals``, y(t) = Re(value exp(j angle)), as a mean and block by block.
    Raises InvalidInput.
    """
    return phasors(record, turn, signals, settle)


def _edges(record: Record) -> tuple[np.ndarray, np.ndarray]:
    """Times [s] of the key's rising edges, and the angle 2 pi n [rad] at them."""
    key, time = record["key"], record.time
    level = (key.min() + key.max()) / 2

    # rising passages of the mid level, between samples by a straight line
    up = np.flatnonzero((key[:-1] < level) & (key[1:] >= level))
    if len(up) < 3:
        raise invalid(
            "the number of edges of the signal key",
            len(up),
            "at least 3",
            "record one pulse per turn, for longer",
        )
    at = time[up] + (level - key[up]) / (key[up + 1] - key[up]) * record.dt
    return at, 2 * np.pi * np.arange(len(at))


def _own_angle(record: Record, steady: Record) -> np.ndarray:
    """The angle (k,) [rad] of the steady part by the record's own speed, zero at its time zero."""
    turning, k = synchronous_of(steady, 1), steady.values.shape[1]
    if turning is None:
        raise InvalidInput(
            "the record is of a rotor at rest; unbalance is found with the rotor turning"
        )
    if "speed" not in record.signals:
        # the turning as the displacements show it: away is what it gains on the stated speed [rad]
        shown = [
            row - row.mean()
            for name, row in zip(steady.signals, steady.values, strict=True)
            if name[:2] == "y_"
        ]
        refined = turning.refined([np.array(shown)], k) or turning
        away = float(refined.frequencies(k)[0] - turning.rate) * k
        if abs(away) > _OFF:
            raise invalid(
                "the speed of the record",
                f"{turning.rate / steady.dt:.6g} rad/s",
                f"the true one: what turns gains {away:.2g} rad on it",
                "record key (a pulse per turn) or angle, or state the speed with more digits",
            )
        return np.asarray(turning.rate * steady.time / steady.dt)

    # the recorded speed's integral by trapezoids, from the record's time zero
    speed = np.abs(record["speed"])
    within = np.concatenate([[0.0], np.cumsum(speed[:-1] + speed[1:]) / 2]) * record.dt
    return np.asarray(within + speed[0] * record.start_time)[-k:]
