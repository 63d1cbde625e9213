"""Influence coefficients: the 1x displacement that an unbalance in a plane makes, from the
machine's model.

Runs are compared by d = y - G v, the displacement that forces and run-out would make without the
currents v: whatever the controller does, unbalance U enters it as W^2 G_f U, run-out as itself. In
y alone slow-roll subtraction fails, for a magnetic bearing holds what its sensors read, run-out
included. With S = (I + G K)^-1, y = S d. Letters: core/lft.py.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ambrose.annexes.site.balancing.vectors import once_per_turn
from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import frequency_response
from ambrose.core.sampling import hold
from ambrose.core.statespace import select
from ambrose.identification.frf.phasors import Step
from ambrose.law.law import LawLike, law_of
from ambrose.law.loop import match_axes
from ambrose.law.timing import Timing, timing_of
from ambrose.machine.messages import suggestion
from ambrose.model.effects.sensor import linearised
from ambrose.model.plant import Plant
from ambrose.model.ports import ports
from ambrose.record.record import Record

CURRENTS = "u_ of the record"
COILS = "i_ of the record"
LAW = "the controller"
NONE = ""


@dataclass(frozen=True, slots=True, eq=False)
class Influence:
    """At one speed: per_unbalance (a, p) [m per kg m], d per unbalance of each plane; per_runout
    (a,), d per run-out: the sensors' lag; closed (a, a), y per d, or None where no controller is
    known; blocks (b, a) [m]: d of the record, block by block; size [m]: of d - y, of which the
    model's error is a share.
    """

    per_unbalance: np.ndarray
    per_runout: np.ndarray
    closed: np.ndarray | None
    blocks: np.ndarray
    size: float


def source_of_currents(record: Record, plant: Plant, controller: LawLike | None) -> str:
    """Where the currents at 1x are known from: the record's u_ or i_, else the controller; "" from
    nowhere.
    """
    if all(name in record.signals for name in plant.named("u")):
        return CURRENTS
    if all(name in record.signals for name in plant.named("i")):
        return COILS
    return NONE if controller is None else LAW


def influence(
    plant: Plant,
    planes: tuple[str, ...],
    controller: LawLike | None,
    record: Record,
    turn: Step,
    settle: float,
) -> Influence:
    """The coefficients of the model at a record's speed, and the record's d. Raises
    InvalidInput.
    """
    omega = np.array([turn.frequency])
    axes = plant.axes
    dt = record.dt
    forces = [name for plane in planes for name in _forces(plant, plane)]
    inputs, outputs = [*plant.named("u"), *forces], [*plant.named("y"), *plant.named("i")]

    # y, i (rows) from u, f (columns): G = y/u, G_i = i/u, H = y/f, two columns of H per plane
    P = frequency_response(select(plant.system, inputs, outputs), omega).values[0]
    a = len(axes)
    G = P[:a, :a]
    G_i = P[a:, :a]
    H = P[:a, a:]

    # W^2 U exp(j W t) in a plane: the force's phasor is (1, -j) along x and y, and exp(-j angle)
    # times that along ports turned by angle
    angle = {port.name: port.direction for port in ports(plant.machine)}
    first = np.array([angle[forces[2 * i].removeprefix("f_")] for i in range(len(planes))])
    along = np.exp(-1j * first)  # U exp(j angle) rotates as (1, -j) along x and y
    per_unbalance = omega[0] ** 2 * (H[:, 0::2] - 1j * H[:, 1::2]) * along

    # S = (I + G K)^-1, K with its hold where it is sampled
    closed = None
    if controller is not None:
        timing = timing_of(plant.machine, controller) or Timing(dt)
        law = law_of(controller).at(plant.point)
        law = match_axes(timing.in_loop(law), axes, repr(plant.machine.name))
        K = frequency_response(law, omega).values[0] * (
            1.0 if law.dt is None else hold(omega, law.dt)[0]
        )
        closed = np.linalg.inv(np.eye(a) + G @ K)

    # d = y - G v, block by block as rows
    source = source_of_currents(record, plant, controller)
    kinds = {CURRENTS: ("y", "u", "e"), COILS: ("y", "i")}.get(source, ("y",))
    blocks = once_per_turn(
        record, turn, tuple(f"{kind}_{axis}" for kind in kinds for axis in axes), settle
    ).blocks
    y = shown = blocks[:, :a]
    if source == CURRENTS:
        # v = hold (u + e): the commands are held over a sample
        y = y - (blocks[:, a : 2 * a] + blocks[:, 2 * a :]) @ (G * hold(omega, dt)[0]).T
    elif source == COILS:
        # coil currents i = G_i v, hence G v = G G_i^-1 i
        y = y - blocks[:, a:] @ np.linalg.solve(G_i.T, G.T)
    elif closed is not None:
        # d = S^-1 y
        y = y @ np.linalg.inv(closed).T

    # root mean square of d - y over the axes
    size = float(np.sqrt(np.mean(np.abs(np.mean(y - shown, axis=0)) ** 2)))
    return Influence(per_unbalance, _sensors_lag(plant, omega), closed, y, size)


def _sensors_lag(plant: Plant, omega: np.ndarray) -> np.ndarray:
    """The response (a,) of the measured signals to what their sensors see, over that at rest."""
    sensors = linearised(plant.machine.sensor_pairs, plant.axes)

    # least squares of the response turning on that at rest, row by row: 1 for sensors without lag
    rest, turning = frequency_response(sensors, np.array([0.0, omega[0]])).values
    return np.asarray(np.sum(turning * rest, axis=1) / np.sum(rest * rest, axis=1))


def _forces(plant: Plant, plane: str) -> list[str]:
    found = [f"f_{port}" for port in plant.ports if port.rpartition("_")[0] == plane]
    if not found:
        known = dict.fromkeys(port.rpartition("_")[0] for port in plant.ports)
        raise InvalidInput(
            f"there is no plane {plane!r}: it names a bearing, coupling, seal or disc; "
            f"{suggestion(plane, known)}"
        )
    return found
