"""Constant multipliers of moving parameters and their rates, found by cutting planes over the
frequency.

With D = D^T >= 0 and G = -G^T the form sigma = z^T D z - w^T D w + 2 z^T G w is not negative where
w = delta z, |delta| <= 1, at every instant, however delta moves; likewise for xi and w2 =
(delta'/rate) xi. If sigma + |y|^2 - gamma^2 |d|^2 is negative definite in (w, w2, d) at every
frequency, gamma bounds the gain (S-procedure; Megretski & Rantzer 1997, IEEE Trans. Autom. Control
42; Scherer 2001, Automatica 37). The search satisfies this at finitely many frequencies and adds
those where it fails; ``proof`` proves what it finds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla

from ambrose.core.checks import NumericalFailure
from ambrose.core.matrix_inequalities.semidefinite import Inequality, minimise, svec
from ambrose.core.varying.loop import Responder, VaryingLoop, Widened, responder, widen

ROOMS = (1e-3, 4e-3, 1.6e-2, 6e-2)  # of gamma, above the smallest, for multipliers of moderate size
_INSIDE = 0.2  # of the room, how far the inequality is kept from zero, of the squares of w and of y
_CLOSE = 2e-4  # of gamma^2, how far the inequality may fail between the frequencies of the search
_ROUNDS = 15  # of minimum and search for frequencies where the inequality fails; assumed
_FIRST, _ADDED = 16, 8  # frequencies at the start, and per round
_PER_DECADE = 250
_TIME_LIMIT = 60.0  # s, of one minimum


@dataclass(frozen=True, slots=True, eq=False)
class Multipliers:
    """D, G (R, R) of the parameters and D2, G2 (m, m) of their rates; gamma: of the search, not
    proved.
    """

    D: np.ndarray
    G: np.ndarray
    D2: np.ndarray
    G2: np.ndarray
    gamma: float

    @property
    def matrix(self) -> np.ndarray:
        """The symmetric matrix (rows, rows) of sigma over (z_e, w_e, xi, w2)."""
        first, second = (
            np.block([[D, G], [G.T, -D]]) for D, G in ((self.D, self.G), (self.D2, self.G2))
        )
        return sla.block_diag(first, second)


@dataclass(frozen=True, slots=True, eq=False)
class _Entries:
    """The free entries of one D (upper triangle, i <= j) and G (i < j) whose indices have one
    owner; start: first variable.
    """

    owner: np.ndarray
    start: int

    def pairs(self, strict: bool) -> tuple[np.ndarray, np.ndarray]:
        i, j = np.triu_indices(len(self.owner), 1 if strict else 0)
        same = self.owner[i] == self.owner[j]
        return i[same], j[same]

    @property
    def count(self) -> int:
        return len(self.pairs(strict=False)[0]) + len(self.pairs(strict=True)[0])

    def groups(self) -> Iterator[np.ndarray]:
        """The indices of every owner."""
        for name in np.unique(self.owner):
            yield np.flatnonzero(self.owner == name)

    def matrices(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """D and G of all variables x."""
        D, G = np.zeros((2, len(self.owner), len(self.owner)))
        (i, j), (k, m) = self.pairs(strict=False), self.pairs(strict=True)
        D[i, j] = D[j, i] = x[self.start : self.start + len(i)]
        G[k, m] = x[self.start + len(i) : self.start + self.count]
        return D, G - G.T

    def forms(self, constraint: np.ndarray, weights: np.ndarray, first: int) -> np.ndarray:
        """Hermitian matrices (f, k, q, q), one per variable; ``first``: where this pair of signals
        begins in the rows.
        """
        size = len(self.owner)

        # sigma is integrated over the sample: signals times the roots of the nodes' weights
        z, w = (
            np.sqrt(weights)[:, None, None] * constraint[:, :, a : a + size]
            for a in (first, first + size)
        )

        # a_i^* b_j, summed over the nodes g, for each pair (i, j)
        def outer(a: np.ndarray, b: np.ndarray, i: np.ndarray, j: np.ndarray) -> np.ndarray:
            return np.einsum("fgkp,fgkq->fkpq", a[:, :, i].conj(), b[:, :, j], optimize=True)

        (i, j), (k, m) = self.pairs(strict=False), self.pairs(strict=True)

        # by D_ij = D_ji: z_i^* z_j - w_i^* w_j + h.c. (half where i = j);
        # by G_km = -G_mk: z_k^* w_m - z_m^* w_k + h.c.
        D = (outer(z, z, i, j) - outer(w, w, i, j)) * np.where(i == j, 0.5, 1.0)[:, None, None]
        G = outer(z, w, k, m) - outer(z, w, m, k)
        both = np.concatenate([D, G], axis=1)
        return both + both.conj().swapaxes(2, 3)

    def positive(self) -> Iterator[Inequality]:
        """D >= 0, owner by owner."""
        i, j = self.pairs(strict=False)
        for group in self.groups():
            inside = np.flatnonzero(np.isin(i, group))
            place = np.searchsorted(group, i[inside]), np.searchsorted(group, j[inside])
            basis = np.zeros((len(inside), len(group), len(group)))
            at = np.arange(len(inside))
            # D = sum of d_ij (E_ij + E_ji), E_ii once
            basis[at, place[0], place[1]] = basis[at, place[1], place[0]] = 1.0
            rows = svec(basis).T
            yield Inequality(rows, np.zeros(len(rows)), self.start + inside)

    def bounded(self) -> Iterator[Inequality]:
        """[b I - D, G; G^T, b I - D] >= 0 with b the variable 0: it bounds D and G together."""
        (i, j), (k, m) = self.pairs(strict=False), self.pairs(strict=True)
        for group in self.groups():
            d = np.flatnonzero(np.isin(i, group))
            g = np.flatnonzero(np.isin(k, group))
            n = len(group)
            basis = np.zeros((1 + len(d) + len(g), 2 * n, 2 * n))
            # b I
            basis[0] = np.eye(2 * n)

            # -D in both diagonal blocks
            a = np.searchsorted(group, i[d])
            b = np.searchsorted(group, j[d])
            at = 1 + np.arange(len(d))
            for shift in (0, n):
                basis[at, shift + a, shift + b] = basis[at, shift + b, shift + a] = -1.0

            # G with G_mk = -G_km above the diagonal, its transpose below
            a = np.searchsorted(group, k[g])
            b = np.searchsorted(group, m[g])
            at = 1 + len(d) + np.arange(len(g))
            for e, f, sign in ((a, b, 1.0), (b, a, -1.0)):
                basis[at, e, n + f] = basis[at, n + f, e] = sign
            rows = svec(basis).T
            yield Inequality(
                rows, np.zeros(len(rows)), np.r_[0, self.start + d, self.start + len(i) + g]
            )


@dataclass(frozen=True, slots=True, eq=False)
class _Search:
    """The variables are gamma^2 (or a bound b in its place), then the entries of both pairs of
    signals.

    constraint (f, g, rows, q), weights (g,), y (f, p, q): responses on a fine grid of frequencies.
    """

    wide: Widened
    constraint: np.ndarray
    weights: np.ndarray
    y: np.ndarray
    entries: tuple[_Entries, _Entries]

    def forms(self, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The inequality -(F0 + sum x_k F_k) >= 0 at frequencies: F (f, k, q, q) and F0 (f, q,
        q).
        """
        constraint, y = self.constraint[chosen], self.y[chosen]
        # by gamma^2: -I on d; then D, G of (z_e, w_e), rows from 0, and D2, G2 of (xi, w2) behind
        q = np.arange(self.wide.driven, y.shape[2])
        gain = np.zeros((len(y), 1, *(y.shape[2],) * 2), complex)
        gain[:, 0, q, q] = -1
        places = (0, 2 * len(self.wide.fast))
        parts = [
            e.forms(constraint, self.weights, a) for e, a in zip(self.entries, places, strict=True)
        ]
        return np.concatenate([gain, *parts], axis=1), np.einsum("fip,fiq->fpq", y.conj(), y)

    def multipliers(self, x: np.ndarray) -> Multipliers:
        return Multipliers(
            *self.entries[0].matrices(x), *self.entries[1].matrices(x), float(np.sqrt(x[0]))
        )

    def excess(self, x: np.ndarray) -> np.ndarray:
        """The largest eigenvalue of the inequality's left side at every frequency (f,): not
        positive where it holds.
        """
        P, q = self.multipliers(x).matrix, self.wide.driven
        # |y|^2 + integral of sigma - gamma^2 |d|^2
        H = np.einsum("fip,fiq->fpq", self.y.conj(), self.y)
        for g, weight in enumerate(self.weights):
            o = self.constraint[:, g]
            H += weight * o.conj().swapaxes(1, 2) @ (P @ o)
        d = np.arange(q, H.shape[2])
        H[:, d, d] -= x[0]
        return np.linalg.eigvalsh((H + H.conj().swapaxes(1, 2)) / 2)[:, -1]

    def smallest_gamma(self, F: np.ndarray, F0: np.ndarray) -> np.ndarray:
        found = self._minimum(
            [*_frequencies(F, F0), *(item for e in self.entries for item in e.positive())],
            F.shape[1],
            1e-6,
        )
        if found is None:
            raise NumericalFailure(
                "no quadratic function proves the loop stable while the parameters move"
            )
        return found

    def smallest_multipliers(
        self, F: np.ndarray, F0: np.ndarray, level: float, inside: float
    ) -> np.ndarray | None:
        """For gamma^2 = level, with some room in every inequality: at the smallest gamma
        multipliers tend to infinity.
        """
        q = self.wide.driven
        room = np.diag(np.r_[np.full(q, inside), np.full(F.shape[2] - q, inside * level)])

        # gamma^2 is given and joins the constant; the variable 0 is the bound b now
        without = np.concatenate([np.zeros_like(F[:, :1]), F[:, 1:]], axis=1)
        limits = [item for e in self.entries for item in (*e.positive(), *e.bounded())]
        found = self._minimum(
            [*_frequencies(without, F0 + level * F[:, 0] + room), *limits], F.shape[1], 1e-3
        )
        return None if found is None else np.r_[level, found[1:]]

    @staticmethod
    def _minimum(items: list[Inequality], count: int, tolerance: float) -> np.ndarray | None:
        found = minimise(np.eye(count)[0], items, tolerance=tolerance, time_limit=_TIME_LIMIT)
        return (
            None
            if found.status in ("infeasible", "time limit") or found.primal_error > 1e-6
            else found.x
        )


def _frequencies(F: np.ndarray, F0: np.ndarray) -> list[Inequality]:
    """-(F0 + sum x_k F_k) >= 0 as real matrices, each of norm about 1."""
    size, every = 1 / np.maximum(1.0, np.linalg.norm(F0, 2, axis=(1, 2))), np.arange(F.shape[1])
    rows, constant = (-svec(_real(M)) for M in (F, F0))
    return [
        Inequality(s * row.T, s * c, every) for s, row, c in zip(size, rows, constant, strict=True)
    ]


def _real(H: np.ndarray) -> np.ndarray:
    """[[Re, -Im], [Im, Re]] of Hermitian matrices (..., q, q)."""
    return np.concatenate(
        [np.concatenate([H.real, -H.imag], axis=-1), np.concatenate([H.imag, H.real], axis=-1)],
        axis=-2,
    )


def find_multipliers(
    wide: Widened, tell: Callable[[str], None] = lambda text: None
) -> Iterator[Multipliers]:
    """Multipliers of the smallest gamma on a fine grid of frequencies, and of ROOMS above it, one
    after the other.

    Raises NumericalFailure where there are none.
    """
    fast = _Entries(wide.fast, 1)
    responses = responder(wide)
    constraint, y = responses.at(frequency_grid(responses))
    search = _Search(
        wide, constraint, responses.weights, y, (fast, _Entries(wide.slow, 1 + fast.count))
    )

    # to begin with: evenly spread, and where y answers most
    chosen = np.zeros(len(y), bool)
    chosen[:: max(1, len(y) // _FIRST)] = True
    chosen[np.argsort(np.linalg.norm(y, 2, axis=(1, 2)))[-_ADDED:]] = True

    def add(x: np.ndarray, allowed: float) -> bool:
        """Choose the frequencies at which the inequality fails most; whether there are any."""
        excess = search.excess(x)
        # local maxima alone, the ends included: neighbours of a peak say the same
        peaks = np.r_[True, excess[1:] >= excess[:-1]] & np.r_[excess[:-1] >= excess[1:], True]
        worst = np.flatnonzero((excess > allowed) & ~chosen & peaks)
        worst = worst[np.argsort(excess[worst])[::-1][:_ADDED]]
        chosen[worst] = True
        return worst.size > 0

    for step in range(_ROUNDS):
        x = search.smallest_gamma(*search.forms(chosen))
        tell(
            f"multipliers, round {step + 1}: gain below {np.sqrt(x[0]):.4f} at "
            f"{int(chosen.sum())} frequencies"
        )
        if not add(x, _CLOSE * x[0]):
            break

    # Multipliers of moderate size, with room; frequencies that fail are added for each room.
    least = x[0]
    for room in ROOMS:
        for _ in range(_ROUNDS):
            found = search.smallest_multipliers(
                *search.forms(chosen), least * (1 + room) ** 2, _INSIDE * room
            )
            if found is None or not add(found, 0.0):
                break
        if found is not None:
            yield search.multipliers(found)


def frequency_grid(responses: Responder) -> np.ndarray:
    """Frequencies (f,) [rad/s] from zero to half the sample rate (or beyond the poles), denser at
    light poles.
    """
    poles = responses.poles
    modulus = np.abs(poles[np.abs(poles) > 0])

    # up to just below half the sample rate; from a tenth of the slowest pole
    high = 0.9999 * np.pi / responses.dt if responses.dt else 10 * modulus.max(initial=1.0)
    low = min(max(0.1 * modulus.min(initial=1.0), 1e-6 * high), 0.1 * high)
    net = np.geomspace(low, high, int(_PER_DECADE * np.log10(high / low)) + 2)

    # damping ratio below 0.3: beside the pole at distances of its decay
    light = poles[(poles.imag > 0) & (-poles.real < 0.3 * np.abs(poles))]
    beside = (
        light.imag[:, None] + light.real[:, None] * np.array([-2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0])
    ).ravel()
    return np.unique(np.concatenate([[0.0], net, beside[(beside > low) & (beside < high)]]))


def unit_of_w(loop: VaryingLoop) -> float:
    """The factor for ``scaled`` with which w reaches y as strongly as d reaches z."""
    wide, r = widen(loop), loop.channels
    responses = responder(wide)
    omega = frequency_grid(responses)
    constraint, y = responses.at(omega[:: max(1, len(omega) // 100)])

    # d -> z is multiplied by the factor, w -> y divided: equal for factor^2 = out / into
    into = np.linalg.norm(constraint[:, 0, :r, r:], 2, axis=(1, 2)).max()
    out = np.linalg.norm(y[:, :, :r], 2, axis=(1, 2)).max()
    return float(np.sqrt(out / into)) if into > 0 and out > 0 else 1.0
