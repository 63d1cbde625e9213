"""Proofs of sampled loops with a slow parameter: against norms at rest, and motions in time."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from ambrose.annexes.scheduled.varying_sampled import SampledLoop, proved_sampled
from ambrose.core.checks import NumericalFailure
from ambrose.core.norms import hinf_norm

DT = 0.1
C = np.array([[1.0, 0.0]])


def matrices(p: float) -> np.ndarray:
    """An oscillator of stiffness 1 + 0.4 p, driven by held d, sampled exactly."""
    N = np.array([[0.0, 1.0, 0.0], [-(1 + 0.4 * p), -0.3, 0.3], [0.0, 0.0, 0.0]])
    return expm(N * DT)[:2]


def loop(off: float = 0.0) -> SampledLoop:
    return SampledLoop(matrices, lambda low, high: [np.full((1, 2, 3), off)], C, DT)


@pytest.fixture(autouse=True)
def few_intervals(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ambrose.annexes.scheduled.varying_sampled._FIRST", 12)


def at_rest() -> float:
    return max(hinf_norm(loop().system(p)).value for p in np.linspace(-1, 1, 41))


def test_a_slow_parameter_is_proved_just_above_rest_a_faster_one_higher() -> None:
    rest = at_rest()
    slow, fast = (proved_sampled(loop(), -1.0, 1.0, rate) for rate in (1e-4, 5e-3))
    assert rest < slow.gamma < 1.08 * rest
    assert slow.gamma < fast.gamma < 1.6 * rest
    assert min(slow.slack, fast.slack) > 100 * max(slow.rounding, fast.rounding)
    assert np.linalg.eigvalsh(slow.X)[0] > 0


def test_no_motion_in_time_beats_the_proof() -> None:
    """Triangles and random walks at the rate, each with the disturbance that it amplifies most."""
    rng = np.random.default_rng(3)
    rate, steps = 0.01, 1500
    gamma = proved_sampled(loop(), -1.0, 1.0, rate).gamma
    worst = 0.0
    for wanted in (
        *(np.sign(np.sin(2 * np.pi * np.arange(steps) * DT / T)) for T in (80.0, 150.0)),
        *(np.sign(np.repeat(rng.normal(size=5), 300)) for _ in range(3)),
    ):
        p = np.zeros(steps)
        for k in range(1, steps):
            p[k] = p[k - 1] + np.clip(wanted[k] - p[k - 1], -rate * DT, rate * DT)
        M = np.array([matrices(v) for v in np.round(p, 3)])
        d = rng.normal(size=steps)
        for _ in range(15):
            d /= np.linalg.norm(d)
            x, costate, y = np.zeros(2), np.zeros(2), np.zeros(steps)
            for k in range(steps):
                y[k] = x[0] + d[k]
                x = M[k, :, :2] @ x + M[k, :, 2] * d[k]
            gain, d = np.linalg.norm(y), y.copy()
            for k in range(steps - 1, -1, -1):
                d[k] += M[k, :, 2] @ costate
                costate = M[k, :, :2].T @ costate + C[0] * y[k]
        worst = max(worst, float(gain))
    assert 0.9 * at_rest() < worst < gamma


def test_what_the_loop_may_be_off_costs() -> None:
    exact, off = (proved_sampled(loop(off), -1.0, 1.0, 1e-4) for off in (0.0, 1e-5))
    assert off.gamma > exact.gamma or off.slack < 0.8 * exact.slack


def test_what_has_no_proof_is_said() -> None:
    with pytest.raises(NumericalFailure, match="unstable at rest at -4"):
        proved_sampled(loop(), -4.0, 1.0, 1e-3)
    with pytest.raises(NumericalFailure, match="slower motion"):
        proved_sampled(loop(), -1.0, 1.0, 2.0)
