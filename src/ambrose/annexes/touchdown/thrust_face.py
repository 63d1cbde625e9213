"""Landing on one thrust face: what process thrust does to the stop when the thrust bearing loses
its power with the others.

From rest at the middle, without damping, under a constant thrust F_0: the way c to the stop and its
stiffness k take F_0 (c + z) = k z^2 / 2 at the turning point z, so that the stop's force is

    k z = F_0 (1 + sqrt(1 + 2 k c / F_0)),

an upper bound: damping takes from it. The rig has the motion itself (scenario power-loss of the
axis).
"""

from __future__ import annotations

import math

from ambrose.annexes.touchdown.verdict import Row
from ambrose.machine.attachment import attached
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.machine.thrust import ThrustBearing

_NOTE = "along the axis: from rest, without damping, under the point's process thrust"


def thrust_rows(machine: Machine, point: OperatingPoint) -> tuple[Row, ...]:
    """The stop's force of every thrust bearing that states its stops and has a thrust there."""
    rows = []
    for _, part in attached(machine):
        if not isinstance(part, ThrustBearing) or part.touchdown_gap is None:
            continue
        thrust = sum(load.force for load in part.loads if load.point == point.label)
        if thrust == 0:
            continue
        side = "right" if thrust > 0 else "left"
        way = part.touchdown_gap[thrust > 0]
        force = landing_force(abs(thrust), way, part.stop_stiffness)
        title = "force on the thrust face"
        rows.append(Row("thrust_face", f"{part.name} {side}", title, force, "N", note=_NOTE))
    return tuple(rows)


def landing_force(thrust: float, way: float, stiffness: float) -> float:
    """F_0 (1 + sqrt(1 + 2 k c / F_0)) [N] at a thrust [N], a way [m] and a stiffness [N/m]."""
    return thrust * (1 + math.sqrt(1 + 2 * stiffness * way / thrust))
