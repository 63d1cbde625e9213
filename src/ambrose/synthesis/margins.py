"""Gain and phase margins of one scalar loop, from eigenvalues: no frequency grid, so no crossing falls between two points."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla

from ambrose.core.checks import invalid
from ambrose.core.statespace import StateSpace, balance

_NEAR_AXIS = 1e-3  # relative distance from the imaginary axis up to which an eigenvalue is tried as a crossing
_MOVE = 1e-2  # relative distance over which a candidate may be refined
_SOLVED = 1e-9  # of the crossing's equation
_NEWTON_STEPS = 12
_SINGULAR = 1e13  # condition number of A from which the loop counts as integrating: l(0) is infinite


@dataclass(frozen=True, slots=True)
class LoopMargins:
    """Of a stable negative feedback loop 1/(1 + l): it stays stable while l is multiplied by any real factor between
    gain_reduction < 1 (0: none needed) and gain_margin > 1 (inf: no limit), or by exp(j a) with |a| < phase_margin [rad]."""

    gain_margin: float
    gain_reduction: float
    phase_margin: float


def loop_margins(loop: StateSpace) -> LoopMargins:
    """The margins of the continuous scalar loop l (one input, one output) whose negative feedback is stable.

    Gain: l(jw) is real where l(s) - l(-s) has a zero on the imaginary axis. Phase: |l(jw)| = 1 where 1 - l(s) l(-s) has
    one. Both are eigenvalue problems of twice the loop's order, so no grid is needed. Raises InvalidInput.
    """
    if loop.D.shape != (1, 1) or loop.dt is not None:
        raise invalid("the loop", repr(loop), "continuous with one input and one output", "open it at one axis")
    A, t = balance(loop.A)
    loop = StateSpace(A, loop.B / t[:, None], loop.C * t, loop.D)
    values = [value.real for value in _crossings(loop, _real_axis_zeros(loop), _phase)]
    values.append(loop.D[0, 0])  # the ends of the frequency axis
    if loop.n_states and np.linalg.cond(A) < _SINGULAR:
        values.append((loop.D - loop.C @ np.linalg.solve(A, loop.B))[0, 0])
    factors = np.array([-1 / value for value in values if value < 0])
    phases = np.array([abs(np.angle(-value)) for value in _crossings(loop, _unit_circle_zeros(loop), _log_gain)])
    return LoopMargins(
        float(factors[factors > 1].min(initial=np.inf)),
        float(factors[factors < 1].max(initial=0.0)),
        float(phases.min(initial=np.pi)),
    )


def _real_axis_zeros(loop: StateSpace) -> np.ndarray:
    """The zeros of l(s) - l(-s), by shift and invert of its system pencil (several of its 2n + 1 zeros are at infinity)."""
    n = loop.n_states
    b, c = np.linalg.norm(loop.B), np.linalg.norm(loop.C)
    if b == 0 or c == 0:
        return np.zeros(0, dtype=complex)
    A, B, C, zero = loop.A, loop.B / b, loop.C / c, np.zeros((n, n))
    moduli = np.abs(np.linalg.eigvals(A))
    shift = 0.7183 * float(np.median(moduli[moduli > 0])) if (moduli > 0).any() else 1.0  # no round number: not a zero itself
    pencil = np.block([[A, zero, B * shift], [zero, -A, B * shift], [C, C, np.zeros((1, 1))]])
    identity = np.diag(np.append(np.ones(2 * n), 0.0))
    inverse = np.linalg.eigvals(np.linalg.solve(pencil - shift * identity, identity))
    return shift + 1 / inverse[np.abs(inverse) > 1e-13 / shift]


def _unit_circle_zeros(loop: StateSpace) -> np.ndarray:
    """The zeros of 1 - l(s) l(-s), the eigenvalues of a Hamiltonian matrix (Boyd, Balakrishnan & Kabamba 1989)."""
    A, B, C, d = loop.A, loop.B, loop.C, loop.D[0, 0]
    R = 1 - d * d
    if abs(R) < 1e-9:  # |l| = 1 at infinity: look for |l| = 1 - 5e-10 instead, the refinement does the rest
        R = -1e-9
    F = A + B @ C * (d / R)
    return np.linalg.eigvals(np.block([[F, B @ B.T / R], [-C.T @ C / R, -F.T]]))


def _phase(value: complex, slope: complex) -> tuple[float, float]:
    """Im l / |l| and its derivative by w, near the real axis; slope is dl/dw."""
    return value.imag / abs(value), slope.imag / abs(value)


def _log_gain(value: complex, slope: complex) -> tuple[float, float]:
    """log |l| and its derivative by w."""
    return float(np.log(abs(value))), (slope / value).real


def _crossings(loop: StateSpace, candidates: np.ndarray, equation: Callable) -> list[complex]:
    """l(jw) at the frequencies near a candidate's imaginary part where Newton's method solves ``equation``."""
    near = (np.abs(candidates.real) < _NEAR_AXIS * np.abs(candidates)) & (candidates.imag > 0)
    A, B, C, D = loop.A, loop.B[:, 0], loop.C[0], loop.D[0, 0]
    found = []
    for start in candidates[near].imag:
        w, error = start, np.inf
        for _ in range(_NEWTON_STEPS):
            factors = sla.lu_factor(1j * w * np.eye(len(A)) - A)
            x = sla.lu_solve(factors, B)
            value = complex(C @ x + D)
            slope = complex(-1j * (C @ sla.lu_solve(factors, x)))
            error, rate = equation(value, slope)
            if abs(error) < _SOLVED or rate == 0:
                break
            w = w - error / rate
            if abs(w / start - 1) > _MOVE:
                break
        if abs(error) < _SOLVED:
            found.append(value)
    return found
