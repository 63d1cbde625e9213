"""Reproducible random systems of every unpleasant kind, for tests and for runs of other codes
(numpy only).

``random_system(kind, seed)`` returns (A, B, C, D, dt); the same seed gives the same numbers with
every numpy >= 1.17 on one machine (linear algebra may differ in the last digits on another).
"""

from __future__ import annotations

import numpy as np

KINDS = (
    "plain",  # dense, well damped
    "light",  # damping ratios 1e-6 .. 1e-2, hidden by an orthogonal transformation
    "modal",  # the same, left block diagonal with frequencies over ten decades
    "scaled",  # dense, states scaled by 1e-9 .. 1e9
    "lightscaled",  # lightly damped and scaled like this, up to 60 states
    "nonminimal",  # uncontrollable and unobservable parts, one of them lightly damped
    "feedthrough",  # D larger than the dynamic part
    "rotor",  # second order with gyroscopic coupling in physical units
    "sampled",  # discrete, poles up to 1e-6 from the unit circle
    "nyquist",  # discrete, a pole close to z = -1, delays, and one near z = 1
    "flat",  # all-pass plus a little: the gain is constant to a few per cent
)


def random_system(
    kind: str, seed: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, float | None]:
    """(A, B, C, D, dt) of a stable system; dt is None for continuous time."""
    rng = np.random.default_rng([KINDS.index(kind), seed])
    n = int(rng.integers(1, 21)) * 2
    m = int(rng.integers(1, 5))
    p = int(rng.integers(1, 5))
    B = rng.standard_normal((n, m))
    C = rng.standard_normal((p, n))
    D = np.zeros((p, m))
    return _BUILDERS[kind](rng, n, B, C, D)


def _orthogonal(rng: np.random.Generator, n: int) -> np.ndarray:
    return np.linalg.qr(rng.standard_normal((n, n)))[0]


def _modes(
    rng: np.random.Generator, n: int, low: float, high: float, damping: tuple[float, float]
) -> np.ndarray:
    """Block diagonal oscillators with frequencies 10^low .. 10^high and damping ratios
    10^damping.
    """
    A = np.zeros((n, n))
    for i in range(0, n, 2):
        omega, zeta = 10 ** rng.uniform(low, high), 10 ** rng.uniform(*damping)
        A[i : i + 2, i : i + 2] = [[-zeta * omega, omega], [-omega, -zeta * omega]]
    return A


def _plain(rng, n, B, C, D):
    A = rng.standard_normal((n, n))
    return (
        A - (np.linalg.eigvals(A).real.max() + 10 ** rng.uniform(-3, 0)) * np.eye(n),
        B,
        C,
        D,
        None,
    )


def _light(rng, n, B, C, D):
    Q = _orthogonal(rng, n)
    return (
        Q @ _modes(rng, n, 0, 2, (-6, -2)) @ Q.T,
        B,
        C,
        D + (rng.random() < 0.5) * rng.standard_normal(D.shape),
        None,
    )


def _modal(rng, n, B, C, D):
    return _modes(rng, n, -4, 6, (-6, 0)), B, C, D, None


def _scaled(rng, n, B, C, D):
    A, B, C, D, _ = _plain(rng, n, B, C, D)
    t = 10 ** rng.uniform(-9, 9, n)
    return A * t / t[:, None], B / t[:, None], C * t, D, None


def _lightscaled(rng, n, B, C, D):
    extra = int(rng.integers(0, 11)) * 2
    B, C = (
        np.vstack([B, rng.standard_normal((extra, B.shape[1]))]),
        np.hstack([C, rng.standard_normal((len(C), extra))]),
    )
    A, B, C, D, _ = _light(rng, n + extra, B, C, D)
    t = 10 ** rng.uniform(-9, 9, n + extra)
    return A * t / t[:, None], B / t[:, None], C * t, D, None


def _nonminimal(rng, n, B, C, D):
    n = n + 4
    B = np.vstack([B, np.ones((4, B.shape[1]))])
    C = np.hstack([C, np.ones((len(C), 4))])
    A = _modes(rng, n, -1, 2, (-2, 0))
    A[:2, :2] = [[-1e-6, 3.0], [-3.0, -1e-6]]
    B[:2] = 0.0
    C[:, n // 2 :] = 0.0
    Q = _orthogonal(rng, n)
    return Q @ A @ Q.T, Q @ B, C @ Q.T, D, None


def _feedthrough(rng, n, B, C, D):
    A, B, C, D, _ = _plain(rng, n, B, C, D)
    return A, B, C, 10 ** rng.uniform(0, 3) * rng.standard_normal(D.shape), None


def _rotor(rng, n, B, C, D):
    k = n // 2
    M = np.diag(10 ** rng.uniform(-3, 1, k))
    V = rng.standard_normal((k, k))
    K = 10 ** rng.uniform(4, 8) * (V @ V.T + 0.01 * np.eye(k))
    G = rng.standard_normal((k, k))
    half = np.diag(1 / np.sqrt(np.diag(M)))
    damping = (
        10 ** rng.uniform(-5, -2) * half @ K @ half / np.sqrt(np.linalg.norm(half @ K @ half, 2))
    )
    damping = np.linalg.inv(half) @ damping @ np.linalg.inv(half)
    Mi = np.diag(1 / np.diag(M))
    A = np.block([[np.zeros((k, k)), np.eye(k)], [-Mi @ K, -Mi @ (damping + 10 * (G - G.T))]])
    B[:k] = 0.0
    C[:, k:] = 0.0
    return A, np.vstack([B[:k], Mi @ B[k:]]), C, D, None


def _sampled(rng, n, B, C, D):
    A = np.zeros((n, n))
    for i in range(0, n, 2):
        radius, angle = 1 - 10 ** rng.uniform(-6, -0.3), rng.uniform(0, np.pi)
        A[i : i + 2, i : i + 2] = radius * np.array(
            [[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]
        )
    Q = _orthogonal(rng, n)
    return (
        Q @ A @ Q.T,
        B,
        C,
        D + (rng.random() < 0.5) * rng.standard_normal(D.shape),
        10 ** rng.uniform(-5, 0),
    )


def _nyquist(rng, n, B, C, D):
    A = np.diag(rng.uniform(-0.5, 0.5, n)) + 0.1 * np.triu(rng.standard_normal((n, n)), 1)
    A[0, 0], A[1, 1] = -1 + 10 ** rng.uniform(-7, -4), 1 - 10 ** rng.uniform(-7, -4)
    B[0] *= 1e-5 * rng.uniform(0, 2)
    for i in range(2, n, 3):
        A[i, i] = 0.0
    return A, B, C, D, 1e-4


def _flat(rng, n, B, C, D):
    A = np.zeros((n, n))
    b = np.zeros((n, 1))
    # every block is orthogonal in itself: a cascade of all-passes, written as a parallel sum
    for i in range(0, n, 2):
        omega, zeta = 10 ** rng.uniform(-1, 2), 10 ** rng.uniform(-2, 0)
        A[i : i + 2, i : i + 2] = [[-2 * zeta * omega, omega], [-omega, 0.0]]
        b[i, 0] = 2 * np.sqrt(zeta * omega)
        A[i : i + 2, :i] = b[i : i + 2] @ -b[:i].T
    return A, b, -b.T + 1e-3 * rng.standard_normal((1, n)), np.eye(1), None


_BUILDERS = {kind: globals()[f"_{kind}"] for kind in KINDS}
