"""The H-infinity norm against closed forms, invariants, and a search that knows nothing of
Hamiltonian matrices.
"""

import control
import numpy as np
import pytest
import scipy.optimize
from hypothesis import given, settings, strategies as st

from ambrose.core import norms
from ambrose.core.checks import InvalidInput, UnstableSystem
from ambrose.core.norms import HinfNorm, hinf_norm
from ambrose.core.sampling import c2d
from ambrose.core.statespace import (
    StateSpace,
    append,
    poles,
    rename,
    static_gain,
    transfer_function,
)
from random_systems import KINDS, random_system


def gain(system, omega):
    """The largest singular value at omega, by a solve that is refined with residuals in extended
    precision.
    """
    s = 1j * omega if system.dt is None else np.exp(1j * omega * system.dt)
    matrix = s * np.eye(system.n_states) - system.A
    X = np.linalg.solve(matrix, system.B.astype(complex))
    for _ in range(2):
        X = X + np.linalg.solve(
            matrix, (system.B - matrix.astype(np.clongdouble) @ X).astype(complex)
        )
    return np.linalg.norm(system.C @ X + system.D, 2)


def search(system):
    """The oracle: a grid that is dense around every pole, then bounded minimisation between
    neighbours of the best points.
    """
    p = poles(system).astype(complex)
    if system.dt is not None:
        p = np.log(np.where(p == 0, 1e-30, p)) / system.dt
    end = np.inf if system.dt is None else np.pi / system.dt
    spread = np.array([0, 0.2, 0.5, 1, 2, 4, 10, 30])
    width = np.abs(p.real)[:, None] * np.concatenate([-spread[1:], spread])
    grid = np.concatenate(
        [(np.abs(p.imag)[:, None] + width).ravel(), np.abs(p) * 0.999, np.abs(p) * 1.3, [0.0]]
    )
    scale = np.abs(p[np.abs(p) > 0])
    grid = np.concatenate([grid, np.geomspace(scale.min() / 100, min(scale.max() * 100, end), 150)])
    grid = np.unique(np.clip(grid[grid >= 0], 0, end))
    s = 1j * grid if system.dt is None else np.exp(1j * grid * system.dt)
    values = [
        np.linalg.norm(
            system.C @ np.linalg.solve(x * np.eye(len(p)) - system.A, system.B) + system.D, 2
        )
        for x in s
    ]
    best = max(
        (np.linalg.norm(system.D, 2), np.inf) if system.dt is None else (0.0, 0.0),
        (max(values), grid[np.argmax(values)]),
    )
    for i in np.argsort(values)[-8:]:
        low, high = grid[max(i - 1, 0)], grid[min(i + 1, len(grid) - 1)]
        found = scipy.optimize.minimize_scalar(
            lambda x: -gain(system, x),
            bounds=(low, high),
            method="bounded",
            options={"xatol": 1e-7 * (high - low)},
        )
        best = max(best, (-found.fun, found.x))
    return best


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", [100, *(seed for seed in (101, 102))])
def test_random_systems_against_a_search(kind, seed):
    A, B, C, D, dt = random_system(kind, seed)
    system = StateSpace(A, B, C, D, dt=dt)
    norm = hinf_norm(system)
    value, _ = search(system)
    assert norm.value == pytest.approx(value, rel=1e-6)
    assert norm.value <= norm.upper <= norm.value * (1 + 1.1e-6)
    if np.isfinite(norm.frequency):
        # the value is attained
        assert gain(system, norm.frequency) == pytest.approx(norm.value, rel=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_bisection_alone_finds_the_peak(kind, monkeypatch):
    """Started from one useless frequency, and without the climb to the local maximum, only the
    Hamiltonian can help.
    """
    A, B, C, D, dt = random_system(kind, 200)
    system = StateSpace(A, B, C, D, dt=dt)
    expected = hinf_norm(system)
    monkeypatch.setattr(norms, "_seeds", lambda problem: np.array([0.7]))
    monkeypatch.setattr(
        norms, "_zoom", lambda problem, centre, gains, *_: (centre, np.zeros(len(centre)), gains)
    )
    found = hinf_norm(system)
    assert found.value == pytest.approx(expected.value, rel=1e-6)
    assert found.steps > 1 or found.frequency in {0.0, np.inf}


@pytest.mark.parametrize("kind", KINDS)
def test_partial_fractions_and_schur_form_agree_to_the_tolerance(kind, monkeypatch):
    A, B, C, D, dt = random_system(kind, 300)
    system = StateSpace(A, B, C, D, dt=dt)
    fast = hinf_norm(system)
    monkeypatch.setattr(norms, "_EXPANDED", np.inf)
    safe = hinf_norm(system)
    assert fast.value <= safe.upper * (1 + 1e-12) and safe.value <= fast.upper * (1 + 1e-12)


class TestClosedForms:
    @pytest.mark.parametrize("zeta", [0.5, 0.1, 1e-3, 1e-6, 1e-8])
    @pytest.mark.parametrize("omega", [1e-5, 1.0, 1e6])
    def test_resonance(self, zeta, omega):
        norm = hinf_norm(transfer_function([omega**2], [1, 2 * zeta * omega, omega**2]))
        assert norm.value == pytest.approx(
            1 / (2 * zeta * np.sqrt(1 - zeta**2)), rel=3e-16 / zeta + 1e-11
        )
        assert norm.frequency == pytest.approx(
            omega * np.sqrt(1 - 2 * zeta**2), rel=1e-5 * min(zeta, 1) + 1e-14
        )

    @pytest.mark.parametrize(
        ("num", "den", "value", "frequency"),
        [
            ([1], [1, 4], 0.25, 0.0),
            ([1, 0], [1, 4], 1.0, np.inf),
            ([3, 1], [1, 4], 3.0, np.inf),
            ([-1, 4], [1, 4], 1.0, None),
            ([1, 0], [1, 2, 100], 0.5, 10.0),
            ([1, 0.02, 1], [1, 2, 1], 1.0, None),
            ([5], [2], 2.5, None),
            ([0], [1, 1], 0.0, None),
        ],
    )
    def test_simple(self, num, den, value, frequency):
        norm = hinf_norm(transfer_function(num, den))
        assert norm.value == pytest.approx(value, rel=1e-12, abs=1e-300)
        assert frequency is None or norm.frequency == pytest.approx(frequency, abs=1e-4)

    @pytest.mark.parametrize(
        ("a", "frequency"),
        [(0.5, 0.0), (-0.5, np.pi / 0.01), (-1 + 1e-9, np.pi / 0.01), (1 - 1e-9, 0.0), (0.0, None)],
    )
    def test_sampled_first_order(self, a, frequency):
        norm = hinf_norm(StateSpace([[a]], [[1]], [[1]], [[0]], dt=0.01))
        assert norm.value == pytest.approx(1 / (1 - abs(a)), rel=1e-6)
        assert frequency is None or norm.frequency == pytest.approx(frequency, abs=1e-3)

    def test_poles_at_both_ends_and_between(self):
        """Poles at +1, -1 and on the circle between, 1e-7 inside: the bilinear map has to be turned
        away from all of them.
        """
        r = 1 - 1e-7
        A = np.diag([r, -r, 0, 0])
        A[2:, 2:] = r * np.array([[0, 1], [-1, 0]])
        system = StateSpace(
            A, np.ones((4, 1)), np.diag([1, 2, 3, 0.0])[:3], np.zeros((3, 1)), dt=1.0
        )
        norm = hinf_norm(system)
        assert norm.value == pytest.approx(
            search(system)[0], rel=1e-6
        ) and norm.frequency == pytest.approx(np.pi / 2, abs=1e-6)

    def test_many_hidden_resonances(self):
        """50 decoupled modes behind an orthogonal transformation: the norm is the largest of 50
        closed forms.
        """
        rng = np.random.default_rng(3)
        omega, zeta = 10 ** rng.uniform(0, 3, 50), 10 ** rng.uniform(-6, -1, 50)
        modes = append(
            *(
                rename(transfer_function([w**2], [1, 2 * z * w, w**2]), [f"u{i}"], [f"y{i}"])
                for i, (w, z) in enumerate(zip(omega, zeta, strict=True))
            )
        )
        Q = np.linalg.qr(rng.standard_normal((100, 100)))[0]
        norm = hinf_norm(StateSpace(Q @ modes.A @ Q.T, Q @ modes.B, modes.C @ Q.T, modes.D))
        peaks = 1 / (2 * zeta * np.sqrt(1 - zeta**2))
        assert norm.value == pytest.approx(peaks.max(), rel=1e-6)
        assert norm.frequency == pytest.approx(omega[np.argmax(peaks)], rel=1e-6)

    def test_two_peaks_that_differ_by_less_than_they_are_wide(self):
        """Peaks of 1 and 1 + 1e-5: the higher one counts, wherever it stands."""
        for higher in (0, 1):
            factors = [1.0, 1.0]
            factors[higher] += 1e-5
            modes = [
                transfer_function(
                    [f * 2 * 1e-4 * w, 0], [1, 2 * 1e-4 * w, w**2], f"u{w:g}", f"y{w:g}"
                )
                for f, w in zip(factors, (1.0, 1.001), strict=True)
            ]
            norm = hinf_norm(append(*modes))
            assert norm.value == pytest.approx(1 + 1e-5, rel=1e-9)
            assert norm.frequency == pytest.approx((1.0, 1.001)[higher], rel=1e-8)


class TestInvariants:
    @given(
        seed=st.integers(0, 10**6),
        kind=st.sampled_from(KINDS),
        factor=st.sampled_from([1e-9, 1.0, 1e9]),
    )
    @settings(max_examples=25, deadline=None)
    def test_gain_time_and_direction(self, seed, kind, factor):
        """Scaling the output scales the norm; scaling time scales the frequency; the transposed
        system has the same norm.
        """
        A, B, C, D, dt = random_system(kind, seed)
        norm = hinf_norm(StateSpace(A, B, C, D, dt=dt)).value
        assert hinf_norm(StateSpace(A, B, factor * C, factor * D, dt=dt)).value == pytest.approx(
            factor * norm, rel=2e-6
        )
        assert hinf_norm(StateSpace(A.T, C.T, B.T, D.T, dt=dt)).value == pytest.approx(
            norm, rel=2e-6
        )
        if dt is None:
            assert hinf_norm(StateSpace(factor * A, factor * B, C, D)).value == pytest.approx(
                norm, rel=2e-6
            )

    @pytest.mark.parametrize("seed", range(5))
    def test_tustin_keeps_the_norm(self, seed):
        system = StateSpace(*random_system("plain", seed)[:4])
        T = 0.05
        norm, sampled = hinf_norm(system), hinf_norm(c2d(system, T, "tustin"))
        assert sampled.value == pytest.approx(norm.value, rel=2e-6)
        assert 2 / T * np.tan(sampled.frequency * T / 2) == pytest.approx(
            norm.frequency, rel=1e-3, abs=1e-3
        )

    @pytest.mark.parametrize("tolerance", [1e-2, 1e-4, 1e-9, 1e-15])
    def test_tolerance_bounds_the_answer(self, tolerance):
        system = StateSpace(*random_system("light", 3)[:4])
        exact = search(system)[0]
        norm = hinf_norm(system, tolerance)
        assert norm.value <= exact * (1 + 1e-9) and norm.upper >= exact * (1 - 1e-9)
        assert norm.upper / norm.value <= 1 + max(tolerance, 1e-12) + 1e-8


class TestUnstable:
    @pytest.mark.parametrize("A", [[[1.0]], [[0.0]], [[0.0, 5], [-5, 0]], [[0.0, 1], [0, 0]]])
    @pytest.mark.parametrize("dt", [None, 0.1])
    def test_refused_by_default(self, A, dt):
        # forward Euler: on or outside the circle
        A = np.array(A) if dt is None else np.eye(len(A)) + dt * np.array(A)
        n = len(A)
        with pytest.raises(
            UnstableSystem, match=r"not inside the stability region.*allow_unstable=True"
        ):
            hinf_norm(StateSpace(A, np.ones((n, 1)), np.ones((1, n)), [[0]], dt=dt))

    def test_marginal_after_rounding(self):
        T = np.random.default_rng(0).standard_normal((3, 3))
        A = np.linalg.solve(T, np.array([[0, 5, 0], [-5, 0, 0], [0, 0, -1.0]]) @ T)
        with pytest.raises(UnstableSystem):
            hinf_norm(StateSpace(A, np.ones((3, 1)), np.ones((1, 3)), [[0]]))

    def test_l_infinity(self):
        assert hinf_norm(StateSpace(1, 1, 1, 0), allow_unstable=True).value == pytest.approx(
            1.0, rel=1e-12
        )
        assert hinf_norm(
            StateSpace([[-4.0]], [[1]], [[1]], [[0]], dt=0.1), allow_unstable=True
        ).value == pytest.approx(1 / 3)
        A, B, C, D, _ = random_system("plain", 7)
        system = StateSpace(A + 2 * np.eye(len(A)), B, C, D)
        assert poles(system).real.max() > 0.5
        assert hinf_norm(system, allow_unstable=True).value == pytest.approx(
            search(system)[0], rel=1e-6
        )

    @pytest.mark.parametrize(
        ("A", "dt", "frequency"),
        [
            ([[0.0]], None, 0.0),
            ([[0.0, 5], [-5, 0]], None, 5.0),
            ([[0, 1.0], [-1, 0]], 0.1, np.pi / 0.2),
        ],
    )
    def test_poles_on_the_boundary_are_infinite(self, A, dt, frequency):
        n = len(A)
        norm = hinf_norm(
            StateSpace(A, np.ones((n, 1)), np.ones((1, n)), [[0]], dt=dt), allow_unstable=True
        )
        assert norm.value == np.inf and norm.frequency == pytest.approx(frequency)


class TestEdges:
    def test_no_signals_no_states(self):
        assert hinf_norm(
            StateSpace(-np.eye(2), np.zeros((2, 0)), np.ones((1, 2)), np.zeros((1, 0)))
        ) == HinfNorm(0.0, 0.0, 0.0, 0)
        assert hinf_norm(static_gain([[3.0, 4.0]])).value == 5.0

    @pytest.mark.parametrize("dt", [None, 0.1])
    def test_zero_systems(self, dt):
        A = np.diag([-0.5, 0.25]) if dt else np.diag([-1.0, -2.0])
        assert hinf_norm(StateSpace(A, [[0], [0]], [[1, 1]], [[0]], dt=dt)).value == 0.0
        assert hinf_norm(StateSpace(A, [[1], [0]], [[0, 1]], [[0]], dt=dt)).value == 0.0
        T = np.array([[1.0, 0.3], [0.2, 1.0]])
        hidden = StateSpace(
            np.linalg.solve(T, A @ T),
            np.linalg.solve(T, [[1], [0]]),
            np.array([[0, 1]]) @ T,
            [[0]],
            dt=dt,
        )
        assert hinf_norm(hidden).upper < 1e-14

    def test_python_control_systems(self):
        assert hinf_norm(control.ss([[-2.0]], [[1.0]], [[1.0]], [[0.0]])).value == pytest.approx(
            0.5
        )

    @pytest.mark.parametrize("tolerance", [0.0, -1e-6, np.nan])
    def test_bad_tolerance(self, tolerance):
        with pytest.raises(InvalidInput, match="tolerance"):
            hinf_norm(static_gain([[1.0]]), tolerance)
