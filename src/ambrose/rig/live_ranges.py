"""How far a live rig is turned and pushed by hand: from what the machine knows of itself to where
a slider ends.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ambrose.machine.machine import Machine
from ambrose.model.effects.rotor import finite_element_rotor, mass_properties
from ambrose.rig.live import LiveRig

_BEYOND = 1.2  # the top speed's slider over the highest speed
_GRADE = 2.5e-3  # [m/s], G2.5 of ISO 21940-11
_GRADES = 8.0  # the unbalance's slider over the grade
_PUSH = 0.05  # a knock's first displacement over the gap, roughly
_RINGING = 300.0  # [rad/s] of a levitated rotor, roughly
_SHAKE = 0.025  # excitation over the limit of the currents: far from it also on top of the weight


@dataclass(frozen=True, slots=True)
class LiveRanges:
    """speed [rad/s], pressure [Pa] and unbalance [kg m] at most; gap [m], the smallest, of the
    touchdown bearings or the magnets; impulse [N s] that moves the rotor some hundredths of it;
    excitation [A] for identification.
    """

    speed: float
    pressure: float
    unbalance: float
    gap: float
    impulse: float
    excitation: float


def ranges_of(rig: LiveRig, machine: Machine) -> LiveRanges:
    """Those of a machine on its live rig."""
    operation = machine.operation
    speeds = [*operation.speed_range, *(point.speed for point in operation.points), 100.0]
    pressures = [point.seal_pressure for point in operation.points]
    gaps = [float(gap) for gap in rig.clearances if np.isfinite(gap)]
    gaps += [bearing.gap for bearing in machine.bearings if bearing.gap]
    gap = min(gaps, default=1e-4)
    mass = mass_properties(finite_element_rotor(machine)).mass
    limits = [float(most) for most in rig.limits if np.isfinite(most)]
    return LiveRanges(
        speed=_BEYOND * max(speeds),
        pressure=2.5 * max(pressures, default=0.0),
        # m e, with e = grade / speed
        unbalance=_GRADES * mass * _GRADE / max(speeds),
        gap=gap,
        # of a free mass that swings with a share of the gap: m x omega
        impulse=_PUSH * gap * mass * _RINGING,
        excitation=_SHAKE * min(limits, default=1.0),
    )
