"""A matrix scaling D(s) for a repeated block: a rational fit of D^H D, and its spectral factor.

X(w) = D^H D, Hermitian positive definite with X(-w) = conj X(w), is fitted by Phi = Y + Y^H, Y(s) =
Y_0/2 + sum_k Y_k p_k/(s + p_k) with real matrices Y_k: linear least squares in relative error, for
poles -p_k that a search moves inside the grid. Where Phi > 0 on the whole axis it is W(-s)^T W(s)
with W stable and W^-1 stable (spectral factorisation by one Riccati equation; Zhou, Doyle & Glover
1996, sec. 13.4). D is unique up to a constant orthogonal matrix, which no norm sees.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ambrose.core.checks import check_shape, invalid
from ambrose.core.lft import ComplexBlock
from ambrose.core.matrix_equations import solve_riccati
from ambrose.core.statespace import StateSpace, static_gain
from ambrose.synthesis.mu.d_fit import fit_magnitude
from ambrose.synthesis.mu.scaling import BlockScaling, scalar_scaling

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
    for poles in _pole_sets(omega, order, problem):
        size, Y = problem.solve(poles)
        if best is None or size < best[0]:
            factor = _factor(Y, poles)
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
