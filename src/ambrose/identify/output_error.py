"""The output error of one record: residual, normal equations and scores, with initial state and offsets eliminated.

Both enter linearly, y = y(theta, u) + O(theta) x0 + b, O = [C; C A; C A^2; ...], so they are eliminated at every theta
(variable projection, Golub & Pereyra 1973, in Kaufman's form): what is left is a problem in
theta alone. O is never formed for the whole record: O'O follows from doubling, O' times a signal from blocks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ambrose.core.response import SystemDerivative, simulate
from ambrose.core.statespace import StateSpace
from ambrose.identify.gauss_newton import Linearised
from ambrose.identify.lifted_sensitivities import lifted_sensitivities

_INVISIBLE = 1e-12  # directions of the initial state seen weaker than this (squared) are left at zero
_BLIND = 1e-9  # part of a parameter's effect (squared) that must remain beside them
_BLOCK = 64  # samples


@dataclass(frozen=True, slots=True, eq=False)
class Task:
    """A record: excitation mix e of the distinct signals e (r, k), mix (m, r); measured signals over their weights y (p, k);
    what else is estimated."""

    e: np.ndarray
    mix: np.ndarray
    y: np.ndarray
    initial_state: bool
    offset: bool


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A record at one theta: residual (p, k) and the estimated initial state x0 (n,), offsets b (p,)."""

    residual: np.ndarray
    x0: np.ndarray
    b: np.ndarray
    basis: np.ndarray  # (n + p, r): [O, 1] basis has orthonormal columns, which span all that x0 and b can explain


def distinct(e: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Signals (r, k) and mix (m, r) with e (m, k) = mix signals: equal, opposite and absent excitations are simulated once."""
    rows: list[np.ndarray] = []
    mix = np.zeros((len(e), len(e)))
    for i, row in enumerate(e):
        if not row.any():
            continue
        for j, other in enumerate(rows):
            sign = next((s for s in (1.0, -1.0) if np.array_equal(row, s * other)), 0.0)
            if sign:
                mix[i, j] = sign
                break
        else:
            mix[i, len(rows)] = 1.0
            rows.append(row)
    return np.stack(rows), mix[:, : len(rows)]


def _driven(system: StateSpace, directions: list[SystemDerivative], task: Task) -> tuple[StateSpace, list[SystemDerivative]]:
    """The loop and its derivatives from the distinct signals."""
    mixed = StateSpace(system.A, system.B @ task.mix, system.C, system.D @ task.mix, None, system.outputs, system.dt)
    return mixed, [SystemDerivative(d.A, d.B @ task.mix, d.C, d.D @ task.mix) for d in directions]


def fit(system: StateSpace, task: Task) -> Fit:
    """The residual with the best initial state and offsets; ``system`` from the distinct signals to outputs over weights."""
    n, p = system.n_states, len(system.outputs)
    free = task.y - simulate(system, task.e)
    if not (task.initial_state or task.offset):
        return Fit(free, np.zeros(n), np.zeros(p), np.zeros((n + p, 0)))
    basis = _nuisance_basis(system, task)
    found = basis @ (basis.T @ _nuisance_times(system, free[None])[:, 0])
    x0, b = found[:n], found[n:]
    return Fit(free - _free_response(system, x0, free.shape[1]) - b[:, None], x0, b, basis)


def normal_equations(system: StateSpace, directions: list[SystemDerivative], task: Task) -> Linearised:
    """r'r, J'J and J'r of the record for theta alone; ``system`` with its outputs over their weights."""
    system, directions = _driven(system, directions, task)
    at = fit(system, task)
    _, J = lifted_sensitivities(system, directions, task.e, at.x0)
    flat = J.reshape(len(J), -1)
    M = at.basis.T @ _nuisance_times(system, J) if at.basis.size else np.zeros((0, len(J)))
    full = flat @ flat.T
    H, g = full - M.T @ M, flat @ at.residual.ravel()
    blind = np.diag(H) <= _BLIND * np.diag(full)  # what is left is rounding: initial state and offsets explain it all
    H[blind], H[:, blind], g[blind] = 0.0, 0.0, 0.0
    return Linearised(float(np.vdot(at.residual, at.residual)), H, g)


def projected_jacobian(system: StateSpace, directions: list[SystemDerivative], task: Task) -> tuple[Fit, np.ndarray]:
    """The fit and J (q, p, k) without the part that initial state and offsets could explain."""
    system, directions = _driven(system, directions, task)
    at = fit(system, task)
    _, J = lifted_sensitivities(system, directions, task.e, at.x0)
    if at.basis.size:
        n = system.n_states
        for j, found in enumerate((at.basis @ (at.basis.T @ _nuisance_times(system, J))).T):
            J[j] -= _free_response(system, found[:n], J.shape[2]) + found[n:, None]
    return at, J


def _free_response(system: StateSpace, x0: np.ndarray, k: int) -> np.ndarray:
    return simulate(system, np.zeros((len(system.inputs), k)), x0=x0)


def _nuisance_basis(system: StateSpace, task: Task) -> np.ndarray:
    """The basis (n + p, r) of Fit; rows of what is not estimated are zero."""
    n, p, k = system.n_states, len(system.outputs), task.y.shape[1]
    Q, F, _ = _sums(system.A, system.C, k)
    G = np.block([[Q, F], [F.T, k * np.eye(p)]])
    used = np.r_[np.full(n, task.initial_state), np.full(p, task.offset)] & (np.diag(G) > 0)
    size = np.sqrt(np.where(used, np.diag(G), 1.0))
    scaled = np.where(used[:, None] & used, G / size / size[:, None], 0.0)
    values, V = np.linalg.eigh(scaled)
    keep = values > _INVISIBLE * values[-1]
    return V[:, keep] / np.sqrt(values[keep]) / size[:, None]


def _sums(A: np.ndarray, C: np.ndarray, k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """sum A'^t C'C A^t, sum A'^t C' over t = 0..k - 1, and A^k, by doubling."""
    if k == 1:
        return C.T @ C, C.T.copy(), A
    Q, F, P = _sums(A, C, k // 2)
    Q, F, P = Q + P.T @ Q @ P, F + P.T @ F, P @ P
    return (Q + P.T @ C.T @ C @ P, F + P.T @ C.T, P @ A) if k % 2 else (Q, F, P)


def _nuisance_times(system: StateSpace, signals: np.ndarray) -> np.ndarray:
    """[O, 1]' times signals (c, p, k): (n + p, c)."""
    c, p, k = signals.shape
    n, L = system.n_states, min(_BLOCK, k)
    rows, power = [system.C], system.A
    for _ in range(L - 1):
        rows.append(rows[-1] @ system.A)
    power = np.linalg.matrix_power(system.A, L)
    O_L = np.concatenate(rows).reshape(L, p, n).transpose(1, 0, 2).reshape(p * L, n)
    count = -(-k // L)
    padded = np.zeros((c, p, count * L))
    padded[:, :, :k] = signals
    blocks = padded.reshape(c, p, count, L).transpose(2, 0, 1, 3).reshape(count, c, p * L) @ O_L
    z = np.zeros((c, n))
    for block in blocks[::-1]:
        z = block + z @ power
    return np.vstack([z.T, signals.sum(axis=2).T])
