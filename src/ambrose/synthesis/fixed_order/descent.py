"""L-BFGS whose line search never leaves the set of stabilising controllers (Nocedal & Wright 2006,
alg. 7.4, 3.1).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

_MEMORY = 25  # steps that the approximation of the Hessian remembers; assumed
_HALVINGS = 25
_RENEWED = 10  # steps between two calls of ``renew``


def descend(
    cost: Callable[[np.ndarray], tuple[float, np.ndarray]],
    allowed: Callable[[np.ndarray], bool],
    x: np.ndarray,
    iterations: int,
    tolerance: float,
    proceed: Callable[[], bool],
    renew: Callable[[np.ndarray], bool] | None = None,
    least: float = -np.inf,
) -> tuple[np.ndarray, int]:
    """x (k,) with a lower cost, reached through allowed points only, and the iterations used.

    x (k,): allowed. Ends after ``iterations``, when ten of them gain less than ``tolerance``, when
    the cost is below ``least``, or when ``proceed`` says no. renew: called with x at the start,
    every ten steps and at the end, it may change what the cost leaves out. Where it says False the
    cost had left out that x is not allowed: the descent goes on from where it last said True.
    """
    if renew is not None:
        renew(x)
    safe = x
    value, g = cost(x)
    pairs: list[tuple[np.ndarray, np.ndarray]] = []
    values = [value]
    used = 0
    while used < iterations:
        used += 1
        if not proceed():
            break
        if renew is not None and used % _RENEWED == 0:
            # leaving out other parts changes the cost at the same x: earlier values move along, so
            # that gains can still be told
            if not renew(x):
                x = safe
                renew(x)
                pairs.clear()
            safe = x
            before = value
            value, g = cost(x)
            values = [item + value - before for item in values]

        # -H g; without descent (rounding, or a cost that was renewed) the memory is dropped.
        direction = _direction(g, pairs)
        slope = float(g @ direction)
        if slope >= 0:
            pairs.clear()
            direction, slope = -g, -float(g @ g)

        # The memory scales a direction itself; the bare gradient starts with 1 % of |x|, or of 1.
        step = (
            1.0
            if pairs
            else min(
                1.0,
                1e-2 * max(1.0, float(np.linalg.norm(x))) / max(float(np.linalg.norm(g)), 1e-300),
            )
        )
        for _ in range(_HALVINGS):
            trial = x + step * direction
            # sufficient decrease, among allowed points; where the cost is far higher (inf where a
            # loop is unstable) the step falls tenfold
            new, g_new = cost(trial)
            if new <= value + 1e-4 * step * slope and allowed(trial):
                break
            step *= 0.5 if np.isfinite(new) and new < value + 1 else 0.1
        else:
            # no step along -g itself gains: the end; otherwise once more along -g
            if not pairs:
                break
            pairs.clear()
            continue

        # Only a pair of positive curvature keeps H positive definite.
        s, y = trial - x, g_new - g
        if s @ y > 1e-10 * np.linalg.norm(s) * np.linalg.norm(y):
            pairs = [*pairs[-_MEMORY + 1 :], (s, y)]
        x = trial
        value = new
        g = g_new
        values.append(value)
        if value < least or (len(values) > 10 and values[-11] - value < tolerance):
            break
    return (x if renew is None or renew(x) else safe), used


def _direction(g: np.ndarray, pairs: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """-H g by the two-loop recursion."""
    # First loop, from the newest pair: q = V q with V = I - y s^T / s^T y.
    q, alphas = g.copy(), []
    for s, y in reversed(pairs):
        alpha = float(s @ q) / float(s @ y)
        q -= alpha * y
        alphas.append(alpha)

    # H_0 = (s^T y / y^T y) I of the newest pair
    if pairs:
        s, y = pairs[-1]
        q *= float(s @ y) / float(y @ y)

    # Second loop, from the oldest: q = V^T q + s alpha.
    for (s, y), alpha in zip(pairs, reversed(alphas), strict=True):
        q += s * (alpha - float(y @ q) / float(s @ y))
    return -q
