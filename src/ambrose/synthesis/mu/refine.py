"""Scalar D scalings where they are wanted: the lowest peak of sigma_max(D M D^-1), not the nearest
magnitude.

A fit of low order cannot follow the optimal D at every frequency, and need not: around the optimum
is a whole tube of D with almost the same sigma_max. ``tube`` finds it, for a fit to its middle with
its width as the weight.

Least squares still does not know where an error costs most. Starting from the fit, the gains, poles
and zeros of all blocks are moved together by L-BFGS to lower the p-norm over frequency of the
largest singular value, whose derivative is exact: d ln sigma = sum_i (|left_i|^2 - |right_i|^2) d
ln |d_i|, with the parts of the singular vectors that belong to block i. Only the magnitude of d_i
matters, its phase is unitary.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ambrose.core.frequency import largest_gain
from ambrose.core.mu.structure import Structure
from ambrose.synthesis.mu.d_fit import RealRational, corner_slopes

_POWER = 40.0
_REACH = 6.0  # largest half-width of a tube, in ln d
_HALVINGS = 7
_ITERATIONS = 40


def peak_gain(
    M: np.ndarray, omega: np.ndarray, structure: Structure, d: Sequence[RealRational]
) -> np.ndarray:
    """sigma_max(D_z M D_w^-1) (w,) for M (w, n_z, n_w) at omega (w,) [rad/s], D_i = |d_i(j omega)|
    I.
    """
    return largest_gain(
        _scaled(M, structure, np.stack([x.log_magnitude(omega) for x in d], axis=1))
    )


def _scaled(M: np.ndarray, structure: Structure, log_d: np.ndarray) -> np.ndarray:
    """log_d (w, blocks)."""
    w = np.repeat(log_d, [place.block.n_w for place in structure.places], axis=1)
    z = np.repeat(log_d, [place.block.n_z for place in structure.places], axis=1)
    return np.exp(z)[:, :, None] * M * np.exp(-w)[:, None, :]


def tube(
    M: np.ndarray, structure: Structure, log_d: np.ndarray, level: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Where ln d_i may lie, one block at a time, with sigma_max(D M D^-1) <= level: middle and
    half-width, (w, blocks - 1).

    M (w, n_z, n_w); log_d (w, blocks): the optimal ones; level (w,): above their sigma_max.
    Half-widths are at most 6.
    """
    S = _scaled(M, structure, log_d)
    count = log_d.shape[1] - 1
    ends = np.zeros((2, len(M), count))
    for i in range(count):
        for side, sign in enumerate((-1.0, 1.0)):
            # all frequencies at once: the whole reach first, then halving between what keeps the
            # level and what does not
            inside, outside = np.zeros(len(M)), np.full(len(M), _REACH)
            for halving in range(_HALVINGS):
                trial = outside if halving == 0 else 0.5 * (inside + outside)
                change = np.zeros_like(log_d)
                change[:, i] = sign * trial
                below = largest_gain(_scaled(S, structure, change)) <= level
                inside, outside = np.where(below, trial, inside), np.where(below, outside, trial)
            ends[side, :, i] = log_d[:, i] + sign * inside
    return 0.5 * (ends[0] + ends[1]), 0.5 * (ends[1] - ends[0])


def refine(
    M: np.ndarray, omega: np.ndarray, structure: Structure, d: Sequence[RealRational]
) -> list[RealRational]:
    """``d`` with a peak that is lower or the same. The last block's d is kept, it is the reference.

    M (w, n_z, n_w) at omega (w,) [rad/s], positive and ascending: its ends bound poles and zeros.
    Orders do not change.
    """
    from scipy.optimize import minimize

    free = list(d[:-1])

    # theta: ln gain, ln zeros, ln poles of every block but the last.
    sizes = [2 * x.order + 1 for x in free]
    start = np.concatenate(
        [np.concatenate([[np.log(x.gain)], np.log(x.zeros), np.log(x.poles)]) for x in free]
    )
    level = float(peak_gain(M, omega, structure, d).max())
    if level <= 0:
        return list(d)
    low, high = np.log(omega[0]), np.log(omega[-1])
    bounds = [edge for x in free for edge in [(None, None), *[(low, high)] * (2 * x.order)]]

    def unpack(theta: np.ndarray) -> list[RealRational]:
        parts = np.split(theta, np.cumsum(sizes)[:-1])
        orders = [x.order for x in free]
        return [
            RealRational(float(np.exp(p[0])), np.exp(p[1 : 1 + n]), np.exp(p[1 + n :]))
            for p, n in zip(parts, orders, strict=True)
        ]

    def cost(theta: np.ndarray) -> tuple[float, np.ndarray]:
        new = [*unpack(theta), d[-1]]
        S = _scaled(M, structure, np.stack([x.log_magnitude(omega) for x in new], axis=1))
        U, s, Vh = np.linalg.svd(S)

        # ln(sum (sigma/level)^p) / p, the largest term taken out of the sum
        ratio = np.log(np.maximum(s[:, 0], 1e-300) / level) * _POWER
        share = np.exp(ratio - ratio.max())
        total = share.sum()
        gradient = []
        for x, place in zip(new[:-1], structure.places[:-1], strict=True):
            # d ln sigma = (|left_i|^2 - |right_i|^2) d ln |d_i|
            slope = (np.abs(U[:, place.z, 0]) ** 2).sum(axis=1) - (
                np.abs(Vh[:, 0, place.w]) ** 2
            ).sum(axis=1)

            # d ln|d| by ln gain: 1; by ln z: -corner_slopes; by ln p: corner_slopes
            slope = slope * share / total
            gradient += [
                [slope.sum()],
                -slope @ corner_slopes(omega, x.zeros),
                slope @ corner_slopes(omega, x.poles),
            ]
        return float((ratio.max() + np.log(total)) / _POWER), np.concatenate(gradient)

    if not np.isfinite(start).all():
        return list(d)
    start = np.clip(
        start,
        [-np.inf if a is None else a for a, _ in bounds],
        [np.inf if b is None else b for _, b in bounds],
    )
    found = minimize(
        cost, start, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": _ITERATIONS}
    )
    better = [*unpack(found.x), d[-1]]
    return better if peak_gain(M, omega, structure, better).max() < level else list(d)
