"""The proof on cells of a loop with parameters within tolerances besides the one that moves.

The tolerances are pulled out of the loop, w_i = delta_i z_i with |delta_i| <= 1 and z = Z x, and so
are multiplied: whatever delta_i is,

    sigma_i = d z_i^2 - d w_i^2 >= 0,    d >= 0,

and V' + sum_i sigma_i + |y|^2 - gamma^2 |d|^2 < 0 on every cell proves gamma for parameters that
move as they like (S-procedure). Of those that stand still more is known: with the filters xi_i' = a
(z_i - xi_i), eta_i' = a (w_i - eta_i) eta_i = delta_i xi_i holds as well, and with v = (z_i, xi_i),
u = (w_i, eta_i)

    sigma_i = v^T D v - u^T D u + 2 g (z_i eta_i - xi_i w_i) >= 0,    D = D^T >= 0, g any number,

at every instant (the D and G of mixed mu as functions of frequency; Veenman, Scherer & Koroglu
2016, Eur. J. Control 31). V is a quadratic function of the loop's state and the filters'. It need
not be positive for all of them: where eta = delta xi its matrix solves a strict Lyapunov inequality
for every frozen delta and p; it is positive for delta = 0, where the loop is stable, and cannot
become singular on the way to another delta.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import comb

import numpy as np
import scipy.linalg as sla

from ambrose.annexes.scheduled.varying_proof import Proof
from ambrose.core.checks import NumericalFailure
from ambrose.core.matrix_inequalities import Inequality, MatrixVariable, Term, minimise, svec
from ambrose.core.norms import hinf_norm
from ambrose.core.statespace import StateSpace, balance_matrix as balance, is_stable

# The proof for a loop whose matrices follow what is, p, and what is told of it: plant and
# controller, scheduled or fixed.
#
# On a cell of the plane of p and what is told, the loop x' = A x + B d, y = C x + d has polynomial
# matrices, given as control nets of Bernstein polynomials over the cell's two coordinates: they lie
# in the convex hull of the nets' entries. With V = x^T X(p) x, X(p) a polynomial, and |p'| <= rate,
# V' + |y|^2 - gamma^2 |d|^2 < 0 is again a polynomial inequality, affine in X's coefficients. Where
# it holds for every entry of its control net and both signs of the rate it holds on the whole cell,
# however p and what is told move within their cells (bounded real lemma; Wu, Yang, Packard & Becker
# 1996, Int. J. Robust Nonlinear Control 6, for the function; the hull in place of a grid). A
# constant X needs no rate. X(p) is positive where one loop is stable for its p, and cannot become
# singular on the way to another p, for there V' would be zero.
#
# X = sum_d T_d(p) X_d in Chebyshev polynomials; from d = 1 on X_d has only the rows and columns of
# the states that disturbances reach most. The search takes entries in as it needs them; what it
# finds is checked at every one.


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
            f"iteration {step + 1}: gain bound {least:.4f} from {len(chosen)} of "
            f"{len(search.entries)} grid points"
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


# of gamma, above the smallest found, at which the inequality is checked
_BOX_ROOMS = (5e-3, 2e-2, 5e-2)
_REMEDY = "narrower tolerances, a smaller range or a slower motion help"
_TURNS, _WORTH = 10, 0.98  # of the search in its own solution's states, and what a turn must gain
_LESS = 0.25  # of the tolerances, where all of them have no solution in the states at hand
_USELESS = 100.0  # gain, beyond which nothing is called proved
_LIGHT = 1e-9  # of X's largest eigenvalue, below which a direction counts as of that size


def proved_over_tolerances(
    cells: Sequence[Cell],
    C: np.ndarray,
    Z: np.ndarray,
    rate: float = np.inf,
    *,
    pole: float | None = None,
    degree: int = 1,
    time_limit: float = 600.0,
    tell: Callable[[str], None] = lambda text: None,
) -> Proof:
    """The smallest gamma from d to y = C x + d for which a proof is found, for all motions within
    the cells with |p'| <= rate.

    cells: B (.., n, r + q), the columns of w before those of d; C (q, n), Z (r, n); pole [rad/s]: a
    of the filters for parameters that stand still; None: they move as they like. degree: of X(p).
    Raises NumericalFailure where none is found.
    """
    end = time.monotonic() + time_limit
    A, B = middle_of(cells)
    q = len(C)
    T, inverse = own_coordinates(A, B[:, -q:], C)

    # a parameter whose z is zero does nothing: w = delta z = 0
    acts = Z.any(axis=1)
    if not acts.all():
        columns = np.append(acts, np.ones(q, bool))
        cells = [replace(cell, B=cell.B[..., columns]) for cell in cells]
        Z = Z[acts]

    # w and z in units in which each row of Z is 1 long in the middle loop's states; delta stays
    size = np.linalg.norm(Z @ T, axis=1)
    cells, Z = [_scaled(cell, size) for cell in cells], Z / size[:, None]

    # states (x, xi, eta), the filters' as they are
    if pole is not None and len(Z):
        cells, C, Z = _with_filters(cells, C, Z, pole)
        T, inverse = (
            np.pad(M, (0, 2 * len(size))) + np.diag(np.repeat([0.0, 1.0], [len(M), 2 * len(size)]))
            for M in (T, inverse)
        )
    # share of the tolerances, by which states are found
    least = np.inf
    unit = np.ones(len(size))
    count = len(size)
    share = 1.0
    for _ in range(_TURNS):
        search = _Tolerant(
            [_scaled(cell, share / unit) for cell in cells],
            C,
            Z,
            rate,
            degree,
            (T, inverse),
            count,
            unit,
        )
        # the smallest gamma^2 in these states and units, for the share of the tolerances
        first = minimise(
            search.cost, search.inequalities(), tolerance=3e-3, time_limit=end - time.monotonic()
        )
        held = first.status in ("optimal", "inexact") and first.x[-1] > 0

        # all the tolerances are in: a gamma, and the turns end where one gains too little
        if held and share == 1.0:
            if not np.sqrt(first.x[-1]) < _WORTH * least:
                break
            least = float(np.sqrt(first.x[-1]))
            tell(f"gain below {least:.4f}")
        elif least < np.inf or time.monotonic() > end:
            break
        # no solution in these states: first for a smaller share
        if not held:
            share *= _LESS
            continue

        # the next turn's states: X_0 = V diag(values) V^T becomes diag(+-1)
        values, V = np.linalg.eigh(search.functions(first.x)[0])
        root = np.sqrt(np.maximum(np.abs(values), _LIGHT * np.abs(values).max()))
        T, inverse = T @ (V / root), (V * root).T @ inverse

        # its units of w, in which this d (or D_11) would be 1; and twice the share
        d = first.x[search.begin :][: search.each * count : search.each]
        unit, share = (
            unit * np.sqrt(np.maximum(d, np.finfo(float).tiny)),
            min(1.0, share / _LESS**0.5),
        )
    if not least < _USELESS:
        raise NumericalFailure(
            f"no quadratic function proves the loop over its tolerances ({first.status}); {_REMEDY}"
        )
    search = _Tolerant(
        [_scaled(cell, 1 / unit) for cell in cells], C, Z, rate, degree, (T, inverse), count, unit
    )

    # gamma given, the slack is made largest; what is found is checked at every entry
    for room in _BOX_ROOMS:
        gamma = least * (1 + room)
        found = minimise(
            -search.cost,
            search.inequalities(gamma),
            tolerance=1e-3,
            time_limit=end - time.monotonic(),
        )
        X, m = search.functions(found.x), found.x[search.begin : -1]
        slack = -float(search.excess_with(X, m, gamma).max())
        rounding = search.rounding_with(X, m, gamma)
        if search.admitted(m) and slack > rounding:
            return Proof(gamma, X, slack, rounding)
    raise NumericalFailure(
        f"the inequality does not hold with certainty (by {slack:.1e}, rounding {rounding:.1e}); "
        f"{_REMEDY}"
    )


def _scaled(cell: Cell, size: np.ndarray) -> Cell:
    """With the columns of w times size (r,)."""
    B = cell.B.copy()
    B[..., : len(size)] *= size
    return replace(cell, B=B)


def _with_filters(
    cells: Sequence[Cell], C: np.ndarray, Z: np.ndarray, pole: float
) -> tuple[list[Cell], np.ndarray, np.ndarray]:
    """Cells and C of the states (x, xi, eta), and the rows of z, xi and eta over them (3 r, n + 2
    r).
    """
    r, n = Z.shape
    wide = []
    for cell in cells:
        A = np.pad(cell.A, ((0, 0), (0, 0), (0, 2 * r), (0, 2 * r)))
        B = np.pad(cell.B, ((0, 0), (0, 0), (0, 2 * r), (0, 0)))
        # xi' = a (z - xi) with z = Z x,   eta' = a (w - eta)
        A[..., n : n + r, :n] = pole * Z
        A[..., n:, n:] -= pole * np.eye(2 * r)
        B[..., n + r :, :r] += pole * np.eye(r)
        wide.append(replace(cell, A=A, B=B))
    return (
        wide,
        np.pad(C, ((0, 0), (0, 2 * r))),
        np.vstack([np.pad(Z, ((0, 0), (0, 2 * r))), np.eye(2 * r, n + 2 * r, n)]),
    )


class _Tolerant(CellSearch):
    """The inequalities over (x, w, d) with the multipliers' numbers after X's: a parameter's d, or
    D (3) and g; gamma^2 last.

    rows: of z, or of z, xi and eta, in the states given; unit (r,): w is in, so that d is about 1.
    """

    def __init__(
        self,
        cells: Sequence[Cell],
        C: np.ndarray,
        rows: np.ndarray,
        rate: float,
        degree: int,
        coordinates: tuple[np.ndarray, np.ndarray],
        count: int,
        unit: np.ndarray | None = None,
    ) -> None:
        super().__init__(cells, C, rate, degree, 1.0, coordinates)
        n, q = self.T.shape[1], len(C)
        unit = np.ones(count) if unit is None else unit

        # (z), or (z, xi, eta), of each parameter as rows over (x, w, d): in the search's states and
        # time (hence 1/sqrt(pace)), times unit, as w is
        seen = (
            rows @ self.T / np.sqrt(self.pace) * np.tile(unit, len(rows) // max(1, count))[:, None]
        )
        seen = np.pad(seen, ((0, 0), (0, count + q))).reshape(
            len(rows) // max(1, count), count, n + count + q
        )
        w = np.eye(count, n + count + q, n)
        self.each, self.begin, self.count, self.w = (
            (4 if len(seen) == 3 else 1),
            self.variables[-1].stop,
            count,
            w,
        )
        self.forms: list[np.ndarray] = []
        for i in range(count):
            # d, or D_11: z^2 - w^2
            z = seen[0, i]
            self.forms.append(_product(z, z) - _product(w[i], w[i]))
            if self.each == 4:
                # D_12: 2 (z xi - w eta), D_22: xi^2 - eta^2, g: 2 (z eta - xi w)
                xi, eta = seen[1:, i]
                self.forms += [
                    2 * (_product(z, xi) - _product(w[i], eta)),
                    _product(xi, xi) - _product(eta, eta),
                ]
                self.forms.append(2 * (_product(z, eta) - _product(xi, w[i])))

    @property
    def size(self) -> int:
        return self.variables[-1].stop + self.each * self.count + 1

    @property
    def cost(self) -> np.ndarray:
        return np.eye(1, self.size, self.size - 1)[0]

    def inequalities(self, gamma: float | None = None) -> list[Inequality]:
        """All of them; with a gamma the last variable is by how much they hold."""
        # -(V' + sigma + |y|^2 - gamma^2 |d|^2) >= 0 (with a gamma: >= last I) over (x, w, d)
        n, q = len(self.T), len(self.C)
        corner = np.diag(np.repeat([0.0, 0.0, 1.0], [n, self.count, q]))
        last = svec(corner) if gamma is None else -svec(np.eye(len(corner)))
        rows = np.column_stack([*(-svec(form) for form in self.forms), last])
        columns = np.arange(self.begin, self.size)
        given = 0.0 if gamma is None else gamma**2 * svec(corner)
        found = [
            replace(item, rows=rows, columns=columns, constant=item.constant + given)
            for item in map(self.inequality, self.entries)
        ]
        return [*found, *self._positive(), self.bound()]

    def _positive(self) -> list[Inequality]:
        # d >= 0, or D = [D_11, D_12; D_12, D_22] >= 0; g is free
        entries = (
            [[[1, 0], [0, 0]], [[0, 1], [1, 0]], [[0, 0], [0, 1]]] if self.each == 4 else [[[1]]]
        )
        rows = np.column_stack([svec(np.array(E, float)) for E in entries])
        starts = self.begin + self.each * np.arange(self.count)
        return [
            Inequality(rows, np.zeros(len(rows)), start + np.arange(rows.shape[1]))
            for start in starts.tolist()
        ]

    def admitted(self, m: np.ndarray) -> bool:
        """Whether every D is positive semidefinite."""
        D = m.reshape(self.count, self.each)
        return bool(
            (D[:, 0] > 0).all() and (self.each == 1 or (D[:, 0] * D[:, 2] >= D[:, 1] ** 2).all())
        )

    def excess_with(self, X: np.ndarray, m: np.ndarray, gamma: float) -> np.ndarray:
        """``excess`` with the multipliers of the numbers m."""
        n, q = len(self.T), len(self.C)

        # sigma + |d|^2 - gamma^2 |d|^2, the same at every entry
        fixed = sum(
            (a * form for a, form in zip(m, self.forms, strict=True)),
            np.zeros((n + self.count + q,) * 2),
        )
        fixed[n + self.count :, n + self.count :] += (1 - gamma**2) * np.eye(q)
        found = []
        for e in self.entries:
            # rows of x, half of it: V' + |C x|^2 + 2 x^T C^T d
            half = np.hstack(
                [
                    (X @ e.A).sum(0) + np.tensordot(e.slope / 2, X, 1) + self.C.T @ self.C / 2,
                    (X @ e.B).sum(0),
                ]
            )
            half[:, n + self.count :] += self.C.T
            found.append(
                np.linalg.eigvalsh(
                    fixed
                    + np.pad(half, ((0, self.count + q), (0, 0)))
                    + np.pad(half, ((0, self.count + q), (0, 0))).T
                )[-1]
            )
        return np.array(found)

    def rounding_with(self, X: np.ndarray, m: np.ndarray, gamma: float) -> float:
        """``rounding``, and that of the multipliers' forms."""
        size = sum(
            abs(a) * float(np.linalg.norm(form)) for a, form in zip(m, self.forms, strict=True)
        )
        return self.rounding(X, gamma) + 4 * (len(self.T) + self.count) * np.finfo(float).eps * size


def _product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return (np.outer(a, b) + np.outer(b, a)) / 2
