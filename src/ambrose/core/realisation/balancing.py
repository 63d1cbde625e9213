"""Diagonal scaling of state-space matrices: exact (powers of two), cheap, and worth several
digits.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg as sla


def balance(A: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Diagonal similarity that evens out row and column norms: T^-1 A T with T = diag(t), and t
    (n,). Exact (powers of 2).

    A (n, n). Source: Parlett & Reinsch 1969 (LAPACK's gebal, without permutations).
    """
    if A.shape[0] == 0:
        return A, np.ones(0)
    gebal = sla.lapack.zgebal if np.iscomplexobj(A) else sla.lapack.dgebal
    balanced, _, _, scale, _ = gebal(A, scale=1, permute=0)
    return balanced, scale


def balance_system(
    A: np.ndarray, B: np.ndarray, C: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """State scaling x = diag(t) z that evens out A, B and C together: T^-1 A T, T^-1 B, C T and t
    (n,).

    A (n, n), B (n, m), C (p, n). Inputs and outputs keep their units; one more row and column, the
    norms of B and C, stand for them while balancing.
    """
    n = A.shape[0]

    # [|A| |B|; |C| 0] with B and C as one column and one row of norms.
    joint = np.zeros((n + 1, n + 1))
    joint[:n, :n] = np.abs(A)
    joint[:n, n] = np.linalg.norm(B, axis=1)
    joint[n, :n] = np.linalg.norm(C, axis=0)

    # The last factor, that of the signals, is set to one.
    t = balance(joint)[1]
    t = t[:n] / t[n]
    return A * t / t[:, None], B / t[:, None], C * t, t
