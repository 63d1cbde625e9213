"""What a magnet can carry over the frequency, beside what the rotor asks of it.

The control current that an amplifier can drive at omega is the least of

    i_max             its own limit, and the bias current i_0: class A keeps 0 <= i_0 +- i
    (V - R i)/|R + j omega L|   what bias and static current i leave of the link's voltage V, over
                                the coil: the slew of the current (R = 0 where none is stated)

less the static current that holds the rotor's weight. The force is F = k_i i on the rotor that
stands still; back-EMF k_i omega q of its motion is taken off the voltage where the motion is known.
Both sides of the bias are looked at: the static current takes away on one side only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ambrose.annexes.rotordynamics.response import Response
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.model.static_load import magnet_coefficients, static_sag

_POINTS = 200


@dataclass(frozen=True, slots=True, eq=False)
class AxisCapacity:
    """One control axis.

    omega (w,) [rad/s]; force (w,) [N] zero to peak that is left beside the static load, current
    (w,) [A] zero to peak and what limits it there. static_force [N] and static_current [A] hold the
    weight. demand: (name, frequency [rad/s], force [N] zero to peak) of the loads. margin: least
    capacity over demand (inf without demand), at ``worst``.
    """

    axis: str
    omega: np.ndarray
    force: np.ndarray
    current: np.ndarray
    limited_by: tuple[str, ...]
    static_force: float
    static_current: float
    demand: tuple[tuple[str, float, float], ...]
    margin: float
    worst: str


def current_limit(
    machine: Machine, axis: int, omega: np.ndarray, static: float, back_emf: np.ndarray | float = 0
) -> tuple[np.ndarray, tuple[str, ...]]:
    """Largest control current (w,) [A] zero to peak of an axis over omega (w,) [rad/s] beside a
    static current [A], and what limits it. back_emf (w,) [V] is taken off the voltage.

    Raises nothing: an amplifier without voltage or inductance is limited by its current alone.
    """
    bearing = machine.bearings[axis // 2]
    amplifier = machine.amplifier
    rows = {"bias current": np.full(len(omega), bearing.bias_current - abs(static))}
    if bearing.max_current:
        rows["current"] = np.full(len(omega), bearing.max_current - abs(static))
    inductance, voltage = amplifier.inductance, amplifier.max_voltage
    if inductance and voltage:
        # beside R i_0: the resistance is 0 where the file has none
        resistance = amplifier.resistance or 0.0
        left = voltage - resistance * (bearing.bias_current + abs(static)) - back_emf
        impedance = np.hypot(resistance, omega * inductance)
        rows["voltage"] = np.maximum(left, 0.0) / np.maximum(impedance, 1e-9)
    names = list(rows)
    stacked = np.array([rows[name] for name in names])
    least = stacked.argmin(axis=0)
    current = np.maximum(stacked.min(axis=0), 0.0)
    return current, tuple(names[k] for k in least)


def capacities(
    machine: Machine, point: OperatingPoint, response: Response | None, trip: float
) -> tuple[AxisCapacity, ...]:
    """Capacity and demand of every axis; response: to the analysis' unbalance up to trip speed
    [rad/s] (None: no demand but weight).
    """
    k_i, _ = magnet_coefficients(machine, point)
    weight = static_sag(machine)[1].ravel()
    highest = 10 * trip if trip else 2 * np.pi * 2000
    omega = np.geomspace(max(0.02 * trip, 1.0), highest, _POINTS)
    found = []
    for a, axis in enumerate(machine.axes):
        static = float(weight[a] / k_i[a])
        limit, why = current_limit(machine, a, omega, static)
        demand = _unbalance_demand(response, a, trip) if response is not None else ()
        margins = []
        for name, frequency, current in demand:
            able = current_limit(machine, a, np.array([frequency]), static)[0][0]
            margins.append((able / current if current else np.inf, name))
        margin, worst = min(margins, default=(np.inf, ""))
        loads = tuple((name, w, float(k_i[a] * current)) for name, w, current in demand)
        found.append(
            AxisCapacity(
                axis,
                omega,
                k_i[a] * limit,
                limit,
                why,
                float(abs(weight[a])),
                abs(static),
                loads,
                float(margin),
                worst,
            )
        )
    return tuple(found)


def _unbalance_demand(
    response: Response, axis: int, trip: float
) -> tuple[tuple[str, float, float], ...]:
    """(name, speed, current [A]) of every set of unbalance where its current comes nearest to the
    limit of slew: at the largest current and at trip speed.
    """
    rows = []
    for k, case in enumerate(response.cases):
        current = response.currents(k)[:, axis]
        top = int(np.argmax(current))
        speed = float(response.fine[top])
        rows.append((f"{case.name}, largest", speed, float(current[top])))
        rows.append((f"{case.name}, at trip", float(response.fine[-1]), float(current[-1])))
    return tuple(rows)
