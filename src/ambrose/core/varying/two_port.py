"""Worst-case cost to come over a stretch of time, as a two-port between states and costates.

Over a stretch, the largest of the integral of a quadratic form over all inputs, plus lambda1^T x1
at its end, is described by

    x1 = E x0 + G lambda1,    lambda0 = F x0 + E^T lambda1,

F, G symmetric, G >= 0. Stretches compose; a period composed with itself again and again (doubling)
goes to E = 0 and to F = X, the stabilising solution of the Riccati equation over all time to come
(Anderson 1978, Int. J. Control 28; Chu, Fan & Lin 2005, Linear Algebra Appl. 396). Where I - G1 F2
has an eigenvalue that is not positive the largest value is infinite.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla

from ambrose.core.checks import NumericalFailure

_LARGEST = 0.5  # norm of the balanced Hamiltonian times the first step
_DOUBLINGS = 60
_STILL = 1e-13  # change of a doubling, relative, from which on it is rounding


@dataclass(frozen=True, slots=True, eq=False)
class TwoPort:
    """E (n1, n0), G (n1, n1), F (n0, n0)."""

    E: np.ndarray
    G: np.ndarray
    F: np.ndarray

    def in_states(self, T: np.ndarray, inverse: np.ndarray) -> TwoPort:
        """In states x = T x', before and after (n0 = n1)."""
        return TwoPort(
            inverse @ self.E @ T,
            _symmetric(inverse @ self.G @ inverse.T),
            _symmetric(T.T @ self.F @ T),
        )

    def then(self, other: TwoPort, bounded: bool = True) -> TwoPort:
        """This stretch followed by another. Raises NumericalFailure where, with ``bounded``, the
        cost of both is not.
        """
        # 1: this stretch, 2: the other. x1 = E1 x0 + G1 lambda1, lambda1 = F2 x1 + E2^T lambda2:
        # (I - G1 F2) x1 = E1 x0 + G1 E2^T lambda2
        M = np.eye(len(self.G)) - self.G @ other.F
        factors = sla.lu_factor(M, check_finite=False)
        both = sla.lu_solve(factors, np.hstack([self.E, self.G @ other.E.T]), check_finite=False)
        E1, G1 = both[:, : self.E.shape[1]], both[:, self.E.shape[1] :]

        # finite where I - G1 F2 has positive eigenvalues alone
        if not np.isfinite(both).all() or (bounded and not _positive(self.G, other.F)):
            raise NumericalFailure("the cost is unbounded")

        # x2 = E2 x1 + G2 lambda2,   lambda0 = F1 x0 + E1^T lambda1
        return TwoPort(
            other.E @ E1,
            _symmetric(other.G + other.E @ G1),
            _symmetric(self.F + self.E.T @ other.F @ E1),
        )


def _positive(G: np.ndarray, F: np.ndarray) -> bool:
    """Whether I - G F has positive eigenvalues alone, G >= 0: I - L^T F L > 0 with G = L L^T."""
    values, V = np.linalg.eigh(G)
    L = V * np.sqrt(np.maximum(values, 0))
    try:
        np.linalg.cholesky(np.eye(len(G)) - _symmetric(L.T @ F @ L))
    except np.linalg.LinAlgError:
        return False
    return True


def cost_before(port: TwoPort, X: np.ndarray) -> tuple[np.ndarray, float]:
    """The matrix of the largest cost over a stretch with x1^T X x1 at its end, and how far it is
    from unbounded (positive).
    """
    values, V = np.linalg.eigh(port.G)
    L = V * np.sqrt(np.maximum(values, 0))

    # lambda1 = X x1, so that x1 = (I - G X)^-1 E x0 and the cost is F + E^T X (I - G X)^-1 E; with
    # G = L L^T: X (I - G X)^-1 = X + X L (I - L^T X L)^-1 L^T X
    inner = np.eye(len(L)) - _symmetric(L.T @ X @ L)
    room = float(np.linalg.eigvalsh(inner)[0])
    XL = X @ L
    return port.F + _symmetric(port.E.T @ (X + XL @ np.linalg.solve(inner, XL.T)) @ port.E), room


def _symmetric(M: np.ndarray) -> np.ndarray:
    return (M + M.T) / 2


def _negative(R: np.ndarray) -> np.ndarray:
    """(-R)^-1. Raises NumericalFailure unless R < 0."""
    if R.size and np.linalg.eigvalsh(R)[-1] >= 0:
        raise NumericalFailure("the cost is unbounded: an input adds to it at once")
    return np.linalg.inv(-R)


def instant(A: np.ndarray, B: np.ndarray, Q: np.ndarray, S: np.ndarray, R: np.ndarray) -> TwoPort:
    """A jump x1 = A x0 + B d with the cost x0^T Q x0 + 2 x0^T S d + d^T R d, R < 0."""
    # the worst input: d = (-R)^-1 (S^T x0 + B^T lambda1)
    inverse = _negative(R)
    return TwoPort(
        A + B @ inverse @ S.T, _symmetric(B @ inverse @ B.T), _symmetric(Q + S @ inverse @ S.T)
    )


def linear(A: np.ndarray) -> TwoPort:
    """x1 = A x0, no cost, no input."""
    return TwoPort(A, np.zeros((len(A), len(A))), np.zeros((A.shape[1],) * 2))


def flow(
    A: np.ndarray, B: np.ndarray, Q: np.ndarray, S: np.ndarray, R: np.ndarray, time: float
) -> TwoPort:
    """x' = A x + B w with the cost integral x^T Q x + 2 x^T S w + w^T R w, R < 0, over ``time``
    [s].
    """
    # the worst input: w = (-R)^-1 (S^T x + B^T lambda)
    inverse = _negative(R)
    a = A + B @ inverse @ S.T

    # x' = a x + B (-R)^-1 B^T lambda,   lambda' = -(Q + S (-R)^-1 S^T) x - a^T lambda
    H = np.block([[a, B @ inverse @ B.T], [-(Q + S @ inverse @ S.T), -a.T]])

    # A first step h, doubled below until it is the whole time. |W22(t) - I| <= e^(|H| t) - 1 <
    # 1 for |H| t <= 1/2, in any units of the states and costates: W22 stays regular within h, so
    # that the cost does, and ``then`` looks at every doubling.
    n, balanced = len(A), sla.matrix_balance(H, permute=False)[0]
    size = max(np.abs(balanced).sum(axis=1).max(), 1e-300)
    count = max(0, int(np.ceil(np.log2(time * size / _LARGEST))))
    W = sla.expm(H * (time / 2**count))

    # (x1, lambda1) = W (x0, lambda0), solved for (x1, lambda0):
    # x1 = W11 x0 + W12 lambda0,   lambda0 = W22^-1 (lambda1 - W21 x0)
    inv = np.linalg.inv(W[n:, n:])
    port = TwoPort(
        W[:n, :n] - W[:n, n:] @ inv @ W[n:, :n],
        _symmetric(W[:n, n:] @ inv),
        _symmetric(-inv @ W[n:, :n]),
    )
    for _ in range(count):
        port = port.then(port)
    return port


def forever(port: TwoPort) -> np.ndarray:
    """X (n, n): the largest cost x0^T X x0 from a state, over repetitions of a period without end.
    Raises NumericalFailure.
    """
    size = 0.0
    for _ in range(_DOUBLINGS):
        new = port.then(port, bounded=False)
        size = max(size, float(np.abs(new.F).max()))
        change = float(np.abs(new.F - port.F).max())
        port = new

        # settled, and of the state at the end nothing comes back to the beginning
        if change < _STILL * size and np.abs(port.E).max() < 1e-6:
            return port.F
    raise NumericalFailure("the cost does not settle: the loop hardly decays")
