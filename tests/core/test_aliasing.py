"""A mode above half the sample rate is read at its own frequency, against closed forms, the same
loop sampled faster, and a root of the loop's characteristic equation; one that the loop moves, or
loses, is not hidden.
"""

from __future__ import annotations

import numpy as np
import pytest

from ambrose.core.aliasing import continuous_poles, fast_modes
from ambrose.core.sampling import c2d
from ambrose.core.statespace import StateSpace

T = 1e-4
MODE = 2 * np.pi * 10_199.0  # rad/s: 199 Hz beside the sample rate
ZETA = 0.003
TURN = 2 * np.pi / T
STIFF, DAMPED = (2 * np.pi * 100) ** 2, 2 * 0.5 * 2 * np.pi * 100  # of the unit mass


def plant(seen: float, mode: float = MODE) -> StateSpace:
    """A free unit mass and a mode that the same force drives; the sensor reads y = x + seen q."""
    A = np.zeros((4, 4))
    A[0, 1] = A[2, 3] = 1.0
    A[3, 2:] = -(mode**2), -2 * ZETA * mode
    B = np.array([[0.0], [1.0], [0.0], [1.0]])
    return StateSpace(A, B, np.array([[1.0, 0.0, seen, 0.0]]), np.zeros((1, 1)))


def loop(system: StateSpace, dt: float = T) -> np.ndarray:
    """The plant behind its hold with u = -STIFF y - DAMPED (y - y before)/dt."""
    d = c2d(system, dt)
    now, before = STIFF + DAMPED / dt, DAMPED / dt
    return np.block([[d.A - now * d.B @ d.C, before * d.B], [d.C, np.zeros((1, 1))]])


def read(system: StateSpace, dt: float = T) -> np.ndarray:
    """Poles with Im >= 0, by frequency."""
    poles = continuous_poles(loop(system, dt), dt, system.A)[0]
    poles = poles[poles.imag >= 0]
    return poles[np.argsort(poles.imag)]


@pytest.mark.parametrize("mode", [MODE, 2 * np.pi * 9_900, 2 * np.pi * 5_200, 2 * np.pi * 30_500])
def test_a_mode_that_the_sensor_does_not_see_is_read_where_the_plant_has_it(mode):
    """Closed form: lambda = -zeta w + j w sqrt(1 - zeta^2)."""
    own = mode * (-ZETA + 1j * np.sqrt(1 - ZETA**2))
    assert read(plant(0.0, mode))[-1] == pytest.approx(own, rel=1e-9)
    blind = continuous_poles(loop(plant(0.0, mode)), T)[0]
    assert np.abs(blind.imag).max() <= TURN / 2 * (1 + 1e-12)


@pytest.mark.parametrize("seen", [0.01, -0.01, 10.0, -10.0])
def test_a_mode_that_the_loop_moves_little_is_read_on_its_own_branch(seen):
    """Against the loop's matrix at z = e^{s T}, and the same loop at 40 kHz, where the mode lies
    within half the rate; its controller moves it there, if the sensor sees much of it.
    """
    found = read(plant(seen))[-1]
    z = np.exp(found * T)
    A = loop(plant(seen))
    assert np.linalg.svd(z * np.eye(5) - A, compute_uv=False)[-1] < 1e-9 * np.abs(A).max()
    assert abs(found.imag - MODE) < 1e-4 * MODE
    if abs(seen) < 1:
        fast = read(plant(seen), T / 4)[-1]
        assert found.imag == pytest.approx(fast.imag, rel=1e-4)
        assert found.real == pytest.approx(fast.real, rel=0.02)


def test_all_other_poles_stay_where_they_were():
    A, P = loop(plant(10.0)), plant(10.0).A
    before, after = (np.sort_complex(continuous_poles(A, T, given)[0]) for given in (None, P))
    slow = np.abs(after.imag) <= np.pi / T
    assert slow.sum() == 3
    assert all(np.abs(before - s).min() < 1e-9 * np.abs(s) for s in after[slow])


def test_a_mode_that_the_loop_moves_is_judged_where_the_controller_sees_it():
    """seen = -1000: the loop takes six sevenths of its decay, and the mass moves at 206 Hz."""
    found = read(plant(-1000.0))
    assert np.abs(found.imag).max() == pytest.approx(2 * np.pi * 205.6, rel=1e-3)
    assert found[-1].real == pytest.approx(-26.4, rel=1e-2)


@pytest.mark.parametrize(("seen", "mode"), [(-2000.0, MODE), (1.0, 2 * np.pi * 5_200)])
def test_a_mode_that_the_loop_loses_is_unstable_and_named_by_its_own_frequency(seen, mode):
    A = loop(plant(seen, mode))
    worst = max(read(plant(seen, mode)), key=lambda s: s.real)
    assert worst.real == pytest.approx(np.log(np.abs(np.linalg.eigvals(A)).max()) / T, rel=1e-9)
    assert worst.real > 0 and worst.imag == pytest.approx(mode, rel=2e-3)


def test_a_mode_at_the_sample_rate_is_no_real_pole():
    """z is real there, twice: both are read at the sample rate, and at least one with Im > 0."""
    mode = TURN / np.sqrt(1 - ZETA**2)
    system = plant(0.0, mode)
    poles = continuous_poles(loop(system), T, system.A)[0]
    own = poles[np.abs(poles.imag) > TURN / 2]
    assert np.abs(own.imag) == pytest.approx([TURN] * 2, rel=1e-6) and own.imag.max() > 0
    assert own.real == pytest.approx([-ZETA * mode] * 2, rel=1e-3)


def test_neither_scaling_nor_a_change_of_states_moves_a_pole():
    """x = M x_s with M of a plant of two like planes, whose modes coincide."""
    both = np.kron(np.eye(2), plant(3.0).A)
    d = loop(plant(3.0))
    A = np.zeros((10, 10))
    for k in range(2):  # the plants' states first, then the two held samples
        rows = [*range(4 * k, 4 * k + 4), 8 + k]
        A[np.ix_(rows, rows)] = d
    M = (
        np.diag(10.0 ** np.arange(-4, 4))
        @ np.linalg.qr(np.random.default_rng(0).normal(size=(8, 8)))[0]
    )
    wide = np.block([[M, np.zeros((8, 2))], [np.zeros((2, 8)), np.eye(2)]])
    plain = continuous_poles(A, T, both)[0]
    turned = continuous_poles(np.linalg.solve(wide, A @ wide), T, np.linalg.solve(M, both @ M))[0]
    assert (np.abs(plain.imag) > TURN / 2).sum() == 4
    assert np.sort(turned.imag) == pytest.approx(np.sort(plain.imag), rel=1e-6, abs=1.0)


def test_without_fast_modes_nothing_is_asked():
    assert fast_modes(plant(1.0).A, T / 4) is None
    assert fast_modes(np.zeros((2, 2)), T) is None
    values, vectors = continuous_poles(plant(1.0).A)
    assert plant(1.0).A @ vectors == pytest.approx(vectors * values, rel=1e-6, abs=1e-3)
