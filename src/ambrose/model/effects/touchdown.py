"""Touchdown (backup) bearing: contact with clearance, stiffness, damping and friction; inner race,
rolling elements, ring and soft mount behind it. No linear view: zero inside.

The normal force N = k d + c d' d/(d + d_0), d the penetration [m] and d_0 a thousandth of the
clearance, begins at zero at first touch and is never negative, so that the contact pushes and never
pulls. Friction mu N v/sqrt(v^2 + v_0^2) opposes the sliding speed v of the surfaces, mu between its
values at low and at high sliding speed (Stribeck). Both only take energy: N d' - k d d' >= 0 and
friction times v >= 0 at every instant. The kernels of the rig (rig/engine/kernel.py) and of drops
compile these functions as they stand.
"""

import math
from typing import NamedTuple

from ambrose.machine.description import MagneticBearing
from ambrose.machine.machine import Machine
from ambrose.machine.part import Touchdown

_ROUNDING = 1e-3  # d_0 over the clearance
_REST = 1.0  # [rad/s] below which the race's drag fades
# [rad] per step of the fastest oscillation: in contact, and of race and ring alone, which count for
# little while the rotor flies
_TURN, _FLIGHT = 0.5, 1.4
_DECAY = 0.8  # of the fastest damping, per step


class Bearing(NamedTuple):
    """A touchdown bearing, SI, in the order of the p that compiled functions take: p[0] clearance
    to p[20] stop_stiffness. Contact: clearance, stiffness and damping, friction mu, sliding_speed
    below which friction fades, radius, onset (depth over which the damping sets in),
    static_friction and stribeck_speed.

    race_mass 0: no inner race, the rotor meets the ring. hertz K [N/m^1.5] and preload, as the
    deflection [m] that it makes. ring_mass 0: the ring is fixed in the housing. travel inf: no
    stop. drag: friction moment of the race without load [N m]; drag_arm [m]: of its load.
    """

    clearance: float
    stiffness: float
    damping: float
    friction: float
    sliding_speed: float
    radius: float
    onset: float
    static_friction: float
    stribeck_speed: float
    race_mass: float = 0.0
    race_inertia: float = 1.0
    hertz: float = 0.0
    preload: float = 0.0
    element_damping: float = 0.0
    drag: float = 0.0
    drag_arm: float = 0.0
    ring_mass: float = 0.0
    mount_stiffness: float = 0.0
    mount_damping: float = 0.0
    travel: float = math.inf
    stop_stiffness: float = 0.0

    @property
    def moves(self) -> bool:
        """Whether what the rotor meets has a mass of its own."""
        return bool(self.race_mass or self.ring_mass)


def parameters(machine: Machine, bearing: MagneticBearing) -> Bearing:
    """The numbers of a bearing's touchdown bearing.

    The clearance is the bearing's touchdown_gap; without one it is infinite and nothing is ever
    touched. Without a [bearing.touchdown] table the assumed defaults of description.Touchdown hold.
    Radius: the shaft's at the bearing.
    """
    table = Touchdown() if bearing.touchdown is None else bearing.touchdown
    clearance = math.inf if bearing.touchdown_gap is None else bearing.touchdown_gap
    rounding = _ROUNDING * clearance if math.isfinite(clearance) else 1.0
    radius = table.radius
    if radius is None:
        section = next(
            (s for s in machine.shaft if bearing.position <= s.start + s.length), machine.shaft[-1]
        )
        share = min(max((bearing.position - section.start) / section.length, 0.0), 1.0)
        radius = section.diameters(share)[0] / 2
    static = table.friction if table.static_friction is None else table.static_friction
    numbers = Bearing(
        clearance,
        table.stiffness,
        table.damping,
        table.friction,
        table.sliding_speed,
        radius,
        rounding,
        static,
        table.stribeck_speed,
    )
    race, mount = table.race, table.mount
    if race is not None:
        # F = K d^1.5 through (F_0, d_0 = F_0 / k_0): K = F_0 / d_0^1.5
        load = race.element_load
        hertz = load / (load / race.element_stiffness) ** 1.5
        pitch = 3 * radius if race.pitch_diameter is None else race.pitch_diameter
        numbers = numbers._replace(
            race_mass=race.mass,
            race_inertia=race.inertia,
            hertz=hertz,
            preload=(race.preload / hertz) ** (2 / 3),
            element_damping=race.element_damping,
            drag=race.friction_moment,
            drag_arm=race.load_friction * pitch / 2,
        )
    if mount is not None:
        numbers = numbers._replace(
            ring_mass=mount.mass,
            mount_stiffness=mount.stiffness,
            mount_damping=mount.damping,
            travel=math.inf if mount.travel is None else mount.travel,
            stop_stiffness=mount.stop_stiffness,
        )
    return numbers


def force(
    x: float,
    y: float,
    vx: float,
    vy: float,
    speed: float,
    p: tuple[float, ...],
    factor: float = 1.0,
    lag: float = 0.0,
) -> tuple[float, float, float, float]:
    """Force fx, fy [N] and torque about the axis [N m] on the rotor, and the normal force [N], zero
    where there is no contact.

    x, y [m], vx, vy [m/s] of the rotor's centre in the touchdown bearing, relative to what it
    meets, in any axes; speed [rad/s] likewise, positive from x to y; p: ``Bearing``. factor: on the
    friction; lag [m/(N s)]: by the force of friction the sliding speed below which it fades, so
    that a step can follow it. Compiles with numba as it stands.
    """
    # p: 0 clearance, 1 k, 2 c, 3 mu, 4 v_0, 5 radius, 6 d_0, 7 and 8 static friction and its speed
    r = math.sqrt(x * x + y * y)
    depth = r - p[0]
    if depth <= 0.0:
        return 0.0, 0.0, 0.0, 0.0
    ex, ey = x / r, y / r
    normal = p[1] * depth + p[2] * (vx * ex + vy * ey) * depth / (depth + p[6])
    if normal <= 0.0:
        return 0.0, 0.0, 0.0, 0.0
    sliding = vy * ex - vx * ey + speed * p[5]
    mu = factor * p[3]
    if p[7] > p[3]:
        mu += factor * (p[7] - p[3]) * math.exp(-abs(sliding) / p[8])
    fade = max(p[4], lag * mu * normal)
    tangential = -mu * normal * sliding / math.sqrt(sliding * sliding + fade * fade)
    return -normal * ex - tangential * ey, -normal * ey + tangential * ex, tangential * p[5], normal


def element_force(deflection: float, hertz: float, preload: float) -> float:
    """Force [N] of preloaded rolling elements: those in front carry K (p + d)^1.5, those behind
    K (p - d)^1.5 until they come off. Compiles with numba as it stands.
    """
    front = preload + deflection
    back = preload - deflection
    force = hertz * front * math.sqrt(front)
    return force - hertz * back * math.sqrt(back) if back > 0.0 else force


def elements(
    x: float, y: float, vx: float, vy: float, p: tuple[float, ...]
) -> tuple[float, float, float]:
    """Force [N] along x and y with which the race presses on what carries its rolling elements, and
    their load [N]; x, y [m], vx, vy [m/s]: of the race against that. Compiles with numba.
    """
    # element_force in place, as what is compiled calls no function of its module; p: 11 hertz, 12
    # preload, 13 element_damping
    deflection = math.sqrt(x * x + y * y)
    front = p[12] + deflection
    back = p[12] - deflection
    load = p[11] * front * math.sqrt(front)
    if back > 0.0:
        load -= p[11] * back * math.sqrt(back)
    share = load / max(deflection, 1e-15)
    return share * x + p[13] * vx, share * y + p[13] * vy, load


def mount(
    x: float, y: float, vx: float, vy: float, p: tuple[float, ...], stiffer: float, damped: float
) -> tuple[float, float]:
    """Force [N] of the soft mount with its stop on the ring at x, y [m] with vx, vy [m/s]; factors
    on its stiffness and damping. Compiles with numba as it stands.
    """
    # p: 17 and 18 stiffness and damping of the mount, 19 travel, 20 stiffness of the stop
    spring = stiffer * p[17]
    damping = damped * p[18]
    square = x * x + y * y
    if square > p[19] * p[19]:
        way = math.sqrt(square)
        spring += p[20] * (way - p[19]) / way
    return -spring * x - damping * vx, -spring * y - damping * vy


def race_drag(speed: float, load: float, p: tuple[float, ...]) -> float:
    """Friction moment [N m] M_0 + mu_b F d/2 of a race that turns at a speed [rad/s] under a load
    [N]; it fades at rest. Compiles with numba as it stands.
    """
    # p: 14 drag M_0, 15 drag_arm mu_b d/2
    return (p[14] + p[15] * load) * speed / (abs(speed) + _REST)


def longest_steps(bearing: Bearing, mobility: float, load: float) -> tuple[float, float]:
    """Longest steps [s] of a Runge-Kutta method of order four: in contact, and in free flight,
    where race and ring ring on alone.

    mobility [1/kg]: what a radial force makes the rotor do at once; load [N]: of the elements,
    whose stiffness rises with it.
    """
    stiff = 0.0  # of the elements, tangent K 3/2 sqrt(d)
    if bearing.race_mass:
        deflection = (load / bearing.hertz) ** (2 / 3) + bearing.preload
        stiff = 1.5 * bearing.hertz * math.sqrt(deflection)
    race = 1 / bearing.race_mass if bearing.race_mass else 0.0
    ring = 1 / bearing.ring_mass if bearing.ring_mass else 0.0
    met = race or ring
    steps = []
    for touching, turn in ((bearing.stiffness, _TURN), (0.0, _FLIGHT)):
        damp = bearing.damping if touching else 0.0
        spring = bearing.mount_stiffness
        if touching and math.isfinite(bearing.travel):
            spring += bearing.stop_stiffness
        # squares of the oscillations' frequencies [1/s^2] and rates of decay [1/s], bounded by
        # spring and damping over both masses that they part: rotor and race, race and ring, ring
        squares = [
            touching * (mobility + met) + stiff * race,
            stiff * (race + ring) + spring * ring,
        ]
        if not race:
            squares.append((touching + spring) * ring)
        decays = [
            damp * (mobility + met) + bearing.element_damping * race,
            bearing.element_damping * (race + ring) + bearing.mount_damping * ring,
            bearing.mount_damping * ring + (0.0 if race else damp * ring),
        ]
        fastest = math.sqrt(max(squares))
        steps.append(min(turn / max(fastest, 1.0), _DECAY / max(*decays, 1.0)))
    return steps[0], steps[1]


def inverses(bearing: Bearing, mobility: float) -> tuple[float, float, float, float]:
    """1/mass of race, 1/inertia, 1/mass of ring, and what a friction force makes the sliding change
    at once [1/kg]: of the rotor, and of the race or ring.
    """
    race = 1 / bearing.race_mass if bearing.race_mass else 0.0
    ring = 1 / bearing.ring_mass if bearing.ring_mass else 0.0
    spin = 1 / bearing.race_inertia if race else 0.0
    return race, spin, ring, mobility + (race or ring) + bearing.radius**2 * spin
