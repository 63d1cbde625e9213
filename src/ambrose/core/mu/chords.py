"""A frequency response between two frequencies: the chord that joins its values, and how far it can
lie from it.

M(s) = D + sum of R_k / (s - p_k) in modal form, so that between a and b, entry by entry,

    |M(j omega) - chord| <= (b - a)^2 / 8 max |M''|,

with M'' by its Taylor series in the middle, the remainder by the sum of n! |R_k| / d_k^(n+1), d_k
the distance of p_k from the interval: residues that cancel do so in the terms that count. Poles
that cannot be told apart stay together as a small matrix, whose resolvent is bounded by a Neumann
series. Nothing is asked of a grid: what lies between its points is enclosed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg as sla

from ambrose.core.checks import NumericalFailure, UnstableSystem, invalid
from ambrose.core.frequency import solve_shifted
from ambrose.core.realisation.balancing import balance_system
from ambrose.core.realisation.modal_form import ModalForm, modal_form
from ambrose.core.statespace import StateSpace, as_statespace

_GROWTH = (1e4, 1e2, 1e1)  # of the transforms that separate poles, the first that keeps the digits
_TERMS = 8  # of the Taylor series
# of the eigenvectors of a cluster, up to which its resolvent is also bounded in their coordinates
_CONDITION = 1e9
_CHUNK = 200_000  # numbers held at once, which a processor keeps near


@dataclass(frozen=True, slots=True, eq=False)
class Chords:
    """D (n_z, n_w); poles (k,) [rad/s], both of a pair; residues (k, n_z, n_w); clusters: (A, B, C)
    of poles kept together, A quasi-triangular.
    """

    D: np.ndarray
    poles: np.ndarray
    residues: np.ndarray
    clusters: tuple[tuple[np.ndarray, np.ndarray, np.ndarray], ...]

    @property
    def every_pole(self) -> np.ndarray:
        """The poles, those of the clusters included (n,) [rad/s]."""
        return np.concatenate([self.poles, *(np.linalg.eigvals(A) for A, _, _ in self.clusters)])

    def between(self, left: np.ndarray, right: np.ndarray) -> ChordsBetween:
        """left M right, for constant left (p, n_z) and right (n_w, m)."""
        return ChordsBetween(self, left, right)

    def part(self, outputs: np.ndarray, inputs: np.ndarray) -> Chords:
        """The chords between some of the inputs and outputs, by number."""
        clusters = tuple((A, B[:, inputs], C[outputs]) for A, B, C in self.clusters)
        return Chords(
            self.D[np.ix_(outputs, inputs)],
            self.poles,
            self.residues[:, outputs][:, :, inputs],
            clusters,
        )

    def at(self, omega: np.ndarray) -> np.ndarray:
        """M (w, n_z, n_w) at omega (w,) [rad/s]; infinity gives D."""
        values = np.broadcast_to(self.D, (len(omega), *self.D.shape)).astype(complex)
        finite = np.flatnonzero(np.isfinite(omega))
        step = max(1, _CHUNK // max(1, len(self.poles)))
        for start in range(0, len(finite), step):
            k = finite[start : start + step]
            values[k] += next(self._sums(omega[k], 1))
        return values

    def slope(self, omega: np.ndarray) -> np.ndarray:
        """dM/d omega (w, n_z, n_w) at omega (w,) [rad/s]; zero at infinity."""
        finite = np.isfinite(omega)
        return np.where(
            finite[:, None, None], -1j * next(self._sums(np.where(finite, omega, 0.0), 2)), 0.0
        )

    def _sums(self, omega: np.ndarray, first: int, count: int = 1) -> Iterator[np.ndarray]:
        """The sums of R_k / (j omega - p_k)^power, (w, n_z, n_w) each, for ``count`` powers from
        ``first``.
        """
        # factor: 1 / (s - p_k), (w, k); sides: (s I - A)^-power B of every cluster, from B on
        s = 1j * omega
        factor = 1 / (s[:, None] - self.poles)
        flat = self.residues.reshape(len(self.poles), self.D.size)
        sides = [
            np.repeat(B[:, None, :].astype(complex), len(s), axis=1) for _, B, _ in self.clusters
        ]

        # one division, one solution of a shifted system more for every power
        part = factor
        for power in range(1, first + count):
            part = part * factor if power > 1 else part
            for (A, _, _), X in zip(self.clusters, sides, strict=True):
                solve_shifted(A, X, s)
            if power >= first:
                values = (part @ flat).reshape(len(s), *self.D.shape)
                for (_, _, C), X in zip(self.clusters, sides, strict=True):
                    values += np.moveaxis(np.tensordot(C, X, 1), 0, 1)
                yield values

    def distance(self, low: np.ndarray, high: np.ndarray, cells: int) -> np.ndarray:
        """Bound (c, n_z, n_w) on the entries of |M - chord| over each interval [low, high] (c,)
        [rad/s], cut into ``cells`` of one width with a chord each; of |M - D| where high is
        infinite. Infinite where one is too wide for its clusters.
        """
        bound = np.empty((len(low), *self.D.shape))
        end = np.isinf(high)
        bound[end] = self._tail(low[end])
        low, high = low[~end], high[~end]

        # d_k of the docstring: from p_k to the segment j [low, high]
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        beside = np.maximum(np.abs(middle[:, None] - self.poles.imag) - half[:, None], 0.0)
        near = np.hypot(self.poles.real, beside)

        # |M''| <= sum_i (i + 1)(i + 2) |sum_k R_k / (j middle - p_k)^(i + 3)| half^i, i < _TERMS,
        # as M^(i + 2) / i! = (-j)^(i + 2) (i + 1)(i + 2) sum_k R_k / (s - p_k)^(i + 3). The
        # remainder is the term i = _TERMS with |R_k| / d_k^(_TERMS + 3).
        last = _TERMS + 3
        rest = (near**-last @ np.abs(self.residues).reshape(len(self.poles), self.D.size)).reshape(
            len(low), *self.D.shape
        )
        for A, B, C in self.clusters:
            rest = rest + _cluster(A, B, C, middle, half, last)
        bend = (_TERMS + 1) * (_TERMS + 2) * half[:, None, None] ** _TERMS * rest
        for i, term in enumerate(self._sums(middle, 3, _TERMS)):
            bend += (i + 1) * (i + 2) * half[:, None, None] ** i * np.abs(term)

        # (b - a)^2 / 8 max |M''| for a chord of width 2 half / cells
        bound[~end] = (2 * half[:, None, None] / cells) ** 2 / 8 * bend
        return bound

    def _tail(self, low: np.ndarray) -> np.ndarray:
        """Bound (c, n_z, n_w) on |M - D| above each frequency low (c,) [rad/s]."""
        # |M - D| <= sum |R_k| / |s - p_k|, from the nearest s above low
        near = np.hypot(self.poles.real, np.maximum(low[:, None] - np.abs(self.poles.imag), 0.0))
        bound = (1 / near @ np.abs(self.residues).reshape(len(self.poles), self.D.size)).reshape(
            len(low), *self.D.shape
        )
        for A, B, C in self.clusters:
            # |(s I - A)^-1| <= 1 / (|s| - |A|)
            beyond = np.maximum(low - np.linalg.norm(A, 2), 0.0)[:, None, None]
            outside = np.linalg.norm(C, axis=1)[:, None] * np.linalg.norm(B, axis=0)
            bound = bound + np.divide(
                outside, beyond, out=np.full_like(bound, np.inf), where=beyond > 0
            )
        return np.asarray(bound)


@dataclass(frozen=True, slots=True, eq=False)
class ChordsBetween:
    """left M right of constant matrices: what is summed over the poles is M, however often its
    entries occur.
    """

    model: Chords
    left: np.ndarray
    right: np.ndarray

    @property
    def D(self) -> np.ndarray:
        return np.asarray(self.left @ self.model.D @ self.right)

    @property
    def every_pole(self) -> np.ndarray:
        """As of M."""
        return self.model.every_pole

    def at(self, omega: np.ndarray) -> np.ndarray:
        """left M right (w, p, m) at omega (w,) [rad/s]; infinity gives that of D."""
        return np.asarray(self.left @ self.model.at(omega) @ self.right)

    def distance(self, low: np.ndarray, high: np.ndarray, cells: int) -> np.ndarray:
        """As of M: |left (M - chord) right| <= |left| |M - chord| |right|, entry by entry."""
        # infinity beside a zero entry would be NaN
        bound = self.model.distance(low, high, cells)
        wide = ~np.isfinite(bound).all(axis=(1, 2))
        bound[wide] = 0.0
        moved = np.abs(self.left) @ bound @ np.abs(self.right)
        moved[wide] = np.inf
        return np.asarray(moved)


def _cluster(
    A: np.ndarray, B: np.ndarray, C: np.ndarray, middle: np.ndarray, half: np.ndarray, power: int
) -> np.ndarray:
    """Bound on |C R^power B| within ``half`` of ``middle``: the smaller one of the coordinates
    given and of eigenvectors.
    """
    bound = _neumann(A, B, C, middle, half, power)
    V = np.linalg.eig(A)[1]
    if np.linalg.cond(V) < _CONDITION:
        inverse = np.linalg.inv(V)
        bound = np.minimum(
            bound, _neumann(inverse @ A @ V, inverse @ B, C @ V, middle, half, power)
        )
    return bound


def _neumann(
    A: np.ndarray, B: np.ndarray, C: np.ndarray, middle: np.ndarray, half: np.ndarray, power: int
) -> np.ndarray:
    """R = R0 (I + j d R0)^-1 with R0 in the middle and |d| <= half."""
    # R here is R0; it commutes with (I + j d R0)^-1, whose norm is at most 1 / (1 - half |R0|):
    # |C R^power B| <= |C R0| |R0|^(power - 2) |R0 B| / (1 - half |R0|)^power.
    R = np.linalg.inv(1j * middle[:, None, None] * np.eye(len(A)) - A)
    size = np.linalg.norm(R, 2, axis=(1, 2))
    part = half * size
    grown = np.full(len(middle), np.inf)
    fits = part < 0.9
    grown[fits] = size[fits] ** (power - 2) / (1 - part[fits]) ** power
    inside = np.linalg.norm(C @ R, axis=2)[:, :, None] * np.linalg.norm(R @ B, axis=1)[:, None, :]

    # not zero: infinity times zero would be NaN
    return np.asarray(grown[:, None, None] * np.maximum(inside, np.finfo(float).tiny))


def chords(system: Any) -> Chords:
    """The chords of a stable continuous system. Raises InvalidInput for a sampled one,
    UnstableSystem.
    """
    system = as_statespace(system)
    if system.dt is not None:
        raise invalid(
            "the system", repr(system), "continuous", "give the one that it was sampled from"
        )
    response = modal_chords(system)
    if not (response.every_pole.real < 0).all():
        worst = response.every_pole.real.max()
        raise UnstableSystem(f"a pole has real part {worst:.4g} rad/s; close the loop stably first")
    return response


def modal_chords(system: StateSpace) -> Chords:
    """The response of a continuous system, stable or not, by its modal form with the widest
    separation that keeps its digits; one single cluster where there is none.
    """
    for growth in _GROWTH:
        try:
            modal = modal_form(system, growth)
        except NumericalFailure:
            continue
        return _residues(modal)

    # No transform keeps the digits: the whole system is one cluster, in real Schur form.
    nothing = np.zeros((0, *system.D.shape), complex)
    A, B, C, _ = balance_system(system.A, system.B, system.C)
    T, Q = sla.schur(A)
    return Chords(system.D.astype(float), np.zeros(0, complex), nothing, ((T, Q.T @ B, C @ Q),))


def _residues(modal: ModalForm) -> Chords:
    A = modal.system.A
    B = modal.system.B
    C = modal.system.C
    D = modal.system.D
    poles: list[complex] = []
    residues: list[np.ndarray] = []
    clusters = []
    for start, size in zip(modal.starts, modal.sizes, strict=True):
        i = slice(start, start + size)
        a = A[i, i]
        b = B[i]
        c = C[:, i]
        if size == 1:
            poles.append(complex(a[0, 0]))
            residues.append(c @ b + 0j)
        elif size == 2 and a[0, 0] == a[1, 1] and a[0, 1] * a[1, 0] < 0:
            # A = [[a, p], [q, a]] with p q < 0: poles a +- j beta, beta^2 = -p q
            p, q = a[0, 1], a[1, 0]
            beta = np.sqrt(-p) * np.sqrt(q) if q > 0 else np.sqrt(p) * np.sqrt(-q)
            # A v = (a + j beta) v, u A = (a + j beta) u
            v, u = np.array([p, 1j * beta]), np.array([q, 1j * beta])

            # R = C v u B / (u v), its conjugate at the other pole
            residue = np.outer(c @ v, u @ b) / (u @ v)
            poles += [complex(a[0, 0], beta), complex(a[0, 0], -beta)]
            residues += [residue, residue.conj()]
        else:
            clusters.append((a, b, c))
    stacked = np.array(residues, complex).reshape(-1, *D.shape)
    return Chords(D.astype(float), np.array(poles, complex), stacked, tuple(clusters))
