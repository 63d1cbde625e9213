"""Proof that Herm(T S) > 0 over an interval of a parameter and a box of others, bounded between
points.

S(d, p) = D + C P(d, p)^-1 Q, where the pencil is known with a bound of what is left out, entry by
entry:

    P(d, p) = P0 + d P1 + d^2 P2 + sum_j p_j E_j + rest,  |rest| <= R,  |d| <= h,  |p_j| <= 1  (1)

With X near P0^-1, N = X P - I and Y = X Q:   S = D + C (I + N)^-1 Y.                          (2)
N = N0 + d N1 + d^2 N2 + sum_j p_j M_j + X rest, N0 = X P0 - I (rounding of X: nothing
is assumed of it).
    S = S0 + d S1 + d^2 S2 + sum_j p_j L_j + tail,                                             (3)
    S0 = D + C Y,  S1 = -C N1 Y,  S2 = C (N1 N1 - N2) Y,  L_j = -C M_j Y
The tail is bounded entry by entry, with |N| <= Nb = |N0| + h |N1| + h^2 |N2| + sum_j |M_j| + |X| R:
    |tail| <= |C N0 Y| + |C X| R |Y| + (r c - h^2 |C N1| |N1 Y|) + r Nb (I - Nb)^-1 c,         (4)
    r = sum of |C N_i| and |C X| R, c = sum of |N_i Y| and |X| R |Y|
which holds where the spectral radius of Nb is below one (a positive v with Nb v < v shows it). In d
the polynomial lies between its Bernstein coefficients; T enters linearly, so that a T that is
linear between two ends holds where both ends do. Entry-wise bounds do not depend on the states'
scales.
"""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ambrose.core.checks import named_failure
from ambrose.core.synchronous import hermitian, sector_angle


@dataclass(frozen=True, slots=True)
class Pencil:
    """One cell of (1), (2): P0, P1, P2 (n, n) complex, members E_j (n, n), rest R (n, n) >= 0; C
    (p, n), Q (n, p), D (p, p); half width h of d.
    """

    P0: np.ndarray
    P1: np.ndarray
    P2: np.ndarray
    members: tuple[np.ndarray, ...]
    rest: np.ndarray
    C: np.ndarray
    Q: np.ndarray
    D: np.ndarray
    half_width: float


@dataclass(frozen=True, slots=True)
class Enclosure:
    """All S of a cell: within the hull of ``corners`` (3, p, p), its Bernstein coefficients, plus
    sum_j p_j slopes[j] (q, p, p) with |p_j| <= 1, plus entries no larger than tail (p, p). middle:
    S0.
    """

    corners: np.ndarray
    slopes: np.ndarray
    tail: np.ndarray
    middle: np.ndarray


@named_failure("the enclosure of a response")
def enclose(cell: Pencil) -> Enclosure | None:
    """The enclosure (3), (4) of a cell; None where the cell is too wide for the series to
    converge.
    """
    n, h = len(cell.P0), cell.half_width

    # The terms of N and Y in (2), (3); N0 takes in what X misses of P0^-1.
    X = np.linalg.inv(cell.P0)
    Y, CX = X @ cell.Q, cell.C @ X
    N0 = X @ cell.P0 - np.eye(n)
    N1 = X @ cell.P1
    N2 = X @ cell.P2
    M = [X @ member for member in cell.members]
    size = np.abs(X)

    # Nb >= |N|, entry by entry, for every d, p and rest of the cell
    bound = np.abs(N0) + h * np.abs(N1) + h * h * np.abs(N2) + size @ cell.rest
    for member in M:
        bound = bound + np.abs(member)
    # v > 0 with Nb v < v, or the radius is not known to be below one
    gap = np.eye(n) - bound
    try:
        v = np.linalg.solve(gap, np.ones(n))
    except np.linalg.LinAlgError:
        return None
    if not (np.isfinite(v).all() and (v > 0).all() and (bound @ v < v).all()):
        return None

    # r (``row``) and c (``column``) of (4): |C N| <= r, |N Y| <= c
    rest_y, rest_c = size @ (cell.rest @ np.abs(Y)), np.abs(CX) @ cell.rest
    parts = [(N0, 1.0), (N1, h), (N2, h * h), *((member, 1.0) for member in M)]
    row = rest_c + sum(weight * np.abs(cell.C @ part) for part, weight in parts)
    column = rest_y + sum(weight * np.abs(part @ Y) for part, weight in parts)

    # C (I + N)^-1 Y = C Y - C N Y + C N N Y - C N N (I + N)^-1 N Y: of C N N Y the part
    # d^2 C N1 N1 Y is in S2, the rest at most r c - h^2 |C N1| |N1 Y|
    kept = h * h * np.abs(cell.C @ N1) @ np.abs(N1 @ Y)

    # |N (I + N)^-1| <= Nb (I - Nb)^-1, by the Neumann series
    third = row @ np.linalg.solve(gap, bound @ column)

    # (4): of C N Y only N0 and X rest are not in S1, S2 and L_j
    tail = np.abs(cell.C @ N0 @ Y) + rest_c @ np.abs(Y) + np.maximum(row @ column - kept, 0) + third

    # (3)
    S0 = cell.D + cell.C @ Y
    S1 = -cell.C @ (N1 @ Y)
    S2 = cell.C @ (N1 @ (N1 @ Y)) - cell.C @ (N2 @ Y)
    slopes = np.array([-cell.C @ (member @ Y) for member in M]).reshape(-1, *S0.shape)
    # Bernstein coefficients of a quadratic on [-h, h]
    corners = np.array([S0 - h * S1 + h * h * S2, S0 - h * h * S2, S0 + h * S1 + h * h * S2])
    return Enclosure(corners, slopes, tail, S0)


def proved_angle(
    enclosure: Enclosure,
    ends: Sequence[np.ndarray],
    allowance: float = 0.0,
    most: float = np.pi / 2,
) -> float:
    """An angle phi [rad] with Herm(exp(+-j phi) T S) > 0 for every S enclosed, T any mean of the
    ends.

    ends: T (n, n) at the ends of the cell. allowance: further uncertainty of S, in its 2-norm.
    most: no larger angle is looked for. Negative: not even Herm(T S) > 0 is shown. The angle is
    found by bisection and is always one that is shown.
    """
    T = np.asarray(ends, complex)

    # |x^H T E x| <= ||T|| allowance for ||E|| <= allowance; |x^H T tail x| <= ||(|T| tail)||_2
    # entry by entry, and the 2-norm of a nonnegative matrix
    slack = np.linalg.norm(T, 2, axis=(1, 2)) * allowance
    slack = slack + np.linalg.norm(np.abs(T) @ enclosure.tail, 2, axis=(1, 2))
    moved = T[:, None] @ enclosure.slopes[None]  # T L_j (ends, q, n, n)
    reached = T[:, None] @ enclosure.corners[None]

    def positive(phi: float) -> bool:
        turn = np.exp(1j * phi * np.array([1.0, -1.0]))[:, None, None, None, None]
        spread = np.zeros((2, len(T), 1, *reached.shape[2:]), complex)
        if len(enclosure.slopes):
            # -|H_j| <= p_j H_j in the order of Hermitian matrices
            values, vectors = np.linalg.eigh(hermitian(turn * moved))
            sizes = (vectors * np.abs(values)[..., None, :]) @ vectors.conj().swapaxes(-1, -2)
            spread = sizes.sum(axis=2, keepdims=True)

        # S is in the hull of the corners and the Hermitian part is linear: positive at each,
        # positive throughout, by more than what tail and allowance can take away.
        H = hermitian(turn * reached) - spread
        return bool((np.linalg.eigvalsh(H)[..., 0] > slack[None, :, None]).all())

    if not positive(0.0):
        return -1.0
    if positive(most):
        return most
    low, high = 0.0, most
    while high - low > 1e-3:
        middle = (low + high) / 2
        if positive(middle):
            low = middle
        else:
            high = middle
    return low


@dataclass(frozen=True, slots=True)
class IntervalProof:
    """What was shown over an interval. proved: Herm(T S) > 0 in every cell; angle [rad]: the
    smallest one shown (negative: none); worst: where; cells: their number; failed: a value at which
    it is not shown (None: none); unstable: whether an eigenvalue of T S has a negative real part
    there, so that no proof can exist.
    """

    proved: bool
    angle: float
    worst: float
    cells: int
    failed: float | None = None
    unstable: bool = False


def prove(
    cell: Callable[[float, float], Enclosure | None],
    table: Callable[[float], np.ndarray],
    low: float,
    high: float,
    width: float,
    allowance: Callable[[float, float], float] = lambda low, high: 0.0,
    narrowest: float = 1e-3,
) -> IntervalProof:
    """Herm(T S) > 0 for every value from low to high, cell by cell; a cell that is not shown is
    halved.

    cell: (low, high) -> the enclosure of S between them (``enclose``). table: value -> T, linear
    within every cell asked for. width: of the first cells. narrowest: share of the interval at
    which a cell that is not shown ends the proof.
    """
    # 1e-9: a width that divides the interval but for rounding gets no cell more.
    count = max(1, int(np.ceil((high - low) / width - 1e-9)))
    edges = np.linspace(low, high, count + 1)

    # A stack with the lowest cell on top: from low to high.
    waiting = [(float(a), float(b)) for a, b in itertools.pairwise(edges)][::-1]
    angle = np.pi / 2
    worst = low
    cells = 0
    while waiting:
        start, end = waiting.pop()
        middle = (start + end) / 2
        enclosure = cell(start, end)
        proved = -1.0
        if enclosure is not None:
            # an angle above the smallest one so far changes nothing
            ends, allowed = [table(start), table(end)], allowance(start, end)
            proved = proved_angle(enclosure, ends, allowed, most=angle)
        if proved <= 0 and enclosure is not None:
            here = sector_angle(table(middle) @ enclosure.middle)
            if here <= 0:  # no cell around the middle can be shown
                eigenvalues = np.linalg.eigvals(table(middle) @ enclosure.middle)
                return IntervalProof(
                    False, here, middle, cells, middle, bool(eigenvalues.real.min() < 0)
                )
        if proved <= 0:
            if end - start <= narrowest * (high - low):
                return IntervalProof(False, proved, middle, cells, middle)
            # both halves wait, the lower one on top
            waiting += [(middle, end), (start, middle)]
            continue
        cells += 1
        if proved < angle:
            angle, worst = proved, middle
    return IntervalProof(True, float(angle), worst, cells)
