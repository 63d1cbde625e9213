"""Oracle of judge/margins.py: gain and phase margins of one scalar loop from eigenvalues, so
that no crossing is missed for falling between grid points; slow on large plants.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ambrose.core.checks import invalid
from ambrose.core.frequency import SchurForm, evaluate, schur_form
from ambrose.core.statespace import StateSpace, balance_matrix as balance, close, select

# points added to the eigenvalues' frequencies, a second net for eigenvalues that rounding displaced
_PER_DECADE = 20
_LARGEST = 1e9  # gain factors beyond this are rounding noise where the loop gain vanishes: no limit
_ROOT_TOLERANCE = 1e-12  # relative, of a crossing's frequency
_ROOT_STEPS = 120
_ROUNDING = 10.0  # a pole within so many rounding errors of the origin is an integrator


@dataclass(frozen=True, slots=True)
class LoopMargins:
    """Of a stable negative feedback loop 1/(1 + l): it stays stable while l is multiplied by any
    real factor between gain_reduction < 1 (0: none needed) and gain_margin > 1 (inf: no limit), or
    by exp(j a) with |a| < phase_margin [rad].
    """

    gain_margin: float
    gain_reduction: float
    phase_margin: float


def loop_margins(loop: StateSpace) -> LoopMargins:
    """The margins of the continuous scalar loop l (one input, one output) whose negative feedback
    is stable.

    Gain: l(jw) is real where l(s) - l(-s) has a zero on the imaginary axis. Phase: |l(jw)| = 1
    where 1 - l(s) l(-s) has one. Both are eigenvalue problems of twice the loop's order; between
    their frequencies, and the points between neighbours, every change of sign is followed to its
    root. Raises InvalidInput.
    """
    if loop.D.shape != (1, 1) or loop.dt is not None:
        raise invalid(
            "the loop",
            repr(loop),
            "continuous with one input and one output",
            "open it at one axis",
        )
    A, t = balance(loop.A)
    loop = StateSpace(A, loop.B / t[:, None], loop.C * t, loop.D)
    form = schur_form(loop.A, loop.B, loop.C, loop.D)
    crossovers, unit = _crossings(
        form, _unit_circle_zeros(loop), lambda value: np.log(np.abs(value))
    )
    zeros = _real_axis_zeros(loop, form, float(crossovers.max(initial=0.0)))
    _, real = _crossings(form, zeros, np.imag)
    values = np.concatenate([real.real, _ends(form)])
    factors = -1 / values[values < -1 / _LARGEST]
    return LoopMargins(
        float(factors[factors > 1].min(initial=np.inf)),
        float(factors[(factors < 1) & (factors > 1 / _LARGEST)].max(initial=0.0)),
        float(np.abs(np.angle(-unit)).min(initial=np.pi)),
    )


def opened(loop: StateSpace, axis: int) -> StateSpace:
    """The scalar loop seen at one output of a square ``loop`` with negative feedback while all
    other outputs stay closed.
    """
    gain = -np.eye(len(loop.outputs))
    gain[axis, axis] = 0.0
    return select(close(loop, gain), loop.inputs[axis], loop.outputs[axis])


def _ends(form: SchurForm) -> np.ndarray:
    """l at infinite and, unless the loop integrates, at zero frequency."""
    ends = [form.D[0, 0]]
    if (np.abs(form.poles) > _ROUNDING * form.pole_errors).all():
        ends.append(evaluate(form, np.zeros(1))[0, 0, 0].real)
    return np.array(ends)


def _real_axis_zeros(loop: StateSpace, form: SchurForm, crossover: float) -> np.ndarray:
    """The zeros of l(s) - l(-s), by shift and invert of its system pencil (several of its 2n + 1
    zeros are at infinity).

    The shift lies near the crossover frequency [rad/s], about which the zeros are wanted most
    exactly.
    """
    n = loop.n_states
    b, c = np.linalg.norm(loop.B), np.linalg.norm(loop.C)
    if b == 0 or c == 0:
        return np.zeros(0, dtype=complex)
    moduli = np.abs(form.poles)
    scale = crossover or (float(np.median(moduli[moduli > 0])) if (moduli > 0).any() else 1.0)
    shift = 0.7183 * scale  # no round number, so that it is not itself a zero
    A = loop.A
    B = loop.B / b * shift
    C = loop.C / c
    zero = np.zeros((n, n))
    pencil = np.block([[A, zero, B], [zero, -A, B], [C, C, np.zeros((1, 1))]])
    identity = np.diag(np.append(np.ones(2 * n), 0.0))
    inverse = np.linalg.eigvals(np.linalg.solve(pencil - shift * identity, identity))
    return shift + 1 / inverse[np.abs(inverse) > 1e-13 / shift]


def _unit_circle_zeros(loop: StateSpace) -> np.ndarray:
    """The zeros of 1 - l(s) l(-s), the eigenvalues of a Hamiltonian matrix (Boyd, Balakrishnan &
    Kabamba 1989).
    """
    A = loop.A
    B = loop.B
    C = loop.C
    d = loop.D[0, 0]
    R = 1 - d * d
    # |l| = 1 at infinity: look for |l| = 1 - 5e-10 instead, the refinement does the rest
    if abs(R) < 1e-9:
        R = -1e-9
    F = A + B @ C * (d / R)
    return np.linalg.eigvals(np.block([[F, B @ B.T / R], [-C.T @ C / R, -F.T]]))


def _crossings(
    form: SchurForm, candidates: np.ndarray, equation: Callable[[np.ndarray], np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies w (k,) [rad/s] and l(jw) (k,) where ``equation`` of l(jw) changes sign."""

    def values(omega: np.ndarray) -> np.ndarray:
        return evaluate(form, 1j * omega)[:, 0, 0]

    points = _points(form, candidates)
    found = values(points)
    f = equation(found)
    strong = np.abs(found) > 1 / _LARGEST
    i = np.flatnonzero((np.sign(f[:-1]) * np.sign(f[1:]) < 0) & strong[:-1] & strong[1:])
    omega = np.concatenate(
        [
            points[f == 0],
            _roots(lambda w: equation(values(w)), points[i], points[i + 1], f[i], f[i + 1]),
        ]
    )
    return omega, values(omega)


def _roots(
    function: Callable[[np.ndarray], np.ndarray],
    a: np.ndarray,
    b: np.ndarray,
    fa: np.ndarray,
    fb: np.ndarray,
) -> np.ndarray:
    """Roots (k,) of ``function`` in the intervals from a to b (k,), all at once: false position,
    halving every third step.
    """
    for step in range(_ROOT_STEPS):
        open_ = (b - a > _ROOT_TOLERANCE * b) & (fa != 0) & (fb != 0)
        if not open_.any():
            break
        weight = np.full(len(a), 0.5) if step % 3 == 2 else np.clip(fa / (fa - fb), 1e-3, 1 - 1e-3)
        middle = np.where(open_, a + weight * (b - a), a)
        f = np.where(open_, function(middle), 0.0)
        left = open_ & (np.sign(f) == np.sign(fa))
        right = open_ & ~left
        # Illinois: an end that stays counts half in the next step
        fb = np.where(right, f, np.where(left, fb / 2, fb))
        fa = np.where(left, f, np.where(right, fa / 2, fa))
        a, b = np.where(left, middle, a), np.where(right, middle, b)
    return np.where(np.abs(fa) < np.abs(fb), a, b)


def _points(form: SchurForm, candidates: np.ndarray) -> np.ndarray:
    """Ascending frequencies (k,) [rad/s]: those of candidates and poles, a coarse net, and the
    means between neighbours.
    """
    poles = form.poles
    moduli = np.abs(poles)
    if not (moduli > 0).any():
        moduli = np.abs(candidates)
    real = moduli[moduli > 1e-9 * moduli.max(initial=0.0)]  # without integrators
    if not real.size:
        return np.zeros(0)
    low, high = real.min() / 100, 100 * real.max()
    net = np.geomspace(low, high, int(_PER_DECADE * np.log10(high / low)))
    # an undamped pole has no value
    beside = np.concatenate([moduli, np.abs(poles.imag)]) * (1 + 1e-7)
    points = np.concatenate([net, beside, candidates.imag])
    points = np.unique(points[(points > 1e-6 * low) & (points < 1e6 * high)])
    return np.unique(np.concatenate([points, np.sqrt(points[:-1] * points[1:])]))
