"""Symmetric matrices among the variables of matrix inequalities: terms U^T X V + V^T X U and their
Schur complement.

Written out, a term of order d has n (n + 1)/2 columns of d (d + 1)/2 entries, and its part of the
Schur complement costs the cube of the variables' number. As a sum of Kronecker products it costs
its square (Vandenberghe, Balakrishnan, Wallin, Hansson & Roh 2005, in Positive Polynomials in
Control).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True, slots=True, eq=False)
class MatrixVariable:
    """A symmetric X (n, n), n = ``order``: its entries (i, j), i <= j, of the first ``rows`` rows
    are variables from start on.

    What has neither its row nor its column among them is zero.
    """

    start: int
    order: int
    rows: int
    pairs: tuple[np.ndarray, np.ndarray] = field(init=False)

    def __post_init__(self) -> None:
        i, j = np.triu_indices(self.order)
        object.__setattr__(self, "pairs", (i[i < self.rows], j[i < self.rows]))

    @property
    def stop(self) -> int:
        return self.start + len(self.pairs[0])

    def matrix(self, x: np.ndarray) -> np.ndarray:
        """X (n, n) of all variables (k,)."""
        i, j = self.pairs
        X = np.zeros((self.order, self.order))
        X[i, j] = X[j, i] = x[self.start : self.stop]
        return X

    def entries(self, G: np.ndarray) -> np.ndarray:
        """<E, G> for the derivative E of X by each of its variables, G (n, n)."""
        i, j = self.pairs
        return np.asarray(np.where(i == j, G[i, i], G[i, j] + G[j, i]))


@dataclass(frozen=True, slots=True, eq=False)
class Term:
    """U^T X V + V^T X U with U and V (n, d)."""

    variable: MatrixVariable
    U: np.ndarray
    V: np.ndarray

    def value(self, x: np.ndarray) -> np.ndarray:
        """The term (d, d) of all variables (k,)."""
        half = self.U.T @ self.variable.matrix(x) @ self.V
        return half + half.T

    def adjoint(self, M: np.ndarray) -> np.ndarray:
        """<dF/dx_j, M> for the variables of X, M (d, d) symmetric."""
        return self.variable.entries(2 * self.V @ M @ self.U.T)

    def squares(self) -> np.ndarray:
        """The squared norms of the term's derivatives by the variables of X."""
        # <F_j, F_j> = sum_l tr(E P_l E Q_l) with Z = W = I, E = e_i e_j^T + e_j e_i^T:
        # P_ii Q_jj + P_jj Q_ii + P_ij Q_ij + P_ji Q_ji; on the diagonal, E = e_i e_i^T, P_ii Q_ii
        one, (i, j) = np.eye(self.U.shape[1]), self.variable.pairs
        P, Q = (np.array(M) for M in kronecker(self, self, one, one))
        straight = (P[:, i, i] * Q[:, j, j] + P[:, j, j] * Q[:, i, i]).sum(0)
        crossed = (P[:, i, j] * Q[:, i, j] + P[:, j, i] * Q[:, j, i]).sum(0)
        return np.asarray(np.where(i == j, straight / 2, straight + crossed))


def kronecker(
    a: Term, b: Term, Z: np.ndarray, W: np.ndarray
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """P_l and Q_l with tr(F_j Z F_k W) = sum_l tr(E_j P_l E_k Q_l) for j of the term a and k of
    b.
    """
    # F_j = U_a^T E_j V_a + V_a^T E_j U_a, F_k likewise: the trace has four products, and in each
    # one E_j goes to the front.
    ZU = Z @ b.U.T
    ZV = Z @ b.V.T
    UW = b.U @ W
    VW = b.V @ W
    return [a.V @ ZU, a.V @ ZV, a.U @ ZU, a.U @ ZV], [
        VW @ a.U.T,
        UW @ a.U.T,
        VW @ a.V.T,
        UW @ a.V.T,
    ]


def curvature(
    first: MatrixVariable, second: MatrixVariable, P: Sequence[np.ndarray], Q: Sequence[np.ndarray]
) -> np.ndarray:
    """sum_l tr(E_j P_l E_k Q_l) for the variables j of ``first`` (n, n) and k of ``second`` (m, m);
    P_l (n, m), Q_l (m, n).
    """
    i, j = first.pairs
    c, d = second.pairs
    n = first.order
    left, right = np.array(P), np.array(Q).reshape(len(Q), -1)

    # place[a, b]: which variable the entry (a, b) of X is; len(i), a row dropped at the end: none
    place = np.full((n, n), len(i))
    place[i, j] = place[j, i] = np.arange(len(i))
    block = np.zeros((len(i) + 1, len(c)))

    # E_k = e_c e_d^T + e_d e_c^T, on the diagonal once: half of the two
    weight = np.where(c == d, 0.5, 1.0)[:, None]
    for b in range(n):
        # T[c, d, a] = sum_l P[b, c] Q[d, a]
        T = (left[:, b].T @ right).reshape(second.order, second.order, n)
        block[place[b]] += ((T[c, d] + T[d, c]) * weight).T
    return block[:-1]
