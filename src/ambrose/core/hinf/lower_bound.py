"""A gain from w to z that no controller comes below, shown by disturbances that are written down.

Two kinds. At one frequency, what the control does not reach or the measurement does not show
(``unavoidable`` beside this file). And in time: up to t = 0 a disturbance that the measurement does
not show, y = 0, so that no causal controller has acted, u = 0, and the state is x0 then; from t = 0
on a fixed disturbance, against the control that is best for it, of one that knows all its future.
Whatever stabilising controller closes the loop,

    gamma^2 >= (int |z|^2 before + min_u int |z|^2 after) / int |w|^2.

This holds for every such disturbance. The one taken is that of the game at a gamma that can be
reached: the optimum itself, to second order in the distance from it, where rho(X Y) = gamma^2
decides. All is a Sylvester and four Lyapunov equations and the Riccati equation of gamma = inf,
in double precision; no conclusion rests on an equation that has no solution. Source of the game:
Basar & Bernhard 1995, H-infinity Optimal Control, chapters 4 and 5.
"""

from __future__ import annotations

import contextlib

import numpy as np
import scipy.linalg as sla

from ambrose.core.checks import AmbroseError, NumericalFailure
from ambrose.core.hinf.riccati import GammaSearch, gains, hamiltonian, normal_form, search_gamma
from ambrose.core.hinf.scaling import ScaledPlant, unavoidable
from ambrose.core.matrix_equations import lyapunov, solve_riccati

_ROUNDING = 1e-11  # of the energies' terms, that is taken off
_AXIS = 1e-6  # of its modulus: an eigenvalue so near the imaginary axis lies on it
_BELOW = 1e-7  # of gamma, at which the frequencies are looked for where the conditions fail


def lower_bound(plant: ScaledPlant) -> float:
    """The gain that no controller of a scaled plant comes below."""
    try:
        normal = normal_form(plant)[0]
        return shown_bound(normal, search_gamma(normal, 1e-3, lambda _: None))
    except (NumericalFailure, np.linalg.LinAlgError):
        return unavoidable(plant)


def shown_bound(plant: ScaledPlant, search: GammaSearch) -> float:
    """The same, of a plant in normal form whose optimum was searched for."""
    best, least = search.best, [0.0]
    at: list[float] = []

    # the transposed plant has the same optimum, and other disturbances
    for side, X, Y in ((plant, best.X, best.Y), (plant.dual(), best.Y, best.X)):
        # where the conditions fail for a frequency's sake, an eigenvalue on the axis shows which
        poles = np.linalg.eigvals(hamiltonian(side, search.lower * (1 - _BELOW)))
        at += np.abs(poles.imag)[np.abs(poles.real) <= _AXIS * np.abs(poles)].tolist()
        with contextlib.suppress(AmbroseError, np.linalg.LinAlgError):
            least.append(_in_time(side, best.gamma, X, Y))
    return max(unavoidable(plant, at), *least)


def _in_time(plant: ScaledPlant, gamma: float, X: np.ndarray, Y: np.ndarray) -> float:
    """The bound in time, 0 where the disturbance has no energy; raises what the equations do."""
    if not len(X):
        return 0.0
    q, r = plant.B1.shape[1], len(plant.C1)
    free = q - len(plant.C2)

    # the costate at t = 0: X x0 = gamma^2 lambda with x0 = Y lambda
    values, vectors = np.linalg.eig(X @ Y)
    costate = vectors[:, int(np.argmax(values.real))].real

    # Before, the dual game backwards: lambda' = -A_L^T lambda, w = W lambda, and its free part W_1:
    # the others follow from y = C2 x + D21 w = 0, D21 = [0 I].
    L = gains(plant.dual(), gamma, Y)
    A_L = plant.A + L.T @ np.vstack([plant.C1, plant.C2])
    W_1 = (plant.B1.T + plant.D11.T @ L[:r] + plant.D21.T @ L[r:])[:free]

    # x' = A_o x + B_o W_1 lambda: what of (lambda, x) dies out backwards in time is the past
    A_o, B_o = plant.A - plant.B1[:, free:] @ plant.C2, plant.B1[:, :free]
    backwards = np.block([[A_L.T, np.zeros_like(A_L)], [-B_o @ W_1, -A_o]])
    T, U, k = sla.schur(backwards, sort="lhp")
    past, U = T[:k, :k], U[:, :k]
    at_end = U.T @ np.concatenate([costate, Y @ costate])
    z = np.hstack([plant.D11[:, :free] @ W_1, plant.C1 - plant.D11[:, free:] @ plant.C2]) @ U
    w = sla.block_diag(W_1, -plant.C2) @ U
    before, spent = lyapunov(past.T, z.T @ z), lyapunov(past.T, w.T @ w)

    # the energies from t = 0 on, at x0
    x0 = (U @ at_end)[len(costate) :]
    terms, energy = _after(plant, gamma, X)
    parts = [at_end @ before @ at_end, *(x0 @ term @ x0 for term in terms)]
    kept, size = sum(parts), sum(abs(part) for part in parts)
    given = at_end @ spent @ at_end + x0 @ energy @ x0
    if not given > 0:
        return 0.0
    return float(np.sqrt(max(kept - _ROUNDING * size, 0.0) / (given * (1 + _ROUNDING))))


def _after(plant: ScaledPlant, gamma: float, X: np.ndarray) -> tuple[list[np.ndarray], np.ndarray]:
    """Terms (n, n) whose sum is min_u int |z|^2 from x0 on, while w is the game's worst, fixed
    beforehand; and its energy int |w|^2.
    """
    q, k = plant.B1.shape[1], len(plant.C1) - plant.B2.shape[1]
    F = gains(plant, gamma, X)
    A_c = plant.A + np.hstack([plant.B1, plant.B2]) @ F
    F = F[:q]  # w = F xi, xi' = A_c xi, xi(0) = x0

    # the last m of z, v = C' x + E w + u, serve as the control:
    # x' = A x + B w + B2 v,   |z|^2 = |C x + N w|^2 + |v|^2
    C, N = plant.C1[:k], plant.D11[:k]
    A, B = plant.A - plant.B2 @ plant.C1[k:], (plant.B1 - plant.B2 @ plant.D11[k:]) @ F

    # min = x^T P x + 2 x^T T xi + xi^T Z xi, v = -B2^T (P x + T xi):
    # A^T P + P A - P B2 B2^T P + C^T C = 0
    # (A - B2 B2^T P)^T T + T A_c + P B F + C^T N F = 0
    # A_c^T Z + Z A_c + (B F)^T T + T^T B F - T^T B2 B2^T T + (N F)^T N F = 0
    solution = solve_riccati(A, plant.B2 @ plant.B2.T, C.T @ C)
    if not solution.solved:
        raise NumericalFailure(solution.status)
    P, NF = solution.X, N @ F
    T = sla.solve_sylvester((A - plant.B2 @ (plant.B2.T @ P)).T, A_c, -(P @ B + C.T @ NF))
    BT = plant.B2.T @ T
    Z = lyapunov(A_c.T, B.T @ T + T.T @ B - BT.T @ BT + NF.T @ NF)
    return [P, 2 * T, Z], lyapunov(A_c.T, F.T @ F)
