"""Rational functions with a wanted magnitude: stable, minimum phase, real poles and zeros inside
the frequency grid.

The D scalings of mu synthesis must be stable with a stable inverse, and they must not invent
dynamics the data do not show: a pole or zero outside the grid is fitted to nothing, and its
integral or roll-off destroys the next synthesis. Poles and zeros are therefore real, negative and
bounded by the grid. The fit is in log magnitude,

    ln |d(j w)| = ln g + 1/2 sum_i ln(1 + (w/z_i)^2) - 1/2 sum_i ln(1 + (w/p_i)^2),

by Gauss-Newton with Levenberg's damping in (ln z, ln p), the gain eliminated. Orders are built up
one by one: a scan finds the pole-zero pair that removes most of what is left, then all move
together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ambrose.core.checks import check_positive, check_shape, invalid
from ambrose.core.statespace import StateSpace

_SCAN = 18  # candidate corner frequencies of a new pole-zero pair, per side
_STARTS = 4  # pairs tried at every order
_STEPS = 60
_AROUND = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)]


@dataclass(frozen=True, slots=True, eq=False)
class RealRational:
    """d(s) = gain prod (s/zeros_i + 1) / prod (s/poles_i + 1): gain > 0 that at s = 0; zeros, poles
    (order,) [rad/s] > 0.
    """

    gain: float
    zeros: np.ndarray
    poles: np.ndarray

    @property
    def order(self) -> int:
        return len(self.poles)

    def log_magnitude(self, omega: np.ndarray) -> np.ndarray:
        """ln |d(j omega)| (w,) at omega (w,) [rad/s]."""
        return (
            np.log(self.gain)
            + _corners(omega, self.zeros).sum(axis=1)
            - _corners(omega, self.poles).sum(axis=1)
        )

    def inverse(self) -> RealRational:
        """1/d(s), which has the same form."""
        return RealRational(1 / self.gain, self.poles, self.zeros)

    def system(self, input: str = "u1", output: str = "y1") -> StateSpace:
        """A balanced chain of first-order sections, slowest first: sections (s/z + 1)/(s/p + 1)
        with paired corners.
        """
        n = self.order
        zeros, poles = np.sort(self.zeros), np.sort(self.poles)
        A = np.zeros((n, n))
        B = np.zeros((n, 1))
        C = np.zeros((1, n))
        through = 1.0  # from the input to the section at hand
        row = np.zeros(n)  # from the states before it
        for k, (z, p) in enumerate(zip(zeros, poles, strict=True)):
            # Section k: x' = -p x + size v, out = direct v +- size x, with size^2 = |1 - p/z| p;
            # v is what comes out of those before: ``through`` times the input, ``row`` times their
            # states.
            direct = p / z  # p/z + (1 - p/z) p/(s + p)
            size = np.sqrt(abs(1 - direct) * p)
            A[k] = size * row
            A[k, k] = -p
            B[k, 0] = size * through
            row = direct * row
            row[k] = np.sign(1 - direct) * size
            through *= direct
        C[0] = self.gain * row
        root = np.sqrt(self.gain)  # the gain shared between B and C
        return StateSpace(A, B * root, C / root, [[self.gain * through]], [input], [output])


def constant(gain: float) -> RealRational:
    """d(s) = gain, of order 0."""
    return RealRational(gain, np.zeros(0), np.zeros(0))


def _corners(omega: np.ndarray, corner: np.ndarray) -> np.ndarray:
    """1/2 ln(1 + (w/c)^2), (w, corners)."""
    return 0.5 * np.log1p((omega[:, None] / corner) ** 2)


def corner_slopes(omega: np.ndarray, corner: np.ndarray) -> np.ndarray:
    """-d ln|1 + j w/c| / d ln c, (w, corners)."""
    ratio = (omega[:, None] / corner) ** 2
    return ratio / (1 + ratio)


def fit_magnitude(
    omega: ArrayLike, magnitude: ArrayLike, order: int, weight: ArrayLike | None = None
) -> RealRational:
    """The RealRational of an order whose log magnitude is nearest to the data, least squares.

    omega (w,) [rad/s]: positive, ascending; its ends bound poles and zeros. magnitude (w,):
    positive. order: number of poles and of zeros. weight (w,): not negative, on the squared log
    error (default: 1). Raises InvalidInput.
    """
    omega = check_shape(omega, "omega", "(w)").astype(float)
    data = check_shape(magnitude, "magnitude", "(w)", w=len(omega)).astype(float)
    scale = (
        np.ones(len(omega))
        if weight is None
        else check_shape(weight, "weight", "(w)", w=len(omega)).astype(float)
    )
    if len(omega) < 2 or (np.diff(omega) <= 0).any() or omega[0] <= 0:
        raise invalid(
            "omega",
            f"{len(omega)} frequencies",
            "2 or more, positive and ascending, in rad/s",
            "sort the grid",
        )
    if (data <= 0).any() or (scale < 0).any() or not scale.any():
        raise invalid(
            "magnitude and weight",
            "partly negative or zero",
            "positive (a weight may be 0)",
            "leave points out",
        )
    if not isinstance(order, int | np.integer) or order < 0:
        raise invalid("order", order, "a whole number, at least 0", "0 is a constant")
    problem = _Problem(omega, np.log(data), np.sqrt(scale / scale.max()))
    theta = np.zeros(0)  # ln z_1, ln p_1, ln z_2, ...
    for _ in range(order):
        trials = [
            problem.descend(np.concatenate([theta, pair])) for pair in problem.new_pairs(theta)
        ]
        theta = min(trials, key=problem.cost)
    gain = float(np.exp(problem.offset(theta)))
    return RealRational(
        check_positive(gain, "the fitted gain", "look at the data"),
        np.exp(theta[::2]),
        np.exp(theta[1::2]),
    )


class _Problem:
    """Weighted residuals with the gain eliminated."""

    __slots__ = ("data", "high", "low", "omega", "root")

    def __init__(self, omega: np.ndarray, data: np.ndarray, root: np.ndarray) -> None:
        self.omega = omega
        self.data = data
        self.root = root
        self.low, self.high = np.log(omega[0]), np.log(omega[-1])

    def _centred(self, columns: np.ndarray) -> np.ndarray:
        """Weighted, minus the weighted mean: what no gain can remove; columns (w, k)."""
        # the gain adds a constant to ln |d|: its best value is the weighted mean
        square = self.root**2
        return self.root[:, None] * (columns - (square @ columns) / square.sum())

    def _shape(self, theta: np.ndarray) -> np.ndarray:
        signs = np.where(np.arange(len(theta)) % 2 == 0, 1.0, -1.0)
        return _corners(self.omega, np.exp(theta)) @ signs

    def offset(self, theta: np.ndarray) -> float:
        square = self.root**2
        return float(square @ (self.data - self._shape(theta)) / square.sum())

    def residual(self, theta: np.ndarray) -> np.ndarray:
        return self._centred((self._shape(theta) - self.data)[:, None])[:, 0]

    def jacobian(self, theta: np.ndarray) -> np.ndarray:
        signs = np.where(np.arange(len(theta)) % 2 == 0, 1.0, -1.0)
        return self._centred(-signs * corner_slopes(self.omega, np.exp(theta)))

    def cost(self, theta: np.ndarray) -> float:
        r = self.residual(theta)
        return float(r @ r)

    def new_pairs(self, theta: np.ndarray) -> list[np.ndarray]:
        """A few (ln z, ln p) on a coarse grid that, added to theta, leave the least: local minima
        over the grid.
        """
        # Residual (shape - data) with one more zero (rows) and pole (columns), for all pairs.
        centres = np.linspace(self.low, self.high, _SCAN + 2)[1:-1]
        shapes = self._centred(_corners(self.omega, np.exp(centres)))
        left = self.residual(theta)
        both = left[:, None, None] + shapes[:, :, None] - shapes[:, None, :]
        size = (both**2).sum(axis=0)
        size[np.diag_indices(_SCAN)] = np.inf  # a pair that cancels would stay where it is

        # A start per valley: not larger than any of the eight neighbours.
        padded = np.pad(size, 1, constant_values=np.inf)
        around = np.min(
            [padded[1 + i : 1 + i + _SCAN, 1 + j : 1 + j + _SCAN] for i, j in _AROUND], axis=0
        )
        rows, columns = np.nonzero((size <= around) & np.isfinite(size))
        best = np.argsort(size[rows, columns])[:_STARTS]
        return [centres[[rows[k], columns[k]]] for k in best]

    def descend(self, theta: np.ndarray) -> np.ndarray:
        """Damped Gauss-Newton within the bounds, from theta to a local minimum."""
        damping, r = 1e-3, self.residual(theta)
        cost = r @ r
        for _ in range(_STEPS):
            J = self.jacobian(theta)
            g, H = J.T @ r, J.T @ J

            # at a bound, what would leave it is held
            free = ~(((theta <= self.low) & (g > 0)) | ((theta >= self.high) & (g < 0)))
            if not free.any() or np.abs(g[free]).max() < 1e-13:
                break
            H = H[np.ix_(free, free)]

            # (H + damping diag H) step = -g; at most 1.5 in a logarithm, within the bounds
            step = np.zeros(len(theta))
            step[free] = -np.linalg.solve(H + damping * np.diag(np.diag(H) + 1e-12), g[free])
            trial = np.clip(theta + np.clip(step, -1.5, 1.5), self.low, self.high)
            r_trial = self.residual(trial)
            if r_trial @ r_trial < cost:
                gain = cost - r_trial @ r_trial
                theta = trial
                r = r_trial
                cost, damping = r @ r, damping / 5
                if gain < 1e-12 * cost + 1e-26:
                    break
            elif damping > 1e8:
                break
            else:
                damping *= 4
        return theta
