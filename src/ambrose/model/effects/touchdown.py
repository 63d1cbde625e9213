"""Touchdown (backup) bearing: contact with clearance, stiffness, damping and Coulomb friction. No
linear view: zero inside.

The normal force N = k d + c d' d/(d + d_0), d the penetration [m] and d_0 a thousandth of the
clearance, begins at zero at first touch and is never negative, so that the contact pushes and never
pulls. Friction mu N v/sqrt(v^2 + v_0^2) opposes the sliding speed v of the surfaces. Both only take
energy: N d' - k d d' >= 0 and friction times v >= 0 at every instant.
"""

from __future__ import annotations

import math

from ambrose.machine.description import MagneticBearing
from ambrose.machine.machine import Machine
from ambrose.machine.touchdown import Touchdown

_ROUNDING = 1e-3  # d_0 over the clearance


def parameters(machine: Machine, bearing: MagneticBearing) -> tuple[float, ...]:
    """What ``force`` needs: (clearance [m], stiffness [N/m], damping [N s/m], friction [-], v_0
    [m/s], radius [m], d_0 [m]).

    The clearance is the bearing's touchdown_gap; without one it is infinite and nothing is ever
    touched. Without a [bearing.touchdown] table the assumed defaults of description.Touchdown hold.
    Radius: the shaft's at the bearing.
    """
    contact = Touchdown() if bearing.touchdown is None else bearing.touchdown
    clearance = math.inf if bearing.touchdown_gap is None else bearing.touchdown_gap
    rounding = _ROUNDING * clearance if math.isfinite(clearance) else 1.0
    radius = contact.radius
    if radius is None:
        section = next(
            (s for s in machine.shaft if bearing.position <= s.start + s.length), machine.shaft[-1]
        )
        radius = (
            section.diameters(
                min(max((bearing.position - section.start) / section.length, 0.0), 1.0)
            )[0]
            / 2
        )
    return (
        clearance,
        contact.stiffness,
        contact.damping,
        contact.friction,
        contact.sliding_speed,
        radius,
        rounding,
    )


def force(
    x: float, y: float, vx: float, vy: float, speed: float, p: tuple[float, ...]
) -> tuple[float, float, float, float]:
    """Force fx, fy [N] and torque about the axis [N m] on the rotor, and the normal force [N], zero
    where there is no contact.

    x, y [m], vx, vy [m/s] of the rotor's centre in the touchdown bearing, in any axes; speed
    [rad/s], positive from x to y. Compiles with numba as it stands.
    """
    r = math.sqrt(x * x + y * y)
    depth = r - p[0]
    if depth <= 0.0:
        return 0.0, 0.0, 0.0, 0.0
    ex, ey = x / r, y / r
    normal = p[1] * depth + p[2] * (vx * ex + vy * ey) * depth / (depth + p[6])
    if normal <= 0.0:
        return 0.0, 0.0, 0.0, 0.0
    sliding = vy * ex - vx * ey + speed * p[5]
    tangential = -p[3] * normal * sliding / math.sqrt(sliding * sliding + p[4] * p[4])
    return -normal * ex - tangential * ey, -normal * ey + tangential * ex, tangential * p[5], normal
