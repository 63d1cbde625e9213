"""Many points of a box of real parameters at once: the determinant and the closed loop at each,
over frequency.

The parameters are closed one after another, M' = M22 + M21 delta (I - M11 delta)^-1 M12, and det(I
- M11 diag(delta)) is the product of the pivots' determinants. Points that share the values of the
first parameters share the work (the corners of a box of k parameters: 2, 4, 8 .. matrices that
shrink, in place of 2^k full ones).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ambrose.core.checks import memberwise

# complex numbers of matrices that are factorised one by one: memory that is not asked for anew
_HELD = 100_000
_CHUNK = 200_000  # numbers held at once, so that they stay in the cache
# a pivot smaller than this, relative, spoils digits: such points are solved with pivoting
_SMALL = 1e-5
_FEW = 16  # points below which each is solved by itself
_SHARED = 0.5  # branches over points, on average over the parameters, above which nothing is gained


@dataclass(frozen=True, slots=True, eq=False)
class _Branching:
    """Parameters in the order in which they are closed; per parameter: channels, the branch it
    comes from, the value there.
    """

    order: np.ndarray
    repeats: tuple[int, ...]
    parents: tuple[np.ndarray, ...]
    values: tuple[np.ndarray, ...]
    leaf: np.ndarray  # (d,) the branch that holds each point


def determinants_at(M11: np.ndarray, owner: np.ndarray, delta: np.ndarray) -> np.ndarray:
    """h = det(I - M11 diag(delta)), (d, w), for M11 (w, n, n), the parameter ``owner`` (n,) of each
    channel, delta (d, k).
    """
    branching = _branching(owner, delta)
    if branching is not None:
        return _closed(M11, owner, delta, branching)[0]
    return np.concatenate(
        [_determinants(M11[None], part[:, None, owner]) for part in _parts(delta, M11.size)]
    )


def transfers_at(M: np.ndarray, owner: np.ndarray, delta: np.ndarray) -> np.ndarray:
    """T = M22 + M21 diag(delta) (I - M11 diag(delta))^-1 M12, (d, w, p, m), for M (w, n + p, n +
    m); the others as above.

    NaN where I - M11 diag(delta) is singular: a pole.
    """
    branching = _branching(owner, delta)
    if branching is not None:
        return _closed(M, owner, delta, branching)[1]
    return np.concatenate(
        [_transfers(M[None], part[:, None, owner]) for part in _parts(delta, M.size)]
    )


def _parts(delta: np.ndarray, size: int) -> list[np.ndarray]:
    """delta (d, k) in parts, whose matrices with ``size`` entries each stay within a few
    megabytes.
    """
    step = max(1, _HELD // size)
    return [delta[i : i + step] for i in range(0, max(1, len(delta)), step)]


def _branching(owner: np.ndarray, delta: np.ndarray) -> _Branching | None:
    """Parameters with few values and many channels first: while there are few branches. None where
    little would be shared.
    """
    d, k = delta.shape
    if d < _FEW or k == 1:
        return None
    repeats = np.bincount(owner, minlength=k)
    distinct = np.array([len(np.unique(column)) for column in delta.T], int)
    if distinct.min() > _SHARED * d:
        return None
    order = np.lexsort((-repeats, distinct))
    leaf = np.zeros(d, int)
    parents = []
    values = []
    # a branch is a combination of values of the parameters so far
    for i in order:
        pairs, leaf = np.unique(np.stack([leaf, delta[:, i]], axis=1), axis=0, return_inverse=True)
        leaf = leaf.reshape(-1)
        parents.append(pairs[:, 0].astype(int))
        values.append(pairs[:, 1])
    if sum(len(parent) for parent in parents) > _SHARED * k * d:
        return None
    return _Branching(order, tuple(repeats[order].tolist()), tuple(parents), tuple(values), leaf)


def _closed(
    M: np.ndarray, owner: np.ndarray, delta: np.ndarray, branching: _Branching
) -> tuple[np.ndarray, np.ndarray]:
    """Determinants (d, w) and transfers (d, w, p, m), in chunks over frequency."""
    n, (w, rows, columns) = len(owner), M.shape
    channels = np.concatenate([np.flatnonzero(owner == i) for i in branching.order])
    row, column = (
        np.append(channels, np.arange(n, rows)),
        np.append(channels, np.arange(n, columns)),
    )

    # frequency last, so that the products run over it; one branch to begin with
    S = np.ascontiguousarray(M[:, row[:, None], column].transpose(1, 2, 0))[:, :, None]
    h = np.empty((len(delta), w), complex)
    T = np.empty((len(delta), w, rows - n, columns - n), complex)
    spoilt = np.empty((len(delta), w), bool)
    step = max(1, _CHUNK // _largest(branching, rows, columns))
    for start in range(0, w, step):
        part = slice(start, start + step)
        det, rest, bad = _eliminated(S[..., part], branching)
        h[:, part], spoilt[:, part] = det[branching.leaf], bad[branching.leaf]
        T[:, part] = rest.transpose(2, 3, 0, 1)[branching.leaf]
    i, j = np.nonzero(spoilt)
    if len(i):  # a pivot close to zero
        wide = delta[i][:, owner]
        h[i, j] = _determinants(M[j, :n, :n], wide)
        if rows > n:
            T[i, j] = _transfers(M[j], wide)
    return h, T


def _largest(branching: _Branching, rows: int, columns: int) -> int:
    """The most numbers per frequency that ``_eliminated`` holds in one array: many branches while
    the matrices are large, as points that share nothing have, count as much as many points.
    """
    closed = np.cumsum([0, *branching.repeats[:-1]])
    branches = np.array([len(parent) for parent in branching.parents])
    return int((branches * (rows - closed) * (columns - closed)).max())


def _eliminated(S: np.ndarray, branching: _Branching) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """S (rows, columns, 1, w) closed parameter by parameter: determinant (c, w), the rest (p, m, c,
    w), spoilt (c, w).
    """
    det, bad = np.ones(S.shape[2:], complex), np.zeros(S.shape[2:], bool)
    with np.errstate(all="ignore"):
        for r, parent, value in zip(
            branching.repeats, branching.parents, branching.values, strict=True
        ):
            # S' = S22 + S21 v (I - S11 v)^-1 S12, and the determinant times det(I - S11 v)
            v = value[:, None]
            if r == 1:
                loop = v * S[0, 0][parent]
                pivot = 1 - loop
                small = np.abs(pivot) < _SMALL * (1 + np.abs(loop))
                step = S[1:, 0][:, None][:, :, parent] * (S[0, 1:][:, parent] * (v / pivot))
            else:
                pivot, small, step = _block(S, r, parent, v)
            S = S[r:, r:][:, :, parent] + step
            det, bad = det[parent] * pivot, bad[parent] | small | ~np.isfinite(pivot)
    return det, S, bad


def _block(
    S: np.ndarray, r: int, parent: np.ndarray, v: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A parameter of r channels: determinant of its pivot (c, w), whether that is near zero, what
    is added (a, b, c, w).
    """
    B, right, left = (
        part.transpose(2, 3, 0, 1)[parent] for part in (S[:r, :r], S[:r, r:], S[r:, :r])
    )
    X = np.eye(r) - B * v[..., None, None]
    pivot = np.linalg.det(X)

    # a singular pivot would end the inversion of all; such points are solved again with pivoting
    singular = ~(np.abs(pivot) > 0)
    X[singular] = np.eye(r)
    inverse = np.linalg.inv(X)
    small = singular | (np.abs(inverse).max(axis=(2, 3)) * np.abs(X).max(axis=(2, 3)) > 1 / _SMALL)
    step = left @ ((inverse * v[..., None, None]) @ right)
    return pivot, small, step.transpose(2, 3, 0, 1)


def _determinants(M11: np.ndarray, wide: np.ndarray) -> np.ndarray:
    """det(I - M11 diag(wide)) by LU with pivoting, M11 (..., n, n), wide (..., n)."""
    return np.asarray(np.linalg.det(np.eye(M11.shape[-1]) - M11 * wide[..., None, :]))


def _transfers(M: np.ndarray, wide: np.ndarray) -> np.ndarray:
    """T with pivoting, for M (..., n + p, n + m) and wide (..., n); NaN on a pole."""
    n, m = wide.shape[-1], M.shape[-1] - wide.shape[-1]
    D = wide[..., None, :]  # on the columns of M11 and M21
    X = np.eye(n) - M[..., :n, :n] * D
    right = np.broadcast_to(M[..., :n, n:], (*X.shape[:-1], m)).reshape(-1, n, m)
    inner = memberwise(np.linalg.solve, X.reshape(-1, n, n), right).reshape(*X.shape[:-1], m)
    return np.asarray(M[..., n:, n:] + (M[..., n:, :n] * D) @ inner)
