"""Amplifiers and sensors against their transfer functions written out."""

import numpy as np
import pytest

from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import frequency_response
from ambrose.core.statespace import poles
from ambrose.machine.description import Amplifier
from ambrose.machine.part import Sensor
from ambrose.model.effects import amplifier, sensor

AXES = ("A_zeta", "A_eta", "B_zeta")
OMEGA = np.geomspace(1.0, 1e5, 40)
S = 1j * OMEGA

AMPLIFIERS = {
    "none": (Amplifier("none"), np.ones_like(S), 0),
    "first": (Amplifier("first", bandwidth=6000.0), 6000 / (S + 6000), 1),
    "twice-first": (
        Amplifier("twice-first", bandwidth=6000.0, eddy_bandwidth=900.0),
        6000 * 900 / ((S + 6000) * (S + 900)),
        2,
    ),
    "second": (
        Amplifier("second", natural_frequency=1360.0, damping=1590.0),
        1360**2 / (S**2 + 1590 * S + 1360**2),
        2,
    ),
}


@pytest.mark.parametrize("order", AMPLIFIERS)
def test_amplifier_is_its_transfer_function_on_every_axis(order):
    description, expected, states = AMPLIFIERS[order]
    system = amplifier.linearised(description, AXES)
    assert system.inputs == ("u_A_zeta", "u_A_eta", "u_B_zeta")
    assert system.outputs == ("i_A_zeta", "i_A_eta", "i_B_zeta")
    assert system.n_states == 3 * states
    values = frequency_response(system, OMEGA).values
    assert values == pytest.approx(expected[:, None, None] * np.eye(3), rel=1e-12, abs=1e-14)
    assert frequency_response(system, [0.0]).values[0] == pytest.approx(np.eye(3), rel=1e-12)
    if states:  # the states are balanced: entries of A and B of one size
        entries = np.abs(np.concatenate([system.A[system.A != 0], system.B[system.B != 0]]))
        assert entries.max() / entries.min() < 10
        assert poles(system).real.max() < 0


@pytest.mark.parametrize(
    ("description", "message"),
    [
        (Amplifier("third"), "none, first, twice-first, second"),
        (Amplifier("first"), "bandwidth is missing"),
        (Amplifier("twice-first", bandwidth=1.0), "eddy_bandwidth is missing"),
        (Amplifier("second", natural_frequency=1.0, damping=0.0), "damping.*positive"),
        (Amplifier("first", bandwidth=np.inf), "bandwidth.*finite"),
    ],
)
def test_incomplete_amplifiers_are_refused(description, message):
    with pytest.raises(InvalidInput, match=message):
        amplifier.linearised(description, AXES)


def test_sensors_have_gain_and_lag_in_the_order_of_the_axes():
    sensors = [
        Sensor("B", 0.7, gain=(1.1, 0.9), bandwidth=5000.0),
        Sensor("A", 0.1, gain=(1.0, 1.2)),
    ]
    axes = ("A_zeta", "A_eta", "B_zeta", "B_eta")
    system = sensor.linearised(sensors, axes)
    assert system.inputs == tuple(f"s_{axis}" for axis in axes)
    assert system.outputs == tuple(f"y_{axis}" for axis in axes)
    assert system.n_states == 2
    lag = 5000 / (S + 5000)
    expected = np.zeros((len(S), 4, 4), complex)
    for axis, value in enumerate((1.0, 1.2, 1.1 * lag, 0.9 * lag)):
        expected[:, axis, axis] = value
    assert frequency_response(system, OMEGA).values == pytest.approx(expected, rel=1e-12, abs=1e-14)


def test_ideal_sensors_have_no_states():
    system = sensor.linearised([Sensor("A", 0.1)], ("A_eta", "A_zeta"))
    assert system.n_states == 0
    assert np.array_equal(system.D, np.eye(2))


@pytest.mark.parametrize(
    ("sensors", "axes", "message"),
    [
        ([], ("A_zeta",), "'A_zeta' has no sensor"),
        ([Sensor("A", 0.1)], ("A_x",), "'A_x'"),
        ([Sensor("A", 0.1, bandwidth=0.0)], ("A_zeta",), "bandwidth.*positive"),
        ([Sensor("A", 0.1, gain=(np.nan, 1.0))], ("A_zeta",), "gain.*finite"),
    ],
)
def test_sensors_that_do_not_fit_are_refused(sensors, axes, message):
    with pytest.raises(InvalidInput, match=message):
        sensor.linearised(sensors, axes)
