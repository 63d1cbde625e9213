"""Campbell map and critical speeds of a gyroscopic disc in closed form; crossing modes are told
apart.
"""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from ambrose.core.checks import InvalidInput
from ambrose.core.statespace import StateSpace
from ambrose.judge.campbell import campbell, campbell_curves, direction
from ambrose.model.assemble import assemble

PORTS = ("A_zeta", "A_eta", "B_zeta", "B_eta")


def discs(single_masses, ratio=(0.6, 0.1), stiffness=(1e4, 1.44e4), damping=2.0):
    """Two planar oscillators z'' + (d - j Omega ratio) z' + k z = 0, z = x + j y, one seen at A,
    the other at B.
    """
    template = single_masses()

    def plant_at(speed):
        A = np.zeros((8, 8))
        C = np.zeros((4, 8))
        for m, (r, k) in enumerate(zip(ratio, stiffness, strict=True)):
            G = r * np.array([[0.0, 1.0], [-1.0, 0.0]])  # skew, forward modes rise with speed
            s = slice(4 * m, 4 * m + 4)
            A[s, s] = np.block(
                [[np.zeros((2, 2)), np.eye(2)], [-k * np.eye(2), -damping * np.eye(2) - speed * G]]
            )
            C[2 * m : 2 * m + 2, 4 * m : 4 * m + 2] = np.eye(2)
        system = StateSpace(
            A, np.zeros((8, 1)), C, np.zeros((4, 1)), outputs=[f"q_{p}" for p in PORTS]
        )
        return replace(template, system=system, ports=PORTS)

    return plant_at


def exact(speed, ratio, k, damping=2.0):
    """Roots s of s^2 + (d - j Omega r) s + k = 0: forward has Im > 0."""
    roots = np.roots([1.0, damping - 1j * speed * ratio, k])
    return roots[np.argmax(roots.imag)], roots[np.argmin(roots.imag)].conj()


def test_closed_form_through_crossings(single_masses):
    speeds = np.linspace(1.0, 150.0, 31)
    found = campbell(discs(single_masses), speeds, 4)
    assert found.frequency.shape == found.damping.shape == found.whirl.shape == (4, 31)
    for frequency, damping, whirl in zip(found.frequency, found.damping, found.whirl, strict=True):
        errors = []
        for ratio, k in ((0.6, 1e4), (0.1, 1.44e4)):
            for branch, sign in ((0, 1), (1, -1)):
                poles = np.array([exact(speed, ratio, k)[branch] for speed in speeds])
                if sign * whirl[-1] > 0:
                    errors.append(
                        np.abs(frequency / poles.imag - 1).max()
                        + np.abs(damping + poles.real / np.abs(poles)).max()
                    )
        # one branch throughout, although forward 1 crosses both modes of disc 2
        assert min(errors) < 1e-9
        assert np.abs(whirl[5:]).min() > 0.99


def critical_speeds(found):
    """Speeds [rad/s] at which a mode's frequency equals the speed, with its whirl direction there,
    by cubic splines.
    """
    crossings = []
    for frequency, whirl in zip(found.frequency, found.whirl, strict=True):
        for root in CubicSpline(found.speeds, frequency - found.speeds).roots(extrapolate=False):
            crossings += [(root, direction(float(np.interp(root, found.speeds, whirl))))] * bool(
                root > 0
            )
    return sorted(crossings)


def test_critical_speeds_in_closed_form(single_masses):
    """-W^2 + r W^2 + k = 0 forward, -W^2 - r W^2 + k = 0 backward, without damping."""
    found = campbell(discs(single_masses, damping=0.0), np.linspace(0.0, 200.0, 41), 4)
    expected = sorted(
        [(np.sqrt(k / (1 - r)), "forward") for r, k in ((0.6, 1e4), (0.1, 1.44e4))]
        + [(np.sqrt(k / (1 + r)), "backward") for r, k in ((0.6, 1e4), (0.1, 1.44e4))]
    )
    speeds = critical_speeds(found)
    assert [word for _, word in speeds] == [word for _, word in expected]
    np.testing.assert_allclose([w for w, _ in speeds], [w for w, _ in expected], rtol=1e-5)


def test_curves_carry_directions_and_the_speed_line(single_masses):
    found = campbell(discs(single_masses), np.linspace(1.0, 100.0, 5), 4)
    frequency, damping = campbell_curves(found)
    assert frequency.labels[-1] == "once per revolution"
    np.testing.assert_array_equal(frequency.y[-1], found.speeds)
    assert sum("forward" in label for label in frequency.labels) == 2
    assert damping.y.shape == (4, 5)


def test_closed_loop_of_the_rig(rig, rig_controller):
    """Real plants in the loop: the map starts at the closed loop's own poles and gyroscopic
    splitting grows with speed.
    """
    point = rig.operation.points[1]
    speeds = 2 * np.pi * np.array([0.0, 150.0, 300.0])
    found = campbell(lambda w: assemble(rig, replace(point, speed=w)), speeds, 12, rig_controller)
    hertz = found.frequency / (2 * np.pi)
    for pair in (
        np.flatnonzero(np.abs(hertz[:, 0] - 550) < 20),
        np.flatnonzero(np.abs(hertz[:, 0] - 1343) < 20),
    ):
        assert len(pair) == 2
        for k in pair:
            assert np.sign(np.diff(hertz[k])) == pytest.approx(np.sign(found.whirl[k, -1]))
            assert abs(found.whirl[k, -1]) > 0.99


def test_refusals(single_masses):
    plant_at = discs(single_masses)
    with pytest.raises(InvalidInput, match="ascending"):
        campbell(plant_at, np.array([1.0]), 2)
    with pytest.raises(InvalidInput, match="number of modes"):
        campbell(plant_at, np.array([1.0, 2.0]), 5)


def test_the_map_shows_itself(rig, rig_plants):
    found = campbell(lambda speed: rig_plants["zero"], np.array([1.0, 2.0]), 4)
    assert repr(found).startswith("CampbellMap(speeds=1 to 2 rad/s, least_damping=")
    assert len(repr(found)) < 200
    assert json.loads(json.dumps(found.to_dict()))["frequency"] == found.frequency.tolist()
