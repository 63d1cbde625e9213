"""Frequency responses against closed forms, dense solves and python-control; next to poles, and
with bounded memory.
"""

import json
import tracemalloc

import control
import numpy as np
import pytest
import scipy.linalg as sla

from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import (
    FrequencyResponse,
    eigenvectors,
    evaluate,
    frequency_response,
    largest_gain,
    largest_gains,
    peak_near,
    schur_form,
    state_response_at,
    transfer_matrix,
    transfer_matrix_at,
)
from ambrose.core.statespace import StateSpace, rename, transfer_function
from pole_sets import matched


def dense(A, B, C, D, s):
    return np.array([C @ np.linalg.solve(x * np.eye(len(A)) - A, B) + D for x in s])


def random_matrices(seed, n, m, p):
    rng = np.random.default_rng(seed)
    return [rng.standard_normal(shape) for shape in ((n, n), (n, m), (p, n), (p, m))]


@pytest.mark.parametrize(
    ("n", "m", "p"),
    [(1, 1, 1), (2, 3, 1), (5, 1, 4), (16, 2, 2), (17, 2, 2), (34, 3, 2), (35, 1, 1), (100, 4, 4)],
)
@pytest.mark.parametrize("kind", ["real", "complex"])
def test_against_dense_solves(n, m, p, kind):
    A, B, C, D = random_matrices(n, n, m, p)
    if kind == "complex":
        A = A + 1j * random_matrices(n + 1, n, m, p)[0]
    s = np.concatenate([1j * np.linspace(-8, 8, 31), [3.0 + 0j, -0.7 + 0.2j]])
    expected = dense(A, B, C, D, s)
    error = np.abs(transfer_matrix(A, B, C, D, s) - expected).max() / np.abs(expected).max()
    assert error < 1e-12
    form = schur_form(A, B, C, D)
    expected = np.linalg.eigvals(A)
    np.testing.assert_allclose(matched(form.poles, expected), expected, atol=1e-10)
    # the prepared form is the same computation
    assert np.array_equal(evaluate(form, s), transfer_matrix(A, B, C, D, s))


@pytest.mark.parametrize(("n", "m", "p"), [(1, 1, 1), (17, 2, 5), (34, 5, 2), (100, 4, 4)])
@pytest.mark.parametrize("kind", ["real", "complex"])
def test_partial_fractions_are_the_same_response(n, m, p, kind):
    A, B, C, D = random_matrices(n, n, m, p)
    if kind == "complex":
        A = A + 1j * random_matrices(n + 1, n, m, p)[0]
    s = np.concatenate([1j * np.linspace(-8, 8, 31), [3.0 + 0j]])
    form = schur_form(A, B, C, D, expand=True)
    assert form.expansion is not None
    expected = evaluate(schur_form(A, B, C, D), s)
    assert np.abs(evaluate(form, s) - expected).max() < 1e-11 * np.abs(expected).max()
    with pytest.raises(InvalidInput, match="is a pole"):
        evaluate(
            schur_form(np.diag([1j, -1j]), np.eye(2), np.eye(2), np.zeros((2, 2)), expand=True),
            np.array([2j, 1j]),
        )


@pytest.mark.parametrize("distance", [0.0, 1e-9, 1e-6])
def test_poles_without_eigenvectors_of_their_own_stay_in_schur_form(distance):
    A = np.array([[-1.0, 1.0], [0.0, -1.0 - distance]])
    form = schur_form(A, np.eye(2), np.eye(2), np.zeros((2, 2)), expand=True)
    assert form.expansion is None
    assert evaluate(form, np.array([1j]))[0, 0, 1] == pytest.approx(
        1 / ((1j + 1) * (1j + 1 + distance)), rel=1e-12
    )


@pytest.mark.parametrize("shape", [(4, 4), (2, 7), (9, 3), (5, 1), (1, 5), (1, 1)])
@pytest.mark.parametrize("scale", [1.0, 1e-170, 1e170])
def test_largest_gain_is_the_largest_singular_value(shape, scale):
    rng = np.random.default_rng(3)
    values = scale * (
        rng.standard_normal((2, 30, *shape)) + 1j * rng.standard_normal((2, 30, *shape))
    )
    values[0, 0] = 0.0
    values[1, :, 1:] *= 1e-9  # the others far below it
    np.testing.assert_allclose(
        largest_gain(values), np.linalg.norm(values, 2, axis=(-2, -1)), rtol=1e-14
    )
    assert largest_gain(values[:, :0]).shape == (2, 0)
    for axis in (0, 1):
        found = largest_gains(values, axis)
        wanted = np.linalg.norm(values, 2, axis=(-2, -1)).max(axis=axis)
        np.testing.assert_allclose(found.max(axis=axis), wanted, rtol=1e-14)
        assert (found <= np.linalg.norm(values, 2, axis=(-2, -1)) * (1 + 1e-12)).all()


@pytest.mark.parametrize("damping", [1e-5, 0.01, 0.5])
def test_a_peak_is_found_to_the_last_digits(damping):
    """1/|1 - x^2 + 2 j d x| is largest at x^2 = 1 - 2 d^2, with 1/(2 d sqrt(1 - d^2)); a gain that
    rises to the end of its grid is largest there.
    """
    grid = np.unique([*np.geomspace(0.01, 100, 50), *(1 + damping * np.linspace(-3, 3, 7))])
    at, value = peak_near(lambda x: 1 / np.abs(1 - x**2 + 2j * damping * x), grid)
    assert value == pytest.approx(1 / (2 * damping * np.sqrt(1 - damping**2)), rel=1e-10)
    assert at == pytest.approx(np.sqrt(1 - 2 * damping**2), rel=1e-4)
    assert peak_near(lambda x: x, grid) == (grid[-1], grid[-1])


@pytest.mark.parametrize(("n", "m", "p"), [(0, 2, 3), (3, 0, 2), (3, 2, 0)])
def test_empty_sides(n, m, p):
    A, B, C, D = random_matrices(0, n, m, p)
    assert transfer_matrix(A, B, C, D, np.array([1j, 2j])).shape == (2, p, m)
    assert transfer_matrix(A, B, C, D, np.array([])).shape == (0, p, m)


def test_defective_poles():
    """A Jordan block has one eigenvector: a diagonalisation would be useless, the Schur form is
    exact.
    """
    n = 6
    A = -np.eye(n) + np.eye(n, k=1)
    omega = np.array([0.0, 0.5, 2.0, 30.0])
    values = frequency_response(
        StateSpace(A, np.eye(n)[:, -1:], np.eye(n), np.zeros((n, 1))), omega
    ).values[:, :, 0]
    expected = (1 / (1j * omega + 1))[:, None] ** np.arange(n, 0, -1)
    np.testing.assert_allclose(values, expected, rtol=1e-12)


@pytest.mark.parametrize("zeta", [1e-2, 1e-6, 1e-9])
@pytest.mark.parametrize("omega_0", [1e-6, 1.0, 3e6])
def test_lightly_damped_resonance(zeta, omega_0):
    system = transfer_function([omega_0**2], [1, 2 * zeta * omega_0, omega_0**2])
    omega = omega_0 * np.array([0.0, 0.5, 1 - zeta, 1.0, 1 + 3 * zeta, 10.0])
    exact = 1 / (1 - (omega / omega_0) ** 2 + 2j * zeta * omega / omega_0)
    np.testing.assert_allclose(
        frequency_response(system, omega).values[:, 0, 0], exact, rtol=4e-16 / zeta + 1e-13
    )


def exact_resonance():
    """An oscillator with zeta = 2^-20 hidden behind an integer transformation: every entry is a
    float exactly.
    """
    zeta = 2.0**-20
    A = np.zeros((4, 4))
    A[:2, :2], A[2:, 2:] = [[-zeta, 1], [-1, -zeta]], [[-3, 1], [0, -5]]
    T = np.array([[1, 2, 0, 3], [0, 1, 4, 1], [0, 0, 1, 5], [0, 0, 0, 1.0]])
    inverse = np.round(np.linalg.inv(T))
    assert np.array_equal(inverse @ T, np.eye(4))
    return inverse @ A @ T, inverse @ np.eye(4)[:, :1], np.eye(4)[:1] @ T, np.zeros((1, 1)), zeta


def test_the_exact_evaluation_is_exact():
    A, B, C, D, zeta = exact_resonance()
    for x in (1.0, 1 + zeta, 1 - zeta / 2, 0.3):
        truth = (1j * x + zeta) / ((1j * x + zeta) ** 2 + 1)
        assert abs(transfer_matrix_at(A, B, C, D, 1j * x)[0, 0] / truth - 1) < 1e-12
        assert abs(transfer_matrix(A, B, C, D, np.array([1j * x]))[0, 0, 0] / truth - 1) < 1e-7
    X, rcond = state_response_at(A, B, 1j)
    np.testing.assert_allclose((1j * np.eye(4) - A) @ X, B, atol=1e-9)
    assert 1e-8 < rcond < 1e-4


@pytest.mark.parametrize("hidden", [False, True])
@pytest.mark.parametrize(
    "A",
    [
        [[0.0]],
        [[0, 1], [0, 0]],
        [[-1, 1, 0], [0, 0, 1], [0, 0, 0]],
        [[0, 2], [-2, 0]],
        np.diag([-1e6, 0.0]),
    ],
)
def test_a_pole_is_refused_and_beside_it_is_not(A, hidden):
    """Integrators keep a residue of rounding in the Schur form; a gain of 1e16 must not be returned
    for infinity.
    """
    A = np.array(A, float)
    n = len(A)
    at = np.abs(np.linalg.eigvals(A).imag).max()
    if hidden:
        T = np.random.default_rng(3).standard_normal((n, n))
        A = np.linalg.solve(T, A @ T)
    B = np.ones((n, 1))
    C = np.ones((1, n))
    D = np.zeros((1, 1))
    with pytest.raises(InvalidInput, match="is a pole of the system; evaluate beside it"):
        frequency_response(StateSpace(A, B, C, D), [5.0, at])
    s = np.array([1j * (at + 1e-3)])
    np.testing.assert_allclose(
        frequency_response(StateSpace(A, B, C, D), s.imag).values, dense(A, B, C, D, s), rtol=1e-7
    )


def test_graded_systems_keep_every_scale():
    """Poles over 18 decades, decoupled: each channel is a first-order lag, also at omega = 0."""
    poles = -np.logspace(-9, 9, 7)
    system = StateSpace(np.diag(poles), np.eye(7), np.eye(7), np.zeros((7, 7)))
    omega = np.concatenate([[0.0], np.logspace(-10, 10, 21)])
    values = frequency_response(system, omega).values
    expected = np.zeros_like(values)
    expected[:, range(7), range(7)] = 1 / (1j * omega[:, None] - poles)
    np.testing.assert_allclose(values, expected, rtol=1e-13, atol=0)


def test_state_scaling_does_not_matter():
    A, B, C, D = random_matrices(5, 8, 2, 2)
    t = 10.0 ** np.arange(-12, 12, 3)
    s = 1j * np.linspace(0, 5, 11)
    scaled = transfer_matrix(A * t / t[:, None], B / t[:, None], C * t, D, s)
    np.testing.assert_allclose(scaled, dense(A, B, C, D, s), rtol=1e-10)


def test_sampled_and_nyquist():
    dt, a = 2e-3, 0.7
    system = StateSpace([[a]], [[1]], [[2]], [[0.5]], dt=dt)
    omega = np.linspace(-np.pi / dt, np.pi / dt, 9)
    expected = 2 / (np.exp(1j * omega * dt) - a) + 0.5
    np.testing.assert_allclose(
        frequency_response(system, omega).values[:, 0, 0], expected, rtol=1e-13
    )
    with pytest.raises(
        InvalidInput,
        match=r"highest frequency is 1600 rad/s, but must be at most the Nyquist frequency 1570.8",
    ):
        frequency_response(system, [1600.0])
    with pytest.raises(InvalidInput, match="is a pole"):
        frequency_response(StateSpace([[1.0]], [[1]], [[2]], [[0]], dt=dt), [0.0])


@pytest.mark.parametrize("bad", [5.0, [[1.0]], [np.nan], [1j], ["1"]])
def test_bad_frequencies(bad):
    with pytest.raises(InvalidInput):
        frequency_response(StateSpace(-1, 1, 1, 0), bad)


def test_python_control_agrees():
    A, B, C, D = random_matrices(8, 12, 3, 2)
    A = A - 6 * np.eye(12)
    omega = np.logspace(-1, 2, 20)
    theirs = control.frequency_response(
        control.ss(A, B, C, D), omega, squeeze=False
    ).complex.transpose(2, 0, 1)
    np.testing.assert_allclose(
        frequency_response(control.ss(A, B, C, D), omega).values, theirs, rtol=1e-10
    )


class TestFrequencyResponse:
    def test_select_by_name_and_singular_values(self):
        A, B, C, D = random_matrices(9, 4, 3, 2)
        system = rename(StateSpace(A, B, C, D), ["a", "b", "c"], ["x", "y"])
        response = frequency_response(system, [0.5, 1.0, 2.0])
        assert np.array_equal(response.select("c", ["y", "x"]).values, response.values[:, ::-1, 2:])
        assert response.select("c").inputs == ("c",) and response.select("c").outputs == ("x", "y")
        expected = [sla.svdvals(value)[0] for value in response.values]
        np.testing.assert_allclose(response.max_singular_value(), expected, rtol=1e-13)
        with pytest.raises(InvalidInput, match="input 'q' is not a signal"):
            response.select("q")

    def test_shape_is_checked(self):
        with pytest.raises(InvalidInput, match="shape of values"):
            FrequencyResponse(np.zeros((3, 2, 2)), np.zeros(4), ("a", "b"), ("x", "y"))

    def test_it_shows_itself(self):
        system = rename(StateSpace(*random_matrices(1, 3, 2, 1)), ["a", "b"], ["y"])
        response = frequency_response(system, [0.5, 2.0])
        assert repr(response).startswith(
            "FrequencyResponse(frequencies=2, range=0.5 to 2 rad/s, peak="
        )
        assert json.loads(json.dumps(response.to_dict()))["imag"] == response.values.imag.tolist()
        stack = FrequencyResponse(
            np.stack([response.values, 2 * response.values]), response.omega, ("a", "b"), ("y",)
        )
        assert stack.max_singular_value().shape == (2, 2)
        assert np.array_equal(stack.select("b").values, stack.values[..., 1:])
        with pytest.raises(InvalidInput, match="take one system"):
            stack.to_frame()

    def test_frame(self):
        pytest.importorskip("pandas")
        system = rename(StateSpace(*random_matrices(1, 3, 2, 1)), ["a", "b"], ["y"])
        frame = frequency_response(system, [0.5, 2.0]).to_frame()
        assert frame.loc[2.0, "y / b"] == frequency_response(system, [2.0]).values[0, 0, 1]


def test_memory_is_bounded():
    """4 x 4 channels of 100 states at 30,000 frequencies: all states at once would take 192 MB, the
    answer itself 7.7 MB.
    """
    A, B, C, D = random_matrices(10, 100, 4, 4)
    omega = np.linspace(0.0, 50.0, 30_000)
    system = StateSpace(A - 12 * np.eye(100), B, C, D)
    tracemalloc.start()
    frequency_response(system, omega)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 130e6


@pytest.mark.parametrize("kind", ["real", "complex", "real poles"])
def test_left_and_right_eigenvectors(kind):
    rng = np.random.default_rng(7)
    A = rng.standard_normal((9, 9)) + (1j * rng.standard_normal((9, 9)) if kind == "complex" else 0)
    A = A + A.T if kind == "real poles" else A
    poles, right, left = eigenvectors(A)
    np.testing.assert_allclose(left @ right, np.eye(9), atol=1e-12)
    np.testing.assert_allclose(left @ A @ right, np.diag(poles), atol=1e-12)
