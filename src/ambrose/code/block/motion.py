"""States of a scheduled block while its parameter moves: a common quadratic Lyapunov function, and
the bound that it gives.

Between grid points A - L C = sum over i, j of s_i s_j (A_i - L_i C_j) with shares that add up to
one, so that every such matrix is a convex combination of its values at these points and of the
means of the two mixed terms of every pair. What contracts in one norm |x|_P at these vertices of
all intervals (cells, of two parameters) contracts in it along every motion of it, jumps included
(Boyd, El Ghaoui, Feron & Balakrishnan 1994, Linear Matrix Inequalities in System and Control
Theory, sec. 5.1).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla

from ambrose.core.checks import NumericalFailure
from ambrose.core.matrix_inequalities.semidefinite import Inequality, minimise, smat, svec

_TIME_LIMIT = 20.0  # s
_LARGEST = 30  # states; beyond, only the candidate of the middle grid point is tried


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """contraction [-]: of |x|_P in a sample at every point and across every move; states (n,):
    bounds on the states with every input at its limit, for any motion; infinite where contraction
    is not below 1, so that nothing is proved.
    """

    contraction: float
    states: np.ndarray

    @property
    def proved(self) -> bool:
        return self.contraction < 1


def bound_motion(
    increment: np.ndarray,
    B: np.ndarray,
    C: np.ndarray,
    D: np.ndarray,
    unwind: np.ndarray,
    inputs: np.ndarray,
    pairs: list[tuple[int, int]],
) -> Motion:
    """The common Lyapunov function of A - L C over a grid, and the states' bounds.

    increment (k, n, n): A - I; B (k, n, m), C (k, p, n), D (k, p, m), unwind (k, n, p): L; inputs
    (m + p,): the largest errors and the largest currents given; pairs: of neighbouring points.
    Examined, never assumed: the contraction is recomputed from the function that was found.
    """
    n = increment.shape[1]
    if n == 0:
        return Motion(0.0, np.zeros(0))
    A = np.eye(n) + increment
    vertices = _vertices(A, unwind, C, pairs)
    best = np.inf
    for P in _candidates(vertices):
        try:
            root = np.linalg.cholesky((P + P.T) / 2)  # P = R R^T, |x|_P = |R^T x|
        except np.linalg.LinAlgError:
            continue

        # |N|_P = |R^T N R^-T|_2, the largest over the vertices
        contraction = max(float(np.linalg.norm(_in_norm(root, N), 2)) for N in vertices)
        if contraction < 1:
            # |x|_P <= push/(1 - contraction) with push the sum of the columns' |b|_P times their
            # limits, and |x_i| <= sqrt((P^-1)_ii) |x|_P
            push = max(
                float(np.linalg.norm(root.T @ b, axis=0) @ inputs)
                for b in _driving(B, unwind, D, pairs)
            )
            # sqrt of the diagonal of P^-1
            reach = np.linalg.norm(sla.solve_triangular(root, np.eye(n), lower=True), axis=0)
            return Motion(contraction, reach * push / (1 - contraction))
        best = min(best, contraction)
    return Motion(best, np.full(n, np.inf))


def _in_norm(root: np.ndarray, N: np.ndarray) -> np.ndarray:
    """R^T N R^-T: N in states in which |x|_P is the Euclidean norm."""
    return root.T @ sla.solve_triangular(root, N.T, lower=True).T


def _vertices(
    A: np.ndarray, L: np.ndarray, C: np.ndarray, pairs: list[tuple[int, int]]
) -> list[np.ndarray]:
    """A - L C at the grid points, then the mean of the mixed terms of every pair of neighbours."""
    # sum s_i s_j (A_i - L_i C_j) = sum s_i^2 V_ii + sum_(i<j) 2 s_i s_j (V_ij + V_ji)/2
    own = [a - gain @ c for a, gain, c in zip(A, L, C, strict=True)]
    mixed = [(A[i] + A[j] - L[i] @ C[j] - L[j] @ C[i]) / 2 for i, j in pairs]
    return own + mixed


def _driving(
    B: np.ndarray, L: np.ndarray, D: np.ndarray, pairs: list[tuple[int, int]]
) -> list[np.ndarray]:
    """[B - L D, L] at the same vertices: what errors and given currents add to the states."""
    gains = [*L, *((L[i] + L[j]) / 2 for i, j in pairs)]
    return [np.hstack([b, gain]) for b, gain in zip(_vertices(B, L, D, pairs), gains, strict=True)]


def _candidates(vertices: list[np.ndarray]) -> Iterator[np.ndarray]:
    """Lyapunov functions, the cheap one first: of the middle vertex, then of all of them by matrix
    inequalities.
    """
    n = len(vertices[0])
    middle = vertices[(len(vertices) // 2) // 2]
    try:
        P = sla.solve_discrete_lyapunov(middle.T, np.eye(n))
        root = np.linalg.cholesky((P + P.T) / 2)
    except (np.linalg.LinAlgError, ValueError):
        return
    yield P
    if n > _LARGEST:
        return

    # the rest in the first candidate's norm, where the vertices are of order one: P = R X R^T
    found = _common([_in_norm(root, N) for N in vertices])
    if found is not None:
        yield root @ found @ root.T


def _common(vertices: list[np.ndarray]) -> np.ndarray | None:
    """P <= I with P - N^T P N >= t I at every vertex, t as large as possible; None where none was
    found.
    """
    n = len(vertices[0])

    # P = sum of x_k basis_k; the last unknown is t
    basis = smat(np.eye(n * (n + 1) // 2))
    count = len(basis)
    every = np.arange(count + 1)
    one = svec(np.eye(n))

    # I - P >= 0, then P - N^T P N - t I >= 0 at every vertex
    items = [Inequality(-np.eye(count), one, every[:-1])]
    for N in vertices:
        items.append(
            Inequality(
                np.column_stack([svec(basis - N.T @ basis @ N).T, -one]), np.zeros(count), every
            )
        )
    try:
        found = minimise(
            np.r_[np.zeros(count), -1.0],
            items,
            tolerance=1e-4,
            time_limit=_TIME_LIMIT,
            hopeless=-1e-12,
        )
    except NumericalFailure:
        return None
    return smat(found.x[:-1]) if found.x[-1] > 0 else None
