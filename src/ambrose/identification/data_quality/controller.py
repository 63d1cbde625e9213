"""Does the controller that is given explain its recorded output? u = K (r - y) sample by sample:
delay, size, lost samples.

Exact where the controller itself records: its unknown initial state and an offset are eliminated,
so a residual of some percent means another controller, another delay, another rate, or samples that
are missing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla

from ambrose.core.response import impulse_response, simulate
from ambrose.core.statespace import StateSpace, poles
from ambrose.identification.excitation import signal_rows
from ambrose.machine.machine import Machine
from ambrose.record.record import Record

LAGS = 6  # samples, the longest delay that is tried
_BLOCK = 8000  # samples that are compared at once, with an initial state of their own
_REMEMBERED = 200  # samples of the law's impulse response
_MARGINAL = 1 + 1e-9  # modulus of a sampled pole: 1 of an integrator, and its rounding
_AT_LIMIT = 0.999  # of the limit: a converter may stop a step short of it
_FOLLOWS = 0.01  # residual of u below which its delay counts as seen
# samples of a piece whose spectrum is taken; and standard deviations of what chance makes coherent
_PIECE, _SURE = 1024, 4.0
# over the median jump of the residual, and over the rms of the signal
_BURST, _VISIBLE = 60.0, 3e-4


@dataclass(frozen=True, slots=True, eq=False)
class ControllerMatch:
    """How well u_<axis> follows the controller, per axis.

    residual (a, lags) [-]: rms of what is left over rms of the signal, when the controller's output
    acts 0, 1, ... samples later; lag (a,): where it is least; gain (a,): recorded over computed
    there, and scaled (a,) the residual with that gain. left (a, k): what is left of the record's u
    at the best delay, zero where u is at its limit. jumps: samples at which the residual of an axis
    jumps although it is quiet around: (axis number, sample).
    """

    axes: tuple[str, ...]
    residual: np.ndarray
    lag: np.ndarray
    gain: np.ndarray
    scaled: np.ndarray
    left: np.ndarray
    jumps: tuple[tuple[int, int], ...]

    @property
    def least(self) -> np.ndarray:
        """The residual (a,) at every axis' best lag."""
        return self.residual[np.arange(len(self.axes)), self.lag]


def controller_match(machine: Machine, record: Record, law: StateSpace) -> ControllerMatch | None:
    """The sampled ``law`` (signals err_<axis>, u_<axis>, no computing delay) against u_ and y_ of
    the record; else None.

    Samples of u at the bearing's largest current do not count. An unstable law is compared through
    its innovation, with an observer in place of the simulation.
    """
    axes = machine.axes
    total = record.values.shape[1]
    if (
        any(f"{kind}_{axis}" not in record.signals for kind in "yu" for axis in axes)
        or total <= 4 * LAGS + law.n_states
    ):
        return None
    systems = _innovation(law)
    a, first = len(axes), _samples(machine, record, 0, min(total, _BLOCK))
    if not np.ptp(first.u, axis=1).all():
        return None
    free = _free(systems[2], first.u.shape[1] - LAGS)
    trials = [_compare(systems, free, first, lag) for lag in range(LAGS + 1)]
    residual = np.array([[trial.residual[i] for trial in trials] for i in range(a)])
    best = residual.argmin(axis=1)
    gain = np.array([trials[lag].gain[i] for i, lag in enumerate(best)])
    scaled = np.array([trials[lag].scaled[i] for i, lag in enumerate(best)])
    jumps: list[tuple[int, int]] = []
    left = np.zeros((a, total))
    for begin in range(0, total - 2 * LAGS, _BLOCK - LAGS):
        part = first if begin == 0 else _samples(machine, record, begin, min(total, begin + _BLOCK))
        if part.u.shape[1] < _BLOCK // 4 and begin:
            continue
        for lag in sorted(set(best.tolist())):
            comparison = trials[lag] if begin == 0 else _compare(systems, free, part, lag)
            for i in np.flatnonzero(best == lag):
                left[i, begin + lag : begin + lag + comparison.left.shape[1]] = comparison.left[i]
                jumps += [
                    (int(i), begin + lag + at) for at in _jumps(comparison.left[i], part.u[i])
                ]
    jumps = jumps if len(jumps) <= a * max(20, total // 500) else []
    return ControllerMatch(axes, residual, best, gain, scaled, left, tuple(jumps))


def seen_delay(match: ControllerMatch | None) -> int | None:
    """After how many samples u follows the controller, the same on every axis and clearly so; None
    where that is not seen.
    """
    if match is None or len(set(match.lag.tolist())) > 1 or match.least.max() > _FOLLOWS:
        return None
    return int(match.lag[0])


@dataclass(frozen=True, slots=True, eq=False)
class _Samples:
    """u (a, k), errors (a, k), and where u is within its limit (a, k) bool."""

    u: np.ndarray
    errors: np.ndarray
    inside: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class _Comparison:
    """residual (a,), gain (a,), residual with that gain (a,), and what is left (a, k), zero where u
    is at its limit.
    """

    residual: np.ndarray
    gain: np.ndarray
    scaled: np.ndarray
    left: np.ndarray


def _samples(machine: Machine, record: Record, begin: int, end: int) -> _Samples:
    def stacked(kind: str) -> np.ndarray:
        return np.stack(
            [
                row[begin:end]
                for row in signal_rows(record, [f"{kind}_{axis}" for axis in machine.axes])
            ]
        )

    limits = [np.inf if b.max_current is None else b.max_current for b in machine.axis_bearings]
    u = stacked("u")
    return _Samples(
        u, stacked("r") - stacked("y"), np.abs(u) < _AT_LIMIT * np.array(limits)[:, None]
    )


def _compare(
    systems: tuple[StateSpace, StateSpace, StateSpace], free: np.ndarray, part: _Samples, lag: int
) -> _Comparison:
    """The controller's output ``lag`` samples later against u, without what initial state and
    offset explain.
    """
    filtered, predicted, _ = systems
    a, k = len(part.u), part.u.shape[1] - LAGS
    given = simulate(filtered, part.u[:, lag : lag + k])
    computed = simulate(predicted, part.errors[:, :k])
    residual = np.ones(a)
    gain = np.ones(a)
    scaled = np.ones(a)
    left = np.zeros((a, k))
    for i in range(a):
        used = part.inside[i, lag : lag + k]
        rest = _without(
            np.column_stack([free[i, :k], np.ones(k)])[used],
            np.stack([given[i], computed[i]])[:, used],
        )
        size, energy = float(np.linalg.norm(rest[0])), float(rest[1] @ rest[1])
        left[i, used] = rest[0] - rest[1]
        residual[i] = float(np.linalg.norm(left[i])) / size if size > 0 else 1.0
        gain[i] = float(rest[0] @ rest[1]) / energy if energy > 0 else 0.0
        scaled[i] = float(np.linalg.norm(rest[0] - gain[i] * rest[1])) / size if size > 0 else 1.0
    return _Comparison(residual, gain, scaled, left)


def _innovation(law: StateSpace) -> tuple[StateSpace, StateSpace, StateSpace]:
    """Systems M (from u) and N (from errors) with M u = N err, and one whose free response is their
    common one.

    A stable law needs no observer: M = I, N = K. Otherwise K = M^-1 N with the observer gain of a
    steady Kalman filter.
    """
    A = law.A
    B = law.B
    C = law.C
    D = law.D
    a = len(C)
    if law.n_states == 0 or float(np.abs(poles(law)).max()) <= _MARGINAL:
        through = StateSpace(
            np.zeros((0, 0)), np.zeros((0, a)), np.zeros((a, 0)), np.eye(a), None, None, law.dt
        )
        return through, StateSpace(A, B, C, D, None, None, law.dt), law
    P = sla.solve_discrete_are(
        A.T, C.T, B @ B.T + 1e-9 * np.eye(len(A)) * np.trace(B @ B.T), np.eye(a)
    )
    L = A @ P @ C.T @ np.linalg.inv(np.eye(a) + C @ P @ C.T)
    stable = A - L @ C
    M = StateSpace(stable, L, -C, np.eye(a), None, None, law.dt)
    N = StateSpace(stable, B - L @ D, C, D, None, None, law.dt)
    return M, N, N


def _free(system: StateSpace, k: int) -> np.ndarray:
    """The free responses (a, k, n) of a system from each of its states."""
    n, a = system.n_states, len(system.C)
    quiet = np.zeros((system.B.shape[1], k))
    return (
        np.stack([simulate(system, quiet, x0=row) for row in np.eye(n)], axis=2)
        if n
        else np.zeros((a, k, 0))
    )


def _without(basis: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """The rows (r, k) without what the columns of the basis (k, c) explain."""
    size = np.linalg.norm(basis, axis=0)
    if not len(basis):
        return rows
    Q, R, _ = sla.qr(basis[:, size > 0] / size[size > 0], mode="economic", pivoting=True)
    Q = Q[:, np.abs(np.diag(R)) > 1e-10 * abs(R[0, 0])]
    return rows - (rows @ Q) @ Q.T


def _jumps(left: np.ndarray, signal: np.ndarray) -> list[int]:
    """Where the residual jumps: first samples of the bursts, at most ten."""
    step = np.abs(np.diff(left))
    quiet = 1.4826 * float(np.median(step))
    large = np.flatnonzero(step > max(_BURST * quiet, _VISIBLE * float(np.std(signal)))) + 1
    large = large[large > 2 * LAGS]  # a record may begin with anything
    return [int(at) for j, at in enumerate(large) if j == 0 or at - large[j - 1] > 50]


def of_another_law(record: Record, match: ControllerMatch) -> np.ndarray:
    """The part of the residual that another law makes (a,), over the rms of u; 0 where it may be
    chance or the record is short.

    With u = -K' y of another law the residual is (K - K') y: all of it follows y, and all of it u.
    Noise of the recorder in y is in the residual and in y, and not in u; that in u not in y; steps
    of converters are in neither. Of such parts the two coherences add up to one at most: counted at
    every line is what they are beyond it.
    """
    a, k = match.left.shape
    starts = np.arange(0, k - _PIECE + 1, _PIECE // 2)
    pieces = len(starts)
    if pieces < 4 * a:
        return np.zeros(a)
    window = np.hanning(_PIECE)

    def spectra(rows: np.ndarray) -> np.ndarray:
        # (lines, pieces, rows), each piece without its mean
        cut = np.array([rows[:, begin : begin + _PIECE] for begin in starts])
        cut = (cut - cut.mean(axis=2, keepdims=True)) * window
        return np.fft.rfft(cut, axis=2)[:, :, 1:].transpose(2, 0, 1)

    rest, u = spectra(match.left), spectra(signal_stack(record, "u", match.axes))
    power = np.mean(np.abs(rest) ** 2, axis=1)
    shared = -power
    for through in (u, spectra(signal_stack(record, "y", match.axes))):
        # multiple coherence: the projection on a signals, less what chance makes of n pieces,
        # g = 1 - (1 - g_n) n / (n - a)
        Q = np.linalg.qr(through)[0]
        told = np.mean(np.abs(Q @ (Q.conj().transpose(0, 2, 1) @ rest)) ** 2, axis=1)
        shared = shared + power - (power - told) * pieces / (pieces - a)
    chance = np.sqrt(np.sum(power**2, axis=0) * 4 * a) / pieces * _SURE
    left = np.maximum(shared.sum(axis=0) - chance, 0.0)
    size = np.mean(np.abs(u) ** 2, axis=1).sum(axis=0)
    return np.asarray(np.sqrt(left / np.maximum(size, 1e-300)))


def signal_stack(record: Record, kind: str, axes: Sequence[str]) -> np.ndarray:
    """The rows (a, k) of one kind of signal."""
    return np.stack([record[f"{kind}_{axis}"] for axis in axes])


def resolution_residual(machine: Machine, record: Record, law: StateSpace) -> np.ndarray:
    """What coarse steps of the recorded y make of the residual (a,), over the rms of u:
    steps/sqrt(12) through the law.
    """
    steps = []
    for axis in machine.axes:
        change = np.abs(np.diff(record[f"y_{axis}"]))
        moved = change[change > 0]
        stepped = len(moved) < 0.98 * len(change) or len(
            np.unique(np.round(moved / moved.min(), 3))
        ) < 0.1 * len(moved)
        steps.append(float(moved.min()) if len(moved) and stepped else 0.0)
    energy = np.sum(impulse_response(law, _REMEMBERED) ** 2, axis=2)
    made = np.sqrt(energy @ (np.array(steps) ** 2 / 12))
    return made / np.array(
        [max(float(np.std(record[f"u_{axis}"])), 1e-300) for axis in machine.axes]
    )
