"""The proof for a loop whose matrices follow what is, p, and what is told of it: plant and
controller, scheduled or fixed.

On a cell of the plane of p and what is told, the loop x' = A x + B d, y = C x + d has polynomial
matrices, given as control nets of Bernstein polynomials over the cell's two coordinates: they lie
in the convex hull of the nets' entries. With V = x^T X(p) x, X(p) a polynomial, and |p'| <= rate,
V' + |y|^2 - gamma^2 |d|^2 < 0 is again a polynomial inequality, affine in X's coefficients. Where
it holds for every entry of its control net and both signs of the rate it holds on the whole cell,
however p and what is told move within their cells (bounded real lemma; Wu, Yang, Packard & Becker
1996, Int. J. Robust Nonlinear Control 6, for the function; the hull in place of a grid). A constant
X needs no rate. X(p) is positive where one loop is stable for its p, and cannot become singular on
the way to another p, for there V' would be zero.

X = sum_d T_d(p) X_d in Chebyshev polynomials; from d = 1 on X_d has only the rows and columns of
the states that disturbances reach most. The search takes entries in as it needs them; what it finds
is checked at every one.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import comb

import numpy as np
import scipy.linalg as sla

from ambrose.core.checks import NumericalFailure
from ambrose.core.matrix_inequalities.matrix_variables import MatrixVariable, Term
from ambrose.core.matrix_inequalities.semidefinite import Inequality, minimise, svec
from ambrose.core.norms import hinf_norm
from ambrose.core.statespace import StateSpace, balance, is_stable
from ambrose.core.varying.proof import Proof

# of gamma, above the smallest found, at which the inequality is checked
_ROOMS = (5e-4, 1e-3, 2e-3, 4e-3, 1e-2, 3e-2)
# of gamma, above the smallest found: a proof this close ends the search
_ENOUGH = 2e-3
# rounds at most, and points that a round adds where the inequality fails; assumed
_ROUNDS, _ADDED = 12, 120
_LARGEST = 1e6  # of X, which is I for the loop in the middle
_FLOOR = 1e-12  # of X's largest eigenvalue, in the choice of coordinates
_TOLERANCE = 2e-3  # relative, of one minimum: no closer than _ENOUGH asks for


@dataclass(frozen=True, slots=True, eq=False)
class Cell:
    """Control nets over a cell: A (a, c, n, n), B (a, c, n, m), and p (2, 2), bilinear, in -1 .. 1;
    over a line (2, 1).
    """

    A: np.ndarray
    B: np.ndarray
    p: np.ndarray


def elevated(net: np.ndarray, size: tuple[int, ...]) -> np.ndarray:
    """The same polynomial with a larger control net."""
    return product(np.ones((size[0] - len(net) + 1, size[1] - net.shape[1] + 1)), net)


def product(p: np.ndarray, net: np.ndarray) -> np.ndarray:
    """The control net of a scalar polynomial p (a, c) times one of matrices (b, d, n, m): (a + b -
    1, c + d - 1, n, m).
    """
    (a, c), (b, d) = p.shape, net.shape[:2]
    found = np.zeros((a + b - 1, c + d - 1, *net.shape[2:]))
    # Bernstein: B_i^m B_j^n = (m over i) (n over j) / (m + n over i + j) B_(i + j)^(m + n), in both
    # coordinates.
    weights = [_binomials(size - 1) for size in (a, c, b, d, a + b - 1, c + d - 1)]
    for i in range(a):
        for k in range(c):
            part = weights[0][i] * weights[1][k] * p[i, k] * net
            found[i : i + b, k : k + d] += (
                part * (weights[2][:, None] * weights[3])[:, :, None, None]
            )
    return found / (weights[4][:, None] * weights[5])[:, :, None, None]


def _binomials(n: int) -> np.ndarray:
    return np.array([float(comb(n, k)) for k in range(n + 1)])


@dataclass(frozen=True, slots=True, eq=False)
class _Entry:
    """One inequality: entries of the nets of T_d(p) A (D + 1, n, n) and T_d(p) B (D + 1, n, m), and
    of p' T_d'(p) (D + 1,).
    """

    A: np.ndarray
    B: np.ndarray
    slope: np.ndarray


class CellSearch:
    """The inequalities in coordinates in which the middle loop's own X is I (or those given, T and
    its inverse), and time in its own pace.
    """

    def __init__(
        self,
        cells: Sequence[Cell],
        C: np.ndarray,
        rate: float,
        degree: int,
        share: float,
        coordinates: tuple[np.ndarray, np.ndarray] | None = None,
    ) -> None:
        A, B = middle_of(cells)

        # x = T x': X = I for the loop in the middle; an orthonormal turn leaves it so
        if coordinates is None:
            T, inverse = own_coordinates(A, B, C)
            turn = _reached_first(inverse @ A @ T, inverse @ B)
            coordinates = T @ turn, turn.T @ inverse
        T, inverse = coordinates

        # time in units of 1/pace, the geometric mean of the poles' moduli
        pace = float(np.exp(np.log(np.abs(np.linalg.eigvals(A)) + 1e-9).mean()))
        off = accurate_product(inverse, T)
        # inverse T = I + F, so that T^-1 A T = (I - F + F^2) inverse A T but for F^3
        F = off[0] - np.eye(len(A)) + off[1]

        # left out: F^3, and the rounding of the products with F
        size = float(np.linalg.norm(F, 2))
        skew = size**3 + np.finfo(float).eps * len(A) * size
        self.error = 0.0  # by which rounding in the change of coordinates moves A and B/2

        # x in units of 1/sqrt(pace) as well: A / pace, B / sqrt(pace), C / sqrt(pace) keep the gain
        self.T, self.pace = T, pace
        self.C = sum(accurate_product(C, T)) / np.sqrt(pace)

        # X_0 has all entries as variables; X_1 .. X_D only the rows and columns of the first states
        self.entries: list[_Entry] = []
        self.degree = degree if np.isfinite(rate) else 0
        self.variables: list[MatrixVariable] = []
        for _ in range(self.degree + 1):
            start = self.variables[-1].stop if self.variables else 0
            self.variables.append(
                MatrixVariable(start, len(A), int(np.ceil(share * len(A))) if start else len(A))
            )
        for cell in cells:
            # inverse A T and inverse B in twice the precision
            high, low = accurate_product(cell.A, T)
            turned_A, rest = accurate_product(inverse, high)
            nets = [
                (turned_A + (rest + inverse @ low)) / pace,
                sum(accurate_product(inverse, cell.B)) / np.sqrt(pace),
            ]

            # T^-1 = (I + F)^-1 inverse = (I - F + F^2) inverse, but for F^3
            nets = [net - F @ (net - F @ net) for net in nets]
            of_A, of_B = (float(np.linalg.norm(net, 2, axis=(2, 3)).max()) for net in nets)
            share = 2 * skew + np.finfo(float).eps * len(A)
            self.error = max(self.error, share * (of_A + of_B / 2))
            self.entries += _entries(cell.p, nets[0], nets[1], self.degree, rate / pace)

    @property
    def size(self) -> int:
        """Number of the variables, gamma^2 the last."""
        return self.variables[-1].stop + 1

    def inequality(self, entry: _Entry) -> Inequality:
        # -(V' + |C x + d|^2 - gamma^2 |d|^2) >= 0 over (x, inputs), d the last q of them: corner is
        # the factor of gamma^2, F0 the part without variables.
        (n, m), q = entry.B.shape[1:], len(self.C)
        corner, F0 = np.zeros((n + m, n + m)), np.zeros((n + m, n + m))
        corner[-q:, -q:] = np.eye(q)
        F0[:n, :n], F0[:n, -q:], F0[-q:, :n], F0[-q:, -q:] = (
            -self.C.T @ self.C,
            -self.C.T,
            -self.C,
            -np.eye(q),
        )

        # V' = 2 x^T X (A x + B d) + x^T X' x, X = sum T_d X_d and X' = sum p' T_d' X_d (slope)
        one = np.eye(n, n + m)
        terms = tuple(
            Term(X, -one, np.hstack([A, B]) + slope / 2 * one)
            for X, A, B, slope in zip(self.variables, entry.A, entry.B, entry.slope, strict=True)
        )
        return Inequality(svec(corner)[:, None], svec(F0), np.array([self.size - 1]), terms)

    def bound(self) -> Inequality:
        """X_0 at most _LARGEST: where states hardly matter nothing else keeps it from growing until
        rounding hides the rest.
        """
        X, one = self.variables[0], np.eye(self.variables[0].order)
        term = Term(X, -one / 2, one)
        return Inequality(
            np.zeros((len(svec(one)), 0)), _LARGEST * svec(one), np.zeros(0, int), (term,)
        )

    def functions(self, x: np.ndarray) -> np.ndarray:
        """X_0 .. X_D (D + 1, n, n) of the variables."""
        return np.array([variable.matrix(x) for variable in self.variables])

    def first(self) -> list[int]:
        """Entries to begin with: the largest gains at rest, and those that the middle loop's own X
        fails most.
        """
        # X = X_0 = I, and the loops with p at rest: T_0 = 1, so e.A[0] and e.B[0] are A and B
        X = np.zeros((len(self.variables), *self.entries[0].A.shape[1:]))
        X[0] = np.eye(len(X[0]))
        excess = self.excess(X, 1.0)
        loops = [StateSpace(e.A[0], e.B[0], self.C, np.eye(len(self.C))) for e in self.entries]
        gains = np.array([hinf_norm(loop).value if is_stable(loop) else 0.0 for loop in loops])
        return list(
            dict.fromkeys(
                int(i) for order in (-gains, -excess) for i in np.argsort(order)[: _ADDED // 2]
            )
        )

    def excess(self, X: np.ndarray, gamma: float) -> np.ndarray:
        """The largest eigenvalue of every inequality's left side (e,); it holds where that is
        negative.
        """
        C, q = self.C, len(self.C)
        corner = (1 - gamma**2) * np.eye(q)
        found = []
        for e in self.entries:
            # over (x, d): [X A + A^T X + X' + C^T C, X B + C^T; B^T X + C, (1 - gamma^2) I]
            Y, Z = (X @ e.A).sum(0) + np.tensordot(e.slope / 2, X, 1), (X @ e.B).sum(0) + C.T
            found.append(np.linalg.eigvalsh(np.block([[Y + Y.T + C.T @ C, Z], [Z.T, corner]]))[-1])
        return np.array(found)

    def rounding(self, X: np.ndarray, gamma: float) -> float:
        """A bound of the error of ``excess``: of the coordinates, of the products, and of the
        eigenvalues of what they add up to.
        """
        n, m = self.entries[0].B.shape[1:]
        size = np.linalg.norm(X, 2, axis=(1, 2)).sum()

        # |X A| + |X' / 2| + |X B| over (x, w, d), and beside them |C|^2, |C| and gamma^2
        largest = max(
            np.linalg.norm(np.concatenate([e.A, e.B], axis=2), 2, axis=(1, 2)).sum()
            + np.abs(e.slope).sum() / 2
            for e in self.entries
        )
        own = (1 + np.linalg.norm(self.C, 2)) ** 2 + gamma**2
        return float(
            2 * size * self.error + 4 * (n + m) * np.finfo(float).eps * (size * (1 + largest) + own)
        )


def _entries(p: np.ndarray, A: np.ndarray, B: np.ndarray, degree: int, rate: float) -> list[_Entry]:
    """All of a cell: nets of T_d(p) A, T_d(p) B and p' T_d'(p), of one size, for p' = -rate and
    rate.
    """
    # p^0 .. p^D; size: of the net of p^D
    size = (degree * (p.shape[0] - 1) + 1, degree * (p.shape[1] - 1) + 1)
    powers = [np.ones((1, 1, 1, 1))]
    for _ in range(degree):
        powers.append(product(p, powers[-1]))

    def net(of: np.polynomial.Chebyshev) -> np.ndarray:
        coefficients = of.convert(kind=np.polynomial.Polynomial).coef
        return np.sum([c * elevated(powers[k], size) for k, c in enumerate(coefficients)], axis=0)[
            :, :, 0, 0
        ]

    # T_0 .. T_D; whole: the net's size of T_D A and T_D B, to which all others are elevated
    series = [np.polynomial.Chebyshev.basis(d) for d in range(degree + 1)]
    whole = tuple(max(A.shape[k], B.shape[k]) + size[k] - 1 for k in (0, 1))
    factors = [net(T) for T in series]
    of_A, of_B = (np.stack([elevated(product(T, M), whole) for T in factors], 2) for M in (A, B))
    slopes = np.stack(
        [elevated(net(T.deriv())[:, :, None, None], whole)[:, :, 0, 0] for T in series], 2
    )

    # one entry for each point of the net; p' enters affinely, so its two ends suffice
    flat = (M.reshape(-1, *M.shape[2:]) for M in (of_A, of_B, slopes))
    signs = (-rate, rate) if degree else (0.0,)
    return [_Entry(a, b, sign * slope) for a, b, slope in zip(*flat, strict=True) for sign in signs]


def accurate_product(A: np.ndarray, B: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A B (..., n, m) as two matrices, as if in twice the precision (Ogita, Rump & Oishi 2005, SIAM
    J. Sci. Comput. 26).
    """
    shape = np.broadcast_shapes(A.shape[:-2], B.shape[:-2])
    high, low = np.zeros((2, *shape, A.shape[-2], B.shape[-1]))
    for k in range(A.shape[-1]):
        # A_ik B_kj exactly, as product + error
        product, error = _product_and_error(A[..., :, k, None], B[..., k, None, :])

        # high + product exactly, as total and the rest (two-sum of Knuth)
        total = high + product
        kept = total - high
        low += error + ((high - (total - kept)) + (product - kept))
        high = total
    return high, low


def _product_and_error(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """a b and what rounding took from it, by splitting both into halves (Dekker 1971)."""
    (a1, a2), (b1, b2) = _halves(a), _halves(b)
    product = a * b
    return product, a2 * b2 - (((product - a1 * b1) - a2 * b1) - a1 * b2)


def _halves(a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    high = a * 134217729.0  # 2^27 + 1
    high = high - (high - a)
    return high, a - high


def middle_of(cells: Sequence[Cell]) -> tuple[np.ndarray, np.ndarray]:
    """A and B in the middle of the cell in the middle."""
    middle = cells[len(cells) // 2]
    return middle.A.mean(axis=(0, 1)), middle.B.mean(axis=(0, 1))


def own_coordinates(A: np.ndarray, B: np.ndarray, C: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """T and its inverse, x = T x', in which the loop's own bounded-real X, 5 % above its gain, is
    about I.
    """
    # x = t x_b, in which A is balanced
    A, t = balance(A)
    B, C, q = B / t[:, None], C * t, len(C)
    gamma = 1.05 * hinf_norm(StateSpace(A, B, C, np.eye(q))).value

    # A^T X + X A + C^T C + (X B + C^T) R^-1 (B^T X + C) = 0 with R = (gamma^2 - 1) I; 1e-9 I keeps
    # X positive where y does not show a state.
    R = (gamma**2 - 1) * np.eye(q)
    inner = np.linalg.solve(R, C)
    try:
        X = sla.solve_continuous_are(
            A + B @ inner, B, C.T @ C + C.T @ inner + 1e-9 * np.eye(len(A)), -R
        )
    except (np.linalg.LinAlgError, ValueError) as error:
        raise NumericalFailure(
            "the loop at rest in the middle of the range has no bounded-real function"
        ) from error

    # X = V diag(values) V^T: x_b = V / root x' makes it I
    values, V = np.linalg.eigh((X + X.T) / 2)
    root = np.sqrt(np.maximum(values, _FLOOR * values.max()))
    return t[:, None] * (V / root), (V * root).T / t


def _reached_first(A: np.ndarray, B: np.ndarray) -> np.ndarray:
    """An orthonormal basis (n, n) of the states, those first that disturbances reach most."""
    return np.linalg.eigh(sla.solve_continuous_lyapunov(A, -B @ B.T))[1][:, ::-1]


def proved_on_cells(
    cells: Sequence[Cell],
    C: np.ndarray,
    rate: float = np.inf,
    *,
    degree: int = 2,
    share: float = 1.0,
    time_limit: float = 600.0,
    tell: Callable[[str], None] = lambda text: None,
) -> Proof:
    """The smallest gamma for which a proof is found, over all motions within the cells with |p'| <=
    rate [1/s].

    degree: of X(p); share: of the states whose rows of X change with p; time_limit [s]: of all.
    Raises NumericalFailure where none is found, with the reason.
    """
    search = CellSearch(cells, C, rate, degree, share)
    chosen = search.first()
    best = None
    reason = ""
    bounded = True
    end = time.monotonic() + time_limit
    for step in range(_ROUNDS):
        # the smallest gamma^2 at the entries chosen so far
        items = [search.inequality(search.entries[i]) for i in chosen] + [search.bound()] * bounded
        found = minimise(
            np.eye(1, search.size, search.size - 1)[0],
            items,
            tolerance=_TOLERANCE,
            time_limit=end - time.monotonic(),
        )
        if found.status == "time limit":
            reason = (
                f"the search was not at its end after {time_limit:.0f} s; a smaller error or fewer "
                "grid points help"
            )
            break

        # the bound on X_0 may be what makes it infeasible: once more without
        if found.status == "infeasible" and bounded:
            bounded = False
            continue
        if found.status == "infeasible" or found.x[-1] <= 0:
            reason = (
                "no quadratic function proves the loop stable while the parameter moves "
                f"({found.status})"
            )
            break
        X = search.functions(found.x)
        least = float(np.sqrt(found.x[-1]))
        rounding = search.rounding(X, least * (1 + _ROOMS[-1]))
        tell(
            f"round {step + 1}: gain below {least:.4f} at {len(chosen)} of {len(search.entries)} "
            "entries"
        )

        # at every entry, a little above: at the least gamma the inequality holds with no slack
        for room in _ROOMS:
            gamma = least * (1 + room)
            excess = search.excess(X, gamma)
            if -excess.max() > rounding and (best is None or gamma < best.gamma):
                best = Proof(gamma, X, float(-excess.max()), rounding)
                break
        if best is not None and best.gamma <= least * (1 + _ENOUGH):
            break

        # entries that fail, the worst first, join the next round
        excess = search.excess(X, least * (1 + _ENOUGH))
        worst = [int(i) for i in np.argsort(-excess) if excess[i] >= 0 and i not in chosen]
        if not worst:
            reason = (
                f"the inequality does not hold with certainty (by {-excess.max():.1e}, rounding "
                f"{rounding:.1e})"
            )
            break
        chosen += worst[:_ADDED]
    if best is None:
        raise NumericalFailure(reason or f"the search does not settle in {_ROUNDS} rounds")
    return best
