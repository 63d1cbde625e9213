"""The pulse response against an independent stepping, settling time against a closed form,
limits.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg as sla

from ambrose.core.sampling import c2d
from ambrose.core.statespace import static_gain
from ambrose.judge.nominal import PulseResponse, pulse_checks, pulse_response
from ambrose.law.loop import closed_loop
from ambrose.machine.criteria import CURRENT_PULSE, Pulse
from ambrose.machine.description import Requirements


@pytest.fixture(scope="module")
def rig_response(rig_plants, rig_controller):
    plant = rig_plants["nominal"]
    closed = closed_loop(plant, rig_controller)
    return plant, closed, pulse_response(closed, plant)


def test_pulse_on_the_rig_against_plain_stepping(rig_response):
    plant, closed, found = rig_response
    n, dt = closed.n_states, found.time[1]
    b = closed.B[:, closed.inputs.index("e_B_zeta")]
    M = np.zeros((n + 1, n + 1))
    M[:n, :n], M[:n, n] = closed.A * dt, b * dt * CURRENT_PULSE.amplitude
    E = sla.expm(M)
    rows = [closed.outputs.index(name) for name in ("y_A_zeta", "y_B_eta", "i_B_zeta", "q_B_zeta")]
    x, y = np.zeros(n), np.zeros((4, 400))
    for k in range(400):
        y[:, k] = closed.C[rows] @ x
        x = E[:n, :n] @ x + (E[:n, n] if k < 100 else 0.0)
    axes = list(plant.axes)
    k = axes.index("B_zeta")
    expected = [
        found.displacement[k, axes.index("A_zeta")],
        found.displacement[k, axes.index("B_eta")],
        found.current[k, k],
        found.bearing_displacement[k, k],
    ]
    for ours, own in zip(expected, y, strict=True):
        np.testing.assert_allclose(ours[:400], own, rtol=0, atol=1e-6 * np.abs(own).max())


def test_settling_of_a_first_order_decay_in_closed_form():
    """exp(-a (t - T)) after the pulse falls to the band of its peak 1 at T + ln(1/band)/a."""
    time = np.arange(20_000) * 1e-4
    pulse = Pulse(0.01, 1.0, 0.05, "test")
    decay = np.where(time < 0.01, time / 0.01, np.exp(-12.0 * np.maximum(time - 0.01, 0)))
    zeros = np.zeros((1, 1, len(time)))
    found = PulseResponse(time, decay[None, None], zeros, zeros, pulse)
    assert found.settling()[0] == pytest.approx(np.log(20) / 12.0, abs=1.5e-4)
    slow = PulseResponse(
        time[:300], decay[None, None, :300], zeros[..., :300], zeros[..., :300], pulse
    )
    assert slow.settling()[0] == np.inf
    silent = PulseResponse(time, zeros, zeros, zeros, pulse)
    assert silent.settling()[0] == 0.0


def test_single_mass_settles_as_its_poles_say(single_masses, pd_controller):
    plant = single_masses(2.0, 100.0, 2e5)
    closed = closed_loop(plant, pd_controller(5000.0, 3.0, 1e-4))
    found = pulse_response(closed, plant)
    p = np.linalg.eigvals(closed.A)
    slowest = -p.real.max()
    settling = found.settling()
    np.testing.assert_allclose(settling, settling[0], rtol=1e-9)
    assert 0.5 * np.log(20) / slowest < settling[0] < 2.0 * np.log(20) / slowest
    other = found.displacement[0, 1:]
    assert np.abs(other).max() < 1e-12 * np.abs(found.displacement[0, 0]).max()


def test_checks_limits_and_the_last_axis(rig_response):
    plant, _, found = rig_response
    checks, curves = pulse_checks(found, plant, Requirements(settling_time=0.05, max_current=0.06))
    checks = {check.name: check for check in checks}
    assert checks["impulse.settling"].value == found.settling().max()
    assert checks["impulse.settling"].passed is bool(found.settling().max() <= 0.05)
    assert checks["impulse.current_0p"].value == np.abs(found.current).max()
    assert (
        checks["impulse.current_0p"].passed is False and checks["impulse.current_0p"].limit == 0.06
    )
    assert checks["impulse.force_0p"].limit == 7500.0 and checks["impulse.force_0p"].passed is True
    worst = plant.axes[int(np.argmax(found.settling()))]
    assert [curve.name for curve in curves] == ["impulse.displacement", "impulse.current"]
    assert all(worst in curve.title and curve.kind == "time" for curve in curves)
    np.testing.assert_array_equal(curves[0].y, found.displacement[plant.axes.index(worst)])


def test_a_loop_that_does_not_settle_in_four_seconds_says_so(single_masses, pd_controller):
    """A hardly damped loop: 5 % of the peak is reached only after ln 20/0.2 = 15 s."""
    plant = single_masses(2.0, 100.0, 2e5, damping=0.8)
    found = pulse_response(closed_loop(plant, static_gain(5000.0 * np.eye(4))), plant)
    assert found.time[-1] == pytest.approx(4.0, abs=0.02)
    check = {c.name: c for c in pulse_checks(found, plant, Requirements(settling_time=1.0))[0]}[
        "impulse.settling"
    ]
    assert check.value == np.inf and check.passed is False and "not settled" in check.detail


def test_a_sampled_loop_keeps_its_own_time(single_masses, pd_controller):
    """The plant is exact under the hold; a fast sampled controller comes close to the continuous
    one.
    """
    plant = single_masses(2.0, 100.0, 2e5)
    controller = pd_controller(5000.0, 8.0, 1e-3)
    smooth = pulse_response(closed_loop(plant, controller), plant)
    sampled = pulse_response(closed_loop(plant, c2d(controller, 5e-5, "tustin")), plant)
    assert sampled.time[1] == 5e-5
    peak = np.abs(smooth.displacement[0, 0]).max()
    assert np.abs(sampled.displacement[0, 0]).max() == pytest.approx(peak, rel=2e-2)
    assert sampled.settling()[0] == pytest.approx(smooth.settling()[0], rel=5e-2)


def test_pulse_scales_linearly(rig_response):
    plant, closed, found = rig_response
    double = pulse_response(closed, plant, replace(CURRENT_PULSE, amplitude=0.1))
    np.testing.assert_allclose(double.displacement, 2 * found.displacement, rtol=1e-9, atol=1e-18)
    np.testing.assert_array_equal(double.settling(), found.settling())
