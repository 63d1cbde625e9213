"""The H-infinity norm: two-step bisection (Bruinsma & Steinbuch 1990) without any classification of
eigenvalues.

gamma is a singular value of G(j omega) exactly where a Hamiltonian matrix has the eigenvalue j
omega. Whether a computed eigenvalue lies "on" the axis is a fragile question; it is not asked. The
imaginary part of *every* eigenvalue, and the midpoints between neighbours, are candidate
frequencies: were there an interval with a gain above gamma, its ends would be eigenvalues, so one
candidate at least would lie inside it and show that gain by evaluation. A wrong candidate costs one
evaluation. The lower bound starts from the poles' frequencies and climbs to the local maximum after
each step.

Between two eigenvalue problems gains are read from the partial fractions, where the eigenvectors
keep their digits (core/ frequency.py), else from the Schur form; the value that is returned is
recomputed from the system as it was given.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg as sla

from ambrose.core.checks import NumericalFailure, UnstableSystem, check_positive, named_failure
from ambrose.core.frequency import SchurForm, evaluate, largest_gain, schur_form, state_response_at
from ambrose.core.presentation import Presented
from ambrose.core.statespace import StateSpace, as_statespace, balance_system

_MAX_STEPS = 60  # raises of the lower bound, at most; it converges quadratically
_STENCIL = np.linspace(-1.0, 1.0, 17)  # points of one pass of the local search
_PASSES = 5  # zooms of the stencil around a peak
# the same with partial fractions, where the last parabola is enough
_FINE_STENCIL = np.linspace(-1.0, 1.0, 13)
_FINE_PASSES = 3  # zooms of the finer stencil
# tolerance from which on partial fractions, which lose up to four digits, may choose the
# frequencies
_EXPANDED = 1e-8
_PEAKS = 6  # local maxima followed at once
# a pole is marginal when it is closer to the boundary than this many rounding errors
_ROUNDING = 10.0


@dataclass(frozen=True, slots=True, repr=False)
class HinfNorm(Presented):
    """The largest singular value over all frequencies, and where it is attained.

    value: attained at ``frequency`` [rad/s] (inf when only approached at infinite frequency); no
    frequency has a gain above ``upper`` = (1 + tolerance) value, up to rounding. ``steps`` counts
    Hamiltonian eigenvalue problems.
    """

    value: float
    frequency: float
    upper: float
    steps: int


@named_failure("the H-infinity norm")
def hinf_norm(system: Any, tolerance: float = 1e-6, allow_unstable: bool = False) -> HinfNorm:
    """The H-infinity norm of a continuous or sampled system, with the frequency of its peak
    [rad/s].

    system: a StateSpace or python-control system; tolerance: relative distance from the value to
    the certified upper bound; allow_unstable: return the L-infinity norm (largest gain on the axis
    or unit circle) of an unstable system; a pole on the boundary then gives inf. Raises
    UnstableSystem for an unstable or marginal system, NumericalFailure when the bounds do not meet.
    Source: Bruinsma & Steinbuch 1990, Systems & Control Letters 14, algorithm 2.
    """
    system = as_statespace(system)
    check_positive(tolerance, "tolerance", "1e-6 suits most uses")
    if 0 in system.D.shape:
        return HinfNorm(0.0, 0.0, 0.0, 0)
    if system.n_states == 0:
        gain = float(np.linalg.norm(system.D, 2))
        return HinfNorm(gain, 0.0, gain, 0)
    tolerance = max(tolerance, 1e-12)
    problem = _Problem.of(system, expand=tolerance >= _EXPANDED)
    marginal = _check_stability(problem, allow_unstable)
    if marginal is not None:
        return HinfNorm(np.inf, marginal / problem.unit, np.inf, 0)
    value, angle, upper, steps = _bisect(problem, tolerance)
    return HinfNorm(value, angle / problem.unit, upper, steps)


@dataclass(frozen=True, slots=True)
class _Peak:
    gain: float
    angle: float
    noise: float


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    """One system prepared: ``form`` for gains at many points, ``A .. D`` of the continuous
    equivalent for the Hamiltonian.

    Frequencies are angles theta = omega dt in 0..pi when sampled, else omega in 0..inf; ``unit`` is
    dt or 1.
    """

    original: StateSpace
    form: SchurForm
    poles: np.ndarray
    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    rotation: float

    @classmethod
    def of(cls, system: StateSpace, expand: bool) -> _Problem:
        A, B, C, _ = balance_system(system.A, system.B, system.C)
        form = schur_form(A, B, C, system.D, expand=expand)
        poles, rotation = form.poles, 0.0
        D = system.D

        # The form keeps z: only the Hamiltonian is that of the bilinear image.
        if system.dt is not None:
            A, B, C, D, rotation = _continuous(A, B, C, D, poles)
            A, B, C, _ = balance_system(A, B, C)
        return cls(system, form, poles, A, B, C, D, rotation)

    @property
    def sampled(self) -> bool:
        return self.original.dt is not None

    @property
    def unit(self) -> float:
        return 1.0 if self.original.dt is None else self.original.dt

    def point(self, angle: np.ndarray) -> np.ndarray:
        return np.exp(1j * angle) if self.sampled else 1j * angle

    def within(self, angle: float) -> float:
        """The angle of the half axis, or half circle, with the same gain."""
        return float(abs(np.angle(np.exp(1j * angle))) if self.sampled else abs(angle))

    def gains(self, angle: np.ndarray, floor: float = 0.0) -> np.ndarray:
        """The largest singular value at each frequency, fast; a bound below ``floor`` where it is
        not above that.
        """
        values = evaluate(self.form, self.point(angle))

        # The Frobenius norm is no smaller than the largest singular value: below the floor it will
        # do.
        parts = np.ascontiguousarray(values).view(float).reshape(len(values), -1)
        bound = np.sqrt(np.einsum("ij,ij->i", parts, parts))
        above = bound >= floor
        if above.any():
            bound[above] = largest_gain(values[above])
        return bound

    def peak(self, angle: float) -> _Peak:
        """The largest singular value at one frequency, as exactly as the data allow, with its
        rounding error.
        """
        s = self.original
        if np.isinf(angle):
            return _Peak(_gain(s.D), angle, 0.0)
        X, _ = state_response_at(s.A, s.B, complex(self.point(np.asarray(angle))))

        # eps (|C| |X| + |D|): what rounding makes of C X + D
        noise = np.finfo(float).eps * np.linalg.norm(np.abs(s.C) @ np.abs(X) + np.abs(s.D))
        return _Peak(_gain(s.C @ X + s.D), angle, float(noise))

    def candidates(self, gamma: float) -> np.ndarray:
        """Every frequency at which gamma may be a singular value, sorted, with the points between
        neighbours.
        """
        values = np.linalg.eigvals(_hamiltonian(self.A, self.B, self.C, self.D, gamma)).imag
        if self.sampled:
            # s = j v of the bilinear image is z = e^(j rotation) (1 + j v)/(1 - j v), of the angle
            # 2 atan v + rotation
            angles = np.abs(np.angle(np.exp(1j * (2 * np.arctan(values) + self.rotation))))
            ends = np.unique(np.concatenate([[0.0], angles, [np.pi]]))
        else:
            ends = np.unique(np.concatenate([[0.0], np.abs(values)]))

        # Both means: the geometric one for intervals of many decades.
        middle, geometric = (ends[1:] + ends[:-1]) / 2, np.sqrt(ends[1:] * ends[:-1])
        return np.sort(np.concatenate([ends, middle, geometric]))


def _continuous(
    A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray, poles: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, float]:
    """The bilinear image z = e^(j rotation) (1 + s) / (1 - s); rotated (and complex) only when a
    pole is close to z = -1.
    """
    rotation = 0.0
    if np.abs(poles + 1).min() < 1e-3:
        # s is infinite at z = -e^(j rotation): the point of the circle farthest from all poles.
        # zeta = e^(-j rotation) z has the matrices e^(-j rotation) (A, B).
        angles = np.linspace(0.0, np.pi, 65)
        rotation = float(
            angles[np.argmax(np.abs(poles[:, None] + np.exp(1j * angles)).min(axis=0))]
        )
        A, B = A * np.exp(-1j * rotation), B * np.exp(-1j * rotation)

    # zeta = (1 + s)/(1 - s): zeta - A = (A + I) (s - A_c)/(1 - s), A_c = (A + I)^-1 (A - I), and
    # (1 - s)(s - A_c)^-1 = 2 (A + I)^-1 (s - A_c)^-1 - I, so that
    # G = 2 C (A + I)^-1 (s - A_c)^-1 (A + I)^-1 B + D - C (A + I)^-1 B
    plus = A + np.eye(len(A))
    lu = sla.lu_factor(plus)
    left = sla.lu_solve(lu, np.hstack([A - np.eye(len(A)), B]))
    CE = sla.lu_solve(lu, C.T.astype(plus.dtype), trans=1).T
    return left[:, : len(A)], np.sqrt(2) * left[:, len(A) :], np.sqrt(2) * CE, D - CE @ B, rotation


def _hamiltonian(
    A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray, gamma: float
) -> np.ndarray:
    """Eigenvalues j omega where gamma is a singular value of C (j omega - A)^-1 B + D; scaled to
    gamma = 1.
    """
    B = B / np.sqrt(gamma)
    C = C / np.sqrt(gamma)
    D = D / gamma
    DH = D.conj().T
    CH = C.conj().T
    BH = B.conj().T

    # x' = A x + B u, y = C x + D u, and the adjoint p' = -A^H p - C^H y with u = B^H p + D^H y (u
    # is an input that G^H G gives back with gain one):
    # (I - D^H D) u = D^H C x + B^H p; u = right (x, p)
    right = np.linalg.solve(np.eye(D.shape[1]) - DH @ D, np.hstack([DH @ C, BH]))
    n = len(A)
    H = np.empty((2 * n, 2 * n), right.dtype)

    # x' = A x + B u
    H[:n, :n] = A + B @ right[:, :n]
    H[:n, n:] = B @ right[:, n:]

    # p' = -A^H p - C^H (C x + D u)
    H[n:, :n] = -CH @ (C + D @ right[:, :n])
    H[n:, n:] = -H[:n, :n].conj().T
    return H


def _gain(M: np.ndarray) -> float:
    return float(np.linalg.svd(M, compute_uv=False)[0]) if M.any() else 0.0


def _check_stability(problem: _Problem, allow_unstable: bool) -> float | None:
    """The frequency of a pole on the stability boundary, or None; refuses unstable systems unless
    they are allowed.
    """
    poles, errors = problem.poles, _ROUNDING * problem.form.pole_errors
    distance = 1 - np.abs(poles) if problem.sampled else -poles.real
    if (distance <= errors).any():
        worst = int(np.argmin(distance - errors))
        if not allow_unstable:
            kind = "z" if problem.sampled else "s"
            raise UnstableSystem(
                f"the pole {kind} = {poles[worst]:.6g} is not inside the stability region, so the "
                "H-infinity norm does not "
                "exist; stabilise the loop first, or ask for the L-infinity norm with "
                "allow_unstable=True"
            )
        on_boundary = np.flatnonzero(np.abs(distance) <= errors)
        if on_boundary.size:
            pole = poles[on_boundary[0]]
            return float(abs(np.angle(pole)) if problem.sampled else abs(pole.imag))
    return None


def _bisect(problem: _Problem, tolerance: float) -> tuple[float, float, float, int]:
    """Raise the lower bound until no candidate beats it by more than ``tolerance``: value, angle,
    upper bound, steps.
    """
    # Where continuous, D is the gain at infinity, which no finite frequency need attain.
    best = _Peak(0.0, 0.0, 0.0) if problem.sampled else problem.peak(np.inf)
    best = _climb(problem, _seeds(problem), best, 0.0)
    for step in range(_MAX_STEPS):
        level = best.gain * (1 + tolerance) + best.noise
        if level == 0.0:
            return 0.0, 0.0, 0.0, step

        # Half of the tolerance below the level: fast gains only choose where to look more exactly.
        higher = _climb(
            problem, problem.candidates(level), best, level - 0.5 * tolerance * best.gain
        )

        # No candidate above the level: there is no interval with a gain above it.
        if higher.gain <= level:
            return higher.gain, higher.angle, level, step + 1
        best = higher
    raise NumericalFailure(
        f"the H-infinity norm's lower bound {best.gain:.6g} still rises after {_MAX_STEPS} steps; "
        "use a larger tolerance "
        f"than {tolerance:g}, or rescale the inputs and outputs"
    )


def _seeds(problem: _Problem) -> np.ndarray:
    """Frequencies to start from: those of the poles, the ends, and points between."""
    poles = problem.poles[problem.poles.imag >= 0]  # they come in conjugate pairs
    if problem.sampled:  # the last one is where the bilinear map has its infinity
        seeds = np.concatenate([[0.0, np.pi, np.pi - problem.rotation], np.abs(np.angle(poles))])
    else:
        # both are near the peak of a lightly damped pole; |p| is the corner of a well damped one
        seeds = np.concatenate([[0.0], np.abs(poles), np.abs(poles.imag)])
    seeds = np.unique(seeds)
    return np.sort(np.concatenate([seeds, (seeds[1:] + seeds[:-1]) / 2]))


def _climb(problem: _Problem, angles: np.ndarray, best: _Peak, level: float) -> _Peak:
    """The highest of ``best`` and the local maxima near the best of these (sorted) frequencies with
    gains above ``level``.
    """
    gains = problem.gains(angles, level)

    # Local maxima of the sorted gains above the level, none of less than half of the largest.
    left, right = np.append(-np.inf, gains[:-1]), np.append(gains[1:], -np.inf)
    peaks = np.flatnonzero(
        (gains >= left) & (gains >= right) & (gains > max(level, 0.5 * gains.max()))
    )
    peaks = peaks[np.argsort(-gains[peaks])][:_PEAKS]
    if peaks.size == 0:
        return best

    # With partial fractions the last parabola is enough: one exact gain at the highest.
    if problem.form.expansion is not None:
        centre, _, height = _zoom(problem, angles[peaks], gains[peaks], _FINE_STENCIL, _FINE_PASSES)
        peak = problem.peak(problem.within(centre[np.argmax(height)]))
        return peak if peak.gain > best.gain else best
    centre, radius, height = _zoom(problem, angles[peaks], gains[peaks], _STENCIL, _PASSES)
    keep = height > (1 - 1e-3) * height.max()
    for angle, step in zip(centre[keep], radius[keep], strict=True):
        peak = _polish(problem, float(angle), float(step))
        if peak.gain > best.gain:
            best = peak
    return best


def _zoom(
    problem: _Problem, centre: np.ndarray, gains: np.ndarray, stencil: np.ndarray, passes: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Local maximisation from several starts (k,) at once: centres, remaining radii, gains.

    The first radius is the distance to the nearest pole: on that scale G changes. Frequencies may
    leave the half axis (or the half circle); the gain is symmetric. Where the last stencil holds
    the maximum, its parabola gives the centre.
    """
    points = problem.point(centre)
    radius = np.abs(points[:, None] - problem.poles).min(axis=1)
    k, last = np.arange(len(centre)), len(stencil) - 1
    for _ in range(passes):
        # All starts at once: a stencil (k, stencil) around each.
        angles = centre[:, None] + radius[:, None] * stencil
        values = problem.gains(angles.ravel()).reshape(angles.shape)
        top = np.argmax(values, axis=1)

        # The maximum at an end of the stencil and higher than before: walk on at the same scale.
        # Else narrow down to one spacing of the stencil.
        inside = (top > 0) & (top < last)
        better = values[k, top] > gains
        centre = np.where(better, angles[k, top], centre)
        gains = np.where(better, values[k, top], gains)
        radius = np.where(inside | ~better, radius * 2 / last, radius)

    # Parabola through the maximum and its neighbours, one spacing (by now the radius) apart; where
    # it does not bend down the vertex is the centre.
    left, right = values[k, np.maximum(top - 1, 0)], values[k, np.minimum(top + 1, last)]
    bend = left - 2 * gains + right
    vertex = 0.5 * (left - right) / np.where(bend < 0, bend, -np.inf)
    return np.where(inside, centre + radius * vertex, centre), radius, gains


def _polish(problem: _Problem, angle: float, step: float) -> _Peak:
    """The same for one start with exactly evaluated gains: walk while a neighbour is higher, end
    with a parabola.
    """
    step = max(step, 8 * np.spacing(angle))
    here = problem.peak(angle)
    low, high = problem.peak(angle - step), problem.peak(angle + step)

    # Uphill with doubled steps until both neighbours are lower.
    for _ in range(30):
        if max(low.gain, high.gain) <= here.gain:
            break
        step *= 2
        here = max(low, high, key=lambda peak: peak.gain)
        low, high = problem.peak(here.angle - step), problem.peak(here.angle + step)
    bend = low.gain - 2 * here.gain + high.gain
    if bend < 0:
        vertex = problem.peak(here.angle + 0.5 * step * (low.gain - high.gain) / bend)
        here = max(here, vertex, key=lambda peak: peak.gain)
    return _Peak(here.gain, problem.within(here.angle), here.noise)
