"""Scalar D scalings moved to where they are wanted: the lowest peak of sigma_max(D M D^-1), not the nearest magnitude.

A fit of low order cannot follow the optimal D at every frequency, and least squares does not know where an error costs most.
Starting from the fit, the gains, poles and zeros of all blocks are moved together by L-BFGS to lower the p-norm over frequency
of the largest singular value, whose derivative is exact: d ln sigma = sum_i (|left_i|^2 - |right_i|^2) d ln |d_i|, with the
parts of the singular vectors that belong to block i. Only the magnitude of d_i matters, its phase is unitary.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ambrose.core.mu_structure import Structure
from ambrose.synthesis.mu_fit import RealRational

_POWER = 40.0
_ITERATIONS = 40


def peak_gain(M: np.ndarray, omega: np.ndarray, structure: Structure, d: Sequence[RealRational]) -> np.ndarray:
    """sigma_max(D_z M D_w^-1) (w,) for M (w, n_z, n_w) at omega (w,) [rad/s], D_i = |d_i(j omega)| I."""
    return np.linalg.norm(_scaled(M, structure, np.stack([x.log_magnitude(omega) for x in d], axis=1)), 2, axis=(1, 2))


def _scaled(M: np.ndarray, structure: Structure, log_d: np.ndarray) -> np.ndarray:
    """log_d (w, blocks)."""
    w = np.repeat(log_d, [place.block.n_w for place in structure.places], axis=1)
    z = np.repeat(log_d, [place.block.n_z for place in structure.places], axis=1)
    return np.exp(z)[:, :, None] * M * np.exp(-w)[:, None, :]


def refine(M: np.ndarray, omega: np.ndarray, structure: Structure, d: Sequence[RealRational]) -> list[RealRational]:
    """``d`` with a peak that is lower or the same. The last block's d is kept, it is the reference.

    M (w, n_z, n_w) at omega (w,) [rad/s], positive and ascending: its ends bound poles and zeros. Orders do not change.
    """
    from scipy.optimize import minimize

    free = list(d[:-1])
    sizes = [2 * x.order + 1 for x in free]
    start = np.concatenate([np.concatenate([[np.log(x.gain)], np.log(x.zeros), np.log(x.poles)]) for x in free])
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
        ratio = np.log(np.maximum(s[:, 0], 1e-300) / level) * _POWER
        share = np.exp(ratio - ratio.max())
        total = share.sum()
        gradient = []
        for x, place in zip(new[:-1], structure.places[:-1], strict=True):
            slope = (np.abs(U[:, place.z, 0]) ** 2).sum(axis=1) - (np.abs(Vh[:, 0, place.w]) ** 2).sum(axis=1)
            slope = slope * share / total
            gradient += [[slope.sum()], -slope @ _slopes(omega, x.zeros), slope @ _slopes(omega, x.poles)]
        return float((ratio.max() + np.log(total)) / _POWER), np.concatenate(gradient)

    if not np.isfinite(start).all():
        return list(d)
    start = np.clip(start, [-np.inf if a is None else a for a, _ in bounds], [np.inf if b is None else b for _, b in bounds])
    found = minimize(cost, start, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": _ITERATIONS})
    better = [*unpack(found.x), d[-1]]
    return better if peak_gain(M, omega, structure, better).max() < level else list(d)


def _slopes(omega: np.ndarray, corner: np.ndarray) -> np.ndarray:
    """-d ln|1 + j w/c| / d ln c, (w, corners)."""
    ratio = (omega[:, None] / corner) ** 2
    return ratio / (1 + ratio)
