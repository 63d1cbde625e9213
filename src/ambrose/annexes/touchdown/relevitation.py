"""The magnets come on again while the rotor lies in its touchdown bearings.

The controller runs sampled, with its computing delay, its currents and the sensors' readings at
their limits. Its slow states (below 1 Hz: integrators) hold what carried the weight before the
loss, and rest as long as the rotor touches; synchronous blocks are off. Magnets pull with their
nonlinear force through the bandwidth of the amplifier; its voltage has no limit here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg as sla

from ambrose.annexes.touchdown.arrays import Rig, SampledLaw
from ambrose.annexes.touchdown.drop import Fall
from ambrose.annexes.touchdown.fallen import FallenRotor
from ambrose.core.checks import InvalidInput
from ambrose.core.sampling import c2d
from ambrose.core.statespace import StateSpace
from ambrose.law.law import LawLike, law_of
from ambrose.law.timing import timing_of
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.model.effects import magnet
from ambrose.model.static_load import magnet_coefficients

_SLOW = 2 * np.pi  # [rad/s] up to which a state counts as an integrator
_IDEAL = 3e4  # [rad/s] of an amplifier that the file states as ideal


@dataclass(frozen=True, slots=True)
class Recovery:
    """time [s] from power to the last contact, inf where the rotor touches in the last tenth of
    what was simulated; force [N]: largest contact force with the magnets on.
    """

    start: float
    time: float
    force: float

    def to_dict(self) -> dict[str, Any]:
        """Plain data, SI; a recovery that never came is null."""
        time = self.time if math.isfinite(self.time) else None
        return {"power_back": self.start, "time": time, "largest_force_0p": self.force}


def with_magnets(machine: Machine, fallen: FallenRotor, rig: Rig, point: OperatingPoint) -> Rig:
    """The rig with its magnets, at the point's bias current."""
    amplifier = machine.amplifier
    known = (amplifier.bandwidth, amplifier.natural_frequency, _IDEAL)
    bandwidth = next(value for value in known if value is not None)
    angles = [bearing.angle for bearing in machine.bearings]
    bias = point.bias_current
    return rig._replace(
        axes=np.column_stack([np.cos(angles), np.sin(angles)]),
        magnets=np.array([magnet.parameters(bearing, bias) for bearing in machine.bearings]),
        sensors=np.ascontiguousarray(fallen.sensor_rows),
        bandwidth=min(float(bandwidth), _IDEAL),
    )


def sampled_law(
    machine: Machine, law: LawLike, point: OperatingPoint, dt: float
) -> tuple[SampledLaw, float]:
    """(the controller between samples, the step [s] that divides its sample time). Raises
    InvalidInput where nothing says its rate.
    """
    timing = timing_of(machine, law)
    if timing is None:
        raise InvalidInput(
            "nothing says at which rate the controller runs; give sample_time in [controller] of "
            "the machine file"
        )
    system = law_of(law).at(point)
    period = math.ceil(timing.sample_time / dt)
    late = timing.delay_samples * timing.sample_time
    if system.dt is None:
        sampled = c2d(system, timing.sample_time, "tustin", late)
    else:
        sampled = _late(system, timing.delay_samples)
    parts, slow = slow_first(sampled, timing.sample_time)
    currents = [b.max_current or b.bias_current for b in machine.bearings]
    gaps = [b.gap or 2 * (b.touchdown_gap or math.inf) for b in machine.bearings]
    law_arrays = SampledLaw(*parts, slow, period, float(min(currents)), float(min(gaps)))
    return law_arrays, timing.sample_time / period


def _late(system: StateSpace, samples: int) -> StateSpace:
    """A sampled system whose inputs arrive so many samples later."""
    m = system.B.shape[1]
    for _ in range(samples):
        A = np.block([[system.A, system.B], [np.zeros((m, len(system.A))), np.zeros((m, m))]])
        B = np.vstack([np.zeros((len(system.A), m)), np.eye(m)])
        C = np.hstack([system.C, system.D])
        system = StateSpace(
            A, B, C, np.zeros_like(system.D), system.inputs, system.outputs, system.dt
        )
    return system


def slow_first(
    system: StateSpace, sample_time: float
) -> tuple[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray], int]:
    """((A, B, C, D), how many): the same system with its slow poles apart and first."""
    if not len(system.A):
        return (system.A, system.B, system.C, system.D), 0
    least = math.exp(-_SLOW * sample_time)
    T, Z, count = sla.schur(
        system.A, output="real", sort=lambda re, im=0.0: math.hypot(re, im) > least
    )
    # T = [T1 T12; 0 T2]; x = [I X; 0 I] z with T1 X - X T2 = -T12 parts the two
    turn, back = np.eye(len(T)), np.eye(len(T))
    if 0 < count < len(T):
        X = sla.solve_sylvester(T[:count, :count], -T[count:, count:], -T[:count, count:])
        turn[:count, count:] = X
        back[:count, count:] = -X
        T = sla.block_diag(T[:count, :count], T[count:, count:])
    arrays = (T, back @ Z.T @ system.B, system.C @ Z @ turn, system.D)
    a, b, c, d = (np.ascontiguousarray(item, dtype=float) for item in arrays)
    return (a, b, c, d), int(count)


def held_states(
    machine: Machine, fallen: FallenRotor, law: SampledLaw, point: OperatingPoint
) -> np.ndarray:
    """The controller's states (s,) before the loss: slow ones that carry the weight, least in size.

    Forces f at the axes balance the weight in the rotor's four rigid coordinates: N^T f = -w; the
    currents are f/k_i, and C x = f/k_i of the slow states.
    """
    states = np.zeros(len(law.A))
    if not law.slow:
        return states
    rows = []
    for bearing, (x, y) in zip(machine.bearings, fallen.rows, strict=True):
        c, s = math.cos(bearing.angle), math.sin(bearing.angle)
        rows += [c * x + s * y, c * y - s * x]
    rigid = np.array(rows)[:, :4]
    force = np.linalg.lstsq(rigid.T, -fallen.weight[:4], rcond=None)[0]
    currents = force / magnet_coefficients(machine, point)[0]
    states[: law.slow] = np.linalg.lstsq(law.C[:, : law.slow], currents, rcond=None)[0]
    return states


def recovery_of(fall: Fall, start: float, duration: float) -> Recovery:
    """What a drop with power from ``start`` [s] on ended with."""
    last = float(fall.figures[:, 12].max())
    free = last < duration - 0.1 * (duration - start)
    time = max(last - start, 0.0) if free else math.inf
    return Recovery(start, time, float(fall.figures[:, 13].max()))
