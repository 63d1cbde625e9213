"""Weighted least squares of 1x vectors, with a relative error of the model that the misfit asks for
(Paule & Mandel 1982, J. Res. NBS 87, 377).
"""

from __future__ import annotations

import numpy as np

from ambrose.core.checks import InvalidInput

ILL = 30.0  # condition of the matrix above which planes are hardly told apart
LEAST = 0.01  # relative error of a model's coefficients at the least; assumed


def weighted_fit(
    X: np.ndarray, d: np.ndarray, noise: np.ndarray, size: np.ndarray, freedom: int, least: float
) -> tuple[float, np.ndarray, np.ndarray, float]:
    """Relative error of the coefficients, solution, its covariance and the condition of the matrix
    with columns of unit length.

    X (s, a, c), d and noise (s, a), size (s,): what the relative error, at the least ``least``, is
    of.
    """
    from scipy.optimize import brentq

    # records without noise would weigh without limit
    floor = 1e-24 * float(np.max(np.abs(d) ** 2)) + 1e-40

    def solved(error: float) -> tuple[float, np.ndarray, np.ndarray]:
        # rows over their standard deviation, sqrt(noise + (error size)^2)
        w = 1 / np.sqrt(noise + (error * size[:, None]) ** 2 + floor)
        M, right = (X * w[:, :, None]).reshape(-1, X.shape[2]), (d * w).ravel()
        x = np.linalg.lstsq(M, right)[0]
        return float(np.sum(np.abs(M @ x - right) ** 2)), x, M

    # Paule & Mandel: the common error at which the weighted misfit equals its expectation, the
    # freedom; where 10 is not enough, no root is sought
    error = least
    if freedom and solved(least)[0] > freedom:
        error = (
            brentq(lambda e: solved(e)[0] - freedom, least, 10.0, xtol=1e-6)
            if solved(10.0)[0] < freedom
            else 10.0
        )
    _, x, M = solved(error)

    # columns of unit length: the condition tells planes apart, not units
    length = np.linalg.norm(M, axis=0)
    s = np.linalg.svd(M / length, compute_uv=False)
    if s[-1] < 1e-9 * s[0]:
        raise InvalidInput(
            "the planes cannot be told apart by these sensors and speeds; use fewer planes, or "
            "another speed"
        )
    return float(error), x, np.linalg.inv(M.conj().T @ M), float(s[0] / s[-1])


def circle_of_95(freedom: int) -> float:
    """Radius of the circle that holds 95 % of a circular complex error, per standard deviation; the
    variance was estimated with this many complex degrees of freedom (one at the least).
    """
    from scipy.special import fdtri

    # |error|^2 / variance: F(2, 2 nu)
    return float(np.sqrt(fdtri(2, 2 * max(freedom, 1), 0.95)))
