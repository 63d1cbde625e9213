"""Zeros: the frequencies at which a system of any size and rank loses rank; and systems without
hidden poles.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.linalg as sla

from ambrose.core.checks import check_positive, named_failure
from ambrose.core.matrix_equations import balanced_realization
from ambrose.core.realisation.balancing import balance_system
from ambrose.core.statespace import StateSpace, as_statespace


@named_failure("the zeros")
def invariant_zeros(system: Any, tolerance: float = 1e-9) -> np.ndarray:
    """Finite invariant zeros (z,) complex [rad/s, or z-plane]; transmission zeros when the system
    is minimal.

    tolerance: relative to the balanced system matrix, below which a row counts as dependent. Sorted
    by modulus. Works for rank-deficient and non-square systems: zeros at infinity and the singular
    part of [A - s, B; C, D] are deflated first. Emami-Naeini & Van Dooren (1982), Automatica 18.
    """
    system = as_statespace(system)
    A, B, C, D = _scaled(system)
    size = max(float(np.linalg.norm(np.block([[A, B], [C, D]]))), 1e-300)

    # First D of full row rank,
    A, B, C, D = _row_reduced(A, B, C, D, tolerance * size)
    # the dual: now D is square and invertible
    A, C, B, D = (x.T for x in _row_reduced(A.T, C.T, B.T, D.T, tolerance * size))
    n = len(A)
    if n == 0:
        return np.zeros(0, complex)
    # the pencil [A - s, B; C, D]: columns turned so that [C, D] = [0, R] leaves a regular pencil of
    # the size n
    _, _, Vt = sla.svd(np.hstack([C, D]))
    V = Vt[len(C) :].T  # null space of [C, D], n columns

    # [A - s, B] V w = 0 with [C, D] V = 0, V[:n] the part of x: ([A, B] V - s V[:n]) w = 0
    values = sla.eig(np.hstack([A, B]) @ V, V[:n], right=False, homogeneous_eigvals=True)
    alpha, beta = values

    # beta = 0: infinite, a zero that the deflation left to rounding. Back in rad/s.
    finite = np.abs(beta) > 1e-14 * np.abs(alpha)
    zeros = alpha[finite] / beta[finite] * _unit(system)
    return zeros[np.lexsort((zeros.imag, zeros.real, np.abs(zeros)))]


def minimal(system: Any, tolerance: float = 1e-9) -> StateSpace:
    """A stable system without the states whose Hankel singular values are below ``tolerance`` of
    the largest.

    What is left differs by at most twice the sum of those left out, so its poles and zeros are
    those that can be seen. Raises UnstableSystem. Moore (1981); Glover (1984).
    """
    check_positive(tolerance, "tolerance", "1e-9 keeps all that double precision can tell")
    balanced, hankel, _, _ = balanced_realization(system)
    k = int((hankel > tolerance * hankel.max(initial=0.0)).sum())
    k = min(k, balanced.n_states)
    return StateSpace(
        balanced.A[:k, :k],
        balanced.B[:k],
        balanced.C[:, :k],
        balanced.D,
        balanced.inputs,
        balanced.outputs,
        balanced.dt,
    )


def _unit(system: StateSpace) -> float:
    """The rate [rad/s] in which a continuous system's poles are of order one; a sampled system
    stays as it is.
    """
    if system.dt is not None or system.n_states == 0:
        return 1.0
    moduli = np.abs(np.linalg.eigvals(system.A))
    moving = moduli[moduli > 0]
    return float(np.exp(np.mean(np.log(moving)))) if moving.size else 1.0


def _scaled(system: StateSpace) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The matrices in units of time, input and output in which they are of order one; zeros only
    change by the unit of time.
    """
    unit = _unit(system)
    A = system.A / unit
    B = system.B / unit
    C = system.C
    D = system.D

    # States, inputs and outputs in turn: each scaling disturbs the others a little.
    for _ in range(3):
        A, B, C, _ = balance_system(A, B, C)
        columns = np.linalg.norm(np.vstack([B, D]), axis=0)
        columns = np.where(columns > 0, columns, 1.0)
        B, D = B / columns, D / columns
        rows = np.linalg.norm(np.hstack([C, D]), axis=1)
        rows = np.where(rows > 0, rows, 1.0)
        C, D = C / rows[:, None], D / rows[:, None]
    return A, B, C, D


def _row_reduced(
    A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray, tolerance: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A system with the same finite zeros whose D has full row rank: outputs that D does not reach
    hold states at zero.
    """
    while True:
        # Outputs turned so that the last ones have no D.
        U, s, _ = sla.svd(D) if D.size else (np.eye(len(D)), np.zeros(0), None)
        rank = int((s > tolerance).sum())
        C, D = U.T @ C, U.T @ D
        dependent = C[rank:]  # these outputs are zero only if the states they see are
        C, D = C[:rank], D[:rank]
        if not dependent.size:
            return A, B, C, D

        # held x = 0: the states in the null space of ``held`` are free, the k others held at zero.
        _, s, Vt = sla.svd(dependent)
        k = int((s > tolerance).sum())
        if k == 0:
            return A, B, C, D
        T = np.vstack([Vt[k:], Vt[:k]]).T  # free states first, then the k held at zero

        # x = T (free, held), T orthogonal
        A = T.T @ A @ T
        B = T.T @ B
        C = C @ T
        n = len(A) - k

        # held = 0 and so held' = A_hf free + B_h u = 0: k new outputs in place of those used up,
        # and k states fewer. Then again, since the new D may lack rank.
        C, D = np.vstack([A[n:, :n], C[:, :n]]), np.vstack([B[n:], D])
        A, B = A[:n, :n], B[:n]
