"""The D-step: mu's upper bound over a frequency grid that follows the loop, and D(s) of the order
that suffices for it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from ambrose.core.checks import check_positive, check_shape, invalid
from ambrose.core.frequency import frequency_response, largest_gain
from ambrose.core.lft import Block, ComplexBlock, FullBlock, GeneralizedPlant
from ambrose.core.matrix_equations import solve_riccati
from ambrose.core.mu.bounds import mu_bounds
from ambrose.core.mu.structure import Structure, structure_of
from ambrose.core.statespace import StateSpace, append, poles, rename, series, static_gain

# Rational functions with a wanted magnitude: stable, minimum phase, real poles and zeros inside the
# frequency grid.
#
# The D scalings of mu synthesis must be stable with a stable inverse, and they must not invent
# dynamics the data do not show: a pole or zero outside the grid is fitted to nothing, and its
# integral or roll-off destroys the next synthesis. Poles and zeros are therefore real, negative and
# bounded by the grid. The fit is in log magnitude,
#
#     ln |d(j w)| = ln g + 1/2 sum_i ln(1 + (w/z_i)^2) - 1/2 sum_i ln(1 + (w/p_i)^2),
#
# by Gauss-Newton with Levenberg's damping in (ln z, ln p), the gain eliminated. Orders are built up
# one by one: a scan finds the pole-zero pair that removes most of what is left, then all move
# together.


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


# D scalings as dynamic systems: what the D-step finds and the K-step puts around the plant.
#
# Every block Delta_i has D_i(s), stable with a stable inverse, that commutes with it: D_z =
# diag(D_i) multiplies z, D_w^-1 multiplies w, and the H-infinity norm of D_z M D_w^-1 is an upper
# bound of mu(M(j omega)) at every frequency, for complex and real Delta. The last block is the
# reference: its D is 1.


@dataclass(frozen=True, slots=True, eq=False)
class BlockScaling:
    """left (n_z, n_z): D_i(s) on the block's z; right (n_w, n_w): D_i(s)^-1 on its w; order: of D_i
    per channel.
    """

    left: StateSpace
    right: StateSpace
    order: int


@dataclass(frozen=True, slots=True, eq=False)
class Scaling:
    """One BlockScaling per block, in the order of the blocks."""

    parts: tuple[BlockScaling, ...]

    @property
    def states(self) -> int:
        """How many states the scaled plant has more than the plant."""
        return sum(part.left.n_states + part.right.n_states for part in self.parts)

    @property
    def orders(self) -> tuple[int, ...]:
        return tuple(part.order for part in self.parts)

    @property
    def left(self) -> StateSpace:
        """D_z(s), from z to scaled z."""
        return _side([part.left for part in self.parts])

    @property
    def right(self) -> StateSpace:
        """D_w(s)^-1, from scaled w to w."""
        return _side([part.right for part in self.parts])


def _side(systems: Sequence[StateSpace]) -> StateSpace:
    parts, count = [], 0
    for system in systems:
        size = len(system.inputs)
        parts.append(
            rename(
                system,
                [f"i{count + k}" for k in range(size)],
                [f"o{count + k}" for k in range(size)],
            )
        )
        count += size
    return append(*parts)


def scalar_scaling(block: Block, d: RealRational) -> BlockScaling:
    """d(s) I on every channel of the block."""
    inverse = d.inverse()
    return BlockScaling(
        _side([d.system()] * block.n_z), _side([inverse.system()] * block.n_w), d.order
    )


def scaled_loop(loop: StateSpace, scaling: Scaling) -> StateSpace:
    """D_z M D_w^-1 for a system M from w to z, both with the signals of the blocks only."""
    system = series(series(scaling.right, loop), scaling.left)
    return rename(system, loop.inputs, loop.outputs)


def scaled_plant(plant: GeneralizedPlant, scaling: Scaling) -> GeneralizedPlant:
    """The plant with D_z on its z and D_w^-1 on its w, u and y untouched; the blocks must take up
    all of w and z.
    """
    u, y = (
        static_gain(np.eye(len(side)), [f"i_{s}" for s in side], [f"o_{s}" for s in side])
        for side in (plant.u, plant.y)
    )
    system = series(series(append(scaling.right, u), plant.system), append(scaling.left, y))
    system = rename(system, plant.system.inputs, plant.system.outputs)
    return GeneralizedPlant(system, plant.w, plant.u, plant.z, plant.y, plant.blocks)


def scaled_gain(M: np.ndarray, omega: np.ndarray, scaling: Scaling) -> np.ndarray:
    """sigma_max(D_z M D_w^-1) (w,) for M (w, n_z, n_w) at omega (w,) [rad/s]."""
    left, right = (
        frequency_response(scaling.left, omega).values,
        frequency_response(scaling.right, omega).values,
    )
    return largest_gain(left @ M @ right)


# A matrix scaling D(s) for a repeated block: a rational fit of D^H D, and its spectral factor.
#
# X(w) = D^H D, Hermitian positive definite with X(-w) = conj X(w), is fitted by Phi = Y + Y^H, Y(s)
# = Y_0/2 + sum_k Y_k p_k/(s + p_k) with real matrices Y_k: linear least squares in relative error,
# for poles -p_k that a search moves inside the grid. Where Phi > 0 on the whole axis it is W(-s)^T
# W(s) with W stable and W^-1 stable (spectral factorisation by one Riccati equation; Zhou, Doyle &
# Glover 1996, sec. 13.4). D is unique up to a constant orthogonal matrix, which no norm sees.


_CANDIDATES = 10  # pole positions of the first scan


def fit_matrix(
    omega: ArrayLike, X: ArrayLike, order: int, weight: ArrayLike | None = None
) -> BlockScaling:
    """D(s) (r, r) with D(j w)^H D(j w) close to X: real poles inside the grid, stable, with a
    stable inverse.

    omega (w,) [rad/s]: positive, ascending. X (w, r, r): Hermitian positive definite. order: number
    of poles, each with r states. weight (w,): on the squared relative error. Where no fit of the
    order is positive on the whole axis, the scalar fit d(s) I of the mean magnitude is returned.
    Raises InvalidInput.
    """
    omega = check_shape(omega, "omega", "(w)").astype(float)
    X = check_shape(X, "X", "(w, r, r)", w=len(omega)).astype(complex)
    w = (
        np.ones(len(omega))
        if weight is None
        else check_shape(weight, "weight", "(w)", w=len(omega)).astype(float)
    )
    values, vectors = np.linalg.eigh(X)
    if (values <= 0).any():
        raise invalid(
            "the smallest eigenvalue of X",
            float(values.min()),
            "positive",
            "D scalings are positive definite",
        )
    # X^-1/2: errors become relative
    root = (vectors / np.sqrt(values)[:, None, :]) @ vectors.conj().swapaxes(1, 2)
    problem = _Linear(omega, root, np.sqrt(w / w.max()))
    best: tuple[float, BlockScaling] | None = None
    for p in _pole_sets(omega, order, problem):
        size, Y = problem.solve(p)
        if best is None or size < best[0]:
            factor = _factor(Y, p)
            if factor is not None:
                best = size, factor
    if best is not None:
        return best[1]
    scalar = fit_magnitude(omega, np.exp(0.5 * np.log(values).mean(axis=1)), order, w)
    return scalar_scaling(ComplexBlock("d", X.shape[1]), scalar)


class _Linear:
    """min over Y_k of the weighted sum of |X^-1/2 (Phi - X) X^-1/2|^2."""

    __slots__ = ("omega", "root", "target", "weight")

    def __init__(self, omega: np.ndarray, root: np.ndarray, weight: np.ndarray) -> None:
        self.omega = omega
        self.root = root
        self.weight = weight
        eye = np.broadcast_to(np.eye(root.shape[1]), root.shape)
        self.target = _stack(weight[:, None, None] * eye)

    def solve(self, poles: np.ndarray) -> tuple[float, np.ndarray]:
        """Squared error, and Y (order + 1, r, r)."""
        r = self.root.shape[1]

        # Phi = sum_k b_k Y_k + conj(b_k) Y_k^T with b_0 = 1/2, b_k = p_k / (j w + p_k): the entry
        # (i, j) of Y_k adds b_k at (i, j), conj(b_k) at (j, i). X^-1/2 X X^-1/2 = I is the target.
        basis = [np.full(len(self.omega), 0.5 + 0j), *(p / (1j * self.omega + p) for p in poles)]
        columns = []
        for b in basis:
            for i in range(r):
                for j in range(r):
                    E = np.zeros((len(self.omega), r, r), complex)
                    E[:, i, j] += b
                    E[:, j, i] += b.conj()
                    columns.append(_stack(self.weight[:, None, None] * (self.root @ E @ self.root)))
        matrix = np.stack(columns, axis=1)

        # columns of one size, for the cut of small singular values
        scale = np.maximum(np.linalg.norm(matrix, axis=0), 1e-300)
        solution = np.linalg.lstsq(matrix / scale, self.target, rcond=1e-10)[0]
        error = matrix / scale @ solution - self.target
        return float(error @ error), (solution / scale).reshape(len(basis), r, r)


def _stack(values: np.ndarray) -> np.ndarray:
    flat = values.reshape(-1)
    return np.concatenate([flat.real, flat.imag])


def _pole_sets(omega: np.ndarray, order: int, problem: _Linear) -> list[np.ndarray]:
    """Pole positions to try, the best last: greedy on a coarse grid, then moved by a few passes of
    halving steps.
    """
    if order == 0:
        return [np.zeros(0)]

    # One pole after the other, where it helps most.
    corners = np.geomspace(omega[0], omega[-1], _CANDIDATES + 2)[1:-1]
    poles = np.zeros(0)
    sets = []
    for _ in range(order):
        trials = [np.append(poles, c) for c in corners if c not in poles]
        poles = min(trials, key=lambda p: problem.solve(p)[0])
    sets.append(poles)

    # Then each moved either way, by steps that start at half a gap of the grid.
    step = np.log(corners[1] / corners[0]) / 2
    best = problem.solve(poles)[0]
    for _ in range(5):
        for k in range(order):
            for sign in (1.0, -1.0):
                trial = poles.copy()
                trial[k] = np.clip(trial[k] * np.exp(sign * step), omega[0], omega[-1])
                size = problem.solve(trial)[0]
                if size < best:
                    best, poles = size, trial
        sets.append(poles)
        step /= 2
    return sets


def _factor(Y: np.ndarray, poles: np.ndarray) -> BlockScaling | None:
    """W with W(-s)^T W(s) = Y(s) + Y(-s)^T, or None where that is not positive on the axis."""
    r, n = Y.shape[1], len(poles)

    # Phi at infinite frequency, which must be positive
    R = 0.5 * (Y[0] + Y[0].T)
    values, vectors = np.linalg.eigh(R)
    if values.min() <= 1e-9 * values.max():
        return None
    half = (vectors * np.sqrt(values)) @ vectors.T
    names = [f"i{k}" for k in range(r)], [f"o{k}" for k in range(r)]
    if n == 0:
        return BlockScaling(static_gain(half, *names), static_gain(np.linalg.inv(half), *names), 0)

    # Phi = R + C (sI - A)^-1 B + (..)~ with A = -diag(p_k) (x) I, B the sqrt(p_k) I one below the
    # other, C the Y_k sqrt(p_k) side by side.
    A = -np.diag(np.repeat(poles, r))
    size = np.repeat(np.sqrt(poles), r)
    B = size[:, None] * np.tile(np.eye(r), (n, 1))
    C = np.hstack(list(Y[1:])) * size

    # A^T X + X A = K^T R K with K = R^-1 (B^T X + C) makes it W~ W; written out,
    # (A - B F)^T X + X (A - B F) - X B R^-1 B^T X - C^T F = 0,   F = R^-1 C
    F = np.linalg.solve(R, C)
    solution = solve_riccati(A - B @ F, B @ np.linalg.solve(R, B.T), -C.T @ F)
    if not solution.solved:
        return None

    # W = R^1/2 (I + K (sI - A)^-1 B);   W^-1 has the poles of A - B K, stable as X stabilises
    K = np.linalg.solve(R, B.T @ solution.X + C)
    inverse_half = np.linalg.inv(half)
    system = StateSpace(A, B, half @ K, half, *names)
    inverse = StateSpace(A - B @ K, B @ inverse_half, -K, inverse_half, *names)
    return BlockScaling(system, inverse, n)


# Scalar D scalings where they are wanted: the lowest peak of sigma_max(D M D^-1), not the nearest
# magnitude.
#
# A fit of low order cannot follow the optimal D at every frequency, and need not: around the
# optimum is a whole tube of D with almost the same sigma_max. ``tube`` finds it, for a fit to its
# middle with its width as the weight.
#
# Least squares still does not know where an error costs most. Starting from the fit, the gains,
# poles and zeros of all blocks are moved together by L-BFGS to lower the p-norm over frequency of
# the largest singular value, whose derivative is exact: d ln sigma = sum_i (|left_i|^2 -
# |right_i|^2) d ln |d_i|, with the parts of the singular vectors that belong to block i. Only the
# magnitude of d_i matters, its phase is unitary.


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


HIGHEST_ORDER = 5  # tried by order="auto"
_WEIGHT = 6  # power of mu/peak with which a frequency counts in the fit
_TUBE = 0.05  # how far above mu the tube of admissible D reaches, in peaks of mu
_CURVE = 5.0  # tolerances by which sigma_max may exceed mu away from the peak
_NARROW = 5e-3  # least half-width of the tube, in ln d
_FIRST = 12  # frequencies at which mixed mu is computed first; their peak spares most of the others


@dataclass(frozen=True, slots=True, eq=False)
class DStep:
    """The complex upper bound of a loop: omega (w,) [rad/s], M (w, n_z, n_w), upper (w,), D_w (w,
    n_w, n_w) Hermitian.

    structure: of the bound, with repeated blocks as full ones where D is to be scalar; then middle
    and width (w, blocks - 1) of the tube of ln d_i (mu_refine), and empty for matrix scalings.
    """

    omega: np.ndarray
    M: np.ndarray
    upper: np.ndarray
    D_w: np.ndarray
    structure: Structure
    middle: np.ndarray
    width: np.ndarray

    @property
    def peak(self) -> float:
        return float(self.upper.max())


def d_blocks(blocks: Sequence[Block], structure: Literal["scalar", "full"]) -> list[Block]:
    """The blocks whose scalings the D-step may use: d I for a repeated block ("scalar"), or a
    matrix D ("full").
    """
    result: list[Block] = []
    for block in blocks:
        if block.full:
            result.append(block)
        elif structure == "scalar":
            result.append(FullBlock(block.name, block.n_w, block.n_z))
        else:
            result.append(ComplexBlock(block.name, block.repeat))
    return result


def d_step(loop: StateSpace, blocks: Sequence[Block], grid: np.ndarray, rounds: int = 2) -> DStep:
    """The complex upper bound on the grid, on the loop's resonances and between the neighbours of
    its high peaks.
    """
    # The grid with the loop's resonances, lightly damped poles, within its ends.
    p = poles(loop)
    p = p[(p.imag > 0) & (np.abs(p.real) < 0.7 * np.abs(p))]
    extra = np.abs(p.imag)
    omega = np.unique(np.concatenate([grid, extra[(extra > grid[0]) & (extra < grid[-1])]]))
    M, upper, D = _bound(loop, blocks, omega)
    for _ in range(rounds):
        # Peaks of more than 0.9 of the largest: a point between each of them and its neighbours.
        padded = np.concatenate([[-np.inf], upper, [-np.inf]])
        high = (upper >= padded[:-2]) & (upper >= padded[2:]) & (upper > 0.9 * upper.max())
        chosen = high[:-1] | high[1:]
        new = np.sqrt(omega[:-1] * omega[1:])[chosen & (omega[1:] > 1.01 * omega[:-1])]
        if not len(new):
            break
        more = _bound(loop, blocks, new)
        order = np.argsort(np.concatenate([omega, new]))
        omega = np.concatenate([omega, new])[order]
        M, upper, D = (
            np.concatenate([a, b])[order] for a, b in zip((M, upper, D), more, strict=True)
        )

    # Scalar D: one number ln d_i per block, and how far each may move.
    structure = structure_of(blocks)
    middle = width = np.zeros((len(omega), 0))
    if not _matrix_scaled(structure) and upper.max() > 0:
        log_d = np.log(
            np.stack(
                [D[:, place.w.start, place.w.start].real for place in structure.places], axis=1
            )
        )
        middle, width = tube(M, structure, log_d, upper + _TUBE * upper.max())
    return DStep(omega, M, upper, D, structure, middle, np.maximum(width, _NARROW))


def _matrix_scaled(structure: Structure) -> bool:
    return any(place.block.repeat > 1 and not place.block.real for place in structure.places)


def _bound(
    loop: StateSpace, blocks: Sequence[Block], omega: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    M = frequency_response(loop, omega).values
    bound = mu_bounds(M, blocks, g_scaling=False, lower=False, tolerance=1e-3)
    return M, bound.upper, bound.D_w


def peak_below(
    step: DStep, blocks: Sequence[Block], ceiling: np.ndarray, g_scaling: bool
) -> tuple[float, np.ndarray, np.ndarray]:
    """The largest upper bound of another structure on the step's grid, given that it nowhere
    exceeds ``ceiling`` (w,).

    Only frequencies whose ceiling is above what was found elsewhere are computed. Returns the peak,
    the values (the ceiling where it was not needed) and which were computed.
    """
    values = ceiling.copy()
    known = np.zeros(len(ceiling), bool)
    best = 0.0
    while True:
        open_ = np.flatnonzero(~known & (ceiling > best))
        if not len(open_):
            return best, values, known
        # the highest ceilings first: their peak closes most of the others
        chosen = open_[np.argsort(-ceiling[open_])[: _FIRST if best == 0 else None]]
        found = mu_bounds(
            step.M[chosen], blocks, g_scaling=g_scaling, lower=False, tolerance=1e-3
        ).upper
        values[chosen], known[chosen] = np.minimum(found, ceiling[chosen]), True
        best = max(best, float(values[chosen].max()))


@dataclass(frozen=True, slots=True, eq=False)
class FittedScaling:
    """scaling: D(s); peak: of sigma_max(D M D^-1) on the step's grid; excess: the most by which it
    exceeds the bound there; scalars: the d_i where every D is scalar, else empty.
    """

    scaling: Scaling
    peak: float
    excess: float
    scalars: tuple[RealRational, ...] = ()


def fit_scaling(
    step: DStep, order: int | Literal["auto"], tolerance: float, lowest: int = 0
) -> FittedScaling:
    """D(s) for the step's blocks, last block D = 1 where its scaling is a scalar.

    order: of every D per channel; or "auto": the smallest one from ``lowest`` on with which
    sigma_max(D M D^-1) peaks at most 1 + tolerance times as high as the bound, and follows it
    within five tolerances of the peak at every frequency; then lower ones for single blocks. Scalar
    D are fitted in magnitude, then moved to lower the peak (mu_refine).
    """
    if order != "auto":
        return _fit(step, [order] * len(step.structure.places))

    def enough(item: FittedScaling) -> bool:
        return (
            item.peak <= (1 + tolerance) * step.peak
            and item.excess <= _CURVE * tolerance * step.peak
        )

    found = []
    for n in range(min(lowest, HIGHEST_ORDER), HIGHEST_ORDER + 1):
        found.append(_fit(step, [n] * len(step.structure.places)))
        if enough(found[-1]):
            return _fewer(step, found[-1], enough) if n > lowest else found[-1]
    least = min(item.peak for item in found)
    return next(item for item in found if item.peak <= (1 + tolerance) * least)


def extrapolate(
    step: DStep, used: FittedScaling, fitted: FittedScaling, factor: float
) -> FittedScaling | None:
    """The scaling that goes ``factor`` times as far, in log magnitude, from the one used to the
    middle of the step's tube; its orders are those of ``fitted``. None for matrix scalings.
    """
    if not (used.scalars and fitted.scalars and step.width.shape[1]):
        return None

    # ln d = ln d_used + factor (ln d_middle - ln d_used), fitted with the tube's width
    before = np.stack([d.log_magnitude(step.omega) for d in used.scalars[:-1]], axis=1)
    target = before + factor * (step.middle - before)
    found = [
        fit_magnitude(step.omega, np.exp(values), d.order, width**-2.0)
        for values, width, d in zip(target.T, step.width.T, fitted.scalars, strict=False)
    ]
    return of_scalars(step, [*found, fitted.scalars[-1]])


def of_scalars(step: DStep, d: Sequence[RealRational]) -> FittedScaling:
    """One d_i per block, with the peak on the step's grid."""
    scaling = Scaling(
        tuple(
            scalar_scaling(place.block, x)
            for place, x in zip(step.structure.places, d, strict=True)
        )
    )
    gain = peak_gain(step.M, step.omega, step.structure, d)
    return FittedScaling(scaling, float(gain.max()), float((gain - step.upper).max()), tuple(d))


def _fewer(
    step: DStep, fitted: FittedScaling, enough: Callable[[FittedScaling], bool]
) -> FittedScaling:
    """Lower orders of single blocks, as long as that is enough; the largest blocks first."""
    orders = list(fitted.scaling.orders)
    places = step.structure.places
    scaled = [i for i in range(len(places)) if orders[i] > 0]
    if len(scaled) < 2:
        return fitted
    for i in sorted(scaled, key=lambda k: -places[k].block.n_w):
        while orders[i] > 0:
            trial = _fit(step, [*orders[:i], orders[i] - 1, *orders[i + 1 :]])
            if not enough(trial):
                break
            fitted, orders[i] = trial, orders[i] - 1
    return fitted


def _fit(step: DStep, orders: Sequence[int]) -> FittedScaling:
    places = step.structure.places

    # Matrix scalings, some block being repeated: D^H D = D_w^2 of a repeated block, |d| of the
    # others; what counts is where mu is high.
    weight = (step.upper / step.peak) ** _WEIGHT if step.peak > 0 else np.ones(len(step.omega))
    if _matrix_scaled(step.structure):
        parts: list[BlockScaling] = []
        for place, n in zip(places, orders, strict=True):
            D = step.D_w[:, place.w, place.w]
            if place.block.repeat > 1 and not place.block.real:
                parts.append(fit_matrix(step.omega, D @ D, n, weight))
            elif place is places[-1]:
                parts.append(scalar_scaling(place.block, constant(1.0)))
            else:
                parts.append(
                    scalar_scaling(
                        place.block, fit_magnitude(step.omega, D[:, 0, 0].real, n, weight)
                    )
                )
        scaling = Scaling(tuple(parts))
        gain = scaled_gain(step.M, step.omega, scaling)
        return FittedScaling(scaling, float(gain.max()), float((gain - step.upper).max()))

    # Scalar ones: the middle of the tube, with its width as the weight, then moved together.
    fits = [
        fit_magnitude(step.omega, np.exp(middle), n, width**-2.0)
        for middle, width, n in zip(step.middle.T, step.width.T, orders, strict=False)
    ]
    return of_scalars(step, refine(step.M, step.omega, step.structure, [*fits, constant(1.0)]))
