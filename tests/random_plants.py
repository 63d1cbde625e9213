"""Reproducible random plants for H-infinity synthesis, of every unpleasant kind, for tests and
other codes (numpy only).

``random_plant(kind, seed)`` returns (A, B, C, D, m, p): the last m inputs are controls, the last p
outputs measurements.
"""

from __future__ import annotations

import numpy as np

KINDS = (
    "plain",  # dense, mostly unstable, every part of D filled
    "stable",  # stable, D11 = 0, D22 = 0
    "scaled",  # plain; states, controls and measurements in units between 1e-9 and 1e9
    # plain; disturbances and outputs scaled against each other by up to 1e4 either way, states by
    # 1e9
    "dscaled",
    "units",  # plain; time in units of 1e-6 .. 1e6 s, w and z in units of 1e-9 .. 1e9
    "light",  # lightly damped modes between 1 and 1e4 rad/s, hidden by an orthogonal transformation
    # mixed sensitivity of a fast unstable plant with weights whose poles are at 1e-3 .. 3e-2 rad/s
    "weights",
    # unstable second-order system in metres, newtons and amperes with weights and actuators
    "rotor",
    # D12 or D21 lacks rank, or P12 or P21 has a zero on the imaginary axis, or all of it
    "singular",
)
Plant = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, int, int]


def random_plant(kind: str, seed: int) -> Plant:
    """(A, B, C, D, m, p), continuous time."""
    rng = np.random.default_rng([2, KINDS.index(kind), seed])
    return _BUILDERS[kind](rng)


def _plain(rng: np.random.Generator) -> Plant:
    n = int(rng.integers(2, 11))
    m = int(rng.integers(1, 4))
    p = int(rng.integers(1, 4))
    q, r = p + int(rng.integers(0, 4)), m + int(rng.integers(0, 4))
    A = rng.standard_normal((n, n)) / np.sqrt(n) - rng.uniform(-0.2, 0.8) * np.eye(n)
    B, C = rng.standard_normal((n, q + m)), rng.standard_normal((r + p, n))
    return A, B, C, rng.standard_normal((r + p, q + m)), m, p


def _stable(rng: np.random.Generator) -> Plant:
    A, B, C, D, m, p = _plain(rng)
    A = A - (np.linalg.eigvals(A).real.max() + 10 ** rng.uniform(-3, 0)) * np.eye(len(A))
    D[:-p, :-m] = 0.0
    D[-p:, -m:] = 0.0
    return A, B, C, D, m, p


def _scaled(rng: np.random.Generator) -> Plant:
    A, B, C, D, m, p = _plain(rng)
    A, B, C = _state_units(rng, A, B, C)
    u, y = 10 ** rng.uniform(-9, 9, m), 10 ** rng.uniform(-9, 9, p)
    B[:, -m:] *= u
    D[:, -m:] *= u
    C[-p:] *= y[:, None]
    D[-p:] *= y[:, None]
    return A, B, C, D, m, p


def _state_units(
    rng: np.random.Generator, A: np.ndarray, B: np.ndarray, C: np.ndarray
) -> tuple[np.ndarray, ...]:
    t = 10 ** rng.uniform(-9, 9, len(A))
    return A * t / t[:, None], B / t[:, None], C * t


def _dscaled(rng: np.random.Generator) -> Plant:
    A, B, C, D, m, p = _plain(rng)
    d = 10 ** rng.uniform(-4, 4, max(B.shape[1] - m, len(C) - p))
    w, z = d[: B.shape[1] - m], 1 / d[: len(C) - p]
    B[:, :-m] *= w
    D[:, :-m] *= w
    C[:-p] *= z[:, None]
    D[:-p] *= z[:, None]
    A, B, C = _state_units(rng, A, B, C)
    return A, B, C, D, m, p


def _units(rng: np.random.Generator) -> Plant:
    A, B, C, D, m, p = _plain(rng)
    time = 10 ** rng.uniform(-6, 6)
    w = 10 ** rng.uniform(-9, 9)
    z = 10 ** rng.uniform(-9, 9)
    B[:, :-m] *= w
    D[:, :-m] *= w
    C[:-p] *= z
    D[:-p] *= z
    return A * time, B * time, C, D, m, p


def _light(rng: np.random.Generator) -> Plant:
    k = int(rng.integers(1, 6))
    A = np.zeros((2 * k, 2 * k))
    for i in range(0, 2 * k, 2):
        omega, zeta = 10 ** rng.uniform(0, 4), 10 ** rng.uniform(-5, -1) * rng.choice([1, 1, 1, -1])
        A[i : i + 2, i : i + 2] = omega * np.array([[-zeta, 1], [-1, -zeta]])
    Q = np.linalg.qr(rng.standard_normal((2 * k, 2 * k)))[0]
    m, p = int(rng.integers(1, 3)), int(rng.integers(1, 3))
    q, r = p + int(rng.integers(0, 3)), m + int(rng.integers(0, 3))
    size = np.sqrt(np.linalg.norm(A, 2))
    B, C = size * rng.standard_normal((2 * k, q + m)), size * rng.standard_normal((r + p, 2 * k))
    D = rng.standard_normal((r + p, q + m))
    D[:-p, :-m] *= rng.random() < 0.5
    return Q @ A @ Q.T, B, C, D, m, p


def _weights(rng: np.random.Generator) -> Plant:
    """w = (control disturbance, output disturbance), z = (W_p e, W_u u), y = e = d - G (u + w1)."""
    k, n = int(rng.integers(1, 3)), int(rng.integers(2, 6))
    A = 10 ** rng.uniform(1.5, 3) * (
        rng.standard_normal((n, n)) / np.sqrt(n) - rng.uniform(0, 0.8) * np.eye(n)
    )
    B, C = np.sqrt(np.linalg.norm(A, 2)) * rng.standard_normal((n, k)), rng.standard_normal((k, n))
    return _mixed_sensitivity(rng, A, B, C)


def _mixed_sensitivity(
    rng: np.random.Generator, A: np.ndarray, B: np.ndarray, C: np.ndarray
) -> Plant:
    n, k = B.shape
    slow, peak = 10 ** rng.uniform(-3, -1.5, k), rng.uniform(1.5, 4, k)
    bandwidth = slow * 10 ** rng.uniform(2, 4, k)
    W_u = np.diag(10 ** rng.uniform(-1, 0.5, k))
    zero = np.zeros((k, k))
    one = np.eye(k)
    weight = np.diag(bandwidth - slow / peak)
    A = np.block([[A, np.zeros((n, k))], [-C, -np.diag(slow)]])
    B = np.block([[B, np.zeros((n, k)), B], [zero, one, zero]])
    error = np.hstack([-C, zero])
    C = np.vstack([np.hstack([-np.diag(1 / peak) @ C, weight]), np.zeros((k, n + k)), error])
    D = np.block([[zero, np.diag(1 / peak), zero], [zero, zero, W_u], [zero, one, zero]])
    return A, B, C, D, k, k


def _rotor(rng: np.random.Generator) -> Plant:
    """Rigid rotor on bearings of negative stiffness with a cross-coupled seal, actuators of second
    order, errors per 20 um.
    """
    k = int(rng.choice([1, 2]))
    mass = rng.uniform(5, 40) * (np.eye(k) + 0.2 * np.ones((k, k)))
    stiffness = -(10 ** rng.uniform(4, 6)) * np.eye(k)
    if k == 2:
        stiffness = stiffness + 10 ** rng.uniform(4, 6) * np.array([[0, 1], [-1, 0]])
    force = rng.uniform(50, 300)
    wn = 10 ** rng.uniform(2.5, 3.5)
    unit = 20e-6
    M = np.linalg.inv(mass)
    zero = np.zeros((k, k))
    one = np.eye(k)
    A = np.block(
        [
            [zero, one, zero, zero],
            [-M @ stiffness, -10 * one, force * M, zero],
            [zero, zero, zero, wn * one],
            [zero, zero, -wn * one, -1.2 * wn * one],
        ]
    )
    B = np.vstack([np.zeros((3 * k, k)), wn * one])
    return _mixed_sensitivity(rng, A, B, np.hstack([one / unit, np.zeros((k, 3 * k))]))


def _singular(rng: np.random.Generator) -> Plant:
    A, B, C, D, m, p = _stable(rng) if rng.random() < 0.5 else _plain(rng)
    what = rng.integers(0, 4)
    if what in (0, 3):
        D[:-p, -1] = 0.0
    if what in (1, 3):
        D[-1, :-m] = 0.0
    # a mode at +-2j that u reaches and y shows, but w does not, and z shows it only through D12 z's
    # own
    if what in (2, 3):
        n = len(A)
        A = np.block(
            [[A, np.zeros((n, 2))], [np.zeros((2, n)), np.array([[0.0, 2.0], [-2.0, 0.0]])]]
        )
        low = np.zeros((2, B.shape[1]))
        low[:, -m:] = rng.standard_normal((2, m))
        right = np.zeros((len(C), 2))
        right[-p:] = rng.standard_normal((p, 2))
        B, C = np.vstack([B, low]), np.hstack([C, right])
    return A, B, C, D, m, p


_BUILDERS = {kind: globals()[f"_{kind}"] for kind in KINDS}
