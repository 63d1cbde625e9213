"""Linear objective under linear matrix inequalities: minimise c^T x with F_i(x) = F_i0 + sum_j x_j
F_ij >= 0 for every i.

A primal-dual interior-point method: the direction of Helmberg, Kojima and Monteiro, Mehrotra's
predictor and corrector, an infeasible start. Each inequality may depend on few of the variables;
its part of the Schur complement is two products of dense matrices, so that dozens of inequalities
of order 30 in 400 variables cost a tenth of a second per step. Matrices among the variables are
terms of matrix_inequalities.py beside this file: thousands of their entries cost a second. Sources:
Helmberg, Rendl, Vanderbei & Wolkowicz 1996, SIAM J. Optim. 6; Todd, Toh & Tuetuencue 1998, SIAM J.
Optim. 8.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache

import numpy as np
import scipy.linalg as sla

from ambrose.core.checks import NumericalFailure, check_shape, invalid, named_failure

# Symmetric matrices among the variables of matrix inequalities: terms U^T X V + V^T X U and their
# Schur complement.
#
# Written out, a term of order d has n (n + 1)/2 columns of d (d + 1)/2 entries, and its part of the
# Schur complement costs the cube of the variables' number. As a sum of Kronecker products it costs
# its square (Vandenberghe, Balakrishnan, Wallin, Hansson & Roh 2005, in Positive Polynomials in
# Control).


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


_STEPS = 80  # of the method, at most
_SHORT = 1e-7  # a step length below which the method has stalled


@dataclass(frozen=True, slots=True, eq=False)
class Inequality:
    """smat(rows x[columns] + constant) + terms >= 0; rows (d (d + 1)/2, k), constant (d (d +
    1)/2,), columns (k,).

    columns: which of the variables; terms: of matrices among them, each of another one.
    """

    rows: np.ndarray
    constant: np.ndarray
    columns: np.ndarray
    terms: tuple[Term, ...] = ()

    @property
    def side(self) -> int:
        """The order d of the matrix."""
        return side(len(self.constant))

    def value(self, x: np.ndarray) -> np.ndarray:
        """The matrix (d, d) at the variables x, without its constant."""
        matrix = smat(self.rows @ x[self.columns])
        for term in self.terms:
            matrix += term.value(x)
        return matrix

    def add_adjoint(self, M: np.ndarray, result: np.ndarray) -> None:
        """<dF/dx_j, M>, M (d, d) symmetric, added to result (k,) of all variables."""
        result[self.columns] += svec(M) @ self.rows
        for term in self.terms:
            result[term.variable.start : term.variable.stop] += term.adjoint(M)

    def squares(self, count: int) -> np.ndarray:
        """The squared norms of the matrix's derivatives by each of ``count`` variables."""
        norms = np.zeros(count)
        norms[self.columns] += (self.rows**2).sum(0)
        for term in self.terms:
            norms[term.variable.start : term.variable.stop] += term.squares()
        return norms


@dataclass(frozen=True, slots=True, eq=False)
class Minimum:
    """x (k,) with value c^T x; ``bound``: value of the dual, below every feasible value as far as
    ``dual_error`` is zero.

    status: "optimal", "inexact" (progress ended early), "infeasible" or "time limit". primal_error,
    dual_error: relative residuals of the constraints; gap: (value - bound), relative; steps: of the
    method; multipliers: of every inequality Z (d, d), by how much the value falls where it is
    relaxed.
    """

    x: np.ndarray
    value: float
    bound: float
    status: str
    primal_error: float
    dual_error: float
    gap: float
    steps: int
    multipliers: tuple[np.ndarray, ...] = ()


def svec(M: np.ndarray) -> np.ndarray:
    """Upper triangles of symmetric matrices (..., d, d), column by column, off-diagonal entries
    times sqrt(2).
    """
    upper, _, weight = _places(M.shape[-1])
    return M.reshape(*M.shape[:-2], M.shape[-1] ** 2).take(upper, -1) * weight


def smat(v: np.ndarray) -> np.ndarray:
    """The inverse of ``svec``: v (..., d (d + 1)/2) -> (..., d, d)."""
    d = side(v.shape[-1])
    upper, lower, weight = _places(d)
    M = np.empty((*v.shape[:-1], d * d))
    M[..., upper] = M[..., lower] = v / weight
    return M.reshape(*v.shape[:-1], d, d)


@cache
def _places(d: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of the entries of ``svec``: where they stand in the flat matrix, where their mirror images
    do, and their weights.
    """
    j, i = np.tril_indices(d)
    return d * i + j, d * j + i, np.where(i == j, 1.0, np.sqrt(2.0))


def side(length: int) -> int:
    """d for a vector of length d (d + 1)/2."""
    return round((np.sqrt(8 * length + 1) - 1) / 2)


@named_failure("the minimum under matrix inequalities")
def minimise(
    cost: np.ndarray,
    inequalities: Sequence[Inequality],
    *,
    tolerance: float = 1e-7,
    time_limit: float = 60.0,
    hopeless: float = np.inf,
) -> Minimum:
    """The x (k,) with the smallest cost^T x; strictly inside every inequality as long as the method
    has not converged.

    cost (k,); tolerance: relative, of gap and residuals; time_limit [s]; hopeless: end as
    "infeasible" as soon as the dual proves that no value below this one exists. Raises InvalidInput
    for sizes that do not fit, NumericalFailure when a step cannot be computed from the start on.
    """
    cost = check_shape(cost, "cost", "(k)")
    for i, item in enumerate(inequalities):
        if item.rows.shape != (len(item.constant), len(item.columns)):
            raise invalid(
                f"the shape of inequality {i}",
                item.rows.shape,
                "(d (d + 1)/2, columns)",
                "use svec",
            )
    return _Solver(cost, [item for item in inequalities if len(item.constant)]).run(
        tolerance, time_limit, hopeless
    )


class _Solver:
    """The iterates: x, and for every inequality its slack S and multiplier Z (d, d).

    The variables are in units (k,) in which their derivatives have norm 1.
    """

    def __init__(self, cost: np.ndarray, items: Sequence[Inequality]) -> None:
        # units: the derivatives of all F_i by one variable, taken together, have norm 1
        squares = [item.squares(len(cost)) for item in items]
        size = np.sqrt(np.sum(squares, axis=0))
        size[size == 0] = 1.0
        self.unit = 1 / size
        self.cost = cost * self.unit
        self.items = items

        # F_i1, F_i2 ... below each other, (k d, d); and what (G + G^T)[upper] is multiplied by for
        # <sym(G), F_ij>, (d (d + 1)/2, k)
        self.tall = [smat(i.rows.T).reshape(len(i.columns) * i.side, i.side) for i in items]
        self.halves = [_places(i.side)[2][:, None] * i.rows / 2 for i in items]
        self.order = sum(item.side for item in items)
        self.x = np.zeros(len(cost))

        # An infeasible start: multiples of I, Z large beside the cost per derivative, S beside
        # F_i0.
        reach = [
            i.side
            * (1 + np.abs(self.cost[norms > 0]).max(initial=0))
            / (1 + np.sqrt(norms.max(initial=0)))
            for i, norms in zip(items, (norms * self.unit**2 for norms in squares), strict=True)
        ]
        self.Z = [
            max(10.0, np.sqrt(i.side), np.sqrt(i.side) * f) * np.eye(i.side)
            for i, f in zip(items, reach, strict=True)
        ]
        self.S = [
            max(10.0, np.sqrt(i.side), float(np.linalg.norm(i.constant))) * np.eye(i.side)
            for i in items
        ]

    def run(self, tolerance: float, time_limit: float, hopeless: float) -> Minimum:
        begun = time.monotonic()
        status, step = "inexact", 0
        for step in range(1, _STEPS + 1):
            iterate = self.minimum("optimal", step)
            if max(iterate.gap, iterate.primal_error, iterate.dual_error) < tolerance:
                return iterate
            if self.infeasible(iterate) or (
                iterate.bound > hopeless and iterate.dual_error < tolerance
            ):
                status = "infeasible"
                break
            if time.monotonic() - begun > time_limit:
                status = "time limit"
                break
            try:
                if not self.step(iterate):
                    break
            except np.linalg.LinAlgError as error:
                if step == 1:
                    raise NumericalFailure(
                        "the matrix inequalities are singular at the start; scale the problem"
                    ) from error
                break
        return self.minimum(status, step)

    def minimum(self, status: str, step: int) -> Minimum:
        value = float(self.cost @ self.x)

        # the dual: maximise -sum_i <F_i0, Z_i> with sum_i <F_ij, Z_i> = c_j, Z_i >= 0
        bound = -sum(float(i.constant @ svec(Z)) for i, Z in zip(self.items, self.Z, strict=True))
        r = self.residuals()
        primal = max(
            float(np.linalg.norm(R)) / (1 + float(np.linalg.norm(i.constant)))
            for R, i in zip(r, self.items, strict=True)
        )
        dual = float(np.linalg.norm(self.cost - self.adjoint(self.Z))) / (
            1 + float(np.linalg.norm(self.cost))
        )
        gap = self.complementarity() / (1 + abs(value) + abs(bound))
        x, Z = self.x * self.unit, tuple(self.Z)
        return Minimum(x, value, bound, status, primal, dual, gap, step, Z)

    def infeasible(self, iterate: Minimum) -> bool:
        """Whether Z, scaled, is a certificate: F^T(Z) = 0 and -<F_0, Z> > 0."""
        # relative to <F_0, Z>: F^T(Z) is zero but for rounding, and no x has come near
        direction = float(np.linalg.norm(self.adjoint(self.Z)))
        return (
            iterate.bound > 1e-12
            and direction < 1e-8 * iterate.bound
            and iterate.primal_error > 1e-6
        )

    def residuals(self) -> list[np.ndarray]:
        """F_i(x) - S_i."""
        x = self.x * self.unit
        return [i.value(x) + smat(i.constant) - S for i, S in zip(self.items, self.S, strict=True)]

    def adjoint(self, matrices: Sequence[np.ndarray]) -> np.ndarray:
        """sum_i <F_ij, M_i> for every variable j."""
        result = np.zeros(len(self.cost))
        for i, M in zip(self.items, matrices, strict=True):
            i.add_adjoint(M, result)
        return result * self.unit

    def complementarity(self) -> float:
        return float(sum(np.sum(S * Z) for S, Z in zip(self.S, self.Z, strict=True)))

    def step(self, iterate: Minimum) -> bool:
        """One predictor and corrector; whether it moved on."""
        roots, roots_z = ([_root(M) for M in matrices] for matrices in (self.S, self.Z))
        inverse = [half.T @ half for half in roots]
        factor = self.schur_complement(inverse)
        mu = self.complementarity() / self.order
        r = self.residuals()

        # Predictor: mu = 0, and the mu that its longest steps, a of S and b of Z, would leave.
        dx, dS, dZ = self.direction(factor, inverse, r, 0.0, None)
        a, b = _longest(roots, dS), _longest(roots_z, dZ)
        after = (
            sum(
                np.sum((S + a * d) * (Z + b * e))
                for S, d, Z, e in zip(self.S, dS, self.Z, dZ, strict=True)
            )
            / self.order
        )

        # centre: the share (mu_after / mu)^power of mu to keep (Mehrotra), small where the
        # predictor comes far
        power = max(1.0, 3 * min(a, b) ** 2)
        centre = min(1.0, max(float(after) / mu, 1e-6) ** power)

        # Corrector: the term of second order, sym(dZ dS S^-1).
        second = [_symmetric(e @ d @ W) for d, e, W in zip(dS, dZ, inverse, strict=True)]
        dx, dS, dZ = self.direction(factor, inverse, r, centre * mu, second)
        share = 0.9 + 0.09 * min(1.0, a, b)  # of the way to the boundary, never beyond
        a, b = (min(1.0, share * _longest(M, d)) for M, d in ((roots, dS), (roots_z, dZ)))
        self.x = self.x + a * dx
        self.S = [S + a * d for S, d in zip(self.S, dS, strict=True)]
        self.Z = [Z + b * d for Z, d in zip(self.Z, dZ, strict=True)]
        return max(a, b) > _SHORT

    def schur_complement(self, inverse: Sequence[np.ndarray]) -> tuple[np.ndarray, bool]:
        """Cholesky factor of M_jk = sum_i tr(F_ij Z_i F_ik S_i^-1)."""
        M = np.zeros((len(self.cost), len(self.cost)))
        products: dict[
            tuple[MatrixVariable, MatrixVariable], tuple[list[np.ndarray], list[np.ndarray]]
        ] = {}
        for i, F, rows, Z, W in zip(
            self.items, self.tall, self.halves, self.Z, inverse, strict=True
        ):
            d, k = i.side, len(i.columns)

            # G_j = Z F_j S^-1, (k, d, d): M_jk = <sym(G_j), F_k>
            G = Z @ (F @ W).reshape(k, d, d)
            upper, lower, _ = _places(d)
            flat = G.reshape(k, d * d)
            M[np.ix_(i.columns, i.columns)] += (flat.take(upper, 1) + flat.take(lower, 1)) @ rows

            # Terms of matrix variables: with the columns written out, <G_j, term>, and with one
            # another as Kronecker products, gathered over the inequalities. Mixed parts are entered
            # on one side, twice: (M + M^T) / 2 below makes it one on both.
            for n, a in enumerate(i.terms):
                span = slice(a.variable.start, a.variable.stop)
                for column, inner in zip(i.columns, G, strict=True):
                    # its mirror image is left to the end
                    M[span, column] += 2 * a.adjoint(_symmetric(inner))
                for b in i.terms[n:]:
                    P, Q = products.setdefault((a.variable, b.variable), ([], []))
                    factors = kronecker(a, b, Z, W)
                    P += factors[0]
                    Q += factors[1]
        for (first, second), (P, Q) in products.items():
            double = 1 if first is second else 2
            M[first.start : first.stop, second.start : second.stop] += double * curvature(
                first, second, P, Q
            )

        # in the units of the variables
        M *= self.unit[:, None] * self.unit
        M = (M + M.T) / 2
        diagonal = np.diag_indices(len(M))
        # 1: a variable that appears nowhere
        M[diagonal] = np.where(M[diagonal] > 0, M[diagonal] * (1 + 1e-14), 1.0)
        return sla.cho_factor(M, check_finite=False)

    def direction(
        self,
        factor: tuple[np.ndarray, bool],
        inverse: Sequence[np.ndarray],
        r: Sequence[np.ndarray],
        mu: float,
        second: Sequence[np.ndarray] | None,
    ) -> tuple[np.ndarray, list[np.ndarray], list[np.ndarray]]:
        """dx, dS and dZ = mu S^-1 - Z - sym(Z dS S^-1) - second."""
        # With dS = F(dx) + r: dZ = fixed - Z - sym(Z F(dx) S^-1),
        # fixed = mu S^-1 - sym(Z r S^-1) - second
        fixed = [mu * W - _symmetric(Z @ R @ W) for W, Z, R in zip(inverse, self.Z, r, strict=True)]
        if second is not None:
            fixed = [f - s for f, s in zip(fixed, second, strict=True)]

        # dual feasible after a full step, F^T(Z + dZ) = c: M dx = F^T(fixed) - c
        dx = sla.cho_solve(factor, self.adjoint(fixed) - self.cost)
        change = [i.value(dx * self.unit) for i in self.items]
        dS = [c + R for c, R in zip(change, r, strict=True)]
        dZ = [
            f - Z - _symmetric(Z @ c @ W)
            for f, Z, c, W in zip(fixed, self.Z, change, inverse, strict=True)
        ]
        return dx, dS, dZ


def _symmetric(M: np.ndarray) -> np.ndarray:
    return (M + M.T) / 2


def _root(M: np.ndarray) -> np.ndarray:
    """L^-1 of M = L L^T (d, d): M^-1 is its product with itself, L^-T L^-1."""
    L = np.linalg.cholesky(M)
    return np.asarray(sla.solve_triangular(L, np.eye(len(M)), lower=True, check_finite=False))


def _longest(roots: Sequence[np.ndarray], changes: Sequence[np.ndarray]) -> float:
    """The largest step, at most 1e3, that keeps every matrix positive definite; roots: L^-1 of
    each.
    """
    smallest = 0.0
    for half, change in zip(roots, changes, strict=True):
        # M + a dM > 0 as long as I + a L^-1 dM L^-T > 0
        inner = half @ change @ half.T
        smallest = min(smallest, float(np.linalg.eigvalsh(_symmetric(inner))[0]))
    return min(1e3, -1 / smallest) if smallest < 0 else 1e3
