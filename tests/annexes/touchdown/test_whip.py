"""Backward whip: one free mass on a mount, whose edge is the root of a polynomial, and what a rigid
rotor in two bearings makes of it.
"""

from dataclasses import replace

import numpy as np
import pytest
from free_mass import CLEARANCE, bush, polynomial_edge, rotor

import ambrose as amb
from ambrose.annexes.touchdown.drop import elements_deflection, stator_receptance
from ambrose.annexes.touchdown.whip import alone, edge_alone, receptances, together
from ambrose.core.checks import InvalidInput
from ambrose.model.effects.touchdown import element_force


@pytest.mark.parametrize("mu", [0.05, 0.2, 0.6])
@pytest.mark.parametrize(("k", "d"), [(2e7, 5e3), (1e6, 2e3), (1e8, 1e3), (2e6, 9e3)])
def test_one_mass_on_a_mount(k, d, mu):
    m = 12.0
    fallen = rotor(m * np.eye(2), [np.eye(2)], [bush(k, d)])
    w = np.geomspace(5, 2e4, 200)
    curve = alone("A", 0, w, receptances(fallen, w)[:, 0, 0], fallen.bearings[0])
    edge, force = edge_alone(fallen, 0, mu, curve)
    assert edge == pytest.approx(polynomial_edge(m, k, d, mu), rel=1e-6)

    # the motion itself, turning with the whirl: m w^2 r = -f, (k + j w d) s = -f, r - s = c
    f = -force * (1 - 1j * mu)
    r, s = -f / (m * edge**2), -f / (k + 1j * edge * d)
    assert r - s == pytest.approx(CLEARANCE, rel=1e-5)


def test_edge_tends_to_the_joint_resonance():
    """mu without bounds: k / sqrt(k m - d^2)."""
    m, k, d = 12.0, 2e7, 5e3
    assert polynomial_edge(m, k, d, 1e6) == pytest.approx(k / np.sqrt(k * m - d**2), rel=1e-4)
    # the ring's mass and the contact count where they are not small
    soft = stator_receptance(bush(k, d, mass=2.0), 300.0)
    assert soft == pytest.approx(1 / (k - 2.0 * 300**2 + 1j * 300 * d))


def test_two_bearings_together_halve_the_rotor():
    """A rigid rotor between two equal bearings: in one phase half its mass each, in opposition
    inertia over half the span squared.
    """
    m, inertia, a = 20.0, 0.3, 0.25
    tilt = np.array([[1, 0, a, 0], [0, 1, 0, a]])
    fallen = rotor(
        np.diag([m, m, inertia, inertia]),
        [tilt, tilt * [1, 1, -1, -1]],
        [bush(2e7, 5e3), bush(2e7, 5e3)],
    )
    w = np.geomspace(5, 2e4, 1500)
    A = receptances(fallen, w)
    for kind, angles, each in (
        ("in phase", [0, 0], m / 2),
        ("in opposition", [0, np.pi], inertia / (2 * a**2)),
    ):
        edge, _ = together(kind, np.array(angles), w, A, fallen.bearings).edge(0.2)
        assert edge == pytest.approx(polynomial_edge(each, 2e7, 5e3, 0.2), rel=2e-3)


def test_rolling_elements():
    """K d^1.5 without preload; with it stiffer, odd about its centre, and inverted exactly."""
    assert element_force(1e-5, 1e9, 0.0) == pytest.approx(1e9 * 1e-5**1.5)
    tangent = (element_force(1e-9, 1e9, 4e-6) - element_force(-1e-9, 1e9, 4e-6)) / 2e-9
    assert tangent == pytest.approx(3 * 1e9 * 4e-6**0.5, rel=1e-4)
    numbers = bush(1e7, 1e3)._replace(race_mass=0.1, hertz=1e9, preload=4e-6)
    deflection = elements_deflection(numbers, 800.0)
    assert element_force(deflection, 1e9, 4e-6) == pytest.approx(800.0, rel=1e-9)


def test_machine_on_the_map():
    """The front door, and the map's own place; a rotor at rest is refused."""
    blower = amb.load_machine("overhung-blower")
    result = amb.landing(blower)
    plain = result.to_dict()
    assert plain["point"] == "full speed"
    assert {whip["kind"] for whip in plain["whips"]} >= {"impeller-side alone", "free-end alone"}
    assert plain["whip_map"]["place"] is None  # its file states no mount
    frequency = result.whip_map.frequency
    assert frequency.shape == (3, 13, 25)
    # more friction never makes whip slower
    settled = np.where(frequency > 0, frequency, -1)
    assert (np.diff(settled, axis=2) >= -1e-9).all()
    rest = next(p for p in blower.operation.envelope if p.speed == 0)
    with pytest.raises(InvalidInput, match="does not turn"):
        amb.landing(blower, rest)


def test_touchdown_gap_above_a_clearance_is_refused():
    machine = amb.load_machine("turboexpander")
    wide = [replace(item, gap=5e-4, touchdown_gap=4e-4) for item in machine.bearings]
    with pytest.raises(InvalidInput, match=r"touchdown_gap .* is above the clearance .* of seal"):
        amb.landing(replace(machine, bearings=tuple(wide)))
    bare = [replace(item, touchdown_gap=None) for item in machine.bearings]
    with pytest.raises(InvalidInput, match="no touchdown_gap to land in"):
        amb.landing(replace(machine, bearings=tuple(bare)))
