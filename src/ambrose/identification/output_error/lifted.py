"""Outputs and all their parameter derivatives of a sampled loop at once, in blocks and in pieces of
a record.

The same sums as simulate_derivative of tests/whole_records.py, the oracle. There every parameter is
a system of twice the size; here all share the loop's own lifted matrices (Chen & Francis 1995, ch.
8) and one sequential pass, and only a piece of the record is held at a time. No eigenvectors are
formed: this is the exact way that never fails.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ambrose.core.response import SystemDerivative
from ambrose.core.statespace import StateSpace

BLOCK = 16  # samples of a block
_GROUP = 4  # blocks between which the states are not stepped
_PIECE = 256  # blocks held at a time


@dataclass(frozen=True, slots=True, eq=False)
class Lifted:
    """A sampled loop without feedthrough, and its q derivatives, over blocks of L samples.

    With X the states at the starts of the blocks and S_j their derivatives: X+ = P X + R u, S_j+ =
    P S_j + dP_j X + dR_j u; y = O X + T u, dy_j = O S_j + dO_j X + dT_j u. Transposed, for rows of
    signals: powers (g + 1, n, n) of P', and of them triangle (g n, g n), for groups of g blocks;
    pushed (mL, n) = R'; forced (n + mL, qn) of dP and dR; shown (n, pL) = O'; maps (1 + q, n + mL,
    pL) of O and T, then of dO_j and dT_j.
    """

    powers: np.ndarray
    triangle: np.ndarray
    pushed: np.ndarray
    forced: np.ndarray
    shown: np.ndarray
    maps: np.ndarray
    outputs: int


def lift(system: StateSpace, directions: Sequence[SystemDerivative], length: int = BLOCK) -> Lifted:
    """The lifted loop over blocks of ``length`` samples; C and D = 0 do not depend on the
    parameters.
    """
    A = system.A
    B = system.B
    C = system.C
    p, n = C.shape
    m = B.shape[1]
    L = length
    q = len(directions)
    dA = np.stack([d.A for d in directions]) if q else np.zeros((0, n, n))
    dB = np.stack([d.B for d in directions]) if q else np.zeros((0, n, m))
    O_, dO = np.empty((L, p, n)), np.empty((L, q, p, n))
    R, dR = np.empty((L, n, m)), np.empty((L, q, n, m))
    O_[0] = C
    dO[0] = 0.0
    R[0] = B
    dR[0] = dB
    P, dP = A, dA
    for i in range(1, L):  # C A^i, A^i B, A^i and their derivatives
        O_[i], dO[i] = O_[i - 1] @ A, dO[i - 1] @ A + O_[i - 1] @ dA
        R[i], dR[i] = A @ R[i - 1], A @ dR[i - 1] + dA @ R[i - 1]
        P, dP = A @ P, A @ dP + dA @ P

    # transposed for rows [X, u]; R[::-1]: the input s of a block comes out by A^(L - 1 - s) B
    by_state = dP.transpose(2, 0, 1).reshape(n, q * n)
    by_input = dR[::-1].transpose(3, 0, 1, 2).reshape(m * L, q * n)
    # (L, 1 + q, p, m): one sample later
    h = np.concatenate([(O_ @ B)[:, None], dO @ B + O_[:, None] @ dB], axis=1)

    # rows: state, then L samples of each input; columns: L samples of each output. O, T; dO_j, dT_j
    maps = np.empty((1 + q, n + m * L, p * L))
    maps[0, :n] = shown = O_.transpose(2, 1, 0).reshape(n, p * L)
    maps[1:, :n] = dO.transpose(1, 3, 2, 0).reshape(q, n, p * L)
    maps[:, n:] = _toeplitz(h).reshape(1 + q, m * L, p * L)
    pushed = R[::-1].transpose(2, 0, 1).reshape(m * L, n)
    powers = powers_of(P.T, _GROUP + 1)
    return Lifted(
        powers, _triangle(powers), pushed, np.vstack([by_state, by_input]), shown, maps, p
    )


def stream(
    lifted: Lifted,
    u: Sequence[np.ndarray],
    x0: np.ndarray,
    dx0: np.ndarray | None = None,
    piece: int = _PIECE,
) -> Iterator[tuple[int, np.ndarray]]:
    """Pieces of the record, one after the other: the first sample, and outputs and derivatives F (1
    + q, blocks, p, L).

    u: m signals (k,), held between the samples; x0 (n,) the first state and dx0 (q, n) its
    derivatives (None: none); piece: blocks at a time. The last block goes on past the end of the
    record with the input zero.
    """
    n, (q1, width, pL) = len(x0), lifted.maps.shape
    p = lifted.outputs
    q = q1 - 1
    k = len(u[0])
    L = pL // p
    x, s = x0, np.zeros((q, n)) if dx0 is None else dx0
    for start in range(0, k, piece * L):
        stop = min(start + piece * L, k)
        count = -(-(stop - start) // L)

        # rows [X, u], one per block
        XU = np.zeros((count, width))
        for i, signal in enumerate(u):
            XU[:, n + i * L : n + (i + 1) * L] = blocks(signal[start:stop], L)

        # X+ = P X + R u
        driven = XU[:, n:] @ lifted.pushed
        X, x = _states(lifted, driven[None], x[None])
        XU[:, :n], x = X[0], x[0]

        # y = O X + T u, and of dy_j the part dO_j X + dT_j u
        F = np.matmul(XU, lifted.maps)
        if q:
            # S_j+ = P S_j + dP_j X + dR_j u,   dy_j += O S_j
            forced = (XU @ lifted.forced).reshape(count, q, n).transpose(1, 0, 2)
            S, s = _states(lifted, forced, s)
            F[1:] += S @ lifted.shown
        yield start, F.reshape(1 + q, count, p, L)


def _states(lifted: Lifted, driven: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The states (c, count, n) at the starts of blocks, and (c, n) after the last: x+ = x P' +
    driven (c, count, n).

    In groups of blocks, within which one product with powers of P' takes the place of the
    recursion.
    """
    powers, (c, count, n) = lifted.powers, driven.shape
    group = len(powers) - 1
    groups = -(-count // group)
    padded = np.zeros((c, groups * group, n))
    padded[:, :count] = driven
    # what a group's own inputs do by each of its ends
    inside = padded.reshape(c * groups, group * n) @ lifted.triangle
    inside = inside.reshape(c, groups, group, n)
    states = np.empty((c, groups, group, n))
    spread = powers[:group].transpose(1, 0, 2).reshape(n, group * n)

    # x at the groups' starts: x+ = x P'^group + what the group's own inputs do by its end
    starts = np.empty((c, groups, n))
    for g in range(groups):
        starts[:, g] = x
        x = x @ powers[group] + inside[:, g, -1]

    # inside a group, t blocks after its start: x P'^t + what its first t inputs do
    states[:] = (starts @ spread).reshape(states.shape)
    states[:, :, 1:] += inside[:, :, :-1]
    states = states.reshape(c, -1, n)

    # the last group may be short: its state after ``rest`` blocks, not after the padding
    rest = count - (groups - 1) * group
    if rest < group:
        x = starts[:, -1] @ powers[rest] + inside[:, -1, rest - 1]
    return states[:, :count], x


def _triangle(powers: np.ndarray) -> np.ndarray:
    """(group n, group n): inputs of block s (rows) to the state after block t >= s, P'^(t - s)."""
    group, n = len(powers) - 1, powers.shape[1]
    lag = np.arange(group)[None] - np.arange(group)[:, None]
    blocks = np.where((lag >= 0)[:, :, None, None], powers[np.maximum(lag, 0)], 0.0)
    return blocks.transpose(0, 2, 1, 3).reshape(group * n, group * n)


def powers_of(P: np.ndarray, count: int) -> np.ndarray:
    """I, P, P^2, ... (count, n, n)."""
    powers = np.empty((count, *P.shape))
    powers[0] = np.eye(len(P))
    for i in range(1, count):
        powers[i] = powers[i - 1] @ P
    return powers


def blocks(signal: np.ndarray, length: int) -> np.ndarray:
    """A signal (k,) in rows (count, length), the last one filled up with zeros."""
    count = -(-len(signal) // length)
    if count * length == len(signal):
        return signal.reshape(count, length)
    padded = np.zeros(count * length)
    padded[: len(signal)] = signal
    return padded.reshape(count, length)


def _toeplitz(h: np.ndarray) -> np.ndarray:
    """(c, m, L, p, L): what an input at sample s of a block does at sample t > s, h (L, c, p, m)[t
    - s - 1].
    """
    L = len(h)
    padded = np.concatenate([np.zeros((1, *h.shape[1:])), h])
    lag = np.maximum(np.arange(L)[None] - np.arange(L)[:, None], 0)  # (s, t); 0 picks the zeros
    return padded[lag].transpose(2, 4, 0, 3, 1)
