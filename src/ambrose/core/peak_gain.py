"""How large a state can become under bounded inputs: the sum of the absolute impulse response (the
l1 norm), from above.
"""

from __future__ import annotations

import numpy as np

from ambrose.core.checks import check_shape

_EXACT = 4096  # samples summed one by one; beyond, blocks of samples are bounded together
_BATCH = 64  # powers of A that are stacked at once
_DOUBLINGS = 60  # of the horizon, at most


def peak_gains(increment: np.ndarray, B: np.ndarray, steps: float = np.inf) -> np.ndarray:
    """Bounds (n, m) on |x_i| for |u_j| <= 1 and x[k+1] = x[k] + increment x[k] + B u[k] from rest;
    infinite when unstable.

    increment (n, n), B (n, m). steps: how many samples the input acts (infinite: for ever). A - I
    is given, not A: a slow pole keeps its digits. Exact for one state; for several an upper bound,
    exact over the first 4096 samples (Dahleh & Diaz-Bobillo 1995, ch. 2: the l1 norm is the peak
    gain).
    """
    increment = check_shape(increment, "increment", "(n, n)")
    B = check_shape(B, "B", "(n, m)", n=len(increment))
    if len(increment) == 1:
        return np.abs(B) * _single(float(increment[0, 0]), steps)
    A = increment + np.eye(len(increment))
    if steps == np.inf and np.abs(np.linalg.eigvals(A)).max(initial=0.0) >= 1:
        return np.where(np.abs(B).sum(axis=0)[None] > 0, np.inf, np.zeros(B.shape))
    return np.minimum(_summed(A, B, steps), _rotation(A, B, steps))


def _single(increment: float, steps: float) -> float:
    """sum over k < steps of |a|^k, a = 1 + increment."""
    distance = -increment if increment >= -1 else 2 + increment  # 1 - |a|

    # |a| >= 1: the sum (|a|^k - 1)/(|a| - 1) of the geometric series, k where |a| = 1
    if distance <= 0:
        if steps == np.inf:
            return np.inf
        return steps if distance == 0 else float(np.expm1(steps * np.log1p(-distance)) / -distance)

    # (1 - |a|^k)/(1 - |a|), in expm1 and log1p: a slow pole keeps its digits
    return (
        1 / distance
        if steps == np.inf
        else float(-np.expm1(steps * np.log1p(-min(distance, 1.0))) / distance)
    )


def _summed(A: np.ndarray, B: np.ndarray, steps: float) -> np.ndarray:
    """The first samples one by one; then S(2K) <= S(K) + |A^K| S(K)."""
    total, response = np.zeros(B.shape), B
    count = int(min(_EXACT, steps))

    # A^0 .. A^batch: a batch of samples is one product with the response at its start.
    powers = [np.eye(len(A))]
    for _ in range(min(_BATCH, count)):
        powers.append(A @ powers[-1])
    for start in range(0, count, _BATCH):
        total += np.abs(np.stack(powers[: min(_BATCH, count - start)]) @ response).sum(axis=0)
        response = powers[-1] @ response

        # each entry against its own sum: states and inputs may be in units of any size; what is
        # below 1e-18 of it no longer changes a sum of doubles
        if (np.abs(response) <= 1e-18 * total).all():
            count = min(count, start + _BATCH)
            break

    # Entry by entry |A^(K + i) B| <= |A^K| |A^i B|: the next K samples add at most |A^K| S(K).
    power = np.linalg.matrix_power(A, count)
    done = float(count)
    for _ in range(_DOUBLINGS):
        further = np.abs(power) @ total
        if done >= steps or (further <= 1e-12 * total).all():
            break
        total = total + further
        power = power @ power
        done *= 2
    return total * (1 + 1e-9)  # an upper bound in spite of rounding and of what was cut off


def _rotation(A: np.ndarray, B: np.ndarray, steps: float) -> np.ndarray:
    """By r = ||A||_2: ||A^k b|| <= r^k ||b||, with equality where A is r times a rotation."""
    r = np.linalg.norm(A, 2)
    if r >= 1 and steps == np.inf:
        return np.full(B.shape, np.inf)

    # |x_i| <= sum_k ||A^k b|| <= ||b|| sum_k r^k, r the 2-norm of A:
    # at most 1/(1 - r), or (r^steps - 1)/(r - 1)
    length = steps if r >= 1 else 1 / (1 - r)
    if r > 1:  # r^steps overflows beyond exp(709)
        length = float(np.expm1(steps * np.log(r)) / (r - 1)) if steps * np.log(r) < 700 else np.inf
    return np.broadcast_to(np.linalg.norm(B, axis=0) * length, B.shape).copy()
