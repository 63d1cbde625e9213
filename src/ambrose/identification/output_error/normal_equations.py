"""The output error of one record: residual, normal equations and scores, with initial state and offsets eliminated.

Both enter linearly, y = y(theta, u) + O(theta) x0 + b, O = [C; C A; C A^2; ...], so they are eliminated at every theta
(variable projection, Golub & Pereyra 1973, in Kaufman's form): what is left is a problem in theta alone. O is never formed for
the whole record: O'O follows from doubling, O' times a signal from blocks. Records are only looked at in pieces: the memory
does not grow with their length.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ambrose.core.response import SystemDerivative
from ambrose.core.statespace import StateSpace
from ambrose.identification.output_error.levenberg_marquardt import Linearised
from ambrose.identification.output_error.lifted import BLOCK, Lifted, blocks, lift, powers_of, stream

_INVISIBLE = 1e-10  # directions of the initial state seen weaker than this (squared) are left at zero: rounding rules there
_BLIND = 1e-9  # part of a parameter's effect (squared) that must remain beside them
_LONG = 12_288  # samples at a time, about, where pieces are compared with each other


@dataclass(frozen=True, slots=True, eq=False)
class Task:
    """A record: the r distinct excitations e, each (k,), and mix (m, r) of them; the p measured signals y, each (k,), and what
    else is estimated. unit (p,): what y is still to be divided by to stand over its weights (None: it does already). place:
    which of several models made the record. tail: the loop's last states, as far as they are known; alike: how many before them
    are old commands, of one size, some of which may hardly be seen. e and y may be views of the record: only looked at."""

    e: Sequence[np.ndarray] | np.ndarray
    mix: np.ndarray
    y: Sequence[np.ndarray] | np.ndarray
    initial_state: bool
    offset: bool
    unit: np.ndarray | None = None
    place: int = 0
    tail: np.ndarray = field(default_factory=lambda: np.zeros(0))
    alike: int = 0

    @property
    def samples(self) -> int:
        return len(self.y[0])

    def measured(self, i: int, start: int, stop: int) -> np.ndarray:
        """Samples of the measured signal number i over its weight."""
        part = np.asarray(self.y[i][start:stop])
        return part if self.unit is None else part / self.unit[i]

    def first(self, samples: int) -> Task:
        """The same record, ended after ``samples``."""
        return replace(self, e=[x[:samples] for x in self.e], y=[x[:samples] for x in self.y])


@dataclass(frozen=True, slots=True, eq=False)
class RecordSolution:
    """The normal equations of a record at one theta, with the initial state x0 (n,) and the offsets b (p,) over the weights
    that fit best, and how they would follow a parameter: dx0 (q, n), db (q, p)."""

    equations: Linearised
    x0: np.ndarray
    b: np.ndarray
    dx0: np.ndarray
    db: np.ndarray


def distinct(e: Sequence[np.ndarray]) -> tuple[tuple[np.ndarray, ...], np.ndarray]:
    """The r signals (k,) and mix (m, r) with e (m, k) = mix signals: equal, opposite and absent excitations are taken once."""
    rows: list[np.ndarray] = []
    mix = np.zeros((len(e), len(e)))
    for i, row in enumerate(e):
        if not row.any():
            continue
        for j, other in enumerate(rows):
            sign = next((s for s in (1.0, -1.0) if _same(row, s, other)), 0.0)
            if sign:
                mix[i, j] = sign
                break
        else:
            mix[i, len(rows)] = 1.0
            rows.append(row)
    return tuple(rows), mix[:, : len(rows)]


def _same(one: np.ndarray, sign: float, other: np.ndarray, piece: int = 8192) -> bool:
    return all(np.array_equal(one[i : i + piece], sign * other[i : i + piece]) for i in range(0, len(one), piece))


def _driven(system: StateSpace, directions: list[SystemDerivative], task: Task) -> tuple[StateSpace, list[SystemDerivative]]:
    """The loop and its derivatives from the distinct signals."""
    mixed = StateSpace(system.A, system.B @ task.mix, system.C, system.D @ task.mix, None, system.outputs, system.dt)
    return mixed, [SystemDerivative(d.A, d.B @ task.mix, d.C, d.D @ task.mix) for d in directions]


def fit(system: StateSpace, task: Task) -> tuple[np.ndarray, RecordSolution]:
    """The residual (p, k) of a whole record with the best initial state and offsets, and those; ``system`` as in
    ``normal_equations``."""
    best = normal_equations(system, [], task)
    pieces = [piece[: len(system.outputs)] for piece in residual_pieces(system, task, best)]
    return np.concatenate(pieces, axis=1), best


def normal_equations(system: StateSpace, directions: list[SystemDerivative], task: Task) -> RecordSolution:
    """r'r, J'J and J'r of the record for theta alone; ``system`` from all excitations to outputs over their weights.

    Two passes: the first finds initial state and offsets, on which the derivatives depend.
    """
    system, directions = _driven(system, directions, task)
    n, p = system.n_states, len(system.outputs)
    basis = _nuisance_basis(system, task)
    x0, b = np.concatenate([np.zeros(n - len(task.tail)), task.tail]), np.zeros(p)
    if basis.size:
        _, N = _products(lift(system, []), system.A, task, x0, b, with_nuisance=True)
        best = basis @ (basis.T @ N[:, 0])
        x0, b = x0 + best[:n], best[n:]
    G, N = _products(lift(system, directions), system.A, task, x0, b, with_nuisance=bool(basis.size))
    M = basis.T @ N
    shift = (basis @ M).T
    H, g = G[1:, 1:] - M[:, 1:].T @ M[:, 1:], G[1:, 0]
    blind = np.diag(H) <= _BLIND * np.diag(G)[1:]  # what is left is rounding: initial state and offsets explain it all
    H[blind], H[:, blind], g[blind] = 0.0, 0.0, 0.0
    return RecordSolution(Linearised(float(G[0, 0]), H, g), x0, b, -shift[1:, :n], -shift[1:, n:])


def _products(
    lifted: Lifted, A: np.ndarray, task: Task, x0: np.ndarray, b: np.ndarray, with_nuisance: bool
) -> tuple[np.ndarray, np.ndarray]:
    """F F' (1 + q, 1 + q) and [O, 1]' F' (n + p, 1 + q) of F = [r, J], summed over the record."""
    n, p, q1 = len(A), len(task.y), len(lifted.maps)
    G, N = np.zeros((q1, q1)), np.zeros((q1, n + p))
    powers, ahead = np.zeros((0, n, n)), np.eye(n)
    ones = np.repeat(np.eye(p), lifted.shown.shape[1] // p, axis=0)
    seen_by = np.hstack([lifted.shown.T, ones])  # what a block says of the state at its start, and of the offsets
    for start, F in stream(lifted, list(task.e), x0):
        _measured_less(F, task, start, b)
        flat = F.reshape(q1, -1)
        G += flat @ flat.T
        if not with_nuisance:
            continue
        count = F.shape[1]
        if count > len(powers):
            powers = powers_of(lifted.powers[1].T, count + 1)
        both = (F.reshape(q1 * count, -1) @ seen_by).reshape(q1, count, n + p)
        N[:, n:] += both[:, :, n:].sum(axis=1)
        N[:, :n] += both[:, :, :n].reshape(q1, count * n) @ powers[:count].reshape(count * n, n) @ ahead
        ahead = powers[count] @ ahead
    return G, N.T


def _measured_less(F: np.ndarray, task: Task, start: int, b: np.ndarray) -> None:
    """Turn the simulated outputs F[0] (count, p, L) of a piece into the residual; nothing counts past the record's end."""
    _, count, _, L = F.shape
    stop = min(start + count * L, task.samples)
    for i in range(len(task.y)):
        F[0, :, i] = blocks(task.measured(i, start, stop), L) - F[0, :, i] - b[i]
    rest = count * L - (stop - start)
    if rest:
        F[:, -1, :, L - rest :] = 0.0


def residual_pieces(system: StateSpace, task: Task, solution: RecordSolution) -> Iterator[np.ndarray]:
    """The residual over the weights and below it the distinct excitations, (p + r, length) piece by piece."""
    loop, _ = _driven(system, [], task)
    for start, F in stream(lift(loop, []), list(task.e), solution.x0, None, _long(task)):
        _measured_less(F, task, start, solution.b)
        stop = min(start + F.shape[1] * F.shape[3], task.samples)
        yield np.vstack([_in_time(F, stop - start)[0], *(e[None, start:stop] for e in task.e)])


def jacobian_pieces(
    system: StateSpace, directions: list[SystemDerivative], task: Task, solution: RecordSolution
) -> Iterator[np.ndarray]:
    """J (q, p, length) piece by piece, without the part that initial state and offsets could explain."""
    loop, directions = _driven(system, directions, task)
    for start, F in stream(lift(loop, directions), list(task.e), solution.x0, solution.dx0, _long(task)):
        piece = _in_time(F[1:], min(F.shape[1] * F.shape[3], task.samples - start))
        piece += solution.db[:, :, None]
        yield piece


def _long(task: Task) -> int:
    """Blocks at a time, so that the pieces are equally long."""
    count = max(round(task.samples / _LONG), 1)
    return -(-task.samples // (count * BLOCK))


def _in_time(F: np.ndarray, length: int) -> np.ndarray:
    """(c, count, p, L) as (c, p, length)."""
    c, count, p, L = F.shape
    return F.transpose(0, 2, 1, 3).reshape(c, p, count * L)[:, :, :length]


def _nuisance_basis(system: StateSpace, task: Task) -> np.ndarray:
    """(n + p, r) such that [O, 1] basis has orthonormal columns, which span all that x0 and b can explain; rows of what is not
    estimated are zero."""
    n, p, k = system.n_states, len(system.outputs), task.samples
    if not (task.initial_state or task.offset):
        return np.zeros((n + p, 0))
    Q, F, _ = _sums(system.A, system.C, k)
    G = np.block([[Q, F], [F.T, k * np.eye(p)]])
    known = len(task.tail)
    free = np.r_[np.full(n - known, task.initial_state), np.full(known, False), np.full(p, task.offset)]
    seen = np.diag(G).copy()
    old = slice(n - known - task.alike, n - known)
    seen[old] = seen[old].max(initial=0.0)
    used = free & (seen > 0)
    size = np.sqrt(np.where(used, seen, 1.0))
    scaled = np.where(used[:, None] & used, G / size / size[:, None], 0.0)
    values, V = np.linalg.eigh(scaled)
    keep = values > _INVISIBLE * values[-1]
    return V[:, keep] / np.sqrt(values[keep]) / size[:, None]


def _sums(A: np.ndarray, C: np.ndarray, k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """sum A'^t C'C A^t, sum A'^t C' over t = 0..k - 1, and A^k, by doubling."""
    if k == 1:
        return C.T @ C, C.T.copy(), A
    Q, F, P = _sums(A, C, k // 2)
    Q, F, P = Q + P.T @ Q @ P, F + P.T @ F, P @ P
    return (Q + P.T @ C.T @ C @ P, F + P.T @ C.T, P @ A) if k % 2 else (Q, F, P)
