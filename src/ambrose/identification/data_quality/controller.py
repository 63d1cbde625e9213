"""Does the controller that is given explain its recorded output? u = K (r - y) sample by sample:
delay, size, lost samples.

Exact where the controller itself records: its unknown initial state and an offset are eliminated,
so a residual of some percent means another controller, another delay, another rate, or samples that
are missing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla

from ambrose.core.checks import AmbroseError
from ambrose.core.frequency import frequency_response
from ambrose.core.response import impulse_response, simulate
from ambrose.core.sampling import c2d, hold
from ambrose.core.statespace import StateSpace, poles, select
from ambrose.identification.findings import ERROR, WARNING, Code, Finding, signal_rows
from ambrose.identification.frf_spectral import Frf, local_response
from ambrose.identification.parameters import COVERAGE
from ambrose.law.loop import closed_loop
from ambrose.machine.description import AMPLIFIER_PARAMETERS, Tolerance
from ambrose.machine.machine import Machine
from ambrose.machine.parameters import parse_parameter
from ambrose.model.plant import Plant
from ambrose.model.uncertainty import channels, tolerances_around, uncertain
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


# Is the recorded excitation what acted? Its size and its time, told from what the model may have
# wrong.
#
# Of an excitation that is recorded at 1/(1 + delta) of its size and tau too late the responses T of
# the loop become
#
#     X = (1 + delta) exp(j w tau) T,    T = S_o G = T_0 + sum_p a_p dT/dp                      (1)
#
# with the parameters p of the model as far off as they may be: a_p has a normal prior, one standard
# deviation being half of p's half-width. delta and tau have none. They are told apart from gains
# and lags inside the loop because the loop answers: a change of G enters by S_o dG S_i, and with
# integral action S_i(0) = 0, so that the response to slow excitations is the same whatever the
# magnets do. u = -K y holds whatever e is, so that u adds nothing to y.


# relative half-widths of what a machine file states without a tolerance: within what it may be at
# all, as a file before its identification, and within what it is taken to be known; assumed
DOUBTS: Mapping[str, float] = {
    "force_per_current": 0.3,
    "negative_stiffness": 0.4,
    "amplifier": 0.3,
    "seal": 0.5,
}
KNOWN: Mapping[str, float] = {
    "force_per_current": 0.05,
    "negative_stiffness": 0.1,
    "amplifier": 0.2,
    "seal": 0.2,
}
_LEAST = 0.005  # of a response, by which converters and logger may be off whatever is told
_FITS = 0.1  # relative error of a model that tells: one that is further off has other faults
_CERTAIN = 1.5  # times a 95 % interval: 99.7 %, of several axes and two quantities at once
_FAR = 3.0  # times that of a size: a structure that the model lacks is in no interval
_SMALL, _GREAT = 0.03, 0.2  # of the size: no matter, and no number can be trusted
_ROUNDS = 8
_FEWEST, _TRIED = 20, 150  # lines that must tell, and that are asked for
_LOWEST = 10.0  # [rad/s] of them
_CLEAR = 4.0  # power of a line over that of its noise
_ANGLE = 1.0  # [rad] of a sample, up to which lines count
_LAGS = 6  # samples, the longest delay that is tried
_OVERLAP = 3.0  # neighbouring lines of a local response that err together, about
_PER_OCTAVE = 3  # errors of a model are alike over a third of an octave; assumed


@dataclass(frozen=True, slots=True, eq=False)
class ExcitationFit:
    """delta (r,) [-] and tau (r,) [s] of (1) for every distinct excitation with their 95 %
    half-widths; common: tau of all of them, if it is one, with its half-width; misfit: the relative
    error of the model that is left.
    """

    delta: np.ndarray
    delta_half: np.ndarray
    tau: np.ndarray
    tau_half: np.ndarray
    common: tuple[float, float]
    misfit: float


def excitation_findings(
    plant: Plant,
    law: StateSpace,
    records: Sequence[Record],
    doubts: Mapping[str, float] = DOUBTS,
    others: Sequence[Plant] = (),
) -> list[Finding]:
    """law: sampled, its delay included; records at the plant's operating point; doubts: relative
    half-widths by quantity, or "seal"; others: plants that it may be as well, with another number
    of bending modes.
    """
    fit, dt = fit_excitation(plant, law, records, doubts, others), records[0].dt
    if fit is None or fit.misfit > _FITS:
        return []
    sizes, times = [], []
    late = [*zip(fit.tau.tolist(), fit.tau_half.tolist(), strict=True)]
    if _off(*fit.common, dt) and max(abs(t - fit.common[0]) - _CERTAIN * h for t, h in late) <= 0:
        late = [fit.common] * len(late)  # each agrees with one delay of all, which is told better
    for r, axis in enumerate(plant.axes):
        names = f"e_{axis}"
        size = 1 / (1 + fit.delta[r])
        if abs(fit.delta[r]) > _SMALL + _FAR * fit.delta_half[r]:
            sizes.append((names, size, fit.delta_half[r] * size**2))
        if _off(*late[r], dt):
            times.append((names, late[r][0] / dt, late[r][1] / dt))
    remedy = (
        "check the scale and the time of the recorded e, and that it is added between controller "
        "and amplifier"
    )
    found = []
    if sizes:
        told = ", ".join(f"{n} is {s:.3g} ± {h:.2g} times what acted" for n, s, h in sizes)
        great = any(abs(1 - s) - h > _GREAT for _, s, h in sizes)
        what = "the recorded excitation is not of the size that the loop answered"
        severity = ERROR if great else WARNING
        found.append(Finding(Code.EXCITATION, severity, what, told, remedy))
    if times:
        told = ", ".join(
            f"{n} is {abs(t):.2g} ± {h:.1g} samples {'late' if t > 0 else 'early'}"
            for n, t, h in times
        )
        what = "the recorded excitation is not of the time at which the loop answered"
        found.append(Finding(Code.EXCITATION, WARNING, what, told, remedy))
    return found


def _off(tau: float, half: float, dt: float) -> bool:
    """Whether an excitation is late or early by a sample: recorders err by whole ones."""
    return abs(tau) > max(dt / 2, _CERTAIN * half)


def fit_excitation(
    plant: Plant,
    law: StateSpace,
    records: Sequence[Record],
    doubts: Mapping[str, float] = DOUBTS,
    others: Sequence[Plant] = (),
) -> ExcitationFit | None:
    """delta and tau of (1); None where an axis is not excited, or excited as another one, and where
    records are too short.
    """
    dt, axes = records[0].dt, plant.axes
    e, y = ([f"{kind}_{axis}" for axis in axes] for kind in "ey")
    if any(name not in record.signals for record in records for name in y):
        return None
    try:
        at = np.geomspace(_LOWEST, _ANGLE / dt, _TRIED)
        measured = local_response(records, e, y, at=at.tolist(), sparse=True)
        told = _lines(measured)
        omega, r = measured.omega[told], len(axes)
        if np.abs(poles(closed_loop(plant, law))).max() > 1:
            return None  # it shows no response
        loop = LoopModel.of(plant, law, omega, doubted(plant, doubts))
        base = loop.at(np.zeros(len(loop.blocks)))[0]

        # another plant is within a standard deviation, which is half a half-width
        further = [2 * (LoopModel.of(item, law, omega, ()).at(())[0] - base) for item in others]
        beside = np.reshape(further, (-1, *base.shape))
    except AmbroseError:  # which those explain that need the response or the model
        return None
    X, noise = measured.values[told], measured.variance[told]
    q = len(loop.blocks)
    p = q + len(beside)
    if len(told) < _FEWEST:
        return None

    # every line counts by its own size: what a model has wrong is a share of the response
    size = np.sqrt(np.mean(np.abs(X) ** 2, axis=1, keepdims=True))
    delta, tau = np.zeros(r), np.full(r, _first_delay(omega, X, base, dt))
    a = np.zeros(p)
    covariance, misfit = np.eye(2 * r + p), _LEAST
    prior = np.r_[np.zeros(2 * r), np.full(p, 4.0)]  # a_p: 1/2 of a half-width
    for _ in range(_ROUNDS):
        # left = X - (1 + delta) exp(j w tau) T, and its slopes
        T, slopes = loop.at(a[:q])
        T = T + np.einsum("p,pwar->war", a[q:], beside)
        slopes = np.concatenate([slopes, beside])
        turn = np.exp(1j * omega[:, None] * tau)[:, None, :]
        whole = (1 + delta) * turn * T
        left = X - whole
        columns = np.zeros((2 * r + p, *X.shape), complex)
        for k in range(r):
            columns[k, :, :, k] = (turn * T)[:, :, k]
            columns[r + k, :, :, k] = 1j * omega[:, None] * whole[:, :, k]
        for k, slope in enumerate(slopes):
            columns[2 * r + k] = (1 + delta) * turn * slope
        scale = np.r_[np.ones(r), np.full(r, 1 / omega.max()), np.ones(p)]  # unknowns of order one
        misfit = _misfit(left, noise, size)
        weight = 1 / np.sqrt(noise + (misfit * size) ** 2)
        J = (columns * scale[:, None, None, None] * weight).reshape(len(scale), -1)
        b = (left * weight).ravel()
        J, b = np.hstack([J.real, J.imag]), np.hstack([b.real, b.imag])

        # sum |left|^2 / (variance / 2 per part) over how many lines err together + a^2 / (1/4)
        together = _together(omega, misfit)
        normal = 2 * J @ J.T / together + np.diag(prior)
        right = 2 * J @ b / together - prior * np.r_[np.zeros(2 * r), a]
        covariance = np.linalg.pinv(normal)
        step = scale * (covariance @ right)
        delta, tau = delta + step[:r], tau + step[r : 2 * r]
        a = a + step[2 * r :]
        delta, a = np.clip(delta, -0.95, 20.0), np.clip(a, -2.0, 2.0)
        if not np.isfinite(step).all():
            return None
    covariance = scale[:, None] * covariance * scale
    half = COVERAGE * np.sqrt(np.diag(covariance))

    # one tau by the weights of its covariance C: 1' C^-1 tau over 1' C^-1 1
    weights = np.linalg.pinv(covariance[r : 2 * r, r : 2 * r]).sum(axis=1)
    common = float(weights @ tau / weights.sum()), float(COVERAGE / np.sqrt(weights.sum()))
    return ExcitationFit(delta, half[:r], tau, half[r : 2 * r], common, misfit)


def _lines(measured: Frf) -> np.ndarray:
    """The lines whose response stands out of its noise; the best ones where few do, whose interval
    is then wide.
    """
    noise = measured.variance.sum(axis=(1, 2))
    ratio = np.sum(np.abs(measured.values) ** 2, axis=(1, 2)) / np.maximum(noise, 1e-300)
    least = min(_CLEAR, float(np.sort(ratio)[::-1][:_FEWEST].min(initial=np.inf)))
    return np.flatnonzero(ratio >= least)


@dataclass(frozen=True, slots=True, eq=False)
class LoopModel:
    """The loop at frequencies (w,), its parameters open: P (w, z + a, w + a) of z, y from w, u;
    held (w, 1, 1); G (w, a, a) sampled, K (w, a, a); blocks: the signals of each parameter, w and
    z alike.
    """

    P: np.ndarray
    held: np.ndarray
    G: np.ndarray
    K: np.ndarray
    blocks: tuple[slice, ...]

    @staticmethod
    def of(
        plant: Plant, law: StateSpace, omega: np.ndarray, moved: Sequence[Tolerance]
    ) -> LoopModel:
        """Raises InvalidInput."""
        u, y = list(plant.named("u")), list(plant.named("y"))
        dt = law.dt or 0.0
        G = frequency_response(c2d(select(plant.system, u, y), dt), omega).values
        K = frequency_response(law, omega).values
        held = hold(omega, dt)[:, None, None]
        if not moved:
            return LoopModel(G, held, G, K, ())
        general = uncertain(plant, moved)
        w, z = general.w[: general.n_w_blocks], general.z[: general.n_z_blocks]
        P = frequency_response(select(general.system, [*w, *u], [*z, *y]), omega).values
        ends = np.cumsum([0, *(block.n_w for block in general.blocks)]).tolist()
        return LoopModel(P, held, G, K, tuple(map(slice, ends[:-1], ends[1:])))

    def at(self, a: np.ndarray | Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
        """T (w, a, a), y per e, with each parameter a_p half-widths off, and its slopes (p, w, a,
        a).
        """
        n, unit = len(self.P[0]) - len(self.G[0]), np.eye(len(self.G[0]))
        delta = np.zeros(n)
        for block, value in zip(self.blocks, a, strict=True):
            delta[block] = value
        P_zw, P_zu = self.P[:, :n, :n], self.P[:, :n, n:]
        P_yw = self.P[:, n:, :n]

        # G = G_0 + P_yw D (I - P_zw D)^-1 P_zu with D the parameters, each u held over a sample
        inner = np.linalg.inv(np.eye(n) - P_zw * delta)
        G = self.G + (P_yw * delta) @ inner @ P_zu * self.held

        # T = S_o G = (I + G K)^-1 G, and dT = S_o dG S_i with S_i = I - K T
        S = np.linalg.inv(unit + G @ self.K)
        T = S @ G

        # dG = P_yw (I - D P_zw)^-1 E (I - P_zw D)^-1 P_zu, E the parameter's part of I
        left = P_yw @ np.linalg.inv(np.eye(n) - delta[:, None] * P_zw)
        right = inner @ P_zu * self.held
        S_i = unit - self.K @ T
        slopes = [S @ left[:, :, b] @ right[:, b] @ S_i for b in self.blocks]
        return T, np.reshape(slopes, (-1, *T.shape))


def _first_delay(omega: np.ndarray, X: np.ndarray, model: np.ndarray, dt: float) -> float:
    """The whole number of samples [s] by which the responses are turned, about."""
    size = np.mean(np.abs(X) ** 2, axis=(1, 2))
    cross = np.sum(X * model.conj(), axis=(1, 2)) / size
    lags = np.arange(-_LAGS, _LAGS + 1) * dt
    return float(lags[np.argmax((cross @ np.exp(-1j * omega[:, None] * lags)).real)])


def doubted(plant: Plant, doubts: Mapping[str, float] = DOUBTS) -> list[Tolerance]:
    """The machine's tolerances around the point, and what it states without one."""
    machine = plant.machine
    found = list(tolerances_around(plant))
    stated = [Tolerance(path, relative=doubts[path.split(".")[2]]) for path in machine.magnet_paths]
    stated += [
        Tolerance(f"amplifier.{name}", relative=doubts["amplifier"])
        for name in AMPLIFIER_PARAMETERS[machine.amplifier.order]
    ]
    stated += _of_seals(machine, doubts["seal"])
    for item in stated:
        same = [
            t
            for t in found
            if parse_parameter(t.parameter).overlaps(parse_parameter(item.parameter))
        ]
        if any(t.relative is None or t.relative >= (item.relative or 0.0) for t in same):
            continue
        try:
            nominal = any(channel.nominal for channel in channels(plant, item.parameter))
        except AmbroseError:  # a seal of its own kind has no such coefficient
            continue
        if nominal:
            found = [t for t in found if t not in same] + [item]
    return found


def _of_seals(machine: Machine, width: float) -> list[Tolerance]:
    return [
        Tolerance(f"seal.{item.name}.{quantity}", relative=width)
        for item in machine.seals
        for quantity in ("K", "k", "C", "c")
    ]


def _misfit(left: np.ndarray, noise: np.ndarray, size: np.ndarray) -> float:
    """The relative error of the model with which noise explains what is left: the mean of |left|^2
    over its variance is one (Paule & Mandel 1982).
    """
    power, share = np.abs(left) ** 2, size**2 + 0 * noise

    # a mean of so many squares is above one by chance: three standard deviations are no misfit
    chance = 1 + 3 / np.sqrt(power.size / _OVERLAP)

    def ratio(error: float) -> float:
        return float(np.mean(power / np.maximum(noise + error**2 * share, 1e-300)))

    low, high = _LEAST, 10.0
    if ratio(low) <= chance:
        return low
    for _ in range(50):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if ratio(middle) > chance else (low, middle)
    return float(high)


def _together(omega: np.ndarray, misfit: float) -> float:
    """How many lines err together."""
    if misfit <= _LEAST:
        return _OVERLAP
    octaves = float(np.log2(omega[-1] / omega[0]))
    return max(_OVERLAP, len(omega) / max(_PER_OCTAVE * octaves, 1.0))
