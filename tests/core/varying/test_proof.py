"""Gains proved along every motion of a parameter, against closed forms, the vertex inequality,
norms and motions in time.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from ambrose.annexes.scheduled.varying_proof import VaryingLoop, proved_gain
from ambrose.core.checks import InvalidInput, NumericalFailure
from ambrose.core.matrix_inequalities import Inequality, minimise, svec
from ambrose.core.norms import hinf_norm
from ambrose.core.statespace import StateSpace

ONE = np.zeros(1, int)


def oscillator(share: float, damping: float = 0.2) -> VaryingLoop:
    """q'' + 2 zeta q' + (1 + share delta) q = d, y = q."""
    A = np.array([[0.0, 1.0], [-1.0, -2 * damping]])
    B = np.array([[0.0, 0.0], [-share, 1.0]])
    C = np.array([[1.0, 0.0], [1.0, 0.0]])
    return VaryingLoop(A, B, C, np.zeros((2, 2)), ONE)


def sampled() -> VaryingLoop:
    """An unstable mass on a spring of -(1 + 0.3 delta), held by a sampled PD law with its output
    one sample late.
    """
    A = np.array([[0.0, 1.0], [1.0, 0.0]])
    B = np.array([[0.0, 0.0], [0.3, 1.0]])
    C = np.array([[1.0, 0.0], [1.0, 0.0]])
    dt, fast = 0.05, np.exp(-0.05 / 0.1)
    slope = (1 - fast) / dt  # of a filtered difference quotient
    K_A = np.array([[0.0, 0.0, 0.0], [-slope, fast - 0.0, 0.0], [0.0, 0.0, 0.0]])
    K_A[1] = [-slope, fast, 0.0]  # state: last error, filtered slope, output to come
    K_B = np.array([[1.0], [slope], [3.0 + 2.5 * slope]])
    K_A[2] = [-2.5 * slope, 2.5 * fast, 0.0]
    K = StateSpace(K_A, K_B, [[0.0, 0.0, 1.0]], [[0.0]], dt=dt)
    return VaryingLoop(A, B, C, np.zeros((2, 2)), ONE, K)


def frozen(loop: VaryingLoop) -> float:
    return max(hinf_norm(loop.closed(np.array([delta]))).value for delta in np.linspace(-1, 1, 41))


def quadratic_gain(loop: VaryingLoop) -> float:
    """The smallest gamma for which one X satisfies the bounded-real inequality at both ends (n
    small): an LMI of its own.
    """
    n = len(loop.A)
    i, j = np.triu_indices(n)
    basis = np.zeros((len(i), n, n))
    basis[np.arange(len(i)), i, j] = basis[np.arange(len(i)), j, i] = 1.0
    items = [Inequality(svec(basis).T, -1e-6 * svec(np.eye(n)), 1 + np.arange(len(i)))]
    for delta in (-1.0, 1.0):
        s = loop.closed(np.array([delta]))
        m = s.B.shape[1]
        F = np.zeros((1 + len(i), n + m, n + m))
        F[0, n:, n:] = np.eye(m)
        F[1:, :n, :n] = -(s.A.T @ basis + basis @ s.A)
        F[1:, :n, n:] = -basis @ s.B
        F[1:, n:, :n] = F[1:, :n, n:].swapaxes(1, 2)
        F0 = np.zeros((n + m, n + m))
        F0[:n, :n] = -s.C.T @ s.C
        items.append(Inequality(svec(F).T, svec(F0), np.arange(1 + len(i))))
    found = minimise(np.eye(1 + len(i))[0], items)
    assert found.status == "optimal"
    return float(np.sqrt(found.value))


def test_a_scalar_loop_has_the_gain_of_its_worst_end() -> None:
    """x' = -x + a delta x + d is a positive system: however delta moves its gain is 1/(1 - a)."""
    loop = VaryingLoop(-np.eye(1), np.array([[0.6, 1.0]]), np.ones((2, 1)), np.zeros((2, 2)), ONE)
    assert proved_gain(loop).gamma == pytest.approx(2.5, rel=2e-3)


@pytest.mark.parametrize("share", [0.2, 0.3])
def test_any_motion_is_the_quadratic_gain_of_the_two_ends(share: float) -> None:
    loop = oscillator(share)
    wanted = quadratic_gain(loop)
    assert wanted > 1.05 * frozen(loop)  # else nothing is told apart
    found = proved_gain(loop)
    assert wanted * (1 - 1e-5) <= found.gamma <= 1.005 * wanted
    assert found.slack > 100 * found.rounding


def test_slower_motions_have_smaller_gains_down_to_the_frozen_one() -> None:
    loop = oscillator(0.3)
    rest, poles = frozen(loop), (-0.5, -1.0, -2.0)
    gains = [proved_gain(loop, poles, [rate]).gamma for rate in (1e-3, 0.1)]
    gains.append(proved_gain(loop).gamma)
    assert rest < gains[0] < 1.01 * rest
    assert gains[0] < gains[1] < gains[2]


def motions(rate: float, steps: int, dt: float, rng: np.random.Generator) -> np.ndarray:
    """delta (k, steps): square waves about twice the natural frequency, random telegraphs and
    random walks, within the rate.
    """
    t = np.arange(steps) * dt
    waves = [
        np.sign(np.sin(omega * t + phase)) for omega in (1.0, 1.8, 2.0, 2.2) for phase in (0.0, 1.6)
    ]
    telegraphs = [
        np.sign(np.repeat(rng.normal(size=steps // 20 + 1), 20)[:steps]) for _ in range(12)
    ]
    walks = [np.sin(np.cumsum(rng.normal(size=steps)) * 0.2) for _ in range(12)]
    wanted = np.array([*waves, *telegraphs, *walks])
    if not np.isfinite(rate):
        return wanted
    for k in range(1, steps):
        wanted[:, k] = wanted[:, k - 1] + np.clip(
            wanted[:, k] - wanted[:, k - 1], -rate * dt, rate * dt
        )
    return wanted


def worst_gain_in_time(
    loop: VaryingLoop, deltas: np.ndarray, dt: float, rng: np.random.Generator
) -> float:
    """The largest energy gain along the motions; the disturbance by power iteration with the
    adjoint.
    """
    held = {}
    for delta in np.unique(np.round(deltas, 3)):
        s = loop.closed(np.array([delta]))
        held[delta] = expm(np.block([[s.A, s.B], [np.zeros((1, 3))]]) * dt)[:2]
    E = np.array([[held[delta] for delta in row] for row in np.round(deltas, 3)])
    A, B = E[..., :2], E[..., 2]
    runs, steps = deltas.shape
    d = rng.normal(size=(runs, steps))
    y = np.empty((runs, steps))
    adjoint = np.empty((runs, steps))
    for _ in range(12):
        d /= np.linalg.norm(d, axis=1, keepdims=True)
        x, costate = np.zeros((runs, 2)), np.zeros((runs, 2))
        for k in range(steps):
            x = np.einsum("rij,rj->ri", A[:, k], x) + B[:, k] * d[:, k, None]
            y[:, k] = x[:, 0]
        for k in range(steps - 1, -1, -1):
            costate[:, 0] += y[:, k]
            adjoint[:, k] = np.einsum("ri,ri->r", B[:, k], costate)
            costate = np.einsum("rij,ri->rj", A[:, k], costate)
        d = adjoint.copy()
    return float(np.linalg.norm(y, axis=1).max())


@pytest.mark.parametrize("rate", [np.inf, 0.2])
def test_no_motion_in_time_beats_the_proof(rate: float) -> None:
    """Motions of 60 s; at any rate a square wave at twice the natural frequency beats every frozen
    loop.
    """
    rng = np.random.default_rng(5)
    loop = oscillator(0.3)
    dt = 0.05
    proved = proved_gain(loop, (-0.5, -1.0, -2.0), [rate]).gamma
    found = worst_gain_in_time(loop, motions(rate, 1200, dt, rng), dt, rng)
    assert found <= proved * (1 + 2e-3)  # the sum over steps of 0.05 s is not quite the integral
    if not np.isfinite(rate):
        assert found > 1.2 * frozen(loop)


def test_a_loop_that_a_square_wave_destabilises_is_not_proved() -> None:
    """Frozen it is stable everywhere; a bang-bang stiffness at twice the natural frequency pumps it
    up.
    """
    loop = oscillator(0.8, 0.05)
    Phi = np.eye(2)
    for delta, time in (
        (-1.0, np.pi / (2 * np.sqrt(0.2 - 0.0025))),
        (1.0, np.pi / (2 * np.sqrt(1.8 - 0.0025))),
    ):
        Phi = expm(loop.closed(np.array([delta])).A * time) @ Phi
    assert np.abs(np.linalg.eigvals(Phi)).max() > 1
    with pytest.raises(NumericalFailure, match="no quadratic function"):
        proved_gain(loop)


def test_the_sampled_proof_holds_at_the_ends_by_plain_eigenvalues() -> None:
    """The X of the proof in the discrete bounded-real inequality of the exactly sampled loop,
    pressure by pressure.
    """
    loop = sampled()
    found = proved_gain(loop)
    assert frozen(loop) < found.gamma
    assert np.linalg.eigvalsh(found.X)[0] > 0
    X, size = found.X, 1 / np.sqrt(np.diag(found.X))
    unit = np.r_[size, 1.0]
    for delta in np.linspace(-1, 1, 9):
        s = loop.closed(np.array([delta]))
        M = np.block(
            [
                [s.A.T @ X @ s.A - X + s.C.T @ s.C, s.A.T @ X @ s.B + s.C.T @ s.D],
                [s.B.T @ X @ s.A + s.D.T @ s.C, s.B.T @ X @ s.B + s.D.T @ s.D - found.gamma**2],
            ]
        )
        assert np.linalg.eigvalsh(unit[:, None] * M * unit)[-1] < 0


def test_the_sampled_proof_needs_its_gamma() -> None:
    """Below the frozen worst case there is no proof, and the one found is not far above the
    discrete quadratic gain.
    """
    loop = sampled()
    slow = proved_gain(loop, (-0.5, -2.0, -8.0), [1e-3]).gamma
    assert frozen(loop) <= slow < 1.03 * frozen(loop)


def test_units_do_not_matter() -> None:
    loop = oscillator(0.3)
    T = np.diag([1e-6, 1e3])
    other = VaryingLoop(
        np.linalg.solve(T, loop.A @ T), np.linalg.solve(T, loop.B), loop.C @ T, loop.D, ONE
    ).scaled(1e5)
    assert proved_gain(other).gamma == pytest.approx(proved_gain(loop).gamma, rel=1e-3)


def test_two_parameters_and_one_that_stays() -> None:
    """A second, constant parameter of rate zero costs less than one that moves at will."""
    A = np.array([[0.0, 1.0], [-1.0, -0.4]])
    B = np.array([[0.0, 0.0, 0.0], [-0.12, -0.12, 1.0]])
    C = np.array([[1.0, 0.0], [1.0, 0.0], [1.0, 0.0]])
    loop = VaryingLoop(A, B, C, np.zeros((3, 3)), np.array([0, 1]))
    poles = (-0.5, -1.0, -2.0)
    rest = max(
        hinf_norm(loop.closed(np.array([a, b]))).value for a in (-1, 0, 1) for b in (-1, 0, 1)
    )
    stays, moves = proved_gain(loop, poles, [np.inf, 0.0]).gamma, proved_gain(loop).gamma
    assert rest < stays < 0.99 * moves


def test_a_sampled_output_that_holds_the_input_is_refused() -> None:
    loop = sampled()
    with pytest.raises(InvalidInput, match="amplifier a lag"):
        VaryingLoop(loop.A, loop.B, loop.C, np.ones((2, 2)), ONE, loop.controller)
