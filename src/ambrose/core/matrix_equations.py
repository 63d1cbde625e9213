"""Lyapunov and Riccati equations, Gramians and balanced realisations.

Everything is balanced by exact diagonal scaling first, and every result is put back into its
equation: what does not fit is not returned.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.linalg as sla
from numpy.typing import ArrayLike

from ambrose.core.checks import (
    InvalidInput,
    NumericalFailure,
    UnstableSystem,
    check_shape,
    invalid,
    named_failure,
)
from ambrose.core.frequency import schur_eigenvalues
from ambrose.core.statespace import (
    StateSpace,
    as_statespace,
    balance_matrix as balance,
    balance_system,
)

_RESIDUAL = 1e-8  # largest accepted residual, relative to the terms of the equation
_EPS = float(np.finfo(float).eps)


@named_failure("the solution of the Lyapunov equation")
def lyapunov(A: ArrayLike, Q: ArrayLike) -> np.ndarray:
    """X (n, n) with A X + X A^T + Q = 0.

    A (n, n); Q (n, n), any; a symmetric Q gives a symmetric X. The residual is at most 1e-8 of the
    equation's terms. Raises NumericalFailure otherwise, and when A and -A share an eigenvalue.
    Source: Bartels & Stewart 1972, on the complex Schur form of the balanced A.
    """
    return _lyapunov(*_square(A, Q), discrete=False)


@named_failure("the solution of the Lyapunov equation")
def discrete_lyapunov(A: ArrayLike, Q: ArrayLike) -> np.ndarray:
    """X (n, n) with A X A^T - X + Q = 0.

    A (n, n); Q (n, n), any; a symmetric Q gives a symmetric X. The residual is at most 1e-8 of the
    equation's terms. Raises NumericalFailure otherwise, and when the product of two eigenvalues of
    A is 1. Source: Kitagawa 1977, on the complex Schur form of the balanced A.
    """
    return _lyapunov(*_square(A, Q), discrete=True)


def _square(A: ArrayLike, Q: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    a = check_shape(A, "A", "(n, n)")
    return a, check_shape(Q, "Q", "(n, n)", n=a.shape[0])


def _lyapunov(A: np.ndarray, Q: np.ndarray, discrete: bool) -> np.ndarray:
    if A.shape[0] == 0:
        return np.zeros((0, 0))

    # x = diag(t) z: X = diag(t) Z diag(t), Q likewise.
    A, t = balance(A)
    Q = Q / t[:, None] / t
    T, U = sla.schur(A, output="complex")

    # No unique X where two eigenvalues add up to 0 (multiply to 1), to ten rounding errors of each.
    size = np.abs(T)
    error = 10 * _EPS * np.maximum(size.max(0), size.max(1))
    poles = np.diag(T)
    if discrete:
        clash = np.abs(poles[:, None] * poles.conj() - 1) - error[:, None] - error
    else:
        clash = np.abs(poles[:, None] + poles.conj()) - error[:, None] - error
    if clash.min() <= 0:
        i, j = np.unravel_index(np.argmin(clash), clash.shape)
        what = "with the product 1" if discrete else "with the sum 0"
        raise NumericalFailure(
            f"the Lyapunov equation has no unique solution: A has the eigenvalues {poles[i]:.6g} "
            f"and {poles[j].conj():.6g} "
            f"{what}; remove or shift marginal states first"
        )

    # A = U T U^H: X = U Y U^H with T Y + Y T^H + U^H Q U = 0 (sampled: T Y T^H - Y + U^H Q U = 0)
    X = U @ _triangular_lyapunov(T, U.conj().T @ Q @ U, discrete) @ U.conj().T
    if np.isrealobj(A) and np.isrealobj(Q):
        X = X.real
    if np.array_equal(Q, Q.conj().T):
        X = (X + X.conj().T) / 2

    # Put back into the balanced equation, relative to its three terms.
    AX = A @ X
    terms = np.array((AX @ A.conj().T, -X, Q) if discrete else (AX, X @ A.conj().T, Q))
    residual = float(
        np.linalg.norm(terms.sum(axis=0)) / max(np.linalg.norm(terms, axis=(1, 2)).sum(), 1e-280)
    )
    if not residual <= _RESIDUAL:
        raise NumericalFailure(
            f"the Lyapunov equation's relative residual is {residual:.2g}, but must be at most "
            f"{_RESIDUAL:g}; "
            "a pole is too close to the stability boundary, or the states are badly scaled"
        )
    return X * t[:, None] * t


def _triangular_lyapunov(T: np.ndarray, Q: np.ndarray, discrete: bool) -> np.ndarray:
    """Y with T Y + Y T^H + Q = 0, or T Y T^H - Y + Q = 0, for upper triangular T (n, n): the last
    column first.
    """
    n = T.shape[0]
    Y = np.zeros((n, n), dtype=complex)
    for j in range(n - 1, -1, -1):
        # Column j of Y T^H is sum_(i >= j) y_i conj(T_ji): known + y_j conj(T_jj).
        known = Y[:, j + 1 :] @ T[j, j + 1 :].conj()
        shift = T[j, j].conj()
        if discrete:
            # (conj(T_jj) T - I) y_j = -q_j - T known
            left, right = shift * T, -Q[:, j] - T @ known
            left[np.diag_indices(n)] -= 1
        else:
            # (T + conj(T_jj) I) y_j = -q_j - known
            left, right = T.copy(order="F"), -Q[:, j] - known
            left[np.diag_indices(n)] += shift
        Y[:, j] = sla.blas.ztrsv(left, right)
    return Y


@dataclass(frozen=True, slots=True, eq=False)
class RiccatiSolution:
    """The stabilising solution of A^T X + X A - X G X + Q = 0, or why there is none.

    X (n, n) symmetric; closed_loop_poles (n,): eigenvalues of A - G X; residual: relative to the
    sum of the equation's terms. status: "solved", or the reason: "imaginary-axis eigenvalues", "X1
    singular", "inaccurate"; X is NaN unless solved.
    """

    X: np.ndarray
    closed_loop_poles: np.ndarray
    residual: float
    status: str

    @property
    def solved(self) -> bool:
        return self.status == "solved"


def solve_riccati(A: ArrayLike, G: ArrayLike, Q: ArrayLike) -> RiccatiSolution:
    """The stabilising solution of A^T X + X A - X G X + Q = 0: the eigenvalues of A - G X lie in
    the open left half plane.

    A (n, n); G (n, n) and Q (n, n) symmetric, either may be indefinite. For LQR G = B R^-1 B^T; for
    H-infinity control G = B2 B2^T - gamma^-2 B1 B1^T. A solution leaves at most 1e-8 of the
    equation's terms. Failure is a ``status``, not an exception; raises InvalidInput only. Source:
    Laub 1979 (Schur vectors of the Hamiltonian), with symplectic balancing (Benner 2001).
    """
    a = check_shape(A, "A", "(n, n)")
    n = a.shape[0]
    if n == 0:
        return RiccatiSolution(np.zeros((0, 0)), np.zeros(0, complex), 0.0, "solved")
    g, q = _symmetric(G, "G", n), _symmetric(Q, "Q", n)

    found = _balanced_riccati(a, g, q)
    if found.status in ("inaccurate", "asymmetric") and np.isfinite(found.X).all():
        # An X that spans many decades is lost to rounding in states with one scale each. In the
        # states z, x = T z with T^T X T near I, nothing is small beside anything else.
        values, U = np.linalg.eigh(found.X)
        size = np.sqrt(np.maximum(np.abs(values), 1e-14 * np.abs(values).max()))
        T, inverse = U / size, (U * size).T
        G_z, Q_z = inverse @ g @ inverse.T, T.T @ q @ T
        again = _balanced_riccati(inverse @ a @ T, (G_z + G_z.T) / 2, (Q_z + Q_z.T) / 2)
        X = inverse.T @ again.X @ inverse
        found = replace(again, X=(X + X.T) / 2)
    if not found.solved:
        nan = np.full((n, n), np.nan)
        why = "imaginary-axis eigenvalues" if found.status == "asymmetric" else found.status
        return RiccatiSolution(nan, nan[0].astype(complex), found.residual, why)
    return found


def _balanced_riccati(a: np.ndarray, g: np.ndarray, q: np.ndarray) -> RiccatiSolution:
    """The solution in states balanced by one scale each; X also where the status is "inaccurate" or
    "asymmetric" (of a subspace that is not Lagrangian, or whose rounding hides that it is).
    """
    # Balanced by a similarity that keeps the Hamiltonian a Hamiltonian: of the scales of x and of
    # its costate only the ratio is free.
    n = len(a)
    scale = balance(np.block([[a, -g], [-q, -a.T]]))[1]
    d = np.exp2(np.round(np.log2(scale[:n] / scale[n:]) / 2))  # diag(d, 1/d) is symplectic

    # x = diag(d) z: A -> d^-1 A d, G -> d^-1 G d^-1, Q -> d Q d, X -> d X d
    a = a * d / d[:, None]
    g = g / d[:, None] / d
    q = q * d[:, None] * d
    X = np.full((n, n), np.nan)
    residual = np.inf
    poles = np.full(n, np.nan, complex)
    try:
        X, status = _stable_subspace(np.block([[a, -g], [-q, -a.T]]))
        if status == "solved":
            X, residual = _refine(a, g, q, X)
            poles = np.linalg.eigvals(a - g @ X)
            if not residual <= _RESIDUAL:
                status = "inaccurate"
            elif poles.real.max() >= 0:
                status = "imaginary-axis eigenvalues"
    except ValueError:  # LAPACK's refusal, or scipy's of what overflowed
        status = "inaccurate"

    # Back: X = d^-1 X_z d^-1; the poles do not change.
    return RiccatiSolution(X / d[:, None] / d, poles, float(residual), status)


def _symmetric(X: ArrayLike, name: str, n: int) -> np.ndarray:
    x = check_shape(X, name, "(n, n)", n=n)
    if np.abs(x - x.T).max(initial=0.0) > 1e-10 * np.abs(x).max(initial=0.0):
        raise invalid(name, "not symmetric", "symmetric", "use its symmetric part")
    return (x + x.T) / 2


def _stable_subspace(H: np.ndarray) -> tuple[np.ndarray, str]:
    """X = X2 X1^-1 from the n most stable Schur vectors of the Hamiltonian (2n, 2n), and the
    status.

    The n most stable eigenvalues are taken, whatever their sign after rounding: slow poles far
    below the norm would break a count of negative real parts. That they mirror the others shows in
    the symmetry of X (a Lagrangian subspace).
    """
    n = H.shape[0] // 2
    T, Z = sla.schur(H)
    values = schur_eigenvalues(T)
    order = np.argsort(values.real, kind="stable")

    # A complex pair on the axis, to rounding: no stabilising X. Real ones near zero may be slow
    # poles.
    if ((np.abs(values.real) <= 10 * _EPS * np.abs(T).max()) & (values.imag != 0)).any():
        return H[:n, :n], "imaginary-axis eigenvalues"

    # The n most stable ones to the front of the Schur form; m != n where that would part a pair.
    select = np.zeros(2 * n, dtype=np.int32)
    select[order[:n]] = 1
    _, Z, *_, m, _, _, info = sla.lapack.dtrsen(select, T, Z, job=b"N")
    if info != 0 or m != n:
        return H[:n, :n], "imaginary-axis eigenvalues"

    # Z[:, :n] = [X1; X2]. X1 singular: the subspace is no graph over x.
    lu, pivots, singular = sla.lapack.dgetrf(Z[:n, :n])
    if singular or sla.lapack.dgecon(lu, np.abs(Z[:n, :n]).sum(axis=0).max())[0] < 10 * _EPS:
        return H[:n, :n], "X1 singular"

    # X X1 = X2, solved as X1^T X^T = X2^T
    X = sla.lapack.dgetrs(lu, pivots, Z[n:, :n].T, trans=1)[0].T
    # a Lagrangian subspace gives a symmetric X
    lagrangian = np.abs(X - X.T).max() <= 1e-5 * np.abs(X).max()
    return (X + X.T) / 2, "solved" if lagrangian else "asymmetric"


def _refine(A: np.ndarray, G: np.ndarray, Q: np.ndarray, X: np.ndarray) -> tuple[np.ndarray, float]:
    """One Newton step where the residual asks for it, kept only if it helps; the residual
    (relative).
    """

    def put_in(X: np.ndarray) -> tuple[np.ndarray, float]:
        XA, XGX = X @ A, X @ G @ X
        R = XA + XA.T - XGX + Q
        terms = 2 * np.linalg.norm(XA) + np.linalg.norm(XGX) + np.linalg.norm(Q)
        return R, float(np.linalg.norm(R)) / max(float(terms), 1e-280)

    R, residual = put_in(X)
    if residual > 1e-13:
        try:
            # (A - G X)^T dX + dX (A - G X) + R = 0, the residual R to first order in dX
            better = X + lyapunov((A - G @ X).T, (R + R.T) / 2)
        except (NumericalFailure, InvalidInput):  # none, or out of range
            return X, residual
        if put_in(better)[1] < residual:
            return better, put_in(better)[1]
    return X, residual


@named_failure("the controllability Gramian")
def controllability_gramian(system: Any) -> np.ndarray:
    """P (n, n) with A P + P A^T + B B^T = 0, or A P A^T - P + B B^T = 0 when sampled. Raises
    UnstableSystem.
    """
    system = as_statespace(system)
    L = _gramian_factor(system.A, system.B, system.dt is not None)
    return L @ L.T


@named_failure("the observability Gramian")
def observability_gramian(system: Any) -> np.ndarray:
    """Q (n, n) with A^T Q + Q A + C^T C = 0, or A^T Q A - Q + C^T C = 0 when sampled. Raises
    UnstableSystem.
    """
    system = as_statespace(system)
    L = _gramian_factor(system.A.T, system.C.T, system.dt is not None)
    return L @ L.T


def _gramian_factor(A: np.ndarray, B: np.ndarray, discrete: bool) -> np.ndarray:
    """L (n, n) real with P = L L^T, found without forming P, so that small singular values keep
    their digits.

    Source: Hammarling 1982, on the complex Schur form, one column at a time; real and imaginary
    parts side by side are a real factor of the same Gramian.
    """
    n = A.shape[0]
    if n == 0:
        return np.zeros((0, 0))

    # The output plays no part; x = diag(t) z.
    A, B, _, t = balance_system(A, B, np.zeros((1, n)))
    T, U = sla.schur(A, output="complex")

    # Stable by more than ten rounding errors of each pole.
    size = np.abs(T)
    poles, error = np.diag(T), 10 * _EPS * np.maximum(size.max(0), size.max(1))
    distance = 1 - np.abs(poles) if discrete else -poles.real
    if (distance <= error).any():
        worst = poles[np.argmin(distance - error)]
        raise UnstableSystem(
            f"the pole {'z' if discrete else 's'} = {worst:.6g} is not inside the stability "
            "region, so the Gramian does not "
            "exist; stabilise the system, or split off its unstable part"
        )

    # U^H P U = R R^H, R upper triangular, W = U^H B: T R R^H + R R^H T^H + W W^H = 0
    # (sampled: T R R^H T^H - R R^H + W W^H = 0).
    # The last row and column first: T = [T11 t; 0 tau], R = [R11 r; 0 rho], W = [W1; b]; t is
    # ``above``, and a smaller equation of the same kind in R11 is left, with a new W1.
    R = np.zeros((n, n), dtype=complex)
    W = (U.conj().T @ B).astype(complex)
    for k in range(n - 1, -1, -1):
        b = W[k]
        tau = T[k, k]
        above = T[:k, k]
        size_b = np.linalg.norm(b)

        # rho = 0, and with it the whole column of R R^H >= 0: r = 0, W1 stays.
        if size_b == 0.0:
            W = W[:k]
            continue

        # (2, 2): rho^2 alpha^2 = b b^H, alpha^2 = -2 Re tau (sampled: 1 - |tau|^2, in factors)
        unit = b.conj() / size_b
        alpha = np.sqrt((1 - abs(tau)) * (1 + abs(tau)) if discrete else -2 * tau.real)
        R[k, k] = rho = size_b / alpha

        # (1, 2), divided by rho: (T11 + conj(tau)) r = -t rho - alpha c, c = W1 b^H/|b|
        # sampled: (conj(tau) T11 - I) r = -t rho conj(tau) - alpha c
        c = W[:k] @ unit
        left = T[:k, :k] * tau.conj() if discrete else T[:k, :k].copy(order="F")
        left[np.diag_indices(k)] += -1 if discrete else tau.conj()
        if k:
            r = sla.blas.ztrsv(
                left,
                -above * rho * tau.conj() - alpha * c if discrete else -above * rho - alpha * c,
            )
            R[:k, k] = r

            # (1, 1): W1 <- W1 - alpha r b/|b|
            # sampled: W1 <- W1 + (alpha (T11 r + t rho) - tau c - c) b/|b|
            change = alpha * (T[:k, :k] @ r + above * rho) - tau * c - c if discrete else -alpha * r
            W = W[:k] + np.outer(change, unit.conj())

    # P = S S^H is real: [Re S, Im S] [Re S, Im S]^T = P, and QR of its transpose makes it square.
    S = U @ R
    factor: np.ndarray = sla.qr(np.hstack([S.real, S.imag]).T, mode="r")[0][:n]
    return factor.T * t[:, None]


@named_failure("the balanced realisation")
def balanced_realization(system: Any) -> tuple[StateSpace, np.ndarray, np.ndarray, np.ndarray]:
    """The realisation with equal, diagonal Gramians: (system, hankel (n,), T_L (k, n), T_R (n, k)).

    The new system has A = T_L A T_R, B = T_L B, C = C T_R, T_L T_R = I; its Gramians are
    diag(hankel[:k]), in descending order. States whose Hankel singular value is below n eps of the
    largest cannot be told from zero and are left out, so k <= n for a system that is not minimal.
    hankel is good to about 1e-15 of the largest times the condition of the poles. Raises
    UnstableSystem. Source: Tombs & Postlethwaite 1987 (square-root method).
    """
    system = as_statespace(system)
    discrete = system.dt is not None
    A, B, C, t = balance_system(system.A, system.B, system.C)
    n = A.shape[0]

    # P = Lc Lc^T, Q = Lo Lo^T; the singular values of Lo^T Lc are sqrt(eig(P Q)).
    Lc, Lo = _gramian_factor(A, B, discrete), _gramian_factor(A.T, C.T, discrete)
    U, hankel, Vt = np.linalg.svd(Lo.T @ Lc)
    k = int((hankel > n * _EPS * hankel.max(initial=0.0)).sum())

    # T_L = S^-1/2 U^T Lo^T, T_R = Lc V S^-1/2, so that T_L T_R = S^-1/2 U^T (U S V^T) V S^-1/2 = I;
    # with t for the states as given.
    root = np.sqrt(hankel[:k])
    T_L = (Lo @ (U[:, :k] / root)).T / t
    T_R = (Lc @ (Vt[:k].T / root)) * t[:, None]
    balanced = StateSpace(
        T_L @ system.A @ T_R,
        T_L @ system.B,
        system.C @ T_R,
        system.D,
        system.inputs,
        system.outputs,
        system.dt,
    )
    return balanced, hankel, T_L, T_R
