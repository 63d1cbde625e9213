"""What the amplifier as a circuit would change: a first-order lag leaves out the current that the
rotor's motion induces in the coils (``model.effects.amplifier``), and the negative stiffness acts
at once. Every mode is followed into the loop with the circuit.

The inductance is the file's, else k_i^2/(2 k_s), the coil without leakage; R = L/30 ms (assumed),
which only says how slowly a coil forgets.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ambrose.annexes.rotordynamics.loop import shaft_loop
from ambrose.annexes.rotordynamics.placement import ShaftMode
from ambrose.annexes.rotordynamics.stations import lay_out
from ambrose.core.checks import NumericalFailure
from ambrose.law.law import LawLike
from ambrose.law.timing import Timing
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.model.static_load import magnet_coefficients

FLAG = 0.1  # of a mode's damping ratio: from here on the circuit matters
_TIME = 0.03  # [s] L/R, assumed
_FOLLOWED = 0.2  # of |s|: a root further away is another mode


@dataclass(frozen=True, slots=True)
class CircuitChange:
    """The mode whose damping ratio the circuit moves most: its frequency [rad/s], the ratio
    without and with the circuit; inductance [H], and whether the file states it.
    """

    frequency: float
    before: float
    after: float
    inductance: float
    stated: bool

    @property
    def change(self) -> float:
        """Of the damping ratio."""
        return self.after / self.before - 1


def circuit_change(
    machine: Machine,
    point: OperatingPoint,
    law: LawLike | None,
    timing: Timing | None,
    modes: Sequence[ShaftMode],
) -> CircuitChange | None:
    """The largest change over the modes; None without magnets, for an amplifier that is no
    first-order lag, and where no mode can be followed.
    """
    drive = machine.amplifier
    if law is None or not machine.bearings or drive.order != "first":
        return None
    k_i, k_s = magnet_coefficients(machine, point)
    inductance = drive.inductance or float(np.median(k_i**2 / (2 * k_s)))
    circuit = replace(
        drive,
        order="current-loop",
        max_voltage=None,
        inductance=inductance,
        resistance=inductance / _TIME,
    )
    loop = shaft_loop(lay_out(replace(machine, amplifier=circuit)), point, law, timing)
    found: list[CircuitChange] = []
    for mode in modes:
        s = mode.pole
        try:
            pole, _ = loop.mode_near(s, turn=-1j if mode.forward else 1j)
        except NumericalFailure:
            continue
        if abs(pole - s) <= _FOLLOWED * abs(s):
            ratios = -s.real / abs(s), -pole.real / abs(pole)
            stated = drive.inductance is not None
            found.append(CircuitChange(abs(s.imag), *ratios, inductance, stated))
    return max(found, key=lambda item: abs(item.change), default=None)
