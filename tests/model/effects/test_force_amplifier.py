"""The amplifier with its limits: small signals as the linear view, voltage and current at their
stops.
"""

import numpy as np
import pytest
from hypothesis import given
from scipy.integrate import solve_ivp

from ambrose.core.checks import InvalidInput
from ambrose.machine.description import Amplifier
from ambrose.model.effects.amplifier import (
    coil_current,
    derivative,
    effective_current,
    linearised,
    parameters,
)
from physical_numbers import physical

ORDERS = {
    "none": Amplifier(),
    "first": Amplifier("first", bandwidth=9000.0),
    "twice-first": Amplifier("twice-first", bandwidth=9000.0, eddy_bandwidth=700.0),
    "second": Amplifier("second", natural_frequency=1360.0, damping=1590.5),
}


def jacobian(p):
    """A (2, 2), B (2, 1), C (1, 2), D (1, 1) at rest; the functions are linear there, so any step
    is exact.
    """
    unit = np.eye(3) * 0.01
    dx = np.array([derivative(*column, p) for column in unit]).T / 0.01
    y = np.array([effective_current(*column, p) for column in unit]) / 0.01
    return dx[:, 1:], dx[:, :1], y[None, 1:], y[None, :1]


@pytest.mark.parametrize("order", ORDERS)
def test_small_signals_are_the_linear_view(order):
    amplifier = ORDERS[order]
    w = np.array([0.0, 50.0, 700.0, 5e3, 4e4])
    A, B, C, D = jacobian(parameters(amplifier, 4.0))
    ours = [
        (C @ np.linalg.solve(1j * x * np.eye(2) - A + 1e-300 * np.eye(2), B) + D).item()
        if order != "none"
        else D.item()
        for x in w
    ]
    # the second state does not move, and the matrix is singular at zero frequency
    if order == "first":
        ours = [(C[:, :1] / (1j * x - A[0, 0]) * B[0, 0]).item() for x in w]
    theirs = linearised(amplifier, ["A_zeta"])
    expected = [
        (
            theirs.C @ np.linalg.solve(1j * x * np.eye(len(theirs.A)) - theirs.A, theirs.B)
            + theirs.D
        ).item()
        for x in w
    ]
    assert np.allclose(ours, expected, rtol=1e-9, atol=1e-12)


def step(amplifier, u, time, max_current=None, start=(0.0, 0.0)):
    p = parameters(amplifier, max_current)
    t = np.linspace(0, time, 400)
    found = solve_ivp(
        lambda _, s: derivative(u, *s, p),
        (0, time),
        start,
        t_eval=t,
        rtol=1e-8,
        atol=1e-10,
        max_step=time / 400,
    )
    return t, found.y, p


@pytest.mark.parametrize("order", ["first", "twice-first", "second"])
def test_voltage_limits_the_slope_of_the_coil_current(order):
    """150 V at 50 mH: 3000 A/s, held until the current comes near; no overshoot from winding up."""
    values = {
        name: getattr(ORDERS[order], name)
        for name in ("bandwidth", "eddy_bandwidth", "natural_frequency", "damping")
    }
    t, states, _ = step(Amplifier(order, **values, max_voltage=150.0, inductance=0.05), 8.0, 20e-3)
    current = states[0]
    slope = np.diff(current) / np.diff(t)
    assert slope.max() == pytest.approx(3000, rel=1e-3)
    assert np.isclose(slope, 3000, rtol=1e-3).sum() > 30
    assert (np.abs(slope) <= 3000 * (1 + 1e-6)).all()
    free = step(ORDERS[order], 8.0, 20e-3)[1][0].max()
    assert current.max() <= max(free, 8.0) * (1 + 1e-6)
    assert current[-1] == pytest.approx(8.0, rel=2e-2)


def test_first_order_slew_by_hand():
    """Constant slope until w (u - i) falls to it, then the exponential: i(t) known in closed
    form.
    """
    w = 9000.0
    u = 8.0
    slope = 3000.0
    t, states, _ = step(
        Amplifier("first", bandwidth=w, max_voltage=150.0, inductance=0.05), u, 6e-3
    )
    meet = (u - slope / w) / slope
    expected = np.where(t < meet, slope * t, u - slope / w * np.exp(-w * (t - meet)))
    assert np.abs(states[0] - expected).max() < 1e-6


@pytest.mark.parametrize("order", ORDERS)
def test_current_limit(order):
    _, (s_1, s_2), p = step(ORDERS[order], 100.0, 20e-3, max_current=4.0)
    for view in (coil_current, effective_current):
        current = np.array([view(100.0, a, b, p) for a, b in zip(s_1, s_2, strict=True)])
        assert current.max() <= 4.0 * (1 + 1e-3)
        assert current[-1] == pytest.approx(4.0, rel=1e-3)


def test_second_order_leaves_the_stop_at_once():
    """The slope's state does not wind up at the current limit: the way back starts when the command
    turns.
    """
    amplifier = ORDERS["second"]
    _, states, p = step(amplifier, 100.0, 20e-3, max_current=4.0)
    assert derivative(0.0, *states[:, -1], p)[1] < 0
    _, back, _ = step(amplifier, 0.0, 2e-3, max_current=4.0, start=states[:, -1])
    _, reference, _ = step(amplifier, 0.0, 2e-3, start=(4.0, 0.0))
    assert np.abs(back[0] - reference[0]).max() < 0.02


@given(physical(-1e3, 1e3), physical(-5, 5), physical(-50, 50))
def test_odd_and_bounded(u, s_1, s_2):
    limited = Amplifier(
        "second", natural_frequency=1360.0, damping=1590.5, max_voltage=150.0, inductance=0.05
    )
    p = parameters(limited, 4.0)
    d = derivative(u, s_1, s_2, p)
    assert derivative(-u, -s_1, -s_2, p) == (-d[0], -d[1])
    assert abs(d[0]) <= 3000


def test_eddy_currents_lag_behind_the_coil():
    p = parameters(ORDERS["twice-first"])
    assert coil_current(0.0, 2.0, 1.0, p) == 2.0
    assert effective_current(0.0, 2.0, 1.0, p) == 1.0


def test_a_voltage_limit_needs_inductance_and_dynamics():
    with pytest.raises(InvalidInput, match="inductance"):
        parameters(Amplifier("first", bandwidth=9000.0, max_voltage=100.0))
    with pytest.raises(InvalidInput, match="none"):
        parameters(Amplifier("none", max_voltage=100.0, inductance=0.1))
    with pytest.raises(InvalidInput, match="max_current"):
        parameters(ORDERS["first"], -1.0)
