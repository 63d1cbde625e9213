"""A straight line through points with known uncertainties: where the line is, and where the next
point will be.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ambrose.core.checks import check_shape, invalid


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """y = intercept + slope x, weighted least squares through n points.

    covariance (2, 2) of (intercept, slope). scatter: sd of a point of unit weight about the line,
    over what its own sd says (1: as stated; larger: the points scatter more than they claim, and
    every band is widened by it). point_deviation: sd of a further point, its own noise included.
    freedom: n - 2, or n - 1 for a line through the origin. r_squared [-]. apart (n,): how far each
    point is from the line through all others, in stated standard deviations of that difference.
    """

    intercept: float
    slope: float
    covariance: np.ndarray
    scatter: float
    point_deviation: float
    freedom: int
    r_squared: float
    apart: np.ndarray

    def at(self, x: ArrayLike) -> np.ndarray:
        """The line at x."""
        return self.intercept + self.slope * np.asarray(x, dtype=float)

    def deviation(self, x: ArrayLike) -> np.ndarray:
        """Standard deviation of the line at x."""
        x = np.asarray(x, dtype=float)
        S = self.covariance
        return np.sqrt(np.maximum(S[0, 0] + 2 * S[0, 1] * x + S[1, 1] * x**2, 0.0))

    def confidence(self, x: ArrayLike, level: float = 0.95) -> np.ndarray:
        """Half-width of the band that holds the true line at x."""
        return _student(self.freedom, level) * self.deviation(x)

    def prediction(self, x: ArrayLike, level: float = 0.95) -> np.ndarray:
        """Half-width of the band that holds the next measured point at x."""
        return _student(self.freedom, level) * np.sqrt(
            self.deviation(x) ** 2 + self.point_deviation**2
        )

    @property
    def slope_probability(self) -> float:
        """Probability of a slope at least as large, either sign, where there is none (small: the
        slope is real).
        """
        from scipy.special import stdtr

        deviation = float(np.sqrt(self.covariance[1, 1]))
        return (
            2 * float(stdtr(self.freedom, -abs(self.slope) / deviation)) if deviation > 0 else 0.0
        )


def fit_line(
    x: ArrayLike, y: ArrayLike, deviations: ArrayLike | None = None, *, through_origin: bool = False
) -> Line:
    """The line through points x (n,), y (n,) with standard deviations (n,) (None: equal, unknown).

    Where deviations are given, bands follow them, and are widened (never narrowed) when the points
    scatter more: the square root of chi squared over freedom, Birge (1932). Raises InvalidInput for
    fewer points than a line with a scatter needs. Draper & Smith (1998), ch. 1-3.
    """
    x = check_shape(x, "x", "(n)").astype(float)
    n = len(x)
    y = check_shape(y, "y", "(n)", n=n).astype(float)
    least = 2 if through_origin else 3
    if n < least or np.ptp(x) == 0:
        raise invalid(
            "the points of a line",
            f"{n} at {len(np.unique(x))} places",
            f"at least {least}, apart",
            "measure more",
        )
    known = deviations is not None
    sd = (
        check_shape(deviations, "deviations", "(n)", n=n).astype(float)
        if deviations is not None
        else np.ones(n)
    )
    if not (sd > 0).all():
        raise invalid(
            "the smallest standard deviation of a point",
            sd.min(),
            "positive",
            "leave deviations out, or correct it",
        )
    size = np.array([1.0, float(np.abs(x).max())])
    X = np.column_stack([np.ones(n), x / size[1]])[:, 1 if through_origin else 0 :] / sd[:, None]
    inverse = np.linalg.inv(X.T @ X)
    estimate = inverse @ X.T @ (y / sd)
    rest = y / sd - X @ estimate
    freedom = n - X.shape[1]
    birge = float(np.sqrt(rest @ rest / freedom))
    scatter = max(1.0, birge) if known else birge
    whole = np.zeros((2, 2))
    whole[-len(estimate) :, -len(estimate) :] = inverse * scatter**2
    coefficients = np.concatenate([np.zeros(2 - len(estimate)), estimate]) / size
    weight = 1 / sd**2
    spread = float(weight @ (y - weight @ y / weight.sum()) ** 2)
    share = 1 - float(rest @ rest) / spread if spread > 0 else 0.0
    typical = float(1 / np.sqrt(weight.mean()))
    # what of a point's own deviation is left beside the line
    free = 1 - np.einsum("ij,jk,ik->i", X, inverse, X)
    apart = rest / np.sqrt(np.maximum(free, 1e-300)) / (1.0 if known or not birge else birge)
    apart[free < 1e-9] = 0.0  # the others leave the line open there
    return Line(
        float(coefficients[0]),
        float(coefficients[1]),
        whole / size / size[:, None],
        scatter,
        scatter * typical,
        freedom,
        share,
        apart,
    )


def _student(freedom: int, level: float) -> float:
    from scipy.special import stdtrit

    if not 0 < level < 1:
        raise invalid("level", level, "between 0 and 1", "0.95 is usual")
    return float(stdtrit(freedom, (1 + level) / 2))
