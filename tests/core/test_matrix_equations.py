"""Matrix equations against closed forms, scipy, quadrature, and their own defining equations."""

import numpy as np
import pytest
import scipy.linalg as sla
from hypothesis import given, settings, strategies as st

from ambrose.core.checks import InvalidInput, NumericalFailure, UnstableSystem
from ambrose.core.frequency import frequency_response
from ambrose.core.matrix_equations import (
    balanced_realization,
    controllability_gramian,
    discrete_lyapunov,
    lyapunov,
    observability_gramian,
    solve_riccati,
)
from ambrose.core.statespace import StateSpace, poles, static_gain
from pole_sets import matched


def stable(seed, n, dt=None):
    A = np.random.default_rng(seed).standard_normal((n, n))
    if dt is None:
        return A - (np.linalg.eigvals(A).real.max() + 0.1) * np.eye(n)
    return A / (1.05 * np.abs(np.linalg.eigvals(A)).max())


def stable_system(seed, n=6, m=2, p=3, dt=None):
    rng = np.random.default_rng(seed + 1000)
    D = np.zeros((p, m))
    return StateSpace(
        stable(seed, n, dt), rng.standard_normal((n, m)), rng.standard_normal((p, n)), D, dt=dt
    )


def scales(n):
    return 10.0 ** np.linspace(-9, 9, n)[np.random.default_rng(n).permutation(n)]


class TestLyapunov:
    @pytest.mark.parametrize("n", [1, 2, 5, 40])
    @pytest.mark.parametrize("symmetric", [True, False])
    def test_against_scipy(self, n, symmetric):
        Q = np.random.default_rng(n).standard_normal((n, n))
        Q = Q @ Q.T if symmetric else Q
        X, Y = lyapunov(stable(n, n), Q), discrete_lyapunov(stable(n, n, 1.0), Q)
        np.testing.assert_allclose(
            X,
            sla.solve_continuous_lyapunov(stable(n, n), -Q),
            rtol=1e-9,
            atol=1e-11 * np.abs(X).max(),
        )
        expected = sla.solve_discrete_lyapunov(stable(n, n, 1.0), Q, method="bilinear")
        np.testing.assert_allclose(Y, expected, rtol=1e-9, atol=1e-11 * np.abs(Y).max())
        assert not symmetric or (np.array_equal(X, X.T) and np.array_equal(Y, Y.T))

    def test_neither_stability_nor_states_are_needed(self):
        A = np.diag([3.0, -1.0, 0.5])
        X = lyapunov(A, np.ones((3, 3)))
        np.testing.assert_allclose(X, -1 / (np.diag(A)[:, None] + np.diag(A)), rtol=1e-14)
        assert lyapunov(np.zeros((0, 0)), np.zeros((0, 0))).shape == (0, 0)

    @pytest.mark.parametrize("solve", [lyapunov, discrete_lyapunov])
    def test_badly_scaled_states(self, solve):
        A, t = stable(3, 7, 1.0), scales(7)
        A = A - 2 * np.eye(7) if solve is lyapunov else A
        plain = solve(A, np.eye(7))
        scaled = solve(A * t / t[:, None], np.diag(t**-2.0))
        np.testing.assert_allclose(scaled * t[:, None] * t, plain, rtol=1e-10, atol=1e-12)

    @pytest.mark.parametrize(
        ("solve", "A", "message"),
        [
            (lyapunov, [[1.0, 5], [0, -1]], "eigenvalues (1|-1)[^0-9].*with the sum 0"),
            (lyapunov, [[0.0, 3], [-3, 0]], "with the sum 0; remove or shift marginal states"),
            (lyapunov, [[0.0]], "with the sum 0"),
            (discrete_lyapunov, [[2.0, 7], [0, 0.5]], "with the product 1"),
            (discrete_lyapunov, [[0.0, 1], [-1, 0]], "with the product 1"),
        ],
    )
    @pytest.mark.parametrize("hidden", [False, True])
    def test_shared_eigenvalues(self, solve, A, message, hidden):
        A = np.array(A)
        if hidden:
            T = np.random.default_rng(1).standard_normal(A.shape)
            A = np.linalg.solve(T, A @ T)
        with pytest.raises(
            NumericalFailure, match="no unique solution.*" + (message if not hidden else "with the")
        ):
            solve(A, np.eye(len(A)))

    @pytest.mark.parametrize(
        ("A", "Q"), [(np.ones((2, 3)), np.eye(2)), (np.eye(2), np.eye(3)), ([[np.nan]], [[1.0]])]
    )
    def test_refuses(self, A, Q):
        with pytest.raises(InvalidInput):
            lyapunov(A, Q)


class TestRiccati:
    @pytest.mark.parametrize("n", [1, 3, 10, 24])
    def test_lqr_against_scipy(self, n):
        rng = np.random.default_rng(n)
        A = rng.standard_normal((n, n))
        B = rng.standard_normal((n, 2))
        C = rng.standard_normal((2, n))
        solution = solve_riccati(A, B @ B.T, C.T @ C)
        expected = sla.solve_continuous_are(A, B, C.T @ C, np.eye(2))
        np.testing.assert_allclose(
            solution.X, expected, rtol=1e-8, atol=1e-10 * np.abs(expected).max()
        )
        assert (
            solution.solved
            and solution.residual < 1e-12
            and solution.closed_loop_poles.real.max() < 0
        )
        closed = np.linalg.eigvals(A - B @ B.T @ expected)
        found = matched(solution.closed_loop_poles, closed)
        np.testing.assert_allclose(found, closed, rtol=1e-6)

    @pytest.mark.parametrize("seed", [2, 7, 11])
    def test_a_solution_that_spans_ten_decades(self, seed):
        """Scalar equations in hidden orthogonal states: x = (a + sqrt(a^2 + g q))/g, up to 6e10.

        Rounding of A and G alone moves such an X by eps times its condition, some 1e-5 of each
        part; before, it was given up as inaccurate, on some processors only.
        """
        rng = np.random.default_rng(seed)
        U = np.linalg.qr(rng.standard_normal((8, 8)))[0]
        a, q = rng.uniform(0.5, 3, 8), 10 ** rng.uniform(-2, 0, 8)
        g = np.append(1e-10, 10 ** rng.uniform(-10, 0, 7))
        x = (a + np.sqrt(a * a + g * q)) / g
        solution = solve_riccati(U * a @ U.T, U * g @ U.T, U * q @ U.T)
        assert solution.status == "solved"
        parts = U.T @ solution.X @ U / np.sqrt(x) / np.sqrt(x)[:, None]
        assert parts == pytest.approx(np.eye(8), abs=1e-3)

    @pytest.mark.parametrize(
        ("a", "g", "q"),
        [(1.0, 2.0, 3.0), (-2.0, -1.0, 3.0), (-2.0, 0.5, -1.0), (3.0, 1.0, 0.0), (-1, 0, 5)],
    )
    def test_scalar_closed_form_also_indefinite(self, a, g, q):
        """g x^2 - 2 a x - q = 0 with a - g x = -sqrt(a^2 + g q)."""
        root = np.sqrt(a * a + g * q)
        solution = solve_riccati([[a]], [[g]], [[q]])
        assert solution.closed_loop_poles[0].real == pytest.approx(-root, rel=1e-14)
        assert solution.X[0, 0] == pytest.approx((a + root) / g if g else -q / (2 * a), rel=1e-13)

    @pytest.mark.parametrize(
        ("A", "G", "Q", "status"),
        [
            ([[-1.0]], [[-1.0]], [[2.0]], "imaginary-axis eigenvalues"),
            ([[0.0, 1], [-4, 0]], np.zeros((2, 2)), np.eye(2), "imaginary-axis eigenvalues"),
            (
                [[0.0, 1], [-4, 0]],
                np.diag([0, 1.0]),
                np.zeros((2, 2)),
                "imaginary-axis eigenvalues",
            ),
            ([[1.0]], [[0.0]], [[1.0]], "X1 singular"),
            (np.diag([1.0, -2.0]), np.diag([0.0, 1.0]), np.eye(2), "X1 singular"),
        ],
    )
    def test_failure_is_a_status(self, A, G, Q, status):
        solution = solve_riccati(A, G, Q)
        assert solution.status == status and not solution.solved and np.isnan(solution.X).all()

    def test_gamma_flips_the_status_where_theory_says(self):
        """x' = -x + w + u, z = (x, u): a solution exists above gamma = 1/sqrt(2) and not below."""
        for gamma, solved in ((2**-0.5 * (1 + 1e-7), True), (2**-0.5 * (1 - 1e-7), False)):
            assert solve_riccati([[-1.0]], [[1 - gamma**-2]], [[1.0]]).solved is solved

    def test_gamma_iteration_survives_scaling(self):
        """Full-information H-infinity control: the smallest gamma must not depend on the units of
        the states.
        """
        rng = np.random.default_rng(7)
        n, t = 8, scales(8)
        A, B1, B2, C = (rng.standard_normal(shape) for shape in ((n, n), (n, 2), (n, 2), (3, n)))

        def smallest(t):
            a = A * t / t[:, None]
            b1 = B1 / t[:, None]
            b2 = B2 / t[:, None]
            c = C * t
            low, high = 1e-3, 1e3
            while high / low > 1 + 1e-9:
                gamma = np.sqrt(low * high)
                solution = solve_riccati(a, b2 @ b2.T - b1 @ b1.T / gamma**2, c.T @ c)
                good = (
                    solution.solved
                    and np.linalg.eigvalsh(solution.X * t[:, None] ** -1 / t).min() > -1e-9
                )
                low, high = (low, gamma) if good else (gamma, high)
            return high

        assert smallest(t) == pytest.approx(smallest(np.ones(n)), rel=1e-6)

    @pytest.mark.parametrize("pole", [0.03, 0.002, 1e-4])
    def test_slow_weight_poles_beside_fast_dynamics(self, pole):
        """Four uncontrollable weights at 0.002 rad/s and a plant of 1e4 rad/s: the slow eigenvalues
        are lost in the norm.
        """
        rng = np.random.default_rng(8)
        n = 12
        A = np.zeros((n, n))
        A[:8, :8] = 1e4 * rng.standard_normal((8, 8))
        A[8:, :8] = rng.standard_normal((4, 8))
        A[8:, 8:] = -pole * np.eye(4)
        B = np.vstack([1e4 * rng.standard_normal((8, 3)), np.zeros((4, 3))])
        C = np.hstack([rng.standard_normal((5, 8)), np.eye(5, 4)])
        solution = solve_riccati(A, B @ B.T, C.T @ C)
        assert solution.residual < 1e-10
        assert solution.closed_loop_poles.real.max() < 0
        np.testing.assert_allclose(solution.X, solution.X.T)

    @given(seed=st.integers(0, 10**6), n=st.integers(1, 6))
    @settings(max_examples=30, deadline=None)
    def test_solution_solves_and_stabilises(self, seed, n):
        rng = np.random.default_rng(seed)
        A, B, E, C = (rng.standard_normal(shape) for shape in ((n, n), (n, 2), (n, 1), (2, n)))
        G, Q = B @ B.T - 0.05 * E @ E.T, C.T @ C
        solution = solve_riccati(A, G, Q)
        if solution.solved:
            X = solution.X
            assert np.linalg.norm(A.T @ X + X @ A - X @ G @ X + Q) < 1e-7 * (
                1 + np.linalg.norm(X @ G @ X)
            )
            assert np.linalg.eigvals(A - G @ X).real.max() < 1e-9 * (1 + np.linalg.norm(G @ X))

    @pytest.mark.parametrize(
        ("A", "G", "Q", "message"),
        [
            (np.eye(2), np.eye(3), np.eye(2), "shape of G"),
            (np.eye(2), np.eye(2), [[1, 2], [0, 1]], "Q is not symmetric"),
            (np.full((2, 2), np.inf), np.eye(2), np.eye(2), "inf"),
        ],
    )
    def test_refuses(self, A, G, Q, message):
        with pytest.raises(InvalidInput, match=message):
            solve_riccati(A, G, Q)

    def test_no_states(self):
        assert solve_riccati(np.zeros((0, 0)), np.zeros((0, 0)), np.zeros((0, 0))).X.shape == (0, 0)


class TestGramians:
    @pytest.mark.parametrize("dt", [None, 0.1])
    @pytest.mark.parametrize("n", [1, 2, 7, 30])
    def test_defining_equations(self, n, dt):
        s = stable_system(n, n, dt=dt)
        P, Q = controllability_gramian(s), observability_gramian(s)
        if dt is None:
            left, right = s.A @ P + P @ s.A.T, s.A.T @ Q + Q @ s.A
        else:
            left, right = s.A @ P @ s.A.T - P, s.A.T @ Q @ s.A - Q
        np.testing.assert_allclose(
            left, -s.B @ s.B.T, atol=1e-10 * np.abs(P).max() * np.abs(s.A).max()
        )
        np.testing.assert_allclose(
            right, -s.C.T @ s.C, atol=1e-10 * np.abs(Q).max() * np.abs(s.A).max()
        )

    def test_uncontrollable_states_have_exact_zeros(self):
        s = StateSpace(np.diag([-1.0, -2.0, -3.0]), [[1.0], [0.0], [1.0]], np.ones((1, 3)), [[0]])
        P = controllability_gramian(s)
        assert np.array_equal(P[1], np.zeros(3))
        np.testing.assert_allclose(P[[0, 0, 2], [0, 2, 2]], [1 / 2, 1 / 4, 1 / 6], rtol=1e-14)

    @pytest.mark.parametrize(
        ("A", "dt"), [([[0.0]], None), ([[0.0, 3], [-3, 0]], None), ([[1.0]], 0.1), ([[2.0]], 0.1)]
    )
    @pytest.mark.parametrize(
        "function", [controllability_gramian, observability_gramian, balanced_realization]
    )
    def test_unstable(self, function, A, dt):
        n = len(A)
        with pytest.raises(UnstableSystem, match="not inside the stability region"):
            function(StateSpace(A, np.ones((n, 1)), np.ones((1, n)), [[0]], dt=dt))


class TestBalancedRealization:
    @pytest.mark.parametrize("dt", [None, 0.1])
    @pytest.mark.parametrize("scaled", [False, True])
    def test_gramians_are_equal_and_diagonal(self, dt, scaled):
        s = stable_system(5, 8, dt=dt)
        t = scales(8) if scaled else np.ones(8)
        s = StateSpace(
            s.A * t / t[:, None], s.B / t[:, None], s.C * t, np.ones((3, 2)), ["a", "b"], dt=dt
        )
        balanced, hankel, T_L, T_R = balanced_realization(s)
        assert balanced.inputs == ("a", "b") and balanced.dt == dt
        assert (np.diff(hankel) <= 0).all() and len(hankel) == balanced.n_states == 8
        np.testing.assert_allclose(T_L @ T_R, np.eye(8), atol=1e-9)
        for gramian in (controllability_gramian, observability_gramian):
            np.testing.assert_allclose(gramian(balanced), np.diag(hankel), atol=1e-10 * hankel[0])
        omega = np.linspace(0.1, 30, 7)
        before = frequency_response(s, omega).values
        np.testing.assert_allclose(frequency_response(balanced, omega).values, before, rtol=1e-8)

    def test_small_hankel_values_keep_their_digits(self):
        """A = -diag(a), B = C^T = 1: both Gramians are the Cauchy matrix 1/(a_i + a_j), whose
        determinant is known.
        """
        a = np.arange(1.0, 9.0)
        s = StateSpace(-np.diag(a), np.ones((8, 1)), np.ones((1, 8)), [[0]])
        hankel = balanced_realization(s)[1]
        i, j = np.triu_indices(8, 1)
        log_det = 2 * np.log(np.abs(a[i] - a[j])).sum() - np.log(a[:, None] + a).sum()
        assert hankel[-1] < 1e-9 * hankel[0]
        assert np.log(hankel).sum() == pytest.approx(log_det, abs=1e-4)
        assert hankel.sum() == pytest.approx((1 / (2 * a)).sum(), rel=1e-13)

    def test_what_is_not_minimal_is_left_out(self):
        s = StateSpace(np.diag([-1.0, -2.0, -3.0]), [[1.0], [0.0], [1.0]], [[1.0, 1.0, 0.0]], [[0]])
        balanced, hankel, T_L, T_R = balanced_realization(s)
        assert (balanced.n_states, len(hankel), T_L.shape, T_R.shape) == (1, 3, (1, 3), (3, 1))
        assert poles(balanced) == pytest.approx([-1.0]) and hankel[0] == pytest.approx(0.5)
        assert balanced_realization(StateSpace(-1, 0, 1, 2))[0].n_states == 0
        assert balanced_realization(static_gain([[1.0, 2.0]]))[1].shape == (0,)
