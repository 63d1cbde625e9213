"""Outputs and all their parameter derivatives of a sampled loop at once, in blocks.

The same sums as core/response.py's simulate_derivative, which is the oracle in the tests. There every parameter is a system of
twice the size; here all share the loop's own lifted matrices (Chen & Francis 1995, ch. 8) and one sequential pass.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ambrose.core.response import SystemDerivative
from ambrose.core.statespace import StateSpace


def lifted_sensitivities(
    system: StateSpace, directions: Sequence[SystemDerivative], u: np.ndarray, x0: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """y (p, k) and dy (q, p, k) of a stable sampled system without feedthrough, whose C does not change.

    u (m, k); x0 (n,), not depending on the parameters. With X the states at the starts of the blocks of L samples, and S_j
    their derivatives: X+ = P X + R u, S_j+ = P S_j + dP_j X + dR_j u; y = O X + T u, dy_j = O S_j + dO_j X + dT_j u.
    """
    A, B, C = system.A, system.B, system.C
    (p, n), m, k, q = C.shape, B.shape[1], u.shape[1], len(directions)
    L = 64 if m == 1 else 32
    dA, dB = np.stack([d.A for d in directions]), np.stack([d.B for d in directions])
    count = -(-k // L)
    blocks = np.zeros((m, count * L))
    blocks[:, :k] = u
    blocks = np.ascontiguousarray(blocks.reshape(m, count, L).transpose(1, 0, 2)).reshape(count, m * L)

    Ob, dO = np.empty((L, p, n)), np.empty((L, q, p, n))
    R, dR = np.empty((L, n, m)), np.empty((L, q, n, m))
    Ob[0], dO[0], R[0], dR[0] = C, 0.0, B, dB
    P, dP = A, dA
    for i in range(1, L):  # C A^i, A^i B, A^i and their derivatives
        Ob[i], dO[i] = Ob[i - 1] @ A, dO[i - 1] @ A + Ob[i - 1] @ dA
        R[i], dR[i] = A @ R[i - 1], A @ dR[i - 1] + dA @ R[i - 1]
        P, dP = A @ P, A @ dP + dA @ P

    X = np.empty((count, n))
    S = np.zeros((count, q, n))
    pushed = blocks @ R[::-1].transpose(2, 0, 1).reshape(m * L, n)
    x = x0
    for b in range(count):
        X[b] = x
        x = P @ x + pushed[b]
    by_state = dP.transpose(2, 0, 1).reshape(n, q * n)
    by_input = dR[::-1].transpose(3, 0, 1, 2).reshape(m * L, q * n)
    forced = (X @ by_state + blocks @ by_input).reshape(count, q, n)
    s, PT = np.zeros((q, n)), np.ascontiguousarray(P.T)
    for b in range(count):
        S[b] = s
        s = s @ PT + forced[b]

    h, dh = Ob @ B, dO @ B + Ob[:, None] @ dB  # (L, p, m), (L, q, p, m): the response one sample later
    shown = Ob.transpose(2, 1, 0).reshape(n, p * L)
    y = X @ shown + blocks @ _toeplitz(h[:, None]).reshape(m * L, p * L)
    dy = (X @ dO.transpose(3, 1, 2, 0).reshape(n, q * p * L)).reshape(count * q, p * L)
    dy += S.reshape(count * q, n) @ shown
    dy += (blocks @ _toeplitz(dh).reshape(m * L, q * p * L)).reshape(count * q, p * L)
    y = y.reshape(count, p, L).transpose(1, 0, 2).reshape(p, count * L)[:, :k]
    dy = dy.reshape(count, q, p, L).transpose(1, 2, 0, 3).reshape(q, p, count * L)[:, :, :k]
    return y, dy


def _toeplitz(h: np.ndarray) -> np.ndarray:
    """(m, L, q, p, L): what an input at sample s of a block does at sample t > s, h (L, q, p, m)[t - s - 1]."""
    L = len(h)
    padded = np.concatenate([np.zeros((1, *h.shape[1:])), h])
    lag = np.maximum(np.arange(L)[None] - np.arange(L)[:, None], 0)  # (s, t); 0 picks the zeros
    return padded[lag].transpose(4, 0, 2, 3, 1)
