"""What a least-squares fit is worth: covariance under coloured noise, correlations, what residuals
hold, warnings, verdict.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.fft

from ambrose.core.checks import InvalidInput, NumericalFailure
from ambrose.core.statespace import StateSpace
from ambrose.identification.findings import WARNING, Code, Finding
from ambrose.identification.output_error.normal_equations import (
    Minimum,
    RecordSolution,
    Task,
    residual_pieces,
)
from ambrose.machine.parameters import TIMING

# Sums over products of signals some samples apart, from records that are only seen piece by piece.
#
# Overlap-save: each piece is transformed together with the ``span`` samples before it, so that
# every pair of samples at most ``span`` apart meets exactly once and the memory does not grow with
# the record. What output_error/statistics.py does on whole records is the oracle in the tests.


_BAND = 512  # frequencies


@dataclass(frozen=True, slots=True, eq=False)
class LaggedSums:
    """values (pairs, span + 1): sum over t of a(t) b(t - lag) for each pair (a, b) of the c
    signals; total (c,) their sums, squares (c,) those of their squares; head, tail (c, span): the
    first samples and the last; samples: how many there were.
    """

    pairs: tuple[tuple[int, int], ...]
    values: np.ndarray
    total: np.ndarray
    squares: np.ndarray
    head: np.ndarray
    tail: np.ndarray
    samples: int

    def about_the_means(self, a: int, b: int) -> np.ndarray:
        """The sums (span + 1,) for signals a and b less their means."""
        lag, k = np.arange(self.values.shape[1]), self.samples
        mean_a, mean_b = self.total[a] / k, self.total[b] / k
        # of a: the samples that have no partner
        early = np.concatenate([[0.0], np.cumsum(self.head[a])])
        late = np.concatenate([[0.0], np.cumsum(self.tail[b][::-1])])
        sums = self.values[self.pairs.index((a, b))]

        # sum (a - ma)(b' - mb) = sum a b' - mb sum a - ma sum b' + (k - lag) ma mb
        crossed = mean_b * (self.total[a] - early[lag]) + mean_a * (self.total[b] - late[lag])
        return np.asarray(sums - crossed + (k - lag) * mean_a * mean_b)


def lagged_sums(
    pieces: Iterable[np.ndarray], pairs: Sequence[tuple[int, int]], span: int
) -> LaggedSums:
    """The sums over pieces (c, any length) of c signals for lags 0 to ``span``."""
    size = 0
    spectra = np.zeros(0)
    joined = np.zeros((0, 0))
    first, second = [a for a, _ in pairs], [b for _, b in pairs]
    total = squares = np.zeros(0)
    head, samples = np.zeros((0, 0)), 0
    values = np.zeros((len(pairs), span + 1))
    for piece in pieces:
        c, length = piece.shape
        if not samples:
            total = np.zeros(c)
            squares = np.zeros(c)
            joined = np.zeros((c, span))
            head = np.zeros((c, 0))
        needed = scipy.fft.next_fast_len(span + length, real=True)
        if needed > size:  # the first piece, unless a longer one follows
            if size:
                values += scipy.fft.irfft(spectra, size, axis=1)[:, : span + 1]
            size, spectra = needed, np.zeros((len(pairs), needed // 2 + 1), complex)

        # new samples against themselves and the ``span`` before: every pair once
        whole = np.concatenate([joined, piece], axis=1)
        new = whole.copy()
        new[:, :span] = 0.0
        N, W = scipy.fft.rfft(new, size, axis=1), scipy.fft.rfft(whole, size, axis=1)
        for row, (a, b) in enumerate(zip(first, second, strict=True)):
            spectra[row] += N[a] * W[b].conj()
        total += piece.sum(axis=1)
        squares += np.einsum("ct,ct->c", piece, piece)
        if head.shape[1] < span:
            head = np.concatenate([head, piece[:, : span - head.shape[1]]], axis=1)
        joined = whole[:, whole.shape[1] - span :]
        samples += length
    values += scipy.fft.irfft(spectra, size, axis=1)[:, : span + 1]
    return LaggedSums(tuple(pairs), values, total, squares, head, joined, samples)


def coloured_products(pieces: Iterable[np.ndarray], covariance: np.ndarray) -> np.ndarray:
    """sum over t and s of J_t' Gamma(t - s) J_s (q, q) for pieces of J (q, p, any length).

    covariance (p, p, span + 1): Gamma_ij at the lags 0 to span; Gamma_ij(-l) = Gamma_ji(l), and
    zero beyond. All pieces but the last are equally long.
    """
    p, _, longest = covariance.shape
    span = longest - 1
    size = 0
    q = 0
    kernel = np.zeros(0)
    result = np.zeros((0, 0))
    whole = np.zeros((0, p, 0))
    half = covariance.copy()
    half[:, :, 0] /= 2  # one side of the sum, of which the other is the transpose
    for piece in pieces:
        length = piece.shape[2]
        if not size:
            q, size = len(piece), scipy.fft.next_fast_len(span + length, real=True)
            kernel = scipy.fft.rfft(half, size, axis=2)
            result = np.zeros((q, q))
            whole = np.zeros((q, p, size))
            # the frequencies that stand for their negatives too
            kernel[:, :, 1 : (size + 1) // 2] *= 2
            # the piece begins ``span`` samples later
            kernel *= np.exp(2j * np.pi * span / size * np.arange(kernel.shape[2]))

        # mixed(t) = sum over l = 0..span of Gamma(l) J(t - l), result += sum over t of J_t' mixed_t
        whole[:, :, span : span + length] = piece
        whole[:, :, span + length :] = 0.0
        W, N = scipy.fft.rfft(whole, axis=2), scipy.fft.rfft(piece, size, axis=2)
        # few enough frequencies at a time to stay in the cache
        for start in range(0, W.shape[2], _BAND):
            band = slice(start, start + _BAND)
            part = np.ascontiguousarray(W[:, :, band])
            mixed = np.zeros_like(part)
            for i in range(p):
                for j in range(p):
                    mixed[:, i] += kernel[i, j, band] * part[:, j]
            result += np.real(N[:, :, band].conj().reshape(q, -1) @ mixed.reshape(q, -1).T) / size

        # the last ``span`` samples go before the next piece
        whole[:, :, :span] = whole[:, :, length : span + length].copy()
    return result + result.T


# What the residual of one record says: fit per signal, autocovariance, and whether it still follows
# an excitation.


_LAGS = 100  # samples over which the residual is compared with the excitation
_PIECE = 2**15  # samples from which it is taken how a signal follows the excitations
_EXACT = 1e-7  # residual over signal below which a record is noise-free and no test says anything


@dataclass(frozen=True, slots=True, eq=False)
class ResidualScores:
    """fit (p,) [%], NRMSE; covariance (p, p, span + 1) of the residuals at the lags 0 to span;
    tests: one per pair of signal and distinct excitation.
    """

    fit: np.ndarray
    covariance: np.ndarray
    tests: tuple[ResidualTest, ...]


def residual_scores(
    loop: StateSpace,
    task: Task,
    solution: RecordSolution,
    excitations: Sequence[str],
    signals: Sequence[str],
    count: int,
) -> ResidualScores:
    """The scores of a record at the theta of ``loop``, in one pass over its pieces.

    excitations: what to call the task's distinct signals; signals: the fitted ones; count: of all
    tests of the run.
    """
    p, k = len(signals), task.samples
    remembered = memory(k)
    lags = min(_LAGS, k - 1)
    span = max(remembered, lags)

    # signals: the residuals (p), then the distinct excitations
    auto_pairs = [(i, i) for i in range(p, p + len(task.e))]
    pairs = [(i, j) for i in range(p) for j in range(p)]
    crossed = [(i, e) for i in range(p) for e, _ in auto_pairs]
    sums = lagged_sums(residual_pieces(loop, task, solution), [*pairs, *crossed, *auto_pairs], span)
    covariance = tapered(sums.values[: p * p, : remembered + 1], k).reshape(p, p, remembered + 1)
    spread = np.array([_spread(task, i) for i in range(p)])
    with np.errstate(divide="ignore", invalid="ignore"):
        fit = 100.0 * (1.0 - np.sqrt(sums.squares[:p] / spread))
    followed = _followed(task, solution, lags)
    tests = []
    for i, signal in enumerate(signals):
        own_r = sums.about_the_means(i, i)
        size = float(np.sum(task.measured(i, 0, k) ** 2))
        quiet = bool(own_r[0] <= _EXACT**2 * size)
        for e, name in enumerate(excitations, p):
            products = sums.about_the_means(i, e)[: lags + 1], own_r[: remembered + 1]
            own_e = sums.about_the_means(e, e)[: remembered + 1]
            tests.append(
                input_test(
                    *products, own_e, k, signal, name, count, quiet, float(followed[i, e - p])
                )
            )
    return ResidualScores(fit, covariance, tuple(tests))


def _spread(task: Task, i: int) -> float:
    """The sum of squares of a measured signal about its mean."""
    y = task.measured(i, 0, task.samples)
    return float(np.sum((y - y.mean()) ** 2))


def _followed(task: Task, solution: RecordSolution, lags: int) -> np.ndarray:
    """The largest sum (p, r) over the record of a signal, less what turns with the rotor, and an
    excitation before it.
    """
    n = min(task.samples, _PIECE)
    waves = task.waves_at(0, n)
    y = np.array([task.measured(i, 0, n) - solution.b[i] @ waves for i in range(len(task.y))])
    size, e = scipy.fft.next_fast_len(n + lags, real=True), np.array([wave[:n] for wave in task.e])
    Y, E = (
        scipy.fft.rfft(rows - rows.mean(axis=1, keepdims=True), size, axis=1) for rows in (y, e)
    )

    # y(t) e(t - lag) over the first piece, scaled to the whole record
    sums = scipy.fft.irfft(Y[:, None] * E[None].conj(), size, axis=2)[:, :, : lags + 1]
    return np.asarray(np.abs(sums).max(axis=2) * task.samples / n)


# of the strongest parameter's effect; and the least eigenvalue of J'J with a unit diagonal
_VISIBLE = 1e-12
_CONFIDENCE = 0.99  # of all lags of a signal together (Bonferroni)
# standard deviation over value, and correlation, that are worth a warning
_UNSURE, _ALIKE = 0.3, 0.98
# standard deviation over value below which parameters are told apart all the same; assumed, as
# suspects.py's
_TOLD = 0.02
_BLIND = 0.1  # share of the excited response below which one that is missing must show; assumed
_ROUNDING = 1e-11  # of the largest eigenvalue of a covariance with H's diagonal one
_LONGEST = 4096  # samples of the noise's memory that are looked at


@dataclass(frozen=True, slots=True)
class ResidualTest:
    """Whether the residual of ``signal`` still follows an ``excitation``: correlation (-1..1) at
    its worst lag [samples] against its limit; ``passed`` where it stays within.

    visible [-]: the test's power: a response that the model lacks fails it from this share on of
    what the excitation makes of the signal, if it has the same course (NaN: not known; inf: the
    signal does not follow this excitation).
    """

    signal: str
    excitation: str
    correlation: float
    limit: float
    lag: int
    passed: bool
    visible: float = math.nan


@dataclass(frozen=True, slots=True)
class TurningWave:
    """What a fitted ``signal`` of a record holds at ``order`` times its speed, or of a tone (order
    0), beside all that follows the excitation: amplitude cos(order angle + phase [rad]), zero angle
    at the first sample; SI, frequency [Hz] as a mean.

    Motion that unbalance makes and run-out of a sensor's surface are one number here; amplitude's
    standard deviation is that of noise.
    """

    record: int
    signal: str
    order: int
    frequency: float
    amplitude: float
    standard_deviation: float
    phase: float


def turning_waves(
    record: int,
    signals: Sequence[str],
    frequencies: tuple[np.ndarray, Sequence[int]],
    b: np.ndarray,
    noise: np.ndarray,
    samples: int,
    dt: float,
) -> Iterator[TurningWave]:
    """From the amplitudes b (p, 2 f) of cos and sin at the frequencies (f,) [Hz], the first ones of
    these orders, and the residuals' autocovariance noise (p, p, span + 1).
    """
    hertz, orders = frequencies
    lags = np.arange(noise.shape[2])
    for j, frequency in enumerate(hertz.tolist()):
        # S(f) = sum over l of R(l) cos(2 pi f l dt); an amplitude's variance is 2 S/k
        seen = np.where(lags > 0, 2.0, 1.0) * np.cos(2 * np.pi * frequency * dt * lags)
        for i, signal in enumerate(signals):
            z = complex(b[i, 2 * j], -b[i, 2 * j + 1])
            deviation = float(np.sqrt(max(2 * float(noise[i, i] @ seen), 0.0) / samples))
            order = orders[j] if j < len(orders) else 0
            yield TurningWave(
                record, signal, order, frequency, abs(z), deviation, float(np.angle(z))
            )


def check_visible(names: Sequence[str], H: np.ndarray, scale: np.ndarray) -> None:
    """Refuse parameters of which the outputs say nothing, alone or together, before a step is made
    of rounding errors.

    H (q, q) = J'J, scale (q,): the sizes of the parameters. Raises InvalidInput naming them.
    """
    effect = np.sqrt(np.maximum(np.diag(H), 0.0)) * scale
    for name, value in zip(names, effect, strict=True):
        if not value > _VISIBLE * effect.max():
            remedy = (
                "give the delay as it is (--delay-samples)" if name in TIMING else "excite its axis"
            )
            raise InvalidInput(
                f"these records do not determine {name}; {remedy}, or take it as known"
            )

    # unit diagonal: a small eigenvalue is a combination that changes nothing
    values, vectors = np.linalg.eigh(H * scale * scale[:, None] / effect / effect[:, None])
    if values[0] < _VISIBLE:
        together = [
            name for name, part in zip(names, vectors[:, 0], strict=True) if abs(part) > 0.1
        ]
        raise InvalidInput(
            f"these records cannot tell {' from '.join(together)}; excite where they differ, or "
            "take all but one as known"
        )


def memory(samples: int) -> int:
    """Over how many samples noise is taken to remember, in a record of ``samples``."""
    return max(2, min(samples // 10, _LONGEST))


def tapered(products: np.ndarray, samples: int) -> np.ndarray:
    """The autocovariance (..., span + 1) under Parzen's window from sums of products at the lags 0
    to span.
    """
    span = products.shape[-1] - 1
    return products / samples * _parzen(np.arange(span + 1) / span)


def _parzen(x: np.ndarray) -> np.ndarray:
    return np.where(x <= 0.5, 1 - 6 * x**2 + 6 * x**3, 2 * (1 - x) ** 3)


def sandwich_covariance(H: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """H^-1 middle H^-1 (q, q), symmetric, with H = J'J (q, q); both scaled by H's diagonal
    first.
    """
    size = np.sqrt(np.diag(H))
    inverse = np.linalg.inv(H / size / size[:, None])
    covariance = inverse @ (middle / size / size[:, None]) @ inverse / size / size[:, None]
    return (covariance + covariance.T) / 2


def step_with_prior(
    H: np.ndarray, g: np.ndarray, middle: np.ndarray, prior: np.ndarray, off: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The step d (q,) to the likeliest values and their covariance (q, q) where some are known
    before: normal, standard deviations prior (q,) (inf: not known), the values now ``off`` (q,)
    from there.

    H = J'J (q, q), g = J'r (q,), middle = M (q, q) the covariance of g, L = diag(1/prior^2):
    (H M^-1 H + L) d = H M^-1 g - L off, and the inverse of that matrix is the covariance (Bayes'
    rule; Ljung 1999, section 7.4). Raises NumericalFailure where values that nobody knows are not
    told apart.
    """
    # unit diagonals; a value of which nothing is seen keeps its prior
    diagonal = np.diag(H)
    size = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    H, g, middle = H / size / size[:, None], g / size, middle / size / size[:, None]
    L = np.diag(1 / np.maximum(prior * size, 1e-150) ** 2)

    # M^-1 by its eigenvalues, those of rounding raised
    values, vectors = np.linalg.eigh((middle + middle.T) / 2)
    inverse = (vectors / np.maximum(values, _ROUNDING * values[-1])) @ vectors.T
    A = H @ inverse @ H + L
    if not np.isfinite(A).all() or np.linalg.cond(A) > 1 / np.finfo(float).eps:
        raise NumericalFailure("these records do not tell the values apart")
    step = np.linalg.solve(A, H @ inverse @ g - L @ (off * size)) / size
    covariance = np.linalg.inv(A) / size / size[:, None]
    return step, (covariance + covariance.T) / 2


def column_cosine(H: np.ndarray) -> np.ndarray:
    """The cosines (q, q) of the angles between the columns of J, from H = J'J: NOT a correlation,
    mostly of the other sign.
    """
    size = np.sqrt(np.diag(H))
    return H / size / size[:, None]


def parameter_correlation(H: np.ndarray) -> np.ndarray:
    """The parameters' correlation (q, q), (J'J)^-1 scaled to a unit diagonal, as white noise would
    make it.
    """
    return column_cosine(np.linalg.inv(column_cosine(H)))


def input_test(
    crossed: np.ndarray,
    own_r: np.ndarray,
    own_e: np.ndarray,
    k: int,
    signal: str,
    name: str,
    tests: int,
    quiet: bool = False,
    response: float = math.nan,
) -> ResidualTest:
    """Does the residual r (k,) still follow the excitation e (k,), 0 to some lags later? 99 % over
    all ``tests`` of a run.

    From the sums over k samples of r(t) e(t - lag) (lags,), r(t) r(t - lag) and e(t) e(t - lag)
    (both of the same length), means taken off; quiet: the residual is only rounding. The limit is
    the normal one with the variance sum_l R_r(l) R_e(l)/k, which allows for the colour of both;
    Ljung (1999), section 16.6. response: the largest of the sums ``crossed`` with the signal itself
    in the place of its residual.
    """
    from scipy.special import ndtri

    energy = float(np.sqrt(max(own_r[0], 0.0) * max(own_e[0], 0.0)))
    if quiet or energy == 0:
        return ResidualTest(signal, name, 0.0, 1.0, 0, True)
    lags = len(crossed) - 1
    span = len(own_r) - 1

    # Bartlett: var rho = sum over l of rho_r(l) rho_e(l)/k, under Parzen's window
    rho = crossed / energy
    product = own_r / own_r[0] * own_e / own_e[0] * _parzen(np.arange(span + 1) / span)
    variance = max(float(product[0] + 2 * product[1:].sum()), 0.1) / k

    # Bonferroni over all tests and their lags, two-sided
    limit = float(-ndtri((1 - _CONFIDENCE) / 2 / (tests * (lags + 1)))) * variance**0.5
    worst = int(np.argmax(np.abs(rho)))
    visible = limit * energy / response if response else math.inf
    return ResidualTest(
        signal, name, float(rho[worst]), limit, worst, bool(abs(rho[worst]) <= limit), visible
    )


def warnings_of(
    paths: tuple[str, ...],
    minimum: Minimum,
    covariance: np.ndarray,
    correlation: np.ndarray,
    tests: Sequence[ResidualTest],
    verdict: str,
) -> Iterator[Finding]:
    """What makes the result doubtful: not converged, hardly visible, hardly told apart, residuals
    that follow an excitation.
    """
    if not minimum.converged:
        what = f"not converged after {minimum.iterations} steps"
        yield Finding(
            Code.NOT_CONVERGED, WARNING, what, remedy="begin elsewhere, or leave a parameter out"
        )
    for path, value, deviation in zip(paths, minimum.x, np.sqrt(np.diag(covariance)), strict=True):
        if value != 0 and deviation > _UNSURE * abs(value):
            what = f"{path} = {value:.4g} has the standard deviation {deviation:.2g}"
            remedy = "excite its axis more, record longer, or take it as known"
            if path.startswith("rotor."):
                remedy = (
                    "it may stand for a peak of the noise: take the mode as known, its frequency "
                    "too, or excite it more"
                )
            yield Finding(
                Code.HARDLY_VISIBLE, WARNING, what, "barely visible in these records", remedy
            )
    known = np.sqrt(np.diag(covariance)) <= _TOLD * np.abs(minimum.x)
    for i, j in zip(*np.nonzero(np.triu(np.abs(correlation) > _ALIKE, 1)), strict=True):
        if known[i] and known[j]:
            continue
        what = f"{paths[i]} and {paths[j]} are correlated by {correlation[i, j]:.3f}"
        remedy = "excite where they differ (other frequencies, other axes), or take one as known"
        yield Finding(Code.CORRELATED, WARNING, what, "hardly told apart", remedy)
    if not all(test.passed for test in tests):
        yield Finding(Code.RESIDUALS, WARNING, verdict)
    elif (powers := power_of(tests)) and min(powers.values()) > _BLIND:
        what = (
            f"the residual tests see what the model lacks only from {min(powers.values()):.0%} of "
            "the excited response on"
        )
        remedy = (
            "excite more, record longer, tell the record's speed if the rotor turns, or a --tone"
        )
        yield Finding(
            Code.BLIND, WARNING, what, "noise, or motion that nothing excited, hides it", remedy
        )


def power_of(tests: Sequence[ResidualTest]) -> dict[str, float]:
    """From which share of the excited response on one that the model lacks would show, by its best
    test: {signal: share}.
    """
    visible: dict[str, float] = {}
    for test in tests:
        if math.isfinite(test.visible):
            visible[test.signal] = min(visible.get(test.signal, math.inf), test.visible)
    return visible


def verdict_of(tests: Sequence[ResidualTest], converged: bool = True, lacking: str = "") -> str:
    """One sentence: did the fit converge, do the residuals still follow an excitation, and what to
    look for if so.

    lacking: what the model was found to lack, as half a sentence.
    """
    failed = [test for test in tests if not test.passed]
    parts = [] if converged else ["NOT CONVERGED, these values are not the best ones"]
    if failed:
        worst = max(failed, key=lambda test: abs(test.correlation) / test.limit)
        parts.append(
            f"the residual of {worst.signal} still follows {worst.excitation} (correlation "
            f"{worst.correlation:.3f}, "
            f"{abs(worst.correlation) / worst.limit:.1f} times the 99 % limit, {worst.lag} "
            "samples later), and so do "
            f"{len(failed) - 1} of {len(tests) - 1} other pairs"
        )
        lacking = lacking or (
            "the model lacks something: look for a delay, a different controller, a missing "
            "bending mode, magnets beyond their "
            "linear range, or a parameter that is not as known"
        )
    elif lacking:
        parts.append("no residual test fails")
    else:
        powers = sorted(power_of(tests).values())
        share = (
            f"; what it lacks would show from {100 * powers[0]:.2g} to {100 * powers[-1]:.2g} % of "
            "a response on"
            if powers
            else ""
        )
        parts.append(
            "the residuals contain no trace of the excitation: the model explains all that the "
            f"records tell (99 %{share})"
        )
    return "; ".join([*parts, lacking] if lacking else parts)
