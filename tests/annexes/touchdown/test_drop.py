"""Drops against closed forms: the fall, the first blow, the balance of energy, the edge of whip."""

import math
from dataclasses import replace

import numpy as np
import pytest
from free_mass import CLEARANCE, bush, polynomial_edge, rotor

from ambrose.annexes.touchdown.drop import Drop, case_of, rig_of, run
from ambrose.annexes.touchdown.drop_kernel import Case
from ambrose.annexes.touchdown.whip import (
    alone,
    edge_alone,
    edge_at_stop,
    receptances,
    ring_distance,
)
from ambrose.model.effects.touchdown import element_force

G, M = 9.80665, 12.0


def one_mass(bearing, speed=0.0, weight=G, inertia=1e9):
    """One mass in one bearing; so much inertia that its speed stays."""
    fallen = rotor(M * np.eye(2), [np.eye(2)], [bearing])
    return replace(fallen, weight=np.array([0.0, -M * weight]), speed=speed, polar_inertia=inertia)


def fixed(stiffness, friction=0.0, **more):
    """A bush fixed in the housing."""
    return bush(1.0, 0.0)._replace(
        stiffness=stiffness, friction=friction, static_friction=friction, ring_mass=0.0, **more
    )


def drop_of(fallen, duration, *, rows=0, dt=None, tally=True):
    rig, step = rig_of(fallen, tally=tally)
    case, state = case_of(fallen, rig, Drop(fallen.speed, (0.0,), (0.0,)), 0.0)
    return run(rig, case, state, duration, step if dt is None else dt, rows=rows), rig, state


@pytest.mark.parametrize("k", [1e7, 1e8])
def test_fall_and_first_blow(k):
    """t = sqrt(2 c/g), F/(m g) = 1 + sqrt(1 + 2 k c/(m g))."""
    fall, _, _ = drop_of(one_mass(fixed(k)), 0.012, dt=1e-6)
    assert fall.figures[0, 0] == pytest.approx(math.sqrt(2 * CLEARANCE / G), rel=1e-3)
    blow = M * G * (1 + math.sqrt(1 + 2 * k * CLEARANCE / (M * G)))
    assert fall.figures[0, [1, 2]] == pytest.approx([blow, blow], rel=1e-3)


def energy(fallen, bearing, z):
    """All energy [J] that a state holds: n = 2, one bearing."""
    x, v = z[0:2], z[2:4]
    race, ring, race_v, ring_v = z[4:6], z[6:8], z[8:10], z[10:12]
    moving = M * v @ v + bearing.race_mass * race_v @ race_v + bearing.ring_mass * ring_v @ ring_v
    turning = fallen.polar_inertia * z[13] ** 2 + bearing.race_inertia * z[12] ** 2
    depth = max(np.hypot(*(x - race)) - bearing.clearance, 0.0)
    way = np.hypot(*ring)
    stop = max(way - bearing.travel, 0.0)
    springs = bearing.stiffness * depth**2 + bearing.mount_stiffness * way**2
    springs += bearing.stop_stiffness * stop**2
    d = np.linspace(0, np.hypot(*(race - ring)), 4001)
    balls = np.trapezoid([element_force(v, bearing.hertz, bearing.preload) for v in d], d)
    return (moving + turning + springs) / 2 + balls + M * G * x[1]


def test_balance_of_energy():
    """What the state has lost is what contact, elements, mount, drag and slip took; the race spins
    up meanwhile, and the ring meets its stop.
    """
    bearing = bush(2e6, 3e3, mass=0.4, contact=5e7)._replace(
        damping=5e3,
        static_friction=0.3,
        race_mass=0.3,
        race_inertia=2e-4,
        hertz=1e10,
        preload=2e-6,
        element_damping=500.0,
        drag=0.05,
        drag_arm=1e-4,
        travel=5e-5,
        stop_stiffness=2e8,
    )
    fallen = one_mass(bearing, speed=500.0, inertia=0.02)
    errors = []
    for dt in (2e-6, 1e-6):
        fall, _, state = drop_of(fallen, 0.1, dt=dt)
        before, after = (energy(fallen, bearing, z) for z in (state, fall.state))
        errors.append(abs(before - after - fall.energy.sum()) / fall.energy.sum())
    assert fall.energy[:4].min() > 0  # slip, contact, elements, mount
    assert fall.figures[0, 11] > 5e-5
    assert fall.figures[0, 10] > 100
    assert errors[1] < 1e-4
    # all slip turns the race: J (W_0 - W) = I w + what drag took
    torque = fallen.polar_inertia * (500.0 - fall.state[13])
    assert torque > bearing.race_inertia * fall.state[12] > 0


@pytest.mark.parametrize(("k", "d", "mu"), [(2e7, 5e3, 0.2), (4e6, 3e3, 0.4)])
def test_whip_settles_at_the_edge(k, d, mu):
    """A mass thrown around slowly against its spin ends at the polynomial's frequency, within
    2 %.
    """
    bearing = bush(k, d, mass=0.05, contact=2e9)
    bearing = bearing._replace(damping=3e3, friction=mu, static_friction=mu)
    fallen = one_mass(bearing, speed=2e4, weight=0.0)
    rig, dt = rig_of(fallen)
    case = Case(np.zeros(2), np.zeros(2), 1.0, 1.0, 1.0, 0.0)
    edge = polynomial_edge(M, k, d, mu)
    _, state = case_of(fallen, rig, Drop(fallen.speed, (0.0,), (0.0,)), 0.0)
    state[0], state[3] = CLEARANCE, -0.4 * edge * CLEARANCE
    fall = run(rig, case, state, 0.5, dt)
    assert fall.figures[0, 6] > 4 * 2 * math.pi  # turns against the spin
    assert 2 * math.pi / fall.figures[0, 9] == pytest.approx(edge, rel=0.02)
    # in contact all the time, at the force of the edge (soft contact apart)
    assert fall.figures[0, 4] > 0.45


def test_whip_of_race_elements_and_ring():
    """The chain of race, elements under load, ring and mount: the edge of its receptances. A race
    that is too heavy to spin up slips on.
    """
    bearing = bush(1e7, 4e3, mass=0.4, contact=5e8)._replace(
        damping=3e3,
        friction=0.3,
        static_friction=0.3,
        race_mass=0.3,
        race_inertia=1e9,
        hertz=3e9,
        preload=2e-6,
        element_damping=500.0,
    )
    fallen = one_mass(bearing, speed=2e4, weight=0.0)
    w = np.geomspace(20, 5e3, 200)
    curve = alone("A", 0, w, receptances(fallen, w)[:, 0, 0], bearing)
    edge, force = edge_alone(fallen, 0, 0.3, curve)
    rig, dt = rig_of(fallen)
    case, state = case_of(fallen, rig, Drop(fallen.speed, (0.0,), (0.0,)), 0.0)
    state[0], state[3] = CLEARANCE, -0.4 * edge * CLEARANCE
    fall = run(rig, case, state, 0.5, dt, rows=200)
    assert 2 * math.pi / fall.figures[0, 9] == pytest.approx(edge, rel=0.02)
    assert fall.log[-1, 4] == pytest.approx(force, rel=0.05)


@pytest.mark.parametrize(
    ("k", "d", "mu", "travel", "stop", "race"),
    [
        (4e6, 3e3, 0.3, 3e-5, 2e7, False),
        (4e6, 3e3, 0.4, 3e-5, 1e8, False),
        (2e7, 5e3, 0.2, 1e-5, 2e8, False),
        (1e7, 4e3, 0.3, 1e-4, 5e7, True),
    ],
)
def test_whip_at_the_stop_of_the_mount(k, d, mu, travel, stop, race):
    """The stop makes whip two to six times as fast and tens of times as hard; simulation agrees
    within 2 %, in frequency, in force and in the ring's way.
    """
    bearing = bush(k, d, mass=0.05, contact=2e9)._replace(
        damping=3e3, friction=mu, static_friction=mu, travel=travel, stop_stiffness=stop
    )
    if race:
        bearing = bearing._replace(
            ring_mass=0.4,
            stiffness=5e8,
            race_mass=0.3,
            race_inertia=1e9,
            hertz=3e9,
            preload=2e-6,
            element_damping=500.0,
        )
    fallen = one_mass(bearing, speed=2e4, weight=0.0)
    w = np.geomspace(20, 2e4, 300)
    rotor_there = receptances(fallen, w)[:, 0, 0]

    def edge(bearings):
        curve = alone("A", 0, w, rotor_there, bearings[0])
        at, force = edge_alone(replace(fallen, bearings=bearings), 0, mu, curve)
        return at, (force,)

    (linear, _), (at, (force,)) = edge((bearing,)), edge_at_stop(edge, (bearing,), mu)
    rig, dt = rig_of(fallen)
    case, state = case_of(fallen, rig, Drop(fallen.speed, (0.0,), (0.0,)), 0.0)
    state[0], state[3] = CLEARANCE, -0.4 * at * CLEARANCE
    fall = run(rig, case, state, 0.5, dt, rows=200)
    assert at > 2 * linear
    assert 2 * math.pi / fall.figures[0, 9] == pytest.approx(at, rel=0.02)
    assert fall.log[-1, 4] == pytest.approx(force, rel=0.02)
    # s from k_s (1 - t/s) = kappa - k, in the simulation
    turned = bearing._replace(mount_stiffness=k + stop * (1 - travel / np.hypot(*fall.state[6:8])))
    assert ring_distance(turned, at, force, mu) == pytest.approx(
        np.hypot(*fall.state[6:8]), rel=0.02
    )


def test_free_flight_precesses_and_turns_about_its_mass_centre():
    """Between contacts: I v' = j I_p W v of the tilt, and the orbit -u/m e^{j W t} of unbalance."""
    inertia, polar, W, T = 0.3, 0.5, 600.0, 0.02
    tilt = np.array([[1, 0, 0.25, 0], [0, 1, 0, 0.25]])
    far = [fixed(1e8)._replace(clearance=1.0)] * 2
    gyroscopic = np.zeros((4, 4))
    gyroscopic[2, 3], gyroscopic[3, 2] = polar, -polar
    fallen = rotor(np.diag([M, M, inertia, inertia]), [tilt, tilt * [1, 1, -1, -1]], far)
    fallen = replace(
        fallen, gyroscopic=gyroscopic, speed=W, polar_inertia=1e9, weight=np.full(4, 1e-30)
    )
    rig, _ = rig_of(fallen)
    u = 1e-4
    case, state = case_of(fallen, rig, Drop(W, (u / 2, u / 2), (0.4, 0.4)), 0.0)
    state[6] += 0.1  # x tilts
    fall = run(rig, case, state, T, 1e-5)
    v = fall.state[6] + 1j * fall.state[7]
    assert v == pytest.approx(0.1 * np.exp(1j * polar / inertia * W * T), rel=1e-5)
    place = fall.state[0] + 1j * fall.state[1]
    assert place == pytest.approx(-u / M * np.exp(1j * (W * T + 0.4)), rel=1e-6)


@pytest.mark.parametrize("speed", [10.0, 50.0, 500.0])
def test_friction_falls_with_sliding_speed(speed):
    """Stribeck: slip energy over the integral of N v is mu(v) = mu + (mu_s - mu) e^(-v/v_s)."""
    bearing = fixed(1e7, friction=0.1)._replace(damping=2e4, static_friction=0.4, radius=0.04)
    bearing = bearing._replace(stribeck_speed=1.0)
    fall, _, _ = drop_of(one_mass(bearing, speed=speed), 0.06, rows=6000, dt=1e-5)
    v = speed * 0.04
    work = np.trapezoid(fall.log[:, 4], fall.log[:, 0]) * v
    assert fall.energy[0] / work == pytest.approx(0.1 + 0.3 * math.exp(-v), rel=0.03)


def test_weight_lies_on_mount_and_stop():
    """At rest k s + k_stop (s - travel) = m g; without friction the rotor hangs straight down."""
    bearing = bush(2e5, 4e3, mass=0.5, contact=1e7)._replace(
        damping=2e3, friction=0.0, static_friction=0.0, travel=1e-4, stop_stiffness=1e6
    )
    fall, _, _ = drop_of(one_mass(bearing), 0.5)
    down = (M * G + 1e6 * 1e-4) / (2e5 + 1e6)
    assert -fall.state[7] == pytest.approx(down, rel=1e-4)  # the ring's y


def test_steps_converge():
    """Half the step: the blow changes by less than a thousandth."""
    bearing = bush(2e7, 5e3, mass=0.5, contact=1e8)._replace(damping=1e4, friction=0.1)
    fallen = one_mass(bearing, speed=800.0)
    _, dt = rig_of(fallen)
    coarse, fine = (drop_of(fallen, 0.03, dt=dt / part)[0] for part in (1, 4))
    assert coarse.figures[0, 2] == pytest.approx(fine.figures[0, 2], rel=2e-3)
