"""Who costs what phase: the signal from the shaft's displacement to the current that makes force,
element after element, at every bending mode.

    sensor lag    1/(1 + s/b) of the machine file (demodulation and what filters the signal)
    controller    K(e^{sT}) on its own axis, as it is sampled
    computing     e^{-s n T}, n whole samples; where [[chain]] says what they are made of, its
                  elements (filters by their delay at low frequencies, as in the loop) and the rest
    hold          (1 - e^{-sT})/(s T), half a sample late
    amplifier     i/u of the coil's current, at standstill
    eddy currents e/(s + e), of order "twice-first"

The modes are the free rotor's at rest: what no controller moves. Phases are those of each axis'
own path; all others at rest.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ambrose.annexes.rotordynamics.loop import ShaftLoop
from ambrose.core.frequency import frequency_response
from ambrose.law.timing import Timing
from ambrose.machine.machine import Machine
from ambrose.model.basis import bending_modes_of
from ambrose.model.effects import amplifier, sensor
from ambrose.model.effects.rotor import finite_element_rotor, free_modes

_MOST = 6  # bending modes
CONTROLLER = "controller"


@dataclass(frozen=True, slots=True, eq=False)
class PhaseBudget:
    """Phases [rad] of a control axis, elements (e,) by frequencies (m,) [rad/s].

    axes: those that have it, alike to 1e-9. phases (e, m): negative late; ``total`` (m,) is that
    of the whole path but for the sign of the feedback. notes: on filters that the loop has as dead
    time.
    """

    axes: tuple[str, ...]
    frequencies: np.ndarray
    elements: tuple[str, ...]
    phases: np.ndarray
    notes: tuple[str, ...] = ()

    @property
    def total(self) -> np.ndarray:
        return np.asarray(self.phases.sum(axis=0))

    @property
    def cost(self) -> np.ndarray:
        """What all but the controller take (m,) [rad]."""
        own = self.elements.index(CONTROLLER)
        return np.asarray(self.total - self.phases[own])


def phase_budgets(loop: ShaftLoop, timing: Timing | None) -> tuple[PhaseBudget, ...]:
    """The budget of every axis, axes with the same one together; () without a controller.

    timing: the loop's, None for a continuous one.
    """
    law, machine = loop.law, loop.plant.machine
    if law is None:
        return ()
    omega = free_bending(machine, None if law.dt is None else np.pi / law.dt)
    if not len(omega):
        return ()
    rows: dict[str, np.ndarray] = {}
    drive = machine.amplifier
    sensed = frequency_response(sensor.linearised(machine.sensor_pairs, machine.axes), omega)
    acting = np.array([np.diag(loop.gain(1j * w)) for w in omega])
    rows["sensor lag"] = np.angle(sensed.values.sum(axis=2))

    # the law as it acts holds delay and hold, which are known exactly
    ones = np.ones((1, len(machine.axes)))
    late = np.zeros((2, len(omega)))
    if law.dt is not None:
        samples = 0 if timing is None else timing.delay_samples
        late = -np.array([samples, 0.5])[:, None] * omega * law.dt
    rest = acting * np.exp(-1j * late.sum(axis=0))[:, None]
    rows[CONTROLLER] = np.angle(rest)
    if law.dt is not None:
        for name, row in _computing(machine, timing, omega, late[0]):
            rows[name] = row[:, None] * ones
        rows["hold"] = late[1][:, None] * ones
    coil = drive
    if drive.order == "twice-first":
        coil = replace(drive, order="first", eddy_bandwidth=None)
    current = frequency_response(amplifier.linearised(coil, ["a"]), omega).values[:, 0, 0]
    rows["amplifier"] = np.unwrap(np.angle(current))[:, None] * ones
    if drive.order == "twice-first":
        eddy = -np.arctan(omega / float(drive.eddy_bandwidth or np.inf))
        rows["eddy currents"] = eddy[:, None] * ones

    names = tuple(rows)
    phases = np.array([rows[name] for name in names])  # (e, m, a)
    budgets: list[PhaseBudget] = []
    for a, axis in enumerate(machine.axes):
        own = phases[:, :, a]
        for k, known in enumerate(budgets):
            if np.allclose(known.phases, own, rtol=0.0, atol=1e-9):
                budgets[k] = replace(known, axes=(*known.axes, axis))
                break
        else:
            budgets.append(PhaseBudget((axis,), omega, names, own, _filters(machine, omega)))
    return tuple(budgets)


def _computing(
    machine: Machine, timing: Timing | None, omega: np.ndarray, whole: np.ndarray
) -> list[tuple[str, np.ndarray]]:
    """(name, phase (m,)) of what the loop's whole samples (phase ``whole``) are made of.

    Delays that were given by the caller, or that a controller has of its own, are not the file's
    chain.
    """
    total = sum(element.dead_time for element in machine.chain)
    told = timing is not None and timing.source.startswith("machine file")
    if not machine.chain or not told:
        return [("computing", whole)]
    named = [
        (f"{element.kind}: {element.name}", -omega * element.dead_time) for element in machine.chain
    ]
    return [*named, ("rest of the whole samples", whole + omega * total)]


def _filters(machine: Machine, omega: np.ndarray) -> tuple[str, ...]:
    """What a filter's own phase is beside the dead time that stands for it, at the last mode below
    its corner.
    """
    found = []
    for element in machine.chain:
        if element.corner is None:
            continue
        below = omega[omega < element.corner]
        w = float(below[-1] if len(below) else omega[0])
        own, counted = np.degrees([element.phase(w), -w * element.dead_time])
        found.append(
            f"{element.name}: {own:.3g} deg of its own at {w / (2 * np.pi):.4g} Hz, where the loop "
            f"has {counted:.3g} deg; its roll-off is not in the loop"
        )
    return tuple(found)


def free_bending(machine: Machine, highest: float | None = None) -> np.ndarray:
    """Bending frequencies (m,) [rad/s] of the free rotor at rest, below ``highest`` [rad/s]."""
    rotor = finite_element_rotor(machine)
    count = min(_MOST, bending_modes_of(rotor))
    frequencies = np.asarray(free_modes(rotor, count).frequencies)[4::2]
    return frequencies if highest is None else frequencies[frequencies < highest]
