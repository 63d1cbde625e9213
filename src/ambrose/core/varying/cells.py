"""The proof for a loop whose matrices follow what is, p, and what is told of it: plant and scheduled controller.

On a cell of the plane of p and what is told, the loop x' = A x + B d, y = C x + d has polynomial matrices, given as control
nets of Bernstein polynomials over the cell's two coordinates: they lie in the convex hull of the nets' entries. With
V = x^T (X0 + p X1) x and |p'| <= rate, V' + |y|^2 - gamma^2 |d|^2 < 0 is again a polynomial inequality, affine in X0 and X1.
Where it holds for every entry of its control net and both signs of the rate it holds on the whole cell, however p and what is
told move within their cells (bounded real lemma; Wu, Yang, Packard & Becker 1996, Int. J. Robust Nonlinear Control 6, for the
function; the hull in place of a grid). X1 = 0 needs no rate. X0 + p X1 is positive where one loop is stable for its p, and
cannot become singular on the way to another p, for there V' would be zero.

Of a loop of many states X1 has only the rows and columns of the light modes, whose damping the parameter turns about: all else
is proved as well with a constant X (docs/theory.md). The search takes entries in as it needs them; what it finds is checked at
every one.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import comb

import numpy as np
import scipy.linalg as sla

from ambrose.core.checks import NumericalFailure
from ambrose.core.norms import hinf_norm
from ambrose.core.semidefinite import Inequality, minimise, svec
from ambrose.core.statespace import StateSpace, balance, is_stable
from ambrose.core.varying.proof import Proof

_ROOMS = (1e-3, 4e-3, 1e-2, 3e-2)  # of gamma, above the smallest found, at which the inequality is checked
_ENOUGH = 4e-3
LIGHT = (0.3, 0.65)  # damping ratios: the first suffices for most loops, the second costs twice the time
_SMALL = 16  # states up to which X1 has all rows
_ROUNDS, _ADDED = 12, 6
_FLOOR = 1e-12  # of X's largest eigenvalue, in the choice of coordinates
_TOLERANCE = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Cell:
    """Control nets over a cell: A (a, c, n, n), B (a, c, n, m), and p (2, 2), bilinear, in -1 .. 1; over a line (2, 1)."""

    A: np.ndarray
    B: np.ndarray
    p: np.ndarray


def elevated(net: np.ndarray, size: tuple[int, ...]) -> np.ndarray:
    """The same polynomial with a larger control net."""
    return product(np.ones((size[0] - len(net) + 1, size[1] - net.shape[1] + 1)), net)


def product(p: np.ndarray, net: np.ndarray) -> np.ndarray:
    """The control net of a scalar polynomial p (a, c) times one of matrices (b, d, n, m): (a + b - 1, c + d - 1, n, m)."""
    (a, c), (b, d) = p.shape, net.shape[:2]
    found = np.zeros((a + b - 1, c + d - 1, *net.shape[2:]))
    weights = [_binomials(size - 1) for size in (a, c, b, d, a + b - 1, c + d - 1)]
    for i in range(a):
        for k in range(c):
            part = weights[0][i] * weights[1][k] * p[i, k] * net
            found[i : i + b, k : k + d] += part * (weights[2][:, None] * weights[3])[:, :, None, None]
    return found / (weights[4][:, None] * weights[5])[:, :, None, None]


def _binomials(n: int) -> np.ndarray:
    return np.array([float(comb(n, k)) for k in range(n + 1)])


@dataclass(frozen=True, slots=True, eq=False)
class _Entry:
    """One inequality: the entries of the nets of A, B, p A and p B, and the rate with its sign."""

    A: np.ndarray
    B: np.ndarray
    A_p: np.ndarray
    B_p: np.ndarray
    rate: float


class _Search:
    """The inequalities in coordinates in which the middle loop's own X is I, and time in its own pace."""

    def __init__(self, cells: Sequence[Cell], C: np.ndarray, rate: float, light: float) -> None:
        middle = cells[len(cells) // 2]
        A, B = middle.A.mean(axis=(0, 1)), middle.B.mean(axis=(0, 1))
        T, inverse = _coordinates(A, B, C)
        pace = float(np.exp(np.log(np.abs(np.linalg.eigvals(A)) + 1e-9).mean()))
        off = accurate_product(inverse, T)
        F = off[0] - np.eye(len(A)) + off[1]  # inverse T = I + F, so that T^-1 A T = (I - F) inverse A T but for F^2
        skew = float(np.linalg.norm(F, 2)) ** 2
        self.error = 0.0  # by which rounding in the change of coordinates moves A
        self.C = C @ T / np.sqrt(pace)
        self.entries: list[_Entry] = []
        free = np.isfinite(rate)
        rows = _light_rows(inverse @ A @ T, light)
        self.basis = _symmetric_basis(len(A))
        self.moving = _rows_basis(rows) if free else np.zeros((0, *A.shape))
        for cell in cells:
            high, low = accurate_product(cell.A, T)
            turned_A, rest = accurate_product(inverse, high)
            nets = [(turned_A + (rest + inverse @ low)) / pace, sum(accurate_product(inverse, cell.B)) / np.sqrt(pace)]
            nets = [net - F @ net for net in nets]
            largest = float(np.linalg.norm(nets[0], 2, axis=(2, 3)).max())
            self.error = max(self.error, (2 * skew + np.finfo(float).eps * len(A)) * largest)
            if len(self.moving):
                turned = [product(cell.p, net) for net in nets]
                nets = [elevated(net, moved.shape[:2]) for net, moved in zip(nets, turned, strict=True)]
            else:
                turned = [np.zeros_like(net) for net in nets]
            flat = [net.reshape(-1, *net.shape[2:]) for net in (*nets, *turned)]
            signs = (-rate / pace, rate / pace) if len(self.moving) else (0.0,)
            self.entries += [_Entry(A, B, A_p, B_p, sign) for A, B, A_p, B_p in zip(*flat, strict=True) for sign in signs]

    def inequality(self, entry: _Entry) -> Inequality:
        n, q = entry.B.shape
        k, m = len(self.basis), len(self.moving)
        F, F0 = np.zeros((k + m + 1, n + q, n + q)), np.zeros((n + q, n + q))
        for part, basis, A, B, rate in (
            (slice(0, k), self.basis, entry.A, entry.B, 0.0), (slice(k, k + m), self.moving, entry.A_p, entry.B_p, entry.rate)
        ):  # fmt: skip
            XA, XB = basis @ A, basis @ B
            F[part, :n, :n] = -(XA + XA.transpose(0, 2, 1) + rate * basis)
            F[part, :n, n:], F[part, n:, :n] = -XB, -XB.transpose(0, 2, 1)
        F[-1, n:, n:] = np.eye(q)
        F0[:n, :n], F0[:n, n:], F0[n:, :n], F0[n:, n:] = -self.C.T @ self.C, -self.C.T, -self.C, -np.eye(q)
        return Inequality(svec(F).T, svec(F0), np.arange(k + m + 1))

    def functions(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """X0 and X1 of the variables."""
        k = len(self.basis)
        return np.tensordot(x[:k], self.basis, 1), np.tensordot(x[k:-1], self.moving, 1)

    def first(self) -> list[int]:
        """Entries to begin with: the largest gains at rest, and those that the middle loop's own X fails most."""
        one = np.eye(len(self.basis[0]))
        excess = self.excess(one, np.zeros_like(one), 1.0)
        loops = [StateSpace(e.A, e.B, self.C, np.eye(len(self.C))) for e in self.entries]
        gains = np.array([hinf_norm(loop).value if is_stable(loop) else 0.0 for loop in loops])
        return list(dict.fromkeys(int(i) for order in (-gains, -excess) for i in np.argsort(order)[: _ADDED // 2]))

    def excess(self, X0: np.ndarray, X1: np.ndarray, gamma: float) -> np.ndarray:
        """The largest eigenvalue of every inequality's left side (e,); it holds where that is negative."""
        C, q = self.C, len(self.C)
        corner = (1 - gamma**2) * np.eye(q)
        found = []
        for e in self.entries:
            Y, Z = X0 @ e.A + X1 @ e.A_p + e.rate / 2 * X1, X0 @ e.B + X1 @ e.B_p + C.T
            found.append(np.linalg.eigvalsh(np.block([[Y + Y.T + C.T @ C, Z], [Z.T, corner]]))[-1])
        return np.array(found)

    def rounding(self, X0: np.ndarray, X1: np.ndarray) -> float:
        """A bound of the error of ``excess``: of the coordinates, and of the products."""
        size = np.linalg.norm(X0, 2) + np.linalg.norm(X1, 2)
        largest = max(np.linalg.norm(e.A, 2) + np.linalg.norm(e.A_p, 2) for e in self.entries)
        return float(size * (2 * self.error + 4 * len(X0) * np.finfo(float).eps * (1 + largest)))


def accurate_product(A: np.ndarray, B: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A B (..., n, m) as two matrices, as if in twice the precision (Ogita, Rump & Oishi 2005, SIAM J. Sci. Comput. 26)."""
    shape = np.broadcast_shapes(A.shape[:-2], B.shape[:-2])
    high, low = np.zeros((2, *shape, A.shape[-2], B.shape[-1]))
    for k in range(A.shape[-1]):
        product, error = _product_and_error(A[..., :, k, None], B[..., k, None, :])
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


def _coordinates(A: np.ndarray, B: np.ndarray, C: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """T and its inverse, x = T x', in which the loop's own bounded-real X, 5 % above its gain, is about I."""
    A, t = balance(A)
    B, C, q = B / t[:, None], C * t, len(C)
    gamma = 1.05 * hinf_norm(StateSpace(A, B, C, np.eye(q))).value
    R = (gamma**2 - 1) * np.eye(q)
    inner = np.linalg.solve(R, C)
    try:
        X = sla.solve_continuous_are(A + B @ inner, B, C.T @ C + C.T @ inner + 1e-9 * np.eye(len(A)), -R)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise NumericalFailure("the loop at rest in the middle of the range has no bounded-real function") from error
    values, V = np.linalg.eigh((X + X.T) / 2)
    root = np.sqrt(np.maximum(values, _FLOOR * values.max()))
    return t[:, None] * (V / root), (V * root).T / t


def _symmetric_basis(n: int) -> np.ndarray:
    i, j = np.triu_indices(n)
    basis = np.zeros((len(i), n, n))
    at = np.arange(len(i))
    basis[at, i, j] = basis[at, j, i] = 1.0
    return basis


def _light_rows(A: np.ndarray, damping: float) -> np.ndarray:
    """An orthonormal basis (n, k) of what the loop's light modes are seen by: their left eigenvectors; all of a small loop."""
    if len(A) <= _SMALL:
        return np.eye(len(A))
    values, right = np.linalg.eig(A)
    left = np.linalg.inv(right)
    light = (values.imag > 0) & (-values.real < damping * np.abs(values))
    rows = np.concatenate([left[light].real, left[light].imag])
    return np.asarray(np.linalg.qr(rows.T)[0])


def _rows_basis(Q: np.ndarray) -> np.ndarray:
    """A basis of the symmetric matrices Q Y^T + Y Q^T, Y (n, k) anything."""
    n, k = Q.shape
    whole = np.hstack([Q, sla.null_space(Q.T)]) if k else np.eye(n)
    pairs = [(i, j) for i in range(k) for j in range(i, n)]
    return np.array([_pair(whole[:, i], whole[:, j]) for i, j in pairs]).reshape(-1, n, n)


def _pair(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.outer(a, b) + np.outer(b, a)


def proved_on_cells(
    cells: Sequence[Cell],
    C: np.ndarray,
    rate: float = np.inf,
    *,
    light: float = LIGHT[0],
    time_limit: float = 600.0,
    tell: Callable[[str], None] = lambda text: None,
) -> Proof:
    """The smallest gamma for which a proof is found, over all motions within the cells with |p'| <= rate [1/s].

    light: damping ratio of the middle loop's modes below which X1 has their rows; time_limit [s]: of all. Raises
    NumericalFailure where none is found, with the reason.
    """
    search = _Search(cells, C, rate, light)
    chosen = search.first()
    size = len(search.basis) + len(search.moving) + 1
    best, reason, end = None, "", time.monotonic() + time_limit
    for step in range(_ROUNDS):
        items = [search.inequality(search.entries[i]) for i in chosen]
        found = minimise(np.eye(size)[-1], items, tolerance=_TOLERANCE, time_limit=end - time.monotonic())
        if found.status == "time limit":
            reason = f"the search was not at its end after {time_limit:.0f} s; a smaller error or fewer grid points help"
            break
        if found.status == "infeasible" or found.x[-1] <= 0:
            reason = f"no quadratic function proves the loop stable while the parameter moves ({found.status})"
            break
        X0, X1 = search.functions(found.x)
        least, rounding = float(np.sqrt(found.x[-1])), search.rounding(X0, X1)
        tell(f"round {step + 1}: gain below {least:.4f} at {len(chosen)} of {len(search.entries)} entries")
        for room in _ROOMS:
            gamma = least * (1 + room)
            excess = search.excess(X0, X1, gamma)
            if -excess.max() > rounding and (best is None or gamma < best.gamma):
                best = Proof(gamma, np.stack([X0, X1]), float(-excess.max()), rounding)
                break
        if best is not None and best.gamma <= least * (1 + _ENOUGH):
            break
        excess = search.excess(X0, X1, least * (1 + _ENOUGH))
        worst = [int(i) for i in np.argsort(-excess) if excess[i] >= 0 and i not in chosen]
        if not worst:
            reason = f"the inequality does not hold with certainty (by {-excess.max():.1e}, rounding {rounding:.1e})"
            break
        chosen += worst[:_ADDED]
    if best is None:
        raise NumericalFailure(reason or f"the search does not settle in {_ROUNDS} rounds")
    return best
