"""Time responses: against stepping, closed forms, python-control and scipy's expm; derivatives
against complex steps.
"""

import control
import numpy as np
import pytest
import scipy.linalg as sla
from hypothesis import given, settings, strategies as st

from ambrose.core.checks import InvalidInput, NumericalFailure
from ambrose.core.response import (
    SystemDerivative,
    expm_derivative,
    held_derivative,
    hermite,
    impulse_response,
    sample_polynomial,
    settling_time,
    simulate,
    simulate_piecewise,
)
from ambrose.core.sampling import c2d
from ambrose.core.statespace import StateSpace, static_gain
from physical_numbers import physical
from whole_records import simulate_derivative


def random_system(n, m, p, seed=0, scale=30.0, dt=None):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, n)) * scale / max(n, 1) ** 0.5
    if dt is None:
        A -= (np.linalg.eigvals(A).real.max(initial=0.0) + 0.1 * scale) * np.eye(n)
    else:
        A *= 0.98 / max(np.abs(np.linalg.eigvals(A)).max(initial=0.0), 1e-9)
    B = rng.standard_normal((n, m))
    C = rng.standard_normal((p, n))
    D = rng.standard_normal((p, m))
    return StateSpace(A, B, C, D, dt=dt)


def oscillator(w, zeta=0.0):
    return StateSpace([[0, 1], [-(w**2), -2 * zeta * w]], [[0], [1]], [[1, 0]], [[0]])


def stepped(A, B, C, D, u, x):
    """The plain recursion, the oracle of all block algorithms."""
    y, states = [], [x]
    for k in range(u.shape[1]):
        y.append(C @ x + D @ u[:, k])
        x = A @ x + B @ u[:, k]
        states.append(x)
    return np.array(y).T.reshape(len(C), -1), np.array(states).T


def close(actual, expected, tolerance):
    np.testing.assert_allclose(actual, expected, rtol=0, atol=tolerance)


def exact_zoh(system, dt):
    n, m = system.B.shape
    E = sla.expm(np.block([[system.A, system.B], [np.zeros((m, n + m))]]) * dt)
    return E[:n, :n], E[:n, n:]


def watched(system):
    """The system with its states as outputs."""
    n, m = system.n_states, len(system.inputs)
    return StateSpace(
        system.A, system.B, np.eye(n), np.zeros((n, m)), system.inputs, None, system.dt
    )


@pytest.mark.parametrize("k", [1, 2, 7, 64, 1000, 4097])
@pytest.mark.parametrize(
    ("n", "m", "p"),
    [(0, 2, 3), (1, 1, 1), (5, 3, 2), (24, 4, 4), (60, 1, 1), (3, 40, 1), (4, 0, 2)],
)
def test_response_equals_exponential_stepping(n, m, p, k):
    system, dt = random_system(n, m, p, seed=n + k), 3e-3
    rng = np.random.default_rng(k)
    u, x0 = rng.standard_normal((m, k)), rng.standard_normal(n)
    y, x = stepped(*exact_zoh(system, dt), system.C, system.D, u, x0)
    close(simulate(system, u, dt, x0), y, 1e-11 * (1 + np.abs(y).max()))
    close(simulate(watched(system), u, dt, x0), x[:, :-1], 1e-11 * (1 + np.abs(x).max(initial=0)))


@pytest.mark.parametrize("n", [0, 3, 30])
def test_sampled_system_is_stepped_as_it_is(n):
    system = random_system(n, 2, 3, seed=4, dt=1e-3)
    u = np.random.default_rng(1).standard_normal((2, 777))
    x0 = np.ones(n)
    y, x = stepped(system.A, system.B, system.C, system.D, u, x0)
    for dt in (None, 1e-3):
        close(simulate(system, u, dt, x0), y, 1e-11 * np.abs(y).max())
    close(simulate(watched(system), u, x0=x0), x[:, :-1], 1e-11)


def test_python_control_agrees_on_the_held_model_and_is_wrong_on_the_continuous_one():
    system, dt = random_system(8, 2, 2, seed=5), 1e-2
    u = np.sign(np.random.default_rng(2).standard_normal((2, 300)))
    y = simulate(system.to_control(), u, dt)
    time = np.arange(300) * dt
    held = control.forced_response(control.c2d(system.to_control(), dt, "zoh"), time, u)
    assert y == pytest.approx(held.outputs, rel=1e-10, abs=1e-10)
    first_order_hold = control.forced_response(system.to_control(), time, u)
    assert np.abs(y - first_order_hold.outputs).max() > 0.01 * np.abs(y).max()


def test_free_oscillation_keeps_its_energy():
    w = 300.0
    dt = 1e-3
    k = 200_000
    x = simulate(watched(oscillator(w)), np.zeros((1, k)), dt, [1.0, 0.0])
    energy = (w * x[0]) ** 2 + x[1] ** 2
    assert np.abs(energy / w**2 - 1).max() < 1e-10
    assert np.abs(x[0] - np.cos(w * dt * np.arange(k))).max() < 1e-8


def test_step_and_impulse_of_a_damped_oscillator():
    w = 200.0
    zeta = 0.1
    dt = 1e-3
    wd, t = w * np.sqrt(1 - zeta**2), np.arange(500) * dt
    decay = np.exp(-zeta * w * t)
    system = oscillator(w, zeta)
    assert impulse_response(system, 500, dt)[0, 0] == pytest.approx(
        decay * np.sin(wd * t) / wd, abs=1e-15
    )
    step = (1 - decay * (np.cos(wd * t) + zeta * w / wd * np.sin(wd * t))) / w**2
    assert simulate(system, np.ones((1, 500)), dt)[0] == pytest.approx(step, abs=1e-17)


@pytest.mark.parametrize("samples", [1, 2, 3, 50, 1025])
def test_unit_responses_equal_simulation(samples):
    system = random_system(6, 3, 2, seed=6, dt=1e-3)
    pulse = impulse_response(system, samples)
    assert pulse.shape == (2, 3, samples)
    for j in range(3):
        u = np.zeros((3, samples))
        u[j, 0] = 1.0
        assert pulse[:, j] == pytest.approx(simulate(system, u), abs=1e-11)


def test_defective_and_badly_scaled_systems():
    # four integrators in a row
    chain = StateSpace(np.diag(np.ones(3), 1), np.eye(4)[:, 3:], np.eye(4), np.zeros((4, 1)))
    k, dt = 2000, 1e-2
    t = np.arange(k) * dt
    exact = np.array([t**4 / 24, t**3 / 6, t**2 / 2, t])
    assert simulate(chain, np.ones((1, k)), dt) == pytest.approx(exact, rel=1e-11, abs=1e-12)
    system = random_system(6, 1, 1, seed=7)
    t = 10.0 ** np.array([-9, -5, 0, 3, 6, 9])
    scaled = StateSpace(system.A * t / t[:, None], system.B / t[:, None], system.C * t, system.D)
    u = np.random.default_rng(0).standard_normal((1, 500))
    assert simulate(scaled, u, 1e-2) == pytest.approx(
        simulate(system, u, 1e-2), rel=1e-10, abs=1e-10
    )


@settings(max_examples=30, deadline=None)
@given(
    st.integers(0, 6),
    st.integers(1, 3),
    st.integers(1, 200),
    st.integers(0, 50),
    physical(-3, 3),
    st.integers(0, 10**6),
)
def test_linear_and_time_invariant(n, m, k, shift, factor, seed):
    system, dt = random_system(n, m, 2, seed=seed), 2e-3
    u, v = np.random.default_rng(seed).standard_normal((2, m, k))
    both = simulate(system, u + factor * v, dt)
    close(both, simulate(system, u, dt) + factor * simulate(system, v, dt), 1e-10)
    late = simulate(system, np.hstack([np.zeros((m, shift)), u]), dt)
    assert not late[:, :shift].any()
    close(late[:, shift:], simulate(system, u, dt), 1e-10)


def test_future_input_has_no_effect():
    system = random_system(4, 2, 2, seed=8)
    u = np.random.default_rng(3).standard_normal((2, 3000))
    changed = u.copy()
    changed[:, 1234:] = 1e12
    assert np.array_equal(
        simulate(system, u, 1e-3)[:, :1234], simulate(system, changed, 1e-3)[:, :1234]
    )


def test_unstable_response_is_exact_until_it_overflows():
    system = StateSpace([[50.0]], [[1.0]], [[1.0]], [[0.0]])
    y = simulate(system, np.zeros((1, 1000)), 1e-2, [1.0])
    assert y[0] == pytest.approx(np.exp(0.5 * np.arange(1000)), rel=1e-12 * 500)
    with pytest.raises(NumericalFailure, match="unstable"):
        simulate(system, np.zeros((1, 3000)), 1e-2, [1.0])
    with pytest.raises(NumericalFailure, match="unstable"):
        impulse_response(system, 3000, 1e-2)


@pytest.mark.parametrize("degree", [0, 1, 3])
def test_polynomial_inputs_are_exact(degree):
    """An input that is a polynomial in each interval, against an augmented exponential of the whole
    interval.
    """
    system = random_system(4, 2, 3, seed=9)
    dt = 2e-2
    k = 40
    c = np.random.default_rng(4).standard_normal((degree + 1, 2, k))
    sampled = sample_polynomial(system, dt, degree)
    y = simulate(sampled, c.reshape(-1, k))
    x = np.zeros(4)
    for i in range(k):
        assert y[:, i] == pytest.approx(system.C @ x + system.D @ c[0, :, i], abs=1e-12)
        # variation of constants with 40 Gauss points
        nodes, weights = np.polynomial.legendre.leggauss(40)
        tau = (nodes + 1) / 2
        forces = sum(c[j, :, i][:, None] * tau**j for j in range(degree + 1))
        E = sla.expm(system.A * (dt * (1 - tau))[:, None, None])
        integral = np.einsum("tij,jt,t->i", E, system.B @ forces, weights) * dt / 2
        x = sla.expm(system.A * dt) @ x + integral


def test_held_sampling_is_the_package_s_own():
    system, dt = random_system(5, 2, 2, seed=10), 1e-2
    ours, theirs = sample_polynomial(system, dt, 0), c2d(system, dt)
    close(ours.A, theirs.A, 1e-13)
    close(ours.B, theirs.B, 1e-13)
    assert ours.inputs == theirs.inputs


def test_hermite_input_converges_with_fourth_order():
    w, W = 130.0, 400.0
    system = oscillator(W, 0.3)
    errors = []
    for k in (64, 128, 256):
        dt = 0.2 / k
        t = np.arange(k + 1) * dt
        coefficients = hermite(np.sin(w * t)[None], w * np.cos(w * t)[None], dt).reshape(4, k)
        y = simulate(sample_polynomial(system, dt), coefficients)[0]
        generator = sla.expm(
            np.array([[0, 1, 0, 0], [-(W**2), -0.6 * W, 1, 0], [0, 0, 0, w], [0, 0, -w, 0]])
            * t[:k, None, None]
        )
        errors.append(np.abs(y - generator[:, 0, 3]).max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4, abs=0.2)
    assert np.log2(errors[1] / errors[2]) == pytest.approx(4, abs=0.2)


def test_piecewise_constant_system_carries_its_state():
    parts = [random_system(3, 2, 2, seed=s, dt=1e-3) for s in (1, 2, 3)]
    u = np.random.default_rng(5).standard_normal((2, 450))
    pieces = [u[:, :100], u[:, 100:101], u[:, 101:]]
    expected, x = [], np.ones(3)
    for part, piece in zip(parts, pieces, strict=True):
        y, states = stepped(part.A, part.B, part.C, part.D, piece, x)
        expected.append(y)
        x = states[:, -1]
    assert simulate_piecewise(parts, pieces, np.ones(3)) == pytest.approx(
        np.hstack(expected), abs=1e-11
    )
    assert simulate_piecewise([parts[0]] * 3, pieces) == pytest.approx(
        simulate(parts[0], u), abs=1e-11
    )


@pytest.mark.parametrize("n", [1, 3, 12, 40])
@pytest.mark.parametrize("size", [1e-8, 1.0, 1e8])
def test_exponential_derivative_equals_complex_step(n, size):
    rng = np.random.default_rng(n)
    A = 50 * rng.standard_normal((n, n)) / n**0.5
    dA = size * rng.standard_normal((2, 3, n, n))
    t = 0.02
    E, dE = expm_derivative(A, dA, t)
    h = 1e-30 / size
    step = sla.expm((A + 1j * h * dA) * t).imag / h
    close(E, sla.expm(A * t), 1e-12 * np.abs(E).max())
    assert np.abs(dE - step).max() <= 1e-12 * np.abs(step).max()


def test_exponential_derivative_of_special_matrices():
    E, dE = expm_derivative(np.zeros((2, 2)), [[0.0, 3.0], [0.0, 0.0]], 2.0)
    assert np.array_equal(E, np.eye(2)) and dE == pytest.approx(
        np.array([[0, 6.0], [0, 0]]), rel=1e-15
    )
    nilpotent = np.array([[0.0, 1.0], [0.0, 0.0]])  # defective: exp = I + A t
    _, dE = expm_derivative(nilpotent, nilpotent.T)
    assert dE == pytest.approx(np.array([[1 / 2, 1 / 6], [1.0, 1 / 2]]), rel=1e-14)
    A = np.diag([-1.0, -2.0])
    assert expm_derivative(A, A)[1] == pytest.approx(A @ sla.expm(A), rel=1e-14)
    assert expm_derivative(A, np.zeros((0, 2, 2)))[1].shape == (0, 2, 2)


def test_held_derivative_equals_complex_step():
    system, dt = random_system(10, 3, 1, seed=11), 5e-3
    rng = np.random.default_rng(6)
    dA, dB = rng.standard_normal((4, 10, 10)), rng.standard_normal((4, 10, 3))
    Ad, Bd, dAd, dBd = held_derivative(system.A, system.B, dA, dB, dt)
    for ours, theirs in zip((Ad, Bd), exact_zoh(system, dt), strict=True):
        close(ours, theirs, 1e-13)
    for q in range(4):
        M = np.zeros((13, 13), complex)
        M[:10, :10], M[:10, 10:] = system.A + 1e-30j * dA[q], system.B + 1e-30j * dB[q]
        E = sla.expm(M * dt).imag / 1e-30
        assert np.abs(dAd[q] - E[:10, :10]).max() <= 1e-12 * np.abs(E[:10, :10]).max()
        assert np.abs(dBd[q] - E[:10, 10:]).max() <= 1e-12 * np.abs(E[:10, 10:]).max()


def test_response_derivative_equals_complex_step():
    """Of the oracle for identification/output_error."""
    system = random_system(6, 2, 3, seed=12, dt=4e-3)
    rng = np.random.default_rng(7)
    d = [
        SystemDerivative(*(rng.standard_normal(getattr(system, x).shape) for x in "ABCD"))
        for _ in range(3)
    ]
    u, x0 = rng.standard_normal((2, 300)), rng.standard_normal(6)
    y, dy = simulate_derivative(system, d, u, x0)
    assert np.array_equal(y, simulate(system, u, x0=x0))
    for q, direction in enumerate(d):
        A, B, C, D = (getattr(system, x) + 1e-30j * getattr(direction, x) for x in "ABCD")
        exact = stepped(A, B, C, D, u, x0)[0].imag / 1e-30
        assert np.abs(dy[q] - exact).max() <= 1e-12 * np.abs(exact).max()


def test_settling_time_of_an_exponential():
    t = np.arange(2000) * 1e-3
    y = np.exp(-t / 0.2)
    assert settling_time(t, y, 0.05) == pytest.approx(0.2 * np.log(20), rel=1e-5)
    assert settling_time(t, [y, -0.5 * y], 0.02) == pytest.approx(0.2 * np.log(50), rel=1e-5)
    late = np.where(t < 0.5, 0.0, np.exp(-(t - 0.5) / 0.2))
    assert settling_time(t, late, 0.05, start=0.5) == pytest.approx(0.2 * np.log(20), rel=1e-5)
    assert settling_time(t, np.ones(2000), 0.05) == np.inf
    assert settling_time(t, np.zeros(2000)) == 0.0


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda s: simulate(s, np.zeros((1, 5))), "dt is None"),
        (lambda s: simulate(s, np.zeros((1, 5)), 0.0), "dt is 0"),
        (lambda s: simulate(s, np.zeros((2, 5)), 1e-3), "shape of u"),
        (lambda s: simulate(s, [[np.nan, 0]], 1e-3), r"u\[0, 0\]"),
        (lambda s: simulate(s, np.zeros((1, 5)), 1e-3, [1.0]), "shape of x0"),
        (lambda s: simulate(c2d(s, 1e-3), np.zeros((1, 5)), 2e-3), "own 0.001"),
        (lambda s: sample_polynomial(c2d(s, 1e-3), 1e-3), "continuous"),
        (lambda s: impulse_response(s, 0, 1e-3), "samples is 0"),
        (lambda s: impulse_response(static_gain([[1.0]]), 5, 1e-3), "D is not zero"),
        (lambda s: simulate_piecewise([], []), "at least one"),
        (
            lambda s: simulate_piecewise(
                [c2d(s, 1), static_gain([[1.0]], dt=1.0)], [[[1.0]], [[1.0]]]
            ),
            "number of states",
        ),
        (lambda s: expm_derivative(s.A, np.zeros((3, 3))), "shape of dA"),
        (
            lambda s: held_derivative(s.A, s.B, np.zeros((2, 2, 2)), np.zeros((3, 2, 1)), 1.0),
            "leading axes",
        ),
        (lambda s: settling_time([0.0, 1.0], [1.0, 0.0], 1.5), "band"),
        (lambda s: settling_time([0.0, 1.0], [1.0, 0.0], start=2.0), "start"),
        (lambda s: settling_time([0.0, 1.0], [1.0, 0.0, 2.0]), "shape of y"),
        (lambda s: hermite(np.zeros((1, 3)), np.zeros((1, 2)), 1.0), "slopes"),
    ],
)
def test_bad_input_is_refused(call, message):
    with pytest.raises(InvalidInput, match=message):
        call(oscillator(10.0, 0.1))
