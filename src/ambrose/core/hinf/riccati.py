"""H-infinity control by two Riccati equations: which gamma can be reached, and the central
controller for one.

The plant is brought to D12 = [0; I], D21 = [0, I] by unitary transformations of z and w and
invertible ones of u and y. With

    D11 = [D1111 D1112]   r - m rows        N = [D1111 D1112],  E = [D1121 D1122]
          [D1121 D1122]   m rows
           q - p  p columns

gamma can be reached exactly when (Zhou, Doyle & Glover 1996, theorem 17.1 (a); their X_inf, Y_inf,
F, L and hats)

    (i)   gamma > max(|[D1111 D1112]|, |[D1111; D1121]|),
    (ii)  X >= 0 solves its Riccati equation, that of the Hamiltonian H_inf,
    (iii) Y >= 0 solves its own, that of J_inf, which is H_inf of the transposed plant,
    (iv)  rho(X Y) < gamma^2.

Theorem 17.1 (b) gives the controllers, here the central one, Q = 0. First published by Glover &
Doyle 1988, Systems & Control Letters 11; for D11 = 0 they are theorems 3 and 4 of Doyle, Glover,
Khargonekar & Francis 1989, IEEE Trans. Automatic Control 34, and theorems 16.4 and 16.5 of the
book.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ambrose.core.checks import NumericalFailure
from ambrose.core.hinf.scaling import Matrices, ScaledPlant
from ambrose.core.matrix_equations import solve_riccati

_FLOOR = 1e-9  # gamma below this fraction of the plant's gain from w to z counts as zero
# successive factors above the lower bound, the last one repeated
_GROWTH = (1.02, 1.2, 2.0, 4.0, 10.0)
_LARGEST = 1e12  # how far above the lower bound a solution is looked for
_STEPS = 60  # of the bisection on gamma, at most


@dataclass(frozen=True, slots=True, eq=False)
class Level:
    """One gamma tried: ``reason`` is "feasible" or the condition that failed; rho: spectral radius
    of X Y / gamma^2.
    """

    gamma: float
    reason: str
    rho: float
    X: np.ndarray
    Y: np.ndarray

    @property
    def feasible(self) -> bool:
        return self.reason == "feasible"


@dataclass(frozen=True, slots=True, eq=False)
class GammaSearch:
    """The optimal gamma lies between ``lower`` and ``best.gamma``, which can be reached.

    lower: the highest level that failed, as computed; a bound that is shown is that of
    lower_bound.py. inaccurate: whether rounding spoiled a level; vanishing:
    whether gamma fell to a part in 1e9 of the plant's gain, where the search ends; history: a row
    for each level.
    """

    lower: float
    best: Level
    inaccurate: bool
    vanishing: bool
    history: tuple[dict[str, float], ...]


def normal_form(plant: ScaledPlant) -> tuple[ScaledPlant, np.ndarray, np.ndarray]:
    """The plant with D12 = [0; I], D21 = [0, I], and T_u (m, m), T_y (p, p): u = T_u u_normal,
    y_normal = T_y y.

    Raises NumericalFailure when D12 or D21 lacks rank.
    """
    m, p = plant.B2.shape[1], len(plant.C2)
    if len(plant.C1) < m or plant.B1.shape[1] < p:
        raise NumericalFailure("D12 is wide or D21 tall; regularise first")

    # D12 = U [S; 0] V_u^T,   D21 = U_y [S 0] V^T
    U, su, Vuh = np.linalg.svd(plant.D12)
    Uyh, sy, Vh = np.linalg.svd(plant.D21)
    if not (su.min() > 1e-14 and sy.min() > 1e-14):
        raise NumericalFailure("D12 or D21 is singular; regularise first")

    # z_normal = [U_2 U_1]^T z,   w = [V_2 V_1] w_normal,   T_u = V_u S^-1,   T_y = S^-1 U_y^T
    z = np.hstack([U[:, m:], U[:, :m]]).T
    w = np.vstack([Vh[p:], Vh[:p]]).T
    T_u, T_y = Vuh.T / su, (Uyh / sy).T
    normal = replace(
        plant,
        B1=plant.B1 @ w,
        B2=plant.B2 @ T_u,
        C1=z @ plant.C1,
        C2=T_y @ plant.C2,
        D11=z @ plant.D11 @ w,
        D12=np.eye(len(z), m, m - len(z)),
        D21=np.eye(p, len(w), len(w) - p),
    )
    return normal, T_u, T_y


def _riccati(plant: ScaledPlant, gamma: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A, G, Q (n, n) of A^T X + X A - X G X + Q = 0, (ii) of the theorem, H_inf = [A -G; -Q -A^T].

    The theorem inverts R = D1^T D1 - diag(gamma^2 I, 0), D1 = [D11 D12]; here the control u is
    eliminated by hand, so that only gamma^2 I - N^T N is inverted.
    """
    # C1 = [C; C'], C' the last m rows. The last m of z, v = C' x + E w + u, serve as the control:
    # x' = (A - B2 C') x + (B1 - B2 E) w + B2 v,   |z|^2 = |C x + N w|^2 + |v|^2.
    k = len(plant.C1) - plant.B2.shape[1]
    N, E = plant.D11[:k], plant.D11[k:]
    B = plant.B1 - plant.B2 @ E
    A = plant.A - plant.B2 @ plant.C1[k:]

    # S^-1 = 0
    if np.isinf(gamma):
        return A, plant.B2 @ plant.B2.T, plant.C1[:k].T @ plant.C1[:k]

    # S = gamma^2 I - N^T N, worst w = S^-1 (N^T C + B^T X) x, v = -B2^T X x:
    # A + B S^-1 N^T C,   G = B2 B2^T - B S^-1 B^T,   Q = C^T (I + N S^-1 N^T) C
    S = gamma**2 * np.eye(N.shape[1]) - N.T @ N
    S_N, S_B = np.linalg.solve(S, N.T @ plant.C1[:k]), np.linalg.solve(S, B.T)
    G = plant.B2 @ plant.B2.T - B @ S_B
    Q = plant.C1[:k].T @ (plant.C1[:k] + N @ S_N)
    return A + B @ S_N, (G + G.T) / 2, (Q + Q.T) / 2


def hamiltonian(plant: ScaledPlant, gamma: float) -> np.ndarray:
    """H_inf (2n, 2n) of the theorem; J_inf is that of the dual plant."""
    A, G, Q = _riccati(plant, gamma)
    return np.block([[A, -G], [-Q, -A.T]])


def _solve(plant: ScaledPlant, gamma: float, name: str) -> tuple[np.ndarray, str]:
    """X (n, n) and "", or the reason why there is no positive semidefinite one."""
    A, G, Q = _riccati(plant, gamma)

    # X = size X': A^T X' + X' A - X' (size G) X' + Q / size = 0
    size = float(np.linalg.norm(A) / np.linalg.norm(G)) if A.any() and G.any() else 1.0
    solution = solve_riccati(A, size * G, Q / size)  # in units of X in which G is as large as A
    if not solution.solved:
        return solution.X, f"{name}: {solution.status}"
    X = size * solution.X
    values = np.linalg.eigvalsh(X)
    if values.size and values[0] < -1e-12 * max(values[-1], 0.0):
        # X >= 0 exactly when u = -(C1' + B2^T X) x alone stabilises; a test that does not depend on
        # the states' units
        rows = len(plant.C1) - plant.B2.shape[1]
        closed = plant.A - plant.B2 @ (plant.C1[rows:] + plant.B2.T @ X)
        if np.linalg.eigvals(closed).real.max() >= 0:
            return X, f"{name}: not positive semidefinite"
    return X, ""


def gains(plant: ScaledPlant, gamma: float, X: np.ndarray) -> np.ndarray:
    """F = -R^-1 (D1^T C1 + B^T X) (q + m, n): worst disturbance F1 and control F2."""
    # in the letters of _riccati: w = F1 x, u = v - C' x - E w, v = -B2^T X x
    k = len(plant.C1) - plant.B2.shape[1]
    N, E = plant.D11[:k], plant.D11[k:]
    S = gamma**2 * np.eye(N.shape[1]) - N.T @ N
    F1 = np.linalg.solve(S, N.T @ plant.C1[:k] + (plant.B1 - plant.B2 @ E).T @ X)
    return np.vstack([F1, -(plant.C1[k:] + plant.B2.T @ X) - E @ F1])


def try_gamma(plant: ScaledPlant, gamma: float) -> Level:
    """The Riccati conditions at one gamma, for a plant in normal form; gamma inf is the LQG
    problem.
    """
    X, reason = _solve(plant, gamma, "X")
    if reason:
        return Level(gamma, reason, np.nan, X, X)
    Y, reason = _solve(plant.dual(), gamma, "Y")
    if reason:
        return Level(gamma, reason, np.nan, X, Y)
    radius = float(np.linalg.eigvals(X @ Y).real.max(initial=0.0))
    if np.isinf(gamma):
        return Level(gamma, "feasible", radius, X, Y)
    rho = radius / gamma**2
    return Level(gamma, "feasible" if rho < 1 else "rho(X Y) >= gamma^2", rho, X, Y)


def direct_bound(plant: ScaledPlant) -> float:
    """What no controller can change at infinite frequency, (i): max(|[D1111 D1112]|, |[D1111;
    D1121]|), in normal form.
    """
    rows, columns = len(plant.C1) - plant.B2.shape[1], plant.B1.shape[1] - len(plant.C2)
    sizes = [
        np.linalg.norm(part, 2) if part.size else 0.0
        for part in (plant.D11[:rows], plant.D11[:, :columns])
    ]
    return float(max(sizes))


def search_gamma(
    plant: ScaledPlant, tolerance: float, report: Callable[[Level], None]
) -> GammaSearch:
    """The smallest reachable gamma to the relative ``tolerance``, for a plant in normal form.

    Between the bounds: false position on rho, which falls with gamma, where X and Y exist, else
    bisection. ``report`` sees every level and may raise to end the search. Raises NumericalFailure
    when even large gammas fail.
    """
    history: list[dict[str, float]] = []
    inaccurate: list[str] = []

    def attempt(gamma: float) -> Level:
        level = try_gamma(plant, gamma)
        history.append({"gamma": gamma, "feasible": float(level.feasible), "rho": level.rho})
        inaccurate.extend([level.reason] if "inaccurate" in level.reason else [])
        report(level)
        return level

    # Bounds from below: (i), and rho(X Y) < gamma^2 with the X and Y of gamma = inf, the smallest.
    base = try_gamma(plant, np.inf)
    floor = _FLOOR * (plant.gain if plant.gain > 0 else 1.0)
    start = direct_bound(plant)
    if base.feasible:
        start = max(start, float(np.sqrt(base.rho)))  # X and Y grow as gamma falls
    low = Level(max(start, floor), "the lower bound", np.nan, base.X, base.Y)
    high = low

    # Upwards from the lower bound to a gamma that can be reached.
    for step in range(_STEPS):
        gamma = high.gamma * (
            1 + tolerance if step == 0 else _GROWTH[min(step - 1, len(_GROWTH) - 1)]
        )
        high = attempt(gamma)
        if high.feasible:
            break
        if gamma > _LARGEST * max(start, plant.gain, floor):
            why = base.reason if not base.feasible else high.reason
            raise NumericalFailure(
                f"no gamma up to {gamma:.3g} passes the Riccati conditions ({why}); look for "
                "weights or modes whose poles are "
                "many decades apart, for modes close to the imaginary axis that u cannot move or "
                "y does not show, or "
                'use method="lmi"'
            )
        low = high

    # Between: low fails, high can be reached.
    while high.gamma > (1 + tolerance) * low.gamma and len(history) < _STEPS:
        level = attempt(_next(low, high, tolerance))
        low, high = (low, level) if level.feasible else (level, high)
    return GammaSearch(low.gamma, high, bool(inaccurate), low.gamma == floor, tuple(history))


def _next(low: Level, high: Level, tolerance: float) -> float:
    """A gamma between: on either side of the estimated root of rho = 1 in turn, so that both bounds
    close in on it.
    """
    a, b = np.log(low.gamma), np.log(high.gamma)
    middle = (a + b) / 2
    if low.rho > 1 and 0 < high.rho < 1:
        # log rho taken as linear in log gamma; the guess lies beyond the root as seen from the
        # nearer bound, by less than half the tolerance, and 2 % of the way or more from both
        root = a + (b - a) * np.log(low.rho) / (np.log(low.rho) - np.log(high.rho))
        aside = 0.45 * tolerance
        guess = root + aside if b - root > root - a else root - aside
        shortest = 0.02 * (b - a)
        middle = min(max(guess, a + shortest), b - shortest)
    return float(np.exp(middle))


def central_controller(plant: ScaledPlant, gamma: float) -> Matrices:
    """(A, B, C, D) of the central controller at ``gamma`` for a plant in normal form without D22:
    (A, B1, C1, D11) with hats.

    Raises NumericalFailure naming the condition that fails at this gamma.
    """
    level = try_gamma(plant, gamma)
    if not level.feasible or gamma <= direct_bound(plant):
        raise NumericalFailure(f"gamma = {gamma:.6g} cannot be reached: {level.reason}")
    n = len(plant.A)
    q = plant.B1.shape[1]
    r = len(plant.C1)
    m, p = plant.B2.shape[1], len(plant.C2)

    # x = diag(scale) x': X' = diag(scale) X diag(scale), Y' = diag(1/scale) Y diag(1/scale)
    scale = _even(level.X, level.Y)
    plant = plant.in_states(np.diag(scale), np.diag(1 / scale))
    X, Y = level.X * scale[:, None] * scale, level.Y / scale[:, None] / scale

    # F = [F11; F12; F2] with q - p, p and m rows, L = [L11 L12 L2] with r - m, m and p columns
    F, L = gains(plant, gamma, X), gains(plant.dual(), gamma, Y).T
    F12 = F[q - p : q]
    F2 = F[q:]
    L12 = L[:, r - m : r]
    L2 = L[:, r:]

    D1111, D1112 = plant.D11[: r - m, : q - p], plant.D11[: r - m, q - p :]
    D1121, D1122 = plant.D11[r - m :, : q - p], plant.D11[r - m :, q - p :]
    right = gamma**2 * np.eye(q - p) - D1111.T @ D1111
    left = gamma**2 * np.eye(r - m) - D1111 @ D1111.T

    # theorem 17.1 (b), every letter with a hat: D11; D12 D12^T, D21^T D21, any factors of which
    # will do; Z = (I - Y X/g^2)^-1
    D = -D1121 @ D1111.T @ np.linalg.solve(left, D1112) - D1122

    # D12 D12^T = I - D1121 (gamma^2 I - D1111^T D1111)^-1 D1121^T
    # D21^T D21 = I - D1112^T (gamma^2 I - D1111 D1111^T)^-1 D1112
    D12 = np.linalg.cholesky(np.eye(m) - D1121 @ np.linalg.solve(right, D1121.T))
    D21 = np.linalg.cholesky(np.eye(p) - D1112.T @ np.linalg.solve(left, D1112)).T

    # the variable Z holds I - Y X / gamma^2, the inverse of the theorem's Z
    Z = np.eye(n) - Y @ X / gamma**2
    B2 = np.linalg.solve(Z, plant.B2 + L12) @ D12  # Z (B2 + L12) D12
    C2 = -D21 @ (plant.C2 + F12)
    B1 = -np.linalg.solve(Z, L2) + B2 @ np.linalg.solve(D12, D)  # -Z L2 + B2 D12^-1 D11
    C1 = F2 + D @ np.linalg.solve(D21, C2)  # F2 + D11 D21^-1 C2
    # A + B F + B1 D21^-1 C2
    A = plant.A + plant.B1 @ F[:q] + plant.B2 @ F2 + B1 @ np.linalg.solve(D21, C2)
    return A, B1, C1, D


def balancing_states(level: Level) -> tuple[np.ndarray, np.ndarray]:
    """T (n, n) and its inverse: x = T x' makes X and Y of a feasible ``level`` equal and diagonal.

    There the Riccati equations are solved to full accuracy where X or Y spans many decades. Source:
    Jonckheere & Silverman 1983, IEEE Trans. Automatic Control 28 (balancing for control), by the
    square-root method.
    """
    L_x, L_y = _root(level.X), _root(level.Y)

    # X = L_x L_x^T, Y = L_y L_y^T, L_y^T L_x = U Sigma V^T:
    # T = L_y U Sigma^-1/2, T^-1 = Sigma^-1/2 V^T L_x^T, and T^T X T = T^-1 Y T^-T = Sigma
    U, values, Vt = np.linalg.svd(L_y.T @ L_x)
    root = np.sqrt(np.maximum(values, 1e-300))
    return L_y @ U / root, (L_x @ (Vt.T / root)).T


def _root(X: np.ndarray) -> np.ndarray:
    """L (n, n) with L L^T = X, nearly zero and negative eigenvalues raised to 1e-14 of the
    largest.
    """
    values, U = np.linalg.eigh(X)
    largest = float(np.abs(values).max(initial=0.0))
    return U * np.sqrt(np.maximum(values, 1e-14 * largest if largest > 0 else 1.0))


def _even(X: np.ndarray, Y: np.ndarray) -> np.ndarray:
    """State scaling (n,) that gives X and Y equal diagonals, as far as neither is nearly zero;
    powers of 2.
    """
    # scale^2 x = y / scale^2, so scale = (y / x)^(1/4)
    x, y = np.abs(np.diag(X)), np.abs(np.diag(Y))
    x, y = (
        np.maximum(x, 1e-12 * x.max(initial=1e-280)),
        np.maximum(y, 1e-12 * y.max(initial=1e-280)),
    )
    return np.exp2(np.round(np.log2(np.maximum(y, 1e-280) / np.maximum(x, 1e-280)) / 4))
