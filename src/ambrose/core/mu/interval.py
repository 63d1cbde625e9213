"""The structured singular value over frequency: a peak that is no artefact of the grid, and a proof over an interval.

``mu_peak`` refines a grid around every high local maximum; what it returns is still "on the grid". ``mu_certificate`` proves
mu(M(j omega)) < gamma for every omega of an interval: with the scalings (X, G) found at one frequency held constant,

    Phi(omega) = M^H X_z M + j (G M - M^H G^H) - gamma^2 X_w

is a rational Hermitian matrix, negative definite at that frequency; it stays so until an imaginary eigenvalue j omega of the
associated Hamiltonian pencil (Boyd, Balakrishnan & Kabamba 1989; Helmersson 1995 for constant scalings over an interval). The
pieces so proved must cover the interval; where they do not, the part left open is named.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg as sla
from numpy.typing import ArrayLike

from ambrose.core.checks import InvalidInput, check_positive, check_shape, invalid, named_failure
from ambrose.core.frequency import frequency_response, transfer_matrix
from ambrose.core.lft import Block
from ambrose.core.mu.lower import lower_bound
from ambrose.core.mu.structure import Structure, check_matrix, structure_of
from ambrose.core.mu.upper import upper_bound
from ambrose.core.presentation import Presented
from ambrose.core.statespace import as_statespace, balance, poles

_AXIS = 1e-7  # |Re s| / |s| below which an eigenvalue counts as imaginary
_PROBES = 5  # frequencies inside each proved piece at which Phi is looked at, as a check of the eigenvalue solver

_ROUNDS = 12  # of the refinement of a peak

Response = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class MuPeak(Presented):
    """The largest bounds found on a refined grid.

    upper at frequency [rad/s]; lower at lower_frequency [rad/s], with delta (n_w, n_z) that proves it (NaN when lower is 0);
    omega (w,) [rad/s] the refined grid and values (w,) the upper bound there; resolved: whether a finer grid would change
    ``upper`` by less than the tolerance, judged by its neighbours (a judgement, no proof: see mu_certificate).
    """

    upper: float
    frequency: float
    lower: float
    lower_frequency: float
    delta: np.ndarray
    omega: np.ndarray
    values: np.ndarray
    resolved: bool

    def facts(self) -> Mapping[str, Any]:
        """Both bounds and where they are."""
        return {name: getattr(self, name) for name in ("upper", "frequency", "lower", "lower_frequency", "resolved")}


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class MuCertificate(Presented):
    """Whether mu < gamma was proved for every frequency of ``interval`` [rad/s].

    pieces (k, 3) [rad/s]: from, to, and the frequency whose scalings prove the piece; open: the frequency ranges left;
    gap: by how much the upper bound exceeds gamma at open_frequency [rad/s] (0 when proved; at most 0 when the upper bound is
    below gamma there, but the proof ran out of pieces).
    """

    proved: bool
    gamma: float
    interval: tuple[float, float]
    pieces: np.ndarray
    open: tuple[tuple[float, float], ...]
    gap: float
    open_frequency: float

    def facts(self) -> Mapping[str, Any]:
        """The claim and whether it was proved."""
        return {"proved": self.proved, "claim": str(self)}

    def __str__(self) -> str:
        where = f"[{self.interval[0]:g}, {self.interval[1]:g}] rad/s"
        if self.proved:
            return f"mu < {self.gamma:g} on {where}, proved in {len(self.pieces)} pieces"
        return (
            f"mu < {self.gamma:g} on {where} is not proved: {len(self.open)} range(s) left open, the upper bound at "
            f"{self.open_frequency:g} rad/s is {self.gamma + self.gap:g}"
        )


def _response(system: Any, structure: Structure) -> Response:
    """M(omega) from a system or a callable, checked against the blocks."""
    if callable(system) and not hasattr(system, "A"):
        return lambda omega: check_matrix(system(omega), structure)
    state_space = as_statespace(system)
    return lambda omega: check_matrix(frequency_response(state_space, omega).values, structure)


def _grid(omega: ArrayLike, system: Any) -> np.ndarray:
    """The sorted grid; a system's resonances inside it are added."""
    grid = np.unique(check_shape(omega, "omega", "(w)").astype(float))
    if len(grid) < 3 or grid[0] < 0:
        raise invalid("omega", f"{len(grid)} frequencies from {grid.min(initial=0):g}", "3 or more, none negative", "widen it")
    if hasattr(system, "A"):
        p = poles(system)
        dt = getattr(system, "dt", None)
        if dt:
            p = np.log(p[np.abs(p) > 0].astype(complex)) / dt
        extra = np.abs(p[p.imag > 0].imag)
        grid = np.unique(np.concatenate([grid, extra[(extra > grid[0]) & (extra < grid[-1])]]))
    return grid


def _between(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Geometric middle, arithmetic from zero."""
    return np.where(low > 0, np.sqrt(low * high), 0.5 * (low + high))


@named_failure("the peak of the structured singular value")
def mu_peak(
    system: Any,
    blocks: Sequence[Block],
    omega: ArrayLike,
    *,
    lower: bool = True,
    tolerance: float = 1e-4,
    max_points: int = 3000,
) -> MuPeak:
    """The peak of mu over frequency, refined around the high local maxima of its upper bound until they stand still.

    system: a system from w to z (or a callable, omega (w,) [rad/s] -> M (w, n_z, n_w)). omega (w,) [rad/s]: the starting grid.
    Points are added halfway to the neighbours of every local maximum within 10 % of the largest, and once between all
    neighbours of which one is above half the largest. The result is a statement on the final grid, its upper bound to
    ``tolerance`` where ``resolved``.

    Raises InvalidInput when blocks and system do not fit, or a frequency coincides with a pole.
    """
    structure = structure_of(blocks)
    check_positive(tolerance, "tolerance", "use something like 1e-4")
    respond = _response(system, structure)

    def bound(points: np.ndarray) -> np.ndarray:
        return upper_bound(respond(points), structure, tolerance=tolerance / 4).value

    grid = _grid(omega, system)
    values = bound(grid)
    resolved = False
    for count in range(_ROUNDS):
        top = values.max()
        if count == 0:
            chosen = np.maximum(values[:-1], values[1:]) > 0.5 * top
        else:
            padded = np.concatenate([[-np.inf], values, [-np.inf]])
            high = (values >= padded[:-2]) & (values >= padded[2:]) & (values > 0.9 * top)
            chosen = high[:-1] | high[1:]
        new = _between(grid[:-1], grid[1:])[chosen]
        new = new[~np.isin(new, grid)]
        if len(new) == 0 or len(grid) + len(new) > max_points:
            break
        grid, values = np.concatenate([grid, new]), np.concatenate([values, bound(new)])
        order = np.argsort(grid)
        grid, values = grid[order], values[order]
        k = int(values.argmax())
        near = values[max(0, k - 1) : k + 2]
        if count and values[k] - top <= 0.25 * tolerance * values[k] and values[k] - near.min() <= tolerance * values[k]:
            resolved = True
            break
    k = int(values.argmax())
    best, at, delta = 0.0, float(grid[k]), np.full((structure.n_w, structure.n_z), np.nan, complex)
    if lower:
        chosen = np.argsort(values)[::-1][:40]
        M = respond(grid[chosen])
        up = upper_bound(M, structure, tolerance=tolerance / 4)
        low = lower_bound(M, structure, up.value, up.worst, tolerance=tolerance)
        j = int(low.value.argmax())
        best, at, delta = float(low.value[j]), float(grid[chosen[j]]), low.delta[j]
    return MuPeak(float(values[k]), float(grid[k]), min(best, float(values[k])), at, delta, grid, values, resolved)


@dataclass(frozen=True, slots=True, eq=False)
class _Matrices:
    """A balanced continuous-time system; omega of a sampled system is warped by (2/dt) tan(omega dt / 2)."""

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    dt: float | None

    def warp(self, omega: float) -> float:
        if self.dt is None:
            return omega
        return np.inf if omega * self.dt >= np.pi * (1 - 1e-12) else float(2 / self.dt * np.tan(omega * self.dt / 2))

    def unwarp(self, omega: float) -> float:
        return omega if self.dt is None else float(2 / self.dt * np.arctan(omega * self.dt / 2))

    def at(self, omega: float) -> np.ndarray:
        if np.isinf(omega):
            return self.D.astype(complex)
        return transfer_matrix(self.A, self.B, self.C, self.D, np.array([1j * omega]))[0]


def _matrices(system: Any) -> _Matrices:
    system = as_statespace(system)
    A, B, C, D = system.A, system.B, system.C, system.D
    if system.dt is not None:  # bilinear transform: the same M on the warped frequency axis
        if system.n_states and np.linalg.cond(np.eye(system.n_states) + A) > 1e13:
            raise InvalidInput("the sampled system has a pole at z = -1; evaluate mu on a grid, or shorten the sample time")
        P = np.linalg.inv(np.eye(system.n_states) + A)
        A, B, C, D = 2 / system.dt * P @ (A - np.eye(len(A))), 2 / system.dt * P @ B, 2 * C @ P, D - C @ P @ B
    A, t = balance(A)
    B, C = B / t[:, None], C * t
    return _Matrices(A, B, C, D, system.dt)


def _crossings(
    matrices: _Matrices, X_w: np.ndarray, X_z: np.ndarray, G: np.ndarray, gamma: float, structure: Structure
) -> tuple[np.ndarray, Callable[[float], float]]:
    """Frequencies [rad/s] at which Phi is singular, and omega -> largest eigenvalue of Phi scaled so that -1 is M = 0."""
    D_w, D_z = np.zeros_like(X_w), np.zeros_like(X_z)
    for place in structure.places:
        for X, root, part in ((X_w, D_w, place.w), (X_z, D_z, place.z)):
            root[part, part] = np.linalg.cholesky(X[part, part]).conj().T
    inverse = np.linalg.inv(D_w)
    B, C = matrices.B @ inverse, D_z @ matrices.C / gamma
    D, G = D_z @ matrices.D @ inverse / gamma, inverse.conj().T @ G @ np.linalg.inv(D_z) / gamma
    n, m = B.shape

    def largest(omega: float) -> float:
        M = D_z @ matrices.at(omega) @ inverse / gamma
        return float(np.linalg.eigvalsh(M.conj().T @ M + 1j * (G @ M - M.conj().T @ G.conj().T) - np.eye(m))[-1])

    if n == 0:
        return np.zeros(0), largest
    rate = max(np.abs(np.linalg.eigvals(matrices.A)).max(), 1e-300)
    even = np.sqrt(max(float(np.linalg.norm(B)), 1e-300) / max(float(np.linalg.norm(C)), 1e-300))
    A, B, C = matrices.A / rate, B / even / np.sqrt(rate), C * even / np.sqrt(rate)
    Q, S = C.conj().T @ C, C.conj().T @ D - 1j * C.conj().T @ G.conj().T
    R = D.conj().T @ D + 1j * (G @ D - D.conj().T @ G.conj().T) - np.eye(m)
    left = np.block([[A, np.zeros((n, n)), B], [-Q, -A.conj().T, -S], [S.conj().T, B.conj().T, R]])
    right = np.zeros_like(left)
    right[: 2 * n, : 2 * n] = np.eye(2 * n)
    alpha, beta = sla.eig(left, right, right=False, homogeneous_eigvals=True)
    finite = np.abs(beta) > 1e-12 * np.abs(alpha)
    s = alpha[finite] / beta[finite]
    imaginary = np.abs(s.real) <= _AXIS * np.abs(s) + 1e-13 * np.linalg.norm(left)
    return np.sort(s[imaginary].imag) * rate, largest


@named_failure("the proof of mu < gamma")
def mu_certificate(
    system: Any,
    blocks: Sequence[Block],
    gamma: float,
    interval: tuple[float, float],
    *,
    max_pieces: int = 300,
) -> MuCertificate:
    """Prove mu(M(j omega)) < gamma for every omega of an interval, or name the part that stays open.

    system: a system from w to z, continuous or sampled. gamma [-]: the level. interval (from, to) [rad/s], 0 <= from < to;
    to may be infinity (for a sampled system it ends at the Nyquist frequency). max_pieces: how many frequencies are tried.

    Nothing is said about stability: robust stability needs a stable nominal system too. Raises InvalidInput when blocks and
    system do not fit, the interval is empty, or a pole lies on the imaginary axis within it.
    """
    structure = structure_of(blocks)
    matrices = _matrices(system)
    check_matrix(matrices.D, structure)
    gamma = check_positive(gamma, "gamma", "give the level mu must stay below")
    first, last = _checked_interval(matrices, interval)
    low, high = matrices.warp(first), matrices.warp(last)
    todo = [(low, high)]
    pieces: list[tuple[float, float, float]] = []
    open_ranges: list[tuple[float, float]] = []
    gap, open_frequency = 0.0, np.nan
    while todo:
        a, b = todo.pop()
        omega = _trial(a, b)
        covered, value = (a, a), np.nan
        if len(pieces) + len(open_ranges) < max_pieces:
            covered, value = _prove(matrices, structure, omega, gamma)
        if not (covered[0] < omega < covered[1] or (omega in (a, b) and covered[0] < covered[1])):
            if value < gamma and 0 < a * (1 + 1e-4) < b < np.inf:  # proved at omega and nowhere else: a numerical failure
                todo += [(a, omega), (omega, b)]
                pieces.append((matrices.unwarp(omega), matrices.unwarp(omega), matrices.unwarp(omega)))
                continue
            if np.isnan(value):
                value = float(upper_bound(matrices.at(omega)[None].astype(complex), structure).value[0])
            if np.isnan(open_frequency) or value - gamma > gap:
                gap, open_frequency = value - gamma, matrices.unwarp(omega)
            open_ranges.append((matrices.unwarp(a), matrices.unwarp(b)))
            continue
        start, end = max(a, covered[0]), min(b, covered[1])
        pieces.append((matrices.unwarp(start), matrices.unwarp(end), matrices.unwarp(omega)))
        if start > a:
            todo.append((a, start))
        if end < b:
            todo.append((end, b))
    ordered = np.array(sorted(pieces)).reshape(-1, 3)
    return MuCertificate(not open_ranges, gamma, (first, last), ordered, tuple(sorted(open_ranges)), gap, open_frequency)


def _checked_interval(matrices: _Matrices, interval: tuple[float, float]) -> tuple[float, float]:
    """The interval, cut at the Nyquist frequency, without poles on the stability limit."""
    first, last = (float(edge) for edge in interval)
    if matrices.dt is not None:
        last = min(last, np.pi / matrices.dt)
    if not 0 <= first < last:
        raise invalid("interval", interval, "0 <= from < to (and below Nyquist)", "give it in rad/s")
    p = np.linalg.eigvals(matrices.A) if len(matrices.A) else np.zeros(0, complex)
    low, high = matrices.warp(first), matrices.warp(last)
    scale = np.abs(p).max(initial=1e-300)
    bad = (np.abs(p.real) <= 1e-10 * np.abs(p) + 1e-14 * scale) & (np.abs(p.imag) >= low) & (np.abs(p.imag) <= high)
    if bad.any():
        where = matrices.unwarp(float(np.abs(p[bad][0].imag)))
        raise InvalidInput(f"the system has a pole on the stability limit at {where:g} rad/s; leave it out of the interval")
    return first, last


def _trial(a: float, b: float) -> float:
    """The frequency tried in [a, b]: an end that is 0 or infinite first, else the geometric middle."""
    if a == 0 or np.isinf(b):
        return 0.0 if a == 0 else np.inf
    return float(np.sqrt(a * b))


def _prove(matrices: _Matrices, structure: Structure, omega: float, gamma: float) -> tuple[tuple[float, float], float]:
    """The range around omega in which the scalings found there prove mu < gamma, and the bound at omega; empty on failure."""
    M = matrices.at(omega)[None].astype(complex)
    up = upper_bound(M, structure, level=np.array([gamma]), max_iterations=60)
    value = float(up.value[0])
    if not value < gamma:
        return (omega, omega), float(upper_bound(M, structure).value[0])
    try:
        crossings, largest = _crossings(matrices, up.X_w[0], up.X_z[0], up.G[0], gamma, structure)
    except ValueError:  # LAPACK's refusal of scalings that are singular to rounding, or scipy's of what overflowed: no proof
        return (omega, omega), value
    below, above = crossings[crossings <= omega], crossings[crossings > omega]
    start = float(below.max()) if len(below) else 0.0
    end = float(above.min()) if len(above) else np.inf
    if len(below) == 0 and omega >= 0 and start == 0.0:
        start = -1.0  # zero itself is inside
    inside = _probes(max(start, 0.0), end)
    if any(largest(point) >= 0 for point in (omega, *inside)):
        return (omega, omega), value
    # open ends: step inside by more than the eigenvalues' rounding error
    return (start * (1 + 1e-6) if start > 0 else start, end * (1 - 1e-6)), value


def _probes(start: float, end: float) -> np.ndarray:
    """Frequencies inside (start, end), for a second look."""
    low = start if start > 0 else min(1e-3 * end, 1.0)
    high = end if np.isfinite(end) else 1e3 * max(low, 1.0)
    return np.geomspace(low, high, _PROBES + 2)[1:-1] if high > low else np.zeros(0)
