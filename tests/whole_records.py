"""Oracles: what identification/output_error sums piece by piece, over whole records at once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.fft

from ambrose.core.checks import check_shape
from ambrose.core.response import SystemDerivative, simulate
from ambrose.core.statespace import StateSpace
from ambrose.identification.output_error import statistics
from ambrose.identification.output_error.normal_equations import lift, stream


def lifted_sensitivities(
    system: StateSpace, directions: Sequence[SystemDerivative], u: np.ndarray, x0: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """y (p, k) and dy (q, p, k) of a whole record u (m, k), from the state x0 (n,), which the
    parameters do not change.
    """
    pieces = [
        F.transpose(0, 2, 1, 3).reshape(len(F), F.shape[2], -1)
        for _, F in stream(lift(system, directions), list(u), x0)
    ]
    F = np.concatenate(pieces, axis=2)[:, :, : u.shape[1]]
    return F[0], F[1:]


def simulate_derivative(
    system: StateSpace,
    directions: Sequence[SystemDerivative],
    u: np.ndarray,
    x0: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Outputs y (p, k) of a sampled system and their exact derivatives dy (q, p, k), one augmented
    system per parameter.

    x'[k+1] = A x' + dA x + dB u, y' = C x' + dC x + dD u; the first state x0 (n,) does not depend
    on the parameters.
    """
    n = system.n_states
    x0 = np.zeros(n) if x0 is None else x0
    dy = [
        simulate(
            StateSpace(
                np.block([[system.A, np.zeros((n, n))], [d.A, system.A]]),
                np.vstack([system.B, d.B]),
                np.hstack([d.C, system.C]),
                d.D,
                dt=system.dt,
            ),
            u,
            x0=np.concatenate([x0, np.zeros(n)]),
        )
        for d in directions
    ]
    return simulate(system, u, x0=x0), np.stack(dy)


def sandwich_middle(J: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """sum over t and s of J_t' Gamma(t - s) J_s (q, q), the covariance of J'r under noise of any
    colour.

    J (q, p, k), residual (p, k). Gamma is the residual's autocovariance between all signals,
    tapered by Parzen's window over k/10 samples (4096 at most). White (1980), Newey & West (1987);
    the sums are taken over frequency.
    """
    q, p, k = J.shape
    residual = check_shape(residual, "residual", "(p, k)", p=p, k=k)
    span = statistics.memory(k)
    size = scipy.fft.next_fast_len(k + span, real=True)
    R = scipy.fft.rfft(residual, size, axis=1)
    cross = scipy.fft.irfft(R[:, None] * R[None].conj(), size, axis=2) / k
    taper = np.zeros(size)
    taper[: span + 1] = statistics._parzen(np.arange(span + 1) / span)
    taper[-span:] = taper[span:0:-1]
    density = scipy.fft.rfft(cross * taper, size, axis=2)
    twice = np.full(density.shape[2], 2.0)
    twice[0] = 1.0
    if size % 2 == 0:
        twice[-1] = 1.0
    F = scipy.fft.rfft(J, size, axis=2)
    coloured = (
        np.stack([sum(density[i, j] * F[:, j] for j in range(p)) for i in range(p)], axis=1) * twice
    )
    return np.real(F.conj().reshape(q, -1) @ coloured.reshape(q, -1).T) / size


def fit_percent(measured: np.ndarray, residual: np.ndarray) -> float:
    """100 (1 - |residual|/|measured - mean|) of one signal (k,): 100 is perfect, 0 as good as the
    mean (NRMSE).
    """
    spread = float(np.linalg.norm(measured - measured.mean()))
    return 100.0 * (1.0 - float(np.linalg.norm(residual)) / spread) if spread > 0 else float("nan")


def residual_input_test(
    residual: np.ndarray,
    measured: np.ndarray,
    excitation: np.ndarray,
    lags: int,
    signal: str,
    name: str,
    tests: int = 1,
) -> statistics.ResidualTest:
    """Does the residual (k,) still follow the excitation (k,), 0 to ``lags`` samples later? 99 %
    over all ``tests`` of a run.

    The limit is the normal one with the variance sum_l R_r(l) R_e(l)/k, which allows for the colour
    of both; Ljung (1999), section 16.6. A residual below 1e-7 of the signal counts as none.
    """
    k = len(residual)
    r, e = residual - residual.mean(), excitation - excitation.mean()
    span = statistics.memory(k)
    size = scipy.fft.next_fast_len(k + max(span, lags), real=True)  # so far no lag wraps around
    R, E = scipy.fft.rfft(r, size), scipy.fft.rfft(e, size)
    crossed, own_r, own_e = (
        scipy.fft.irfft(X, size) for X in (R * E.conj(), np.abs(R) ** 2, np.abs(E) ** 2)
    )
    quiet = float(np.linalg.norm(r)) <= 1e-7 * float(np.linalg.norm(measured))
    sums = crossed[: min(lags, k - 1) + 1], own_r[: span + 1], own_e[: span + 1]
    return statistics.input_test(*sums, k, signal, name, tests, quiet)
