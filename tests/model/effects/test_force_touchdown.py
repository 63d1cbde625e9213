"""Touchdown contact: pushes, never pulls; friction and damping only take energy; a ball bounces
lower every time.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from scipy.integrate import solve_ivp

from ambrose.machine.description import Touchdown
from ambrose.machine.file.toml import load_machine
from ambrose.model.effects.touchdown import force, parameters
from physical_numbers import physical

RIG = load_machine("seal-rig")
P = parameters(RIG, RIG.bearings[0])  # clearance 0.25 mm, assumed contact
POINT = physical(-6e-4, 6e-4)
SPEED = physical(-2.0, 2.0)


@given(POINT, POINT, SPEED, SPEED, physical(-3000, 3000))
def test_it_pushes_and_never_pulls_and_only_takes_energy(x, y, vx, vy, spin):
    fx, fy, torque, normal = force(x, y, vx, vy, spin, P)
    r = math.hypot(x, y)
    if r <= P[0]:
        assert (fx, fy, torque, normal) == (0, 0, 0, 0)
        return
    ex, ey = x / r, y / r
    assert normal >= 0
    assert fx * ex + fy * ey == pytest.approx(-normal, abs=1e-6 + 1e-12 * normal)
    inward = fx * ex + fy * ey
    sliding = vy * ex - vx * ey + spin * P[5]
    tangential = fy * ex - fx * ey
    assert torque == pytest.approx(tangential * P[5], abs=1e-7 + 1e-9 * abs(tangential))
    assert tangential * sliding <= 1e-9
    assert abs(tangential) <= P[3] * normal * (1 + 1e-9) + 1e-6
    spring = P[1] * (r - P[0])
    # what is not spring takes energy
    assert (inward + spring) * (vx * ex + vy * ey) <= 1e-6 * max(spring, 1)


@given(POINT, POINT, SPEED, SPEED, physical(-3000, 3000), physical(0, 6.3))
def test_it_is_the_same_in_every_direction(x, y, vx, vy, spin, turn):
    if abs(math.hypot(x, y) - P[0]) < 1e-12:
        return  # rotating the point may round it across the clearance
    c, s = math.cos(turn), math.sin(turn)
    fx, fy, *rest = force(x, y, vx, vy, spin, P)
    gx, gy, *other = force(c * x - s * y, s * x + c * y, c * vx - s * vy, s * vx + c * vy, spin, P)
    assert np.allclose([gx, gy], [c * fx - s * fy, s * fx + c * fy], rtol=1e-9, atol=1e-3)
    assert np.allclose(rest, other, rtol=1e-9, atol=1e-3)


def test_figures_by_hand():
    """0.05 mm deep at rest with spin: N = 1e8 * 5e-5 = 5 kN; friction 0.2 N against the spin, at
    radius 42.7 mm.
    """
    fx, fy, torque, normal = force(3e-4, 0.0, 0.0, 0.0, 1000.0, P)
    assert normal == pytest.approx(5000)
    assert fx == pytest.approx(-5000)
    assert fy == pytest.approx(-1000, rel=1e-6)
    assert torque == pytest.approx(-1000 * 0.0427, rel=1e-6)


def test_it_starts_at_zero():
    """No jump at first touch, however fast: a fixed-step integrator keeps its order."""
    for depth in (1e-9, 1e-12):
        assert force(P[0] + depth, 0.0, 1.0, 0.0, 0.0, P)[3] < 1e-2 * depth / 1e-9 * 5000


def test_a_fast_rebound_does_not_stick():
    assert force(P[0] + 1e-6, 0.0, -5.0, 0.0, 0.0, P) == (0, 0, 0, 0)


def bounce(contact, mass=35.0, speed=0.3, friction_spin=0.0):
    """The state 2.5 ms after setting out, when the one normal impact (1.9 ms) is over and the other
    side not reached.
    """
    bearing = replace(RIG.bearings[0], touchdown=contact)
    p = parameters(RIG, bearing)

    def motion(_, s):
        fx, fy, _, _ = force(*s, friction_spin, p)
        return [s[2], s[3], fx / mass, fy / mass]

    found = solve_ivp(
        motion, (0, 2.5e-3), [p[0] - 1e-5, 0.0, speed, 0.0], rtol=1e-9, atol=1e-12, max_step=1e-5
    )
    return found.y[:, -1]


def test_elastic_contact_gives_the_speed_back_and_damped_contact_less():
    assert bounce(Touchdown(damping=0.0, friction=0.0))[2] == pytest.approx(-0.3, rel=1e-5)
    back = [-bounce(Touchdown(damping=d, friction=0.0))[2] for d in (3e3, 1e4, 3e4)]
    assert 0.3 > back[0] > back[1] > back[2] > 0


def test_friction_of_a_spinning_rotor_drives_backward_whirl():
    """Contact on the right while turning from x to y pushes the rotor down: against the spin."""
    assert bounce(Touchdown(), friction_spin=1000.0)[3] < 0


def test_without_a_gap_nothing_is_ever_touched():
    p = parameters(RIG, replace(RIG.bearings[0], touchdown_gap=None))
    assert force(1.0, 0.0, 0.0, 0.0, 0.0, p) == (0, 0, 0, 0)


def test_radius_is_the_shafts_unless_given():
    assert P[5] == pytest.approx(0.0854 / 2)
    assert parameters(RIG, replace(RIG.bearings[0], touchdown=Touchdown(radius=0.03)))[5] == 0.03
