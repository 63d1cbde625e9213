"""What a result depends on: variance-based sensitivity indices from samples that are there, without
further runs.

Main effect of an input x_i: S_i = Var(E[y | x_i]) / Var(y), the share of the variance that goes
when x_i is known (Sobol 1993; Saltelli et al. 2008, sec. 1.2.8). Conditional means are those of
classes: the values themselves where they are few, else classes of equally many samples (the
correlation ratio of Pearson 1905).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ambrose.core.checks import check_shape

_MOST_LEVELS = 40  # values up to which each is a class of its own
_CLASSES = 100  # at most, and as many as leave ten samples to each
_LEAST = 10  # cases in a class, so that its mean says something


def main_effects(x: ArrayLike, y: ArrayLike, *, complete: bool = False) -> np.ndarray:
    """S (v,) of the inputs x (c, v) on y (c,), each 0 to 1.

    complete: x is a full grid, on which class means are exact; else what the scatter of means of
    few samples adds is taken off (Kelley 1935). A constant y gives zeros. Raises InvalidInput for
    arrays that do not fit.
    """
    x = check_shape(x, "x", "(c, v)").astype(float)
    y = check_shape(y, "y", "(c)", c=len(x)).astype(float)
    total = y.var()
    if len(y) < 2 or total <= 1e-24 * np.square(y).mean():
        return np.zeros(x.shape[1])
    return np.array([_share(_classes(column), y, total, complete) for column in x.T])


def _classes(x: np.ndarray) -> np.ndarray:
    levels, which = np.unique(x, return_inverse=True)
    if len(levels) <= min(_MOST_LEVELS, max(2, len(x) // 2)):
        return which
    count = max(2, min(_CLASSES, len(x) // _LEAST))
    rank = np.empty(len(x), dtype=int)
    rank[np.argsort(x, kind="stable")] = np.arange(len(x))
    return rank * count // len(x)


def _share(which: np.ndarray, y: np.ndarray, total: float, complete: bool) -> float:
    sizes = np.bincount(which)
    kept = sizes > 0
    means = np.bincount(which, y)[kept] / sizes[kept]
    share = float((sizes[kept] * (means - y.mean()) ** 2).sum() / len(y) / total)
    if not complete and kept.sum() < len(y):
        share = 1 - (1 - share) * (len(y) - 1) / (len(y) - kept.sum())
    return min(max(share, 0.0), 1.0)
