"""The fast path for a periodic excitation: the same least squares on the lines of its spectrum.

Over M whole periods the mean period x(t) obeys z X = A X + B U + z d at the lines z = exp(2 pi i
k/P), d = (x(0) - x(M P))/M: no leakage, and no need for a steady state, since the n numbers d are
eliminated like an initial state (Pintelon & Schoukens 2012, ch. 2 and 6). Lines without excitation
are left out, and so are those above the frequency up to which nearly all is told. The scatter of
the periods about their mean gives the noise at each line without a model of it, hence the
covariance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.fft
import scipy.linalg as sla

from ambrose.core.checks import InvalidInput, check_positive, invalid
from ambrose.core.response import SystemDerivative
from ambrose.core.statespace import StateSpace
from ambrose.identification.output_error.normal_equations import Linearised, Task
from ambrose.identification.output_error.statistics import ResidualTest

_EXCITED = 1e-6  # of the strongest line: what is weaker counts as not excited
_SAME = 1e-9  # of the peak: excitations closer than this are the same
_INVISIBLE = 1e-12  # directions of the transient seen weaker than this (squared) are left at zero
_UNTOLD = 1e-2  # of what the lines tell may lie above those that are used
_SURE = 3.0  # normal quantile: 99.5 % for four signals


@dataclass(frozen=True, slots=True, eq=False)
class Lines:
    """A record at its excited lines z (l,): the distinct excitations U (r, l), the mean period's
    outputs Y (p, l) over their weights, and by how much the single periods deviate from it, scatter
    (M', p, l); the mean period's waves W (waves, l) that turn with the rotor, which the scatter
    does not hold.

    periods: M; length: P samples; task: the record.
    """

    z: np.ndarray
    U: np.ndarray
    Y: np.ndarray
    scatter: np.ndarray
    W: np.ndarray
    periods: int
    length: int
    task: Task

    @property
    def place(self) -> int:
        """Which of several models made the record."""
        return self.task.place

    @property
    def weight(self) -> float:
        """By which squares at the lines are those of all samples (Parseval)."""
        return 2.0 * self.periods / self.length

    def only(self, kept: slice) -> Lines:
        """Some of the lines only."""
        return replace(
            self,
            z=self.z[kept],
            U=self.U[:, kept],
            Y=self.Y[:, kept],
            scatter=self.scatter[:, :, kept],
            W=self.W[:, kept],
        )


@dataclass(frozen=True, slots=True, eq=False)
class LineFit:
    """The normal equations at the lines, the residual R (p, l) and J (l, p, q) they come from,
    transient and waves taken out: d (n,) and b (p, waves).
    """

    equations: Linearised
    R: np.ndarray
    J: np.ndarray
    d: np.ndarray
    b: np.ndarray


def period_of(task: Task, period: float | str, dt: float) -> int:
    """The period in samples: as given [s], or "auto": the shortest with which all excitations
    repeat exactly.

    Raises InvalidInput where the record has no whole period, or the excitation does not repeat with
    it.
    """
    k = task.samples
    if isinstance(period, str):
        if period != "auto":
            raise invalid(
                "period",
                repr(period),
                'a time in s, or "auto"',
                "leave it out for a fit in time domain",
            )
        shortest = shortest_period(task.e)
        if shortest is None:
            raise InvalidInput(
                'period "auto": the excitation does not repeat within the record; leave period '
                "out, or record whole periods"
            )
        return shortest
    samples = check_positive(period, "period", "give it in seconds") / dt
    P = round(samples)
    if abs(samples - P) > 1e-6 * samples or P < 4:
        raise invalid(
            "period",
            f"{samples:.6g} samples",
            "a whole number of samples, at least 4",
            "generate it by samples",
        )
    if k < P:
        raise invalid(
            "period",
            f"{P} samples",
            f"at most the record, {k} samples",
            "record at least one whole period",
        )
    wrong = next((i for i, wave in enumerate(task.e) if not _repeats(wave, P)), None)
    if wrong is not None:
        raise invalid(
            "period",
            f"{period:g} s",
            "that of the excitation",
            f'excitation {wrong + 1} does not repeat; try "auto"',
        )
    return P


def _repeats(wave: np.ndarray, P: int) -> bool:
    size = _SAME * float(np.abs(wave).max())
    return bool(np.abs(wave[P:] - wave[:-P]).max(initial=0.0) <= size) if len(wave) > P else True


def shortest_period(waves: Sequence[np.ndarray] | np.ndarray) -> int | None:
    """The shortest number of samples after which all waves (m, k) repeat exactly; None: they do
    not.
    """
    k = len(waves[0])
    lags = np.arange(4, k // 2 + 1)
    for wave in waves:
        size = _SAME * float(np.abs(wave).max())
        # a few samples rule out nearly all
        for t in np.unique(np.linspace(0, k - k // 2 - 1, 200).astype(int)):
            lags = lags[np.abs(wave[lags + t] - wave[t]) <= size]
    return next((int(P) for P in lags if all(_repeats(wave, int(P)) for wave in waves)), None)


def lines_of(task: Task, P: int) -> Lines:
    """The record at the excited lines of the period of P samples; what is left after whole periods
    is not used.
    """
    M = task.samples // P
    U = np.stack([scipy.fft.rfft(np.asarray(wave[:P])) for wave in task.e])
    size = np.abs(U).max(axis=0)

    # The constant is an offset's; the line at half the sample rate has no phase.
    size[0] = 0.0
    if P % 2 == 0:
        size[-1] = 0.0
    lines = np.flatnonzero(size > _EXCITED * size.max())
    if not len(lines):
        raise InvalidInput(
            "the excitation has no line inside the period; excite with more than a constant"
        )
    each = np.empty((M, len(task.y), len(lines)), complex)
    for i in range(len(task.y)):
        each[:, i] = scipy.fft.rfft(task.measured(i, 0, M * P).reshape(M, P), axis=1)[:, lines]
    Y = each.mean(axis=0)
    later = each[1:] if M > 2 else each  # the first may still hold the transient
    scatter = later - later.mean(axis=0)
    turning = np.zeros((M, 0, len(lines)), complex)
    if task.synchronous is not None:
        waves = [task.synchronous.waves(m * P, (m + 1) * P) for m in range(M)]
        turning = np.array([scipy.fft.rfft(wave, axis=1)[:, lines] for wave in waves])

        # What the waves themselves scatter from period to period is no noise: least squares on it.
        moved = turning[-len(later) :] - turning[-len(later) :].mean(axis=0)
        columns, rows = (
            _real(x.transpose(0, 2, 1).reshape(-1, x.shape[1])) for x in (moved, scatter)
        )
        amplitudes = np.linalg.lstsq(columns, rows)[0].T
        scatter = scatter - amplitudes @ moved
    return Lines(
        np.exp(2j * np.pi * lines / P), U[:, lines], Y, scatter, turning.mean(axis=0), M, P, task
    )


def line_equations(
    loop: StateSpace, directions: Sequence[SystemDerivative], lines: Lines
) -> LineFit:
    """r'r, J'J and J'r at the lines, scaled as in time domain; ``loop`` from all excitations to
    outputs over their weights.
    """
    A = loop.A
    B = loop.B @ lines.task.mix
    C = loop.C
    z = lines.z
    task = lines.task

    # L = C (z I - A)^-1,   X = (z I - A)^-1 B U,   R = Y - C X
    T, Z = sla.schur(A, output="complex")
    L, X = _rows(T, Z, C, z), _columns(T, Z, B @ lines.U, z)
    R = lines.Y - C @ X
    root = np.sqrt(lines.weight)
    N = np.zeros((2 * R.size, 0))
    d = np.zeros(len(A))
    b = np.zeros((len(C), len(lines.W)))
    if task.initial_state or b.size:
        N, best = _nuisances(L if task.initial_state else np.zeros_like(L), R, lines)
        d, b = best[: len(A)], best[len(A) :].reshape(b.shape)

        # the transient drives like z d:   R = Y - C (X + (z I - A)^-1 z d) - b W
        pushed = z * d[:, None]
        X = X + _columns(T, Z, pushed, z)
        R = lines.Y - C @ X - b @ lines.W
    J = np.zeros((len(z), len(C), 0), complex)
    if directions:
        # dY_j = L (dA_j X + dB_j U), only the rows of the state that some parameter moves
        rows = np.flatnonzero(
            np.any([d.A.any(axis=1) | d.B.any(axis=1) for d in directions], axis=0)
        )
        dA = np.stack([d.A[rows] for d in directions]).reshape(-1, len(A))
        dB = np.stack([(d.B @ task.mix)[rows] for d in directions]).reshape(-1, B.shape[1])
        Q = dA @ X.real + 1j * (dA @ X.imag) + dB @ lines.U
        J = L[:, :, rows] @ Q.reshape(len(directions), len(rows), -1).transpose(2, 1, 0)
    flat, r = root * _real(J.reshape(-1, J.shape[2])), root * _real(R.T.reshape(-1))
    if N.shape[1]:
        # (I - N N') J; r has lost N already
        inside = N.T @ flat
        flat = flat - N @ inside
        J = J - _complex(N @ inside / root).reshape(J.shape)
    return LineFit(Linearised(float(r @ r), flat.T @ flat, flat.T @ r), R, J, d, b)


def told_below(fits: Sequence[LineFit], all_lines: Sequence[Lines]) -> float:
    """The angle of z below which the lines hold nearly all that is told of every combination of the
    parameters.
    """
    H = np.sum([fit.equations.H for fit in fits], axis=0)

    # H = D K K' D, D = diag(size): rows of K^-1 D^-1 J' are orthonormal over all lines
    size = np.sqrt(np.diag(H))
    whitened = np.linalg.cholesky(H / size / size[:, None])
    worst = 0.0
    for fit, lines in zip(fits, all_lines, strict=True):
        parts = np.linalg.solve(whitened, (fit.J.reshape(-1, len(H)) / size).T).reshape(
            len(H), len(lines.z), -1
        )

        # power of each row up to a line; the line up to which all but _UNTOLD of it lies
        power = np.cumsum(np.sum(np.abs(parts) ** 2, axis=2), axis=1)
        enough = np.array([np.searchsorted(row, (1 - _UNTOLD) * row[-1]) for row in power]).max()
        worst = max(worst, float(np.angle(lines.z[min(int(enough) + 1, len(lines.z) - 1)])))
    return worst


def line_residual(loop: StateSpace, lines: Lines, fit: LineFit) -> np.ndarray:
    """The residual (p, l) at all lines, with the transient and the waves found at some."""
    # (z I - A) X = B U + z d
    driven = loop.B @ lines.task.mix @ lines.U + lines.z * fit.d[:, None]
    T, Z = sla.schur(loop.A, output="complex")
    return np.asarray(lines.Y - loop.C @ _columns(T, Z, driven, lines.z) - fit.b @ lines.W)


def _real(values: np.ndarray) -> np.ndarray:
    return np.concatenate([values.real, values.imag])


def _complex(values: np.ndarray) -> np.ndarray:
    half = len(values) // 2
    return np.asarray(values[:half] + 1j * values[half:])


def _rows(T: np.ndarray, Z: np.ndarray, C: np.ndarray, z: np.ndarray) -> np.ndarray:
    """C (z I - A)^-1 (l, p, n) for A = Z T Z' in complex Schur form, by substitution at all lines
    at once; no eigenvectors, which equal poles and pure delays do not have.
    """
    n = len(T)
    poles = 1.0 / (z - np.diag(T)[:, None])
    rows = C @ Z
    left = np.empty((n, len(C), len(z)), complex)

    # Y (z I - T) = C Z, column by column; then Y Z'
    for i in range(n):
        known = np.tensordot(T[:i, i], left[:i], 1) if i else 0.0
        left[i] = (rows[:, i, None] + known) * poles[i]
    L = left.reshape(n, -1).T @ Z.conj().T
    return L.reshape(len(C), len(z), n).transpose(1, 0, 2)


def _columns(T: np.ndarray, Z: np.ndarray, driven: np.ndarray, z: np.ndarray) -> np.ndarray:
    """(z I - A)^-1 driven (n, l) for driven (n, l), likewise."""
    X, poles = Z.conj().T @ driven, 1.0 / (z - np.diag(T)[:, None])

    # (z I - T) X = Z' driven, from the last row up
    for i in range(len(T) - 1, -1, -1):
        X[i] = (X[i] + T[i, i + 1 :] @ X[i + 1 :]) * poles[i]
    return np.asarray(Z @ X)


def _nuisances(L: np.ndarray, R: np.ndarray, lines: Lines) -> tuple[np.ndarray, np.ndarray]:
    """Orthonormal columns (2 p l, r) of all that transient and waves can explain, and the d (n,)
    and b (p waves,) that explain the residual best.
    """
    # dR = -(L z d + b W), rows (line, output), real parts above imaginary ones
    p = len(R)
    waves = np.einsum("wl,ij->lijw", lines.W, np.eye(p)).reshape(R.size, -1)
    N = np.hstack([_real((L * lines.z[:, None, None]).reshape(-1, L.shape[2])), _real(waves)])
    G = N.T @ N
    excited = np.diag(G) > 0
    size = np.sqrt(np.where(excited, np.diag(G), 1.0))

    # directions that the lines do not show stay at zero
    values, V = np.linalg.eigh(np.where(excited[:, None] & excited, G / size / size[:, None], 0.0))
    keep = values > _INVISIBLE * values[-1]
    basis = V[:, keep] / np.sqrt(values[keep]) / size[:, None]
    columns = N @ basis
    return columns, basis @ (columns.T @ _real(R.T.reshape(-1)))


def line_middle(fit: LineFit, lines: Lines) -> np.ndarray:
    """The covariance (q, q) of J'r: from the scatter of the periods, or from the residual where
    there is only one.
    """
    M = len(lines.scatter)
    if M >= 2:
        deviations, count = lines.scatter, lines.periods * (M - 1)
    else:
        deviations, count = fit.R[None], 1
    s = np.einsum("lpq,mpl->mlq", fit.J.conj(), deviations, optimize=True).reshape(
        -1, fit.J.shape[2]
    )

    # J'r = weight Re(s): half of E s s*; the mean of the periods has 1/periods of one's variance
    return lines.weight**2 / 2 * np.real(s.T @ s.conj()) / count


def line_scores(
    R: np.ndarray, lines: Lines, signals: Sequence[str], excitation: str
) -> tuple[list[float], list[ResidualTest]]:
    """Fit [%] of each signal's mean period at the excited lines, and whether the residual R (p, l)
    is more than the scatter of the periods.

    The correlation is that between residual and excitation which leaves so much in the mean of the
    periods; its limit that of noise alone. One period, or two of which the first may hold the
    transient, tell nothing: no test.
    """
    percent, tests = [], []
    M = len(lines.scatter)
    for i, signal in enumerate(signals):
        left, whole = float(np.sum(np.abs(R[i]) ** 2)), float(np.sum(np.abs(lines.Y[i]) ** 2))
        percent.append(100.0 * (1.0 - float(np.sqrt(left / whole))))
        if lines.periods < 3:
            continue
        # variance of one period, per line
        each = np.sum(np.abs(lines.scatter[:, i]) ** 2, axis=0) / (M - 1)
        noise = float(each.sum())
        if left <= 1e-14 * whole or noise == 0:
            tests.append(ResidualTest(signal, excitation, 0.0, 1.0, 0, True))
            continue
        # as many as would be equally noisy
        lines_alike = noise**2 / float(np.sum(each**2)) * (1 + 1 / (M - 1))
        spread = _SURE * np.sqrt((1 + 1 / (M - 1)) / lines_alike) * noise / lines.periods
        total = noise + left
        correlation = float(np.sqrt(max(left - noise / lines.periods, 0.0) / total))
        limit = float(np.sqrt(spread / total))
        tests.append(ResidualTest(signal, excitation, correlation, limit, 0, correlation <= limit))
    return percent, tests
