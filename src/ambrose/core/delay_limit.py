"""What no linear controller can do: the least sensitivity that unstable poles and a delay in the
loop allow.

The output sensitivity S vanishes on the plant's unstable poles, S = S_1 B with B inner, and S - I
carries the loop's delay e^{-s tau}. Hence S_1 = B^{-1} up to what is later than tau, and the least
norm of S is that of the unstable all-pass B^{-1} acting on L2[0, tau] (Sarason 1967; Zhou &
Khargonekar 1987; Foias, Oezbay & Tannenbaum 1996). It is attained in the limit where the rest of
the plant can be inverted, and a lower bound everywhere.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg as sla
from numpy.typing import ArrayLike

from ambrose.core.checks import check_finite, check_positive, check_shape, named_failure

_CELLS = 24  # of [0, tau]; with twice as many, extrapolated: 1e-5 at p tau = 1
_MARGINAL = 1e-6  # of the largest pole: slower ones bind nothing, and count as stable
_BEYOND = 20.0  # p tau from which the limit, some e^{p tau}, is called infinite


@named_failure("the least sensitivity")
def least_sensitivity(A: ArrayLike, C: ArrayLike, delay: float) -> float:
    """The infimum of ||S||_inf over all controllers of a plant with dynamics A (n, n), measurements
    C (m, n) and ``delay`` [s].

    S = (I + G K)^-1 on the m measurements; stable poles of A drop out. 1 without unstable poles or
    delay; for one real pole p e^{p tau}. inf where an unstable motion shows in no measurement.
    Raises InvalidInput.
    """
    a, c = check_shape(A, "A", "(n, n)"), check_finite(C, "C")
    check_positive(delay, "the delay [s]", "zero is none", zero_allowed=True)
    floor = _MARGINAL * max(np.abs(np.linalg.eigvals(a)).max(initial=0.0), 1e-300)

    # The unstable part to the front: leading Schur vectors are invariant, stable poles drop out.
    T, Q, count = sla.schur(a, output="real", sort=lambda re, im: re > floor)
    if count == 0 or delay == 0:
        return 1.0
    a, c = T[:count, :count], c @ Q[:, :count]
    if np.linalg.eigvals(a).real.max() * delay > _BEYOND:
        return float("inf")

    # The inner factor's inverse from the observability of the unstable part (-A is stable).
    observability = sla.solve_continuous_lyapunov(a.T, c.T @ c)  # A^T W + W A = C^T C
    size = np.linalg.eigvalsh((observability + observability.T) / 2)

    # W singular: an unstable motion that shows in no measurement.
    if size[0] <= 1e-13 * size[-1]:
        return float("inf")
    b = np.linalg.solve(observability, c.T)  # B^{-1}(s) = I + C (s - A)^{-1} B is all-pass

    # The error falls with the cell's width squared: extrapolated from two grids (Richardson).
    coarse, fine = (
        _truncated_norm(a, b, c, delay, _CELLS),
        _truncated_norm(a, b, c, delay, 2 * _CELLS),
    )
    return float(fine + (fine - coarse) / 3)


def _truncated_norm(A: np.ndarray, B: np.ndarray, C: np.ndarray, delay: float, cells: int) -> float:
    """The norm of I + C (s - A)^{-1} B between functions on [0, delay] that are constant on equal
    cells: from below.
    """
    n = len(A)
    m = len(C)
    h = delay / cells
    zero, one = np.zeros((n, n)), np.eye(n)
    E = sla.expm(h * np.block([[A, one, zero], [zero, zero, one], [zero, zero, zero]]))
    # e^{A h}, its integral, and the integral of that
    step = E[:n, :n]
    once = E[:n, n : 2 * n]
    twice = E[:n, 2 * n :]

    # Unit functions 1/sqrt(h) on a cell. The kernel I delta(t) + C e^{A t} B averaged from cell 0
    # to cell i:
    # i = 0: I + C twice B/h,   i > 0: C once e^{A h (i - 1)} once B/h
    column = [np.eye(m) + C @ twice @ B / h]
    state = once @ B
    for _ in range(cells - 1):
        column.append(C @ once @ state / h)
        state = step @ state

    # Causal and the same from every cell: block lower triangular Toeplitz.
    whole = np.zeros((cells, m, cells, m))
    for i in range(cells):
        for j in range(i + 1):
            whole[i, :, j] = column[i - j]
    return float(np.linalg.norm(whole.reshape(cells * m, cells * m), 2))
